"""Froxel fog in a hall with light shafts: how far it is from the truth by grid, and how it looks.

Errors are in the picture's brightest value, of float32, over grids: of the whole fog against a march of every pixel's
ray, and of fog without lamps, noise and shadow against height fog's closed form, whose sun is not dimmed either. A
single frame, and the last of some frames at rest.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from diffrender.atmosphere import froxel_fog, froxel_grid, height_fog
from diffrender.atmosphere.froxel_fog import FroxelFog
from diffrender.atmosphere.froxel_grid import Grid
from diffrender.atmosphere.froxel_lights import Lights, Sunlight
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.parameters import defaults
from diffrender.rays import Rays
from experiments import effects, froxel_scene, records

GRIDS = (Grid(40, 22, 16), Grid(80, 45, 32), Grid(160, 90, 64))
SMALL = Grid(16, 9, 12)
STEPS = 1000  # of the march
FRAMES = 16  # at rest
SHOWN = 6  # frames of the sheet, at a history that suits so few
SHOWN_HISTORY = 0.75
BOTTOM = -50.0  # base height of the fog that is compared with height fog: below all rays [m]
EXPOSURE = 1.0  # of the sheet


def changed(**values: Any) -> FroxelFog:
    """The default fog with some of its numbers changed."""
    return replace(defaults(FroxelFog), **{name: torch.tensor(value) for name, value in values.items()})


def everything() -> Lights:
    """Sun, lamps and probe of the hall."""
    return Lights(froxel_scene.sun(), froxel_scene.lamps(), froxel_scene.probe())


def off(drawn: Tensor, truth: Tensor) -> dict[str, float]:
    """Error of a picture, in the truth's brightest value."""
    apart = (drawn - truth).abs() / truth.max()
    return {"root_mean_square": float(apart.square().mean().sqrt()), "largest": float(apart.max())}


def beside_march(grids: Sequence[Grid], width: int, height: int) -> dict[str, Any]:
    """Errors of the whole fog by grid, and of a march of half the steps, in float64."""
    fog, view = defaults(FroxelFog), froxel_scene.frame(width, height, everything(), seconds=7.0)
    exact, once = effects.in_dtype((fog, froxel_scene.still(view, 1)), torch.float64)
    truth, half = (froxel_fog.march(exact, once, steps)[0] for steps in (STEPS, STEPS // 2))
    found = []
    for grid in grids:
        pictures = froxel_fog.render(fog, froxel_scene.still(replace(view, grid=grid), FRAMES))
        found.append({"grid": asdict(grid), "frame": off(pictures[0], truth), "at_rest": off(pictures[-1], truth)})
    return {"grids": found, "half_the_steps": off(half, truth)}


def beside_height_fog(grids: Sequence[Grid], width: int, height: int) -> list[dict[str, Any]]:
    """Errors of fog that has a closed form, by grid."""
    lit = froxel_scene.sun()
    sun = replace(lit, shadow=None)
    view = replace(
        froxel_scene.frame(width, height, Lights(lit, None, None)), lights=Lights(sun, None, None), noise=None
    )
    fog = changed(base_height=BOTTOM, extinction=0.05)
    truth = closed_form(*effects.in_dtype((fog, view, sun), torch.float64))
    found = []
    for grid in grids:
        drawn = froxel_fog.step(fog, replace(view, grid=grid), None)[0]
        found.append({"grid": asdict(grid), "frame": off(drawn, truth)})
    return found


def closed_form(fog: FroxelFog, view: FroxelView, sun: Sunlight) -> Float[Tensor, "height width 3"]:
    """The same fog by height fog, which no grid ends: rays end where it does."""
    direction, stretch = froxel_grid.directions(view.eye, *view.distance.shape)
    length = torch.minimum(view.distance, view.grid.far * stretch)
    plain = defaults(HeightFog, fog.extinction.dtype)
    tall = replace(
        plain,
        extinction=fog.extinction,
        scale_height=1.0 / fog.height_decay,
        base_height=fog.base_height,
        albedo=fog.albedo,
        rayleigh_share=torch.zeros_like(plain.rayleigh_share),
        asymmetry=fog.asymmetry,
    )
    rays = Rays(view.eye.position, direction, length)
    dark = torch.zeros_like(sun.irradiance)
    return height_fog.render_blend(tall, FogView(rays, view.background, sun.to_sun, sun.irradiance, dark))


def sheet(width: int, height: int, grid: Grid) -> dict[str, Float[Tensor, "h w 3"]]:
    """Pictures by title, each the last of some frames at rest."""
    day, dull = everything(), Lights(None, None, froxel_scene.probe())
    lit_by_sun = Lights(day.sun, None, day.probe)
    night = Lights(None, froxel_scene.lamps(), None)
    billows = {"noise_strength": 1.0, "noise_size": 60.0, "extinction": 0.06, "height_decay": 0.1, "probe": 2.0}
    panels: Mapping[str, tuple[Lights, Mapping[str, Any], float]] = {
        "no fog": (lit_by_sun, {"extinction": 0.0}, 0.0),
        "sun through a roof, default fog": (lit_by_sun, {}, 0.0),
        "EXTINCTION × 3": (lit_by_sun, {"extinction": 0.06}, 0.0),
        "ASYMMETRY 0.8": (lit_by_sun, {"asymmetry": 0.8}, 0.0),
        "ASYMMETRY -0.3": (lit_by_sun, {"asymmetry": -0.3}, 0.0),
        "HEIGHT_DECAY 60, EXTINCTION × 5": (lit_by_sun, {"height_decay": 0.6, "extinction": 0.1}, 0.0),
        "ALBEDO 0.95, 0.8, 0.5": (lit_by_sun, {"albedo": (0.95, 0.8, 0.5)}, 0.0),
        "probe alone, EXTINCTION × 3": (dull, {"extinction": 0.06}, 0.0),
        "a spot and a lamp, no sun": (night, {}, 0.0),
        "NOISE 1 of 60 m, EXTINCTION × 3": (lit_by_sun, billows, 0.0),
        "2 s of wind later": (lit_by_sun, billows, 2.0),
        "4 s of wind later": (lit_by_sun, billows, 4.0),
        "all lights": (day, {}, 0.0),
        "SUN 3": (day, {"sun": 3.0}, 0.0),
        "LOCAL 4": (day, {"local": 4.0}, 0.0),
        "PROBE 4": (day, {"probe": 4.0}, 0.0),
    }
    found = {}
    for title, (lights, changes, seconds) in panels.items():
        view = froxel_scene.frame(width, height, lights, seconds, grid)
        found[title] = froxel_fog.render(changed(history=SHOWN_HISTORY, **changes), froxel_scene.still(view, SHOWN))[-1]
    return found


def draw(path: Path, width: int, height: int, grid: Grid) -> None:
    """Write the sheet as PNG, the same exposure for all."""
    figure = Figure(figsize=(16.0, 9.9), layout="constrained")
    for place, (title, picture) in zip(figure.subplots(4, 4).flat, sheet(width, height, grid).items(), strict=True):
        shown = (EXPOSURE * picture / (1.0 + EXPOSURE * picture)).clamp(0.0, 1.0) ** (1.0 / 2.2)
        place.imshow(shown.numpy(), interpolation="nearest")
        place.set_title(title, fontsize="small")
        place.set_axis_off()
    figure.savefig(path, dpi=90)


def size_of(grid: Mapping[str, Any]) -> str:
    """Columns, rows and slices in words."""
    return " x ".join(str(grid[axis]) for axis in ("columns", "rows", "slices"))


def tables(content: Mapping[str, Any]) -> str:
    """Text of the tables."""

    def numbers(error: Mapping[str, float]) -> list[str]:
        return [f"{error['root_mean_square']:.2g}", f"{error['largest']:.2g}"]

    march = content["march"]
    rows = [[size_of(row["grid"]), *numbers(row["frame"]), *numbers(row["at_rest"])] for row in march["grids"]]
    rows.append(["march of half the steps", *numbers(march["half_the_steps"]), "", ""])
    closed = [[size_of(row["grid"]), *numbers(row["frame"])] for row in content["height_fog"]]
    return "\n\n".join(
        [
            records.table(["beside a march", "frame: rms", "largest", "at rest: rms", "largest"], rows),
            records.table(["beside height fog", "rms", "largest"], closed),
        ]
    )


@torch.no_grad()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the errors, and draw the sheet."""
    parser = argparse.ArgumentParser(description="errors and looks of froxel fog")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    full = given.size == "full"
    grids, judged = (GRIDS, (64, 36)) if full else ((SMALL.halved(), SMALL), (8, 5))
    content = {"march": beside_march(grids, *judged), "height_fog": beside_height_fog(grids, *judged)}
    print(tables(content))
    records.write(given.out / "froxels.json", content)
    draw(given.out / "froxels.png", *((320, 180, Grid()) if full else (16, 9, SMALL)))


if __name__ == "__main__":
    main()
