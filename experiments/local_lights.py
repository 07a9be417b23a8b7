"""Whether culling lamps changes pictures, and how many lamps tiles and their slices keep.

Random halls of up to so many lamps are drawn by all of them and by lists; the difference is over the brightest pixel.
In every fourth hall some of the lamps cast shadows.
The picture shows a hall of many lamps, how many are in the list of each tile, and how many a pixel looks at by its
slice of depth.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from torch import Tensor

from diffrender.geometry import light_grid
from diffrender.parameters import defaults
from diffrender.shading import local_lights
from diffrender.shading.lamps import LitView, LocalLights
from experiments import hall_shadows, lamp_scenes, records
from experiments.effects import in_dtype

SCENES, SMALL_SCENES = 10_000, 20
SCENE, SCENE_TILE, MOST_LAMPS = (16, 12), 4, 64  # of random halls
EVERY, SHADOWED, ATLAS = 4, 6, 64  # halls in which some lamps cast shadows, how many at most, and texels of their maps
PICTURE, SMALL_PICTURE, TILE = (640, 400), (64, 40), 16
PICTURE_LAMPS = 2_000
EXPOSURE = 6.0
GROUPS = 16  # of tiles, by the length of their lists
CULLED = {"tiles": local_lights.render_tiles, "clusters": local_lights.render_clusters}


def hall(size: tuple[int, int], lamps: int, tile: int, seed: int) -> LitView:
    """A random hall of so many lamps, in float64."""
    draw = torch.Generator().manual_seed(seed)
    shown = lamp_scenes.seen(lamp_scenes.camera(*size), draw)
    return lamp_scenes.view(shown, lamp_scenes.lamps(lamps, draw), tile)


def shaded_hall(size: tuple[int, int], lamps: int, tile: int, seed: int) -> LitView:
    """The same in which the first of the lamps cast shadows."""
    draw = torch.Generator().manual_seed(seed)
    shown = lamp_scenes.seen(lamp_scenes.camera(*size), draw)
    return hall_shadows.shaded(shown, lamp_scenes.lamps(lamps, draw), min(lamps, SHADOWED), tile, ATLAS)


def differences(count: int) -> dict[str, Any]:
    """Largest difference of culled pictures from those of all lamps, in units of their brightest pixel."""
    lights, largest, looked_at = defaults(LocalLights, torch.float64), dict.fromkeys(CULLED, 0.0), 0.0
    lamps = 1 + torch.randint(MOST_LAMPS, (count,), generator=torch.Generator().manual_seed(0))
    lit = darker = 0
    for seed, number in enumerate(lamps.tolist()):
        made = hall if seed % EVERY else shaded_hall
        view = made(SCENE, number, SCENE_TILE, seed)
        whole = local_lights.render(lights, view)
        darker += _is_darker(lights, view, whole)
        brightest = float(whole.max())
        lit += brightest > 0.0
        held = sum(int((group.lists.listed >= 0).sum()) for group in view.groups)
        looked_at += held / len(view.lists.listed) / number / count
        for name, draw in CULLED.items():
            change = float((draw(lights, view) - whole).abs().max())
            largest[name] = max(largest[name], change / brightest if brightest > 0.0 else change)
    return {
        "scenes": count,
        "with_light": lit,
        "darker_by_shadows": darker,
        "mean_share_in_lists": looked_at,
        "largest_difference": largest,
    }


def _is_darker(lights: LocalLights, view: LitView, whole: Tensor) -> bool:
    """Whether shadows change a picture."""
    if view.shadowed is None:
        return False
    bright = replace(view, shadowed=replace(view.shadowed, shadows=None))
    return bool((local_lights.render(lights, bright) - whole).max() > 1e-3 * whole.max())


def held(view: LitView) -> dict[str, float]:
    """Mean and largest number of lamps in tiles' lists and in the part of them that a pixel looks at."""
    in_tiles, in_cells = (view.lists.listed >= 0).sum(-1).double(), in_slices(view)
    return {
        "mean_in_tile": float(in_tiles.mean()),
        "most_in_tile": float(in_tiles.max()),
        "mean_in_cell": float(in_cells.mean()),
        "most_in_cell": float(in_cells.max()),
    }


def in_slices(view: LitView) -> Float[Tensor, "tiles pixels"]:
    """Number of lamps that every pixel looks at by its slice."""
    return (view.lists.last - view.lists.first + 1).clamp(min=0).gather(-1, view.places.slice).double()


def drawn(path: Path, size: tuple[int, int], view: LitView) -> None:
    """A hall, the lamps in its tiles, and those in its pixels' slices."""
    lights = defaults(LocalLights, torch.float32)
    radiance = local_lights.in_groups(local_lights.render_clusters, lights, in_dtype(view, torch.float32), GROUPS)
    in_tiles = (view.lists.listed >= 0).sum(-1, keepdim=True).expand(radiance.shape[:2])
    width, height = size
    lit, tiles, pixels = (
        light_grid.from_tiles(one, height, width, TILE) for one in (radiance, in_tiles, in_slices(view))
    )
    figure = Figure(figsize=(18.0, 4.4), layout="constrained")
    panels = figure.subplots(1, 3)
    panels[0].imshow((1.0 - torch.exp(-EXPOSURE * lit)).clamp(0.0, 1.0).pow(1.0 / 2.2).numpy())
    panels[0].set_title(f"{len(view.lamps.reach)} lamps")
    for panel, shown, title in (
        (panels[1], tiles, "lamps in the tile's list"),
        (panels[2], pixels, "lamps that a pixel looks at in its slice of 32"),
    ):
        # By its root: the few tiles at edges of depth hold ten times as many as the others.
        image = panel.imshow(shown.numpy(), cmap="inferno", norm=PowerNorm(0.5, 0.0, float(tiles.max())))
        panel.set_title(f"{title}, {float(shown.double().mean()):.0f} on average")
        figure.colorbar(image, ax=panel, shrink=0.8)
    for panel in panels:
        panel.set_axis_off()
    figure.savefig(path, dpi=80)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print differences, and write them as JSON and a picture of lamps in tiles."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    is_small = given.size == "small"
    same = differences(SMALL_SCENES if is_small else SCENES)
    print(
        f"{same['scenes']} halls, {same['with_light']} of them lit, {same['darker_by_shadows']} darker by shadows; "
        f"{same['mean_share_in_lists']:.2g} of lamps in lists"
    )
    print(f"largest differences over the brightest pixel: {same['largest_difference']}")
    size = SMALL_PICTURE if is_small else PICTURE
    view = hall(size, PICTURE_LAMPS, TILE, seed=1)
    written = given.out / "local_lights.json"
    records.write(written, {"differences": same, "picture": {"lamps": PICTURE_LAMPS, "size": size} | held(view)})
    drawn(written.with_suffix(".png"), size, view)


if __name__ == "__main__":
    main()
