"""Wet ground over its parameters, and how far the model is from optics.

The picture: a street from dry to flooded; rings on a puddle at three moments, and in less rain; a dry wall and, wet,
its rivulets at three strengths and moments; a dry box over the street from the moment it is set down.

Figures: how much albedo is left of soaked ground by the published model and by Lekner and Dorf; of white surfaces under
an even white sky, how much they send to the eye, by the tables that effects use and by plain sums over directions.
"""

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import defaults
from diffrender.rays import Perspective
from diffrender.shading import brdf, wetness
from diffrender.shading.brdf import Geometry
from diffrender.shading.soaked_ground import wet_albedo
from diffrender.shading.wet_surface import Wetness
from experiments import records, wet_scenes
from experiments.wet_scenes import Weather
from fit import png

PANEL, SMALL_PANEL = (420, 280), (24, 16)
SAMPLES = 2  # along each side of a pixel
GAP = 4  # pixels between panels
COLUMNS = 4
ALBEDOS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8)
COSINES, ROUGHNESSES, METALS = (0.05, 0.2, 0.5, 1.0), (0.2, 0.3, 0.5, 1.0), (0.0, 1.0)
NODES, SMALL_NODES = (2000, 800), (600, 100)  # of sums over directions, by height and round the normal
DRY = {"amount": 0.0, "hole_flood": 0.0, "puddle_flood": 0.0}
FLOODS = (
    DRY,
    {"amount": 1.0, "hole_flood": 0.0, "puddle_flood": 0.0},
    {"amount": 1.0, "hole_flood": 0.6, "puddle_flood": 0.5, "rain": 0.5},
    {"amount": 1.0, "hole_flood": 0.9, "puddle_flood": 0.9, "rain": 1.0},
)
POURING = {"amount": 1.0, "hole_flood": 0.7, "puddle_flood": 1.0, "rain": 1.0}
RINGS = ((POURING, 4.0), (POURING, 4.15), (POURING, 4.3), (POURING | {"rain": 0.3}, 4.3))  # and when [s]
RIVULETS = (DRY, {"amount": 1.0, "trickle_strength": 0.5}, {"amount": 1.0, "trickle_strength": 1.0},
            {"amount": 1.0, "trickle_strength": 2.0})  # fmt: skip
SINCE = (0.0, 60.0, 240.0, 1800.0)  # a box was set down [s]
BOX = ((4.5, -0.5, 0.0), (1.8, 1.6, 3.0), 0.4)
ON_THE_WALL = (38.0, 215.0)  # where the sun stands then [degrees]
NEAR_EYE = 0.8  # over a puddle [m]


@dataclass(frozen=True)
class Furnace:
    """What a white surface sends to the eye under a white sky: by the tables, and by sums over directions."""

    metallic: float
    roughness: float
    cosine: float
    table: float
    summed: float


def rain(**changed: float) -> Wetness:
    """Wetness of some values, the others the defaults."""
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in changed.items()}
    return replace(defaults(Wetness, torch.float64), **values)


def panels(width: int, height: int) -> Iterator[Float[Tensor, "height width 3"]]:
    """Radiance of every picture of the sheet, row by row."""
    far, near = (camera(width, height) for camera in (wet_scenes.street_camera, wet_scenes.puddle_camera))
    for flood in FLOODS:
        yield wet_scenes.shown(far, rain(**flood), Weather())
    for flood, time in RINGS:
        yield wet_scenes.shown(near, rain(**flood), Weather(time=time, eye=NEAR_EYE))
    ahead = Perspective(width, height, math.radians(57.0), 0.0)
    for row, strength in enumerate(RIVULETS):
        seen = wet_scenes.wall(ahead, Weather(time=4.0 + 0.5 * row, sun=ON_THE_WALL))
        yield wetness.render(rain(**strength), seen)
    for since in SINCE:
        yield wet_scenes.shown(far, rain(**FLOODS[2]), Weather(box=BOX, elapsed=since))


def sheet(width: int, height: int) -> np.ndarray:
    """All pictures as a screen shows them, side by side."""
    seen = [_displayed(panel) for panel in panels(SAMPLES * width, SAMPLES * height)]
    rows = [np.concatenate(seen[start : start + COLUMNS], 1) for start in range(0, len(seen), COLUMNS)]
    return np.concatenate(rows, 0)


def _displayed(radiance: Tensor) -> np.ndarray:
    high, wide = (size // SAMPLES for size in radiance.shape[:2])
    mean = radiance.reshape(high, SAMPLES, wide, SAMPLES, 3).mean((1, 3))
    shown = (1.0 - torch.exp(-mean)).clamp(min=0.0) ** (1.0 / 2.2)
    pixels = np.rint(255.0 * shown.numpy()).astype(np.uint8)
    return np.pad(pixels, ((0, GAP), (0, GAP), (0, 0)), constant_values=255)


def left_of_albedo() -> list[dict[str, float]]:
    """Albedo of soaked ground by both models, and the published model's at the default and the share that optics gives.

    The published model has one share for all ground, whatever its albedo.
    """
    kept = float(defaults(Wetness, torch.float64).soaked_albedo)
    found = []
    for dry in ALBEDOS:
        wet = float(wet_albedo(torch.tensor(dry, dtype=torch.float64)))
        found.append({"dry": dry, "lagarde": kept * dry, "lekner_dorf": wet, "share_by_optics": wet / dry})
    return found


def furnace(heights: int, turns: int) -> list[Furnace]:
    """White surfaces under a white sky."""
    return [
        Furnace(metallic, roughness, cosine, *_sent(metallic, roughness, cosine, (heights, turns)))
        for metallic in METALS
        for roughness in ROUGHNESSES
        for cosine in COSINES
    ]


def _sent(metallic: float, roughness: float, cosine: float, nodes: tuple[int, int]) -> tuple[float, float]:
    def number(value: float) -> Tensor:
        return torch.tensor(value, dtype=torch.float64)

    white = brdf.material(torch.ones(3, dtype=torch.float64), number(roughness), number(metallic))
    rise, turn = ((torch.arange(count, dtype=torch.float64) + 0.5) / count for count in nodes)
    # Steps finest at the horizon and round the mirror's direction, where a grazing eye sees all that there is.
    height, around = rise.square(), math.pi + math.pi * (2.0 * turn - 1.0) ** 3
    solid_angle = 2.0 * rise[:, None] * 6.0 * math.pi * (2.0 * turn - 1.0) ** 2
    level = torch.sqrt(1.0 - height * height)[:, None]
    to_light = torch.stack(
        [level * torch.cos(around), level * torch.sin(around), height[:, None].expand(-1, nodes[1])], -1
    )
    eye = torch.stack([number(math.sqrt(1.0 - cosine * cosine)), number(0.0), number(cosine)])
    up = torch.eye(3, dtype=torch.float64)[2]
    sent = brdf.reflected(white, Geometry(up, eye, to_light))[..., 0]
    return float(brdf.albedo(white, number(cosine))[0]), float((sent * solid_angle).mean())


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures, and write them as JSON and the sheet as a picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=["small", "full"], default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    panel, nodes = (SMALL_PANEL, SMALL_NODES) if given.size == "small" else (PANEL, NODES)
    albedos, white = left_of_albedo(), furnace(*nodes)
    print(records.table(list(albedos[0]), [[f"{value:.3f}" for value in row.values()] for row in albedos]))
    columns = ["metal, roughness, cosine", "by table", "by sums"]
    rows = [[f"{r.metallic:g}, {r.roughness:g}, {r.cosine:g}", f"{r.table:.4f}", f"{r.summed:.4f}"] for r in white]
    print(records.table(columns, rows))
    content = {"panel": panel, "albedos": albedos, "furnace": [vars(row) for row in white]}
    records.write(given.out / "wetness.json", content)
    (given.out / "wetness.png").write_bytes(png.encoded(sheet(*panel)))


if __name__ == "__main__":
    main()
