"""Fitted sharpening beside plain averaging, Catmull-Rom and an exhaustive search, on photos with detail.

The search goes through a grid of thresholds, blends and responses, each with the best lobes on a fine grid, and draws
every picture anew. For the second table the photos are dealt into two halves; each half is drawn with what was fitted
to the other. FLIP [1] is that of standard range, because it is given what such a screen is sent; haloes are how far a
picture leaves the range of the truth's nearest 3 x 3 pixels, root mean square.

Samples of footprint 1 in the pixels' centres are the truth itself, so that "none" has no error there.

[1] P. Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020.
"""

import argparse
import importlib
import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from diffrender.antialiasing import edge_taa, fxaa
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.parameters import defaults, specifications
from experiments import records
from fit import png, sampled_photo, sharpening, sharpening_pictures
from fit.input_error import InputError
from fit.photo import read
from fit.sampled_photo import TILE, Sampling, Scenery, Views, inner
from fit.sharpening_objective import SharpeningObjective

PHOTOS = Path(__file__).parent / "photos"
FOOTPRINTS = (0.0, 0.5, 1.0)
TILES = 4  # of each photo, at most
LEAST_DETAIL = 1e-3  # mean square of what a photo shows finer than pixels in its best tile: less is sky
THRESHOLDS = (0.0625, 0.125, 0.25, 0.4, 0.55, 0.7)
BLENDS = (0.0, 0.4, 0.8)
RESPONSES = (0.0, 1.0, 4.0, 16.0)
LOBES = 101  # from one bound to the other
LOBE_BOUNDS = specifications(AntiAliasing)["sharpening"].bounds
Grid = tuple[Sequence[float], Sequence[float], Sequence[float]]
GRID: Grid = (THRESHOLDS, BLENDS, RESPONSES)
SMALL_GRID: Grid = ((0.25,), (0.75,), (0.0, 2.0))
CROPS, ENLARGED, GAP = 6, 3, 4
SHOWN = ("average", "catmull-rom", "without fxaa", "fitted", "reference")


def views_of(path: Path, footprint: float) -> tuple[Scenery, Views] | None:
    """Tiles of a photo; None where it has too little detail."""
    try:
        scenery = sampled_photo.scenery(read(path), Sampling(footprint=footprint), None)
        corners = sampled_photo.tiles(scenery, TILES)
    except InputError:
        return None
    if sampled_photo.detail(scenery, corners[0]) < LEAST_DETAIL:
        return None
    return scenery, scenery.views(corners, (TILE, TILE), torch.float64)


def joined(several: Sequence[Views]) -> Views:
    """Views of several photos."""
    return Views(
        torch.cat([one.frames for one in several]),
        torch.cat([one.truth for one in several]),
        torch.cat([one.centres for one in several]),
        torch.cat([one.motion for one in several]),
    )


def fitted(views: Views) -> AntiAliasing:
    """Settings that are fitted to views."""
    options = sharpening.Options()
    objective = SharpeningObjective(sharpening.search_space(options), views)
    found = objective.space.scene(torch.from_numpy(sharpening.search(objective, options).point)).antialiasing
    assert found is not None
    return found


def exhausted(views: Views, grid: Grid) -> float:
    """Least error on a grid, as a ratio of the peak to it [dB]."""
    thresholds, blends, responses = grid
    usual = defaults(AntiAliasing, torch.float64)
    tried = [views.frames]  # without FXAA
    for threshold, blend in product(thresholds, blends):
        one = usual.subpixel.new_tensor
        # The same threshold in the dark: of those in the light alone, the fit finds it of no use or worse.
        for minimum in (threshold, 0.0312):
            chosen = replace(
                usual, edge_threshold=one(threshold), edge_threshold_minimum=one(minimum), subpixel=one(blend)
            )
            tried.append(fxaa.preset(chosen, views.frames, quality=12))
    return max(_with_best_lobes(smoothed, views.truth, responses) for smoothed in tried)


def _with_best_lobes(smoothed: Tensor, truth: Tensor, responses: Sequence[float]) -> float:
    share = np.linspace(0.0, 1.0, LOBES)
    found = []
    for response in responses:
        plain, sharpest = (inner(resolved(smoothed, lobe, response)) for lobe in LOBE_BOUNDS)
        error, slope = (plain - inner(truth)).flatten(), (sharpest - plain).flatten()
        # The mean square of error + share slope, at every share of the grid.
        squares = float(error @ error) + 2.0 * share * float(error @ slope) + share**2 * float(slope @ slope)
        found.append(float(squares.min()) / error.numel())
    return float(-10.0 * np.log10(max(min(found), 1e-20)))  # 200 at most, as `psnr`


def resolved(smoothed: Tensor, lobe: float, response: float) -> Tensor:
    """Mean of both frames, resampled to centres."""
    usual = defaults(AntiAliasing, torch.float64)
    one = usual.sharpening.new_tensor
    chosen = replace(usual, sharpening=one(lobe), contrast_response=one(response))
    even, odd = (edge_taa.centred(chosen, frame, count)[1] for count, frame in enumerate(smoothed.unbind(1)))
    return (even + odd) / 2


def halo(picture: Tensor, truth: Tensor) -> float:
    """How far a picture leaves the range of the truth's nearest 3 x 3 pixels, root mean square."""
    channels = truth.movedim(-1, -3).flatten(0, -3)
    high, low = (way * torch.nn.functional.max_pool2d(way * channels[:, None], 3, 1, 1)[:, 0] for way in (1.0, -1.0))
    drawn = picture.movedim(-1, -3).flatten(0, -3)
    return float(torch.maximum(drawn - high, low - drawn).clamp(min=0.0).square().mean().sqrt())


def flip(picture: Tensor, truth: Tensor) -> float | None:
    """Mean FLIP of pictures for a screen of standard range; None where its package is not installed."""
    if importlib.util.find_spec("flip_evaluator") is None:
        return None
    evaluate = importlib.import_module("flip_evaluator").evaluate
    pairs = zip(truth.clamp(0.0, 1.0).float(), picture.clamp(0.0, 1.0).float(), strict=True)
    return float(np.mean([evaluate(right.numpy(), drawn.numpy(), "LDR")[1] for right, drawn in pairs]))


def row(name: str, footprint: float, views: Views, settings: AntiAliasing) -> dict[str, Any]:
    """Scores of every method on the views of one photo."""
    found: dict[str, Any] = {"photo": name, "footprint": footprint}
    scores = sharpening_pictures.scores(settings, views)
    truth = inner(views.truth)
    for method, picture in sharpening_pictures.methods(settings, views).items():
        if method != "reference":
            more = {"halo": halo(inner(picture), truth), "flip": flip(inner(picture), truth)}
            found[method] = scores[method] | more
    return found | {"settings": {name: float(value) for name, value in vars(settings).items()}}


def alone(name: str, footprint: float, views: Views, grid: Grid) -> dict[str, Any]:
    """A photo fitted by itself, beside the exhaustive search."""
    found = row(name, footprint, views, fitted(views))
    best = exhausted(views, grid)
    return found | {"exhaustive": best, "gap": best - found["fitted"]["psnr"]}


def across(all_views: Mapping[str, Views], footprint: float) -> list[dict[str, Any]]:
    """Photos drawn with what was fitted to the other half of them."""
    names = list(all_views)
    halves = (names[::2], names[1::2])
    rows = []
    for mine, others in (halves, halves[::-1]):
        settings = fitted(joined([all_views[name] for name in others]))
        rows += [row(name, footprint, all_views[name], settings) for name in mine]
    return rows


def told(rows: Sequence[Mapping[str, Any]]) -> str:
    """Text of a table of ratios to the error of plain averaging [dB]."""
    methods = ("none", "fxaa", "catmull-rom", "default", "without fxaa", "fitted")
    lines = []
    for one in rows:
        gains = [f"{min(one[method]['psnr'], 100.0) - one['average']['psnr']:.2f}" for method in methods]
        lobe = f"{one['settings']['sharpening']:.3f}"
        gap = f"{one['gap']:.3f}" if "gap" in one else ""
        lines.append([f"{one['photo']} {one['footprint']:g}", *gains, lobe, gap])
    return records.table(["photo and footprint", *methods, "lobe", "gap"], lines)


def means(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Means over photos of what each method gains on plain averaging [dB], and of its other scores."""
    found = []
    for footprint in sorted({one["footprint"] for one in rows}):
        some = [one for one in rows if one["footprint"] == footprint]
        for method in (name for name, score in some[0].items() if isinstance(score, dict) and "psnr" in score):
            mean: dict[str, Any] = {"footprint": footprint, "method": method}
            mean["gain"] = float(np.mean([one[method]["psnr"] - one["average"]["psnr"] for one in some]))
            for name in ("ssim", "halo", "flip"):
                values = [one[method][name] for one in some]
                mean[name] = None if None in values else float(np.mean(values))
            found.append(mean)
    return found


def crops(shown: Sequence[tuple[Scenery, Views, AntiAliasing]]) -> np.ndarray:
    """Crops of the most detailed tile of each, enlarged, methods side by side."""
    rows = []
    for _, views, settings in shown:
        pictures = sharpening_pictures.methods(settings, views.first(1))
        eight = [np.rint(255.0 * inner(pictures[name])[0].clamp(0.0, 1.0).numpy()).astype(np.uint8) for name in SHOWN]
        large = [np.pad(one.repeat(ENLARGED, 0).repeat(ENLARGED, 1), ((0, GAP), (0, GAP), (0, 0))) for one in eight]
        rows.append(np.concatenate(large, 1))
    return np.concatenate(rows, 0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, and write them as JSON and crops as a picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--photos", type=Path, default=PHOTOS)
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    is_small = given.size == "small"
    rows, halves, pictures = [], [], []
    for footprint in FOOTPRINTS[-1:] if is_small else FOOTPRINTS:
        seen = {path.stem: views_of(path, footprint) for path in sorted(given.photos.iterdir()) if is_photo(path)}
        chosen = {name: pair for name, pair in seen.items() if pair is not None}
        if is_small:
            chosen = {name: (scenery, views.first(1)) for name, (scenery, views) in list(chosen.items())[:2]}
        views = {name: pair[1] for name, pair in chosen.items()}
        rows += [alone(name, footprint, one, SMALL_GRID if is_small else GRID) for name, one in views.items()]
        halves += across(views, footprint)
        for name in list(chosen)[:CROPS]:
            settings = next(one["settings"] for one in rows if (one["photo"], one["footprint"]) == (name, footprint))
            record = AntiAliasing(**{key: torch.tensor(value, dtype=torch.float64) for key, value in settings.items()})
            pictures.append((*chosen[name], record))
    print(told(rows), told(halves), sep="\n\nfitted to the other half\n")
    content = {"alone": rows, "across": halves, "means": means(halves)}
    records.write(given.out / "sharpening.json", content)
    (given.out / "sharpening.png").write_bytes(png.encoded(crops(pictures)))


def is_photo(path: Path) -> bool:
    """Whether the name is that of an HDR photo."""
    return path.suffix in {".exr", ".hdr"}


if __name__ == "__main__":
    main()
