"""How well `fit fog` finds the fog of path-traced scenes whose fog is known, and how often its intervals hold it.

`fog_composite.exr` follows the model: surfaces as in `clear.exr`, light scattered once. The noise of its path tracing
is drawn again on top, as many times as asked, so that there is twice its variance, half of it the same in every draw.
`fog_multiple.exr` is the world: light scattered many times, surfaces lit through the fog, shadows in it. It is fitted
with and without the view without fog, and what is lost without is how much wider the intervals are.
"""

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from diffrender.atmosphere import height_fog
from experiments import fog_scenes, plots, records
from fit import fog, sun
from fit import photo as photos
from fit.foggy_photo import Options
from fit.solution import Solution

DRAWS = 20
THREADS = 1  # as the command
NINETY_FIVE = 1.96  # standard errors to each side
EVERY = "all"
NAMES = {"HEIGHT_FOG_EXTINCTION": "density", "HEIGHT_FOG_SCALE_HEIGHT": "scale height"}


@dataclass(frozen=True)
class Found:
    """One of a fog's two numbers as a fit has found it.

    Attributes:
        with_clear: whether the view without fog was given.
        draw: of the noise; None for the picture as it is.
        error: natural logarithm of what was found over what is true.
        standard_error: as the fit tells it, of that logarithm; None where it says that the photo does not determine it.
    """

    scene: str
    picture: str
    with_clear: bool
    draw: int | None
    name: str
    error: float
    standard_error: float | None

    @property
    def is_held(self) -> bool:
        """Whether the interval of 95 % holds the truth; one that was not given has no end."""
        return self.standard_error is None or abs(self.error) <= NINETY_FIVE * self.standard_error


def fits(folder: Path, draws: int) -> Iterator[Found]:
    """What the fits of one scene have found."""
    noise = _noise(folder)
    random = np.random.default_rng(0)
    for draw in range(draws):
        # The channels share their samples, so they share their noise.
        drawn = noise * random.standard_normal((*noise.shape[:2], 1))
        yield from _found(folder, "fog_composite", with_clear=True, draw=draw, noise=drawn)
    for with_clear in (True, False):
        yield from _found(folder, "fog_multiple", with_clear=with_clear, draw=None, noise=np.zeros_like(noise))


def _noise(folder: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Standard error of each pixel and channel of light scattered once, which is all the noise of a composite."""
    scene, _ = fog_scenes.read(folder)
    light = height_fog.phase(scene.fog, scene.view) * scene.fog.albedo * scene.view.irradiance
    relative = light / light[..., fog_scenes.GREEN, None]
    noise: np.ndarray[Any, np.dtype[np.float64]] = (fog_scenes.standard_error(scene)[..., None] * relative).numpy()
    noise[np.isnan(noise)] = 0.0  # of rays without any fog: 0 / 0
    return noise


def _found(
    folder: Path, picture: str, *, with_clear: bool, draw: int | None, noise: np.ndarray[Any, np.dtype[np.float64]]
) -> Iterator[Found]:
    told = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    solution = _fit(folder, told, picture, with_clear=with_clear, noise=noise)
    for name, truth in zip(NAMES, (float(np.mean(told["sigma0"])), told["scale_height"]), strict=True):
        found = solution.parameters[name]
        error = None if found.standard_error is None else found.standard_error / found.value
        yield Found(told["name"], picture, with_clear, draw, NAMES[name], math.log(found.value / truth), error)


def _fit(
    folder: Path, told: dict[str, Any], picture: str, *, with_clear: bool, noise: np.ndarray[Any, np.dtype[np.float64]]
) -> Solution:
    photo = photos.read(
        folder / f"{picture}.exr", "perspective", told["fov_x_degrees"], pitch=told["view_pitch_degrees"]
    )
    noisy = np.maximum(photo.radiance + noise, 0.0).astype(np.float32)
    options = Options(
        distance=folder / "distance.exr",
        clear=folder / "clear.exr" if with_clear else None,
        eye_height=told["eye"][2],
        # Told to the left of the view, asked for to the right.
        sun=sun.given(f"{told['sun_elevation_degrees']},{-told['sun_azimuth_from_view_degrees']}"),
        fixed={"HEIGHT_FOG_BASE_HEIGHT": float(told["z0"])},
    )
    return fog.fit(replace(photo, radiance=noisy), options)


def summary(found: Sequence[Found]) -> list[dict[str, Any]]:
    """Errors and intervals of each way of fitting, over its draws: scene by scene, then of all scenes."""
    rows = []
    for picture, with_clear, name in dict.fromkeys((one.picture, one.with_clear, one.name) for one in found):
        same = [one for one in found if (one.picture, one.with_clear, one.name) == (picture, with_clear, name)]
        for scene in (*dict.fromkeys(one.scene for one in same), EVERY):
            own = [one for one in same if scene in (one.scene, EVERY)]
            given = [one.standard_error for one in own if one.standard_error is not None]
            rows.append(
                {
                    "picture": picture,
                    "with_clear": with_clear,
                    "name": name,
                    "scene": scene,
                    "fits": len(own),
                    "median_error": float(np.median([abs(one.error) for one in own])),
                    "largest_error": max(abs(one.error) for one in own),
                    "determined": len(given),
                    "median_standard_error": float(np.median(given)) if given else None,
                    "held": sum(one.is_held for one in own),
                }
            )
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Text of the table; errors and standard errors in percent."""
    head = ("picture", "clear", "of", "scene", "fits", "median error", "largest", "standard error", "within 95 %")
    lines = [
        [
            row["picture"],
            "given" if row["with_clear"] else "-",
            row["name"],
            row["scene"],
            str(row["fits"]),
            *(f"{100.0 * row[name]:.2f}" for name in ("median_error", "largest_error")),
            "-" if row["median_standard_error"] is None else f"{100.0 * row['median_standard_error']:.2f}",
            f"{row['held']}/{row['fits']}",
        ]
        for row in rows
    ]
    return records.table(head, lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it with every fit as JSON and as a chart."""
    parser = argparse.ArgumentParser(description="fog fitted to path-traced scenes")
    parser.add_argument("--scenes", type=Path, required=True, help="folder of scenes, each a folder")
    parser.add_argument("--draws", type=int, default=DRAWS, help="of the noise")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    torch.set_num_threads(THREADS)
    folders = sorted(path.parent for path in given.scenes.glob("*/scene.json"))
    found = [one for folder in folders for one in fits(folder, given.draws)]
    rows = summary(found)
    print(table(rows))
    written = given.out / "fog_fits.json"
    records.write(written, {"records": rows, "fits": [asdict(one) for one in found]}, THREADS)
    plots.fog_fits(written)


if __name__ == "__main__":
    main()
