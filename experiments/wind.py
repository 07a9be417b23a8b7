"""Wind in a meadow, a plant, a banner and hair: how they look, and whether stems and bones keep their lengths.

Lengths are compared in float32 and float64: of stems the rate at which the bent stem's place changes with height,
which is 1 for a stem that keeps its length; of bones every one at every step.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from matplotlib.figure import Figure, SubFigure
from torch import Tensor

from diffrender.weather import bending, wind
from diffrender.weather.bones import Chain
from experiments import effects, records, wind_scene, wind_sheet
from experiments.wind_scene import Hung, Meadow

SPEEDS = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
PLANT_SPEEDS = (0.0, 4.0, 8.0, 12.0, 18.0)
FLEXIBILITIES = (0.003, 0.01, 0.04)
PLANT = 1.0  # length [m]
MEADOW_TIMES = (1.6, 2.1, 2.6, 3.1)
HUNG_TIMES = (0.5, 1.1, 1.4, 1.8, 2.3, 3.0)
MIDDLE = 9.0  # distance at which the meadow's curve is drawn [m]
INTEGRATED = 30.0  # seconds that are integrated
DRAWN = {"banner": wind_sheet.draw_banner, "hair": wind_sheet.draw_hair}


@dataclass(frozen=True)
class Size:
    """How much is drawn and measured."""

    blades: int
    chains: int
    strands: int
    joints: int
    rate: int  # steps in a second
    quadrature: int  # steps of the integral
    stride: int  # of the times that are drawn, in all times


SIZES = {"small": Size(60, 4, 6, 5, 10, 1000, 5), "full": Size(22_000, 25, 700, 13, 120, 20_000, 1)}


def tangents(
    lean: Float[Tensor, "*batch 2"], length: Float[Tensor, "*batch"], share: float
) -> Float[Tensor, "*batch 3"]:
    """Change of a stem's place with height, at a share of its height; of length 1 where it keeps its length."""
    upright = torch.cat([torch.zeros_like(lean), length[..., None]], -1)
    ahead = torch.zeros_like(upright)
    ahead[..., 2] = 1.0
    tangent: Tensor = torch.func.jvp(lambda place: bending.bent(place, lean, length), (share * upright,), (ahead,))[1]
    return tangent


def stem_lengths(land: Meadow) -> float:
    """Largest relative change of length of the meadow's stems over all speeds."""
    steady = [leans(land, speed) for speed in SPEEDS]
    rates = [tangents(lean, land.length, share).norm(dim=-1) for lean in steady for share in (0.0, 0.5, 1.0)]
    return float((torch.stack(rates) - 1.0).abs().max())


def leans(land: Meadow, speed: float) -> Float[Tensor, "blades 2"]:
    """Leans in a steady wind along x."""
    return bending.lean(land.root.new_tensor([speed, 0.0, 0.0]).expand(land.root.shape), land.flexibility)


def mean_leans(land: Meadow) -> list[dict[str, float]]:
    """Mean angle between the tips of upright stems and the vertical by speed of a steady wind, in degrees."""
    found = []
    for speed in SPEEDS:
        ahead = tangents(leans(land, speed), land.length, 1.0)
        angle = torch.atan2(ahead[:, :2].norm(dim=-1), ahead[:, 2])
        found.append({"speed": speed, "degrees": math.degrees(float(angle.mean()))})
    return found


def bone_lengths(hung: Hung, size: Size) -> float:
    """Largest relative change of length of bones over all steps."""
    resting = hung.bones.rest.diff(dim=-2).norm(dim=-1)
    chains = moved(hung, size)
    return max(float((chain.joint.diff(dim=-2).norm(dim=-1) / resting - 1.0).abs().max()) for chain in chains)


def moved(hung: Hung, size: Size) -> list[Chain]:
    """Chains until the last picture."""
    waves = effects.in_dtype(wind_scene.close_wind(), hung.root.dtype)
    return wind_scene.swung(hung, waves, HUNG_TIMES[-1], size.rate)


def displacement_error(waves: Sequence[wind.Wave], steps: int) -> float:
    """Largest difference of the displacement from the midpoint rule on the velocity, over some places [m]."""
    place = 20.0 * torch.randn(8, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    times = (torch.arange(steps, dtype=torch.float64)[:, None] + 0.5) * (INTEGRATED / steps)
    summed = wind.velocity(waves, place.expand(steps, 8, 3), times).mean(0) * INTEGRATED
    return float((wind.displacement(waves, place, place.new_tensor(INTEGRATED)) - summed).norm(dim=-1).max())


def measured(land: Meadow, hung: Mapping[str, Hung], size: Size) -> dict[str, Any]:
    """All numbers."""
    lengths = {}
    for dtype in (torch.float32, torch.float64):
        plants, chains = effects.in_dtype((land, dict(hung)), dtype)
        here = {"stems": stem_lengths(plants)} | {name: bone_lengths(one, size) for name, one in chains.items()}
        lengths[str(dtype).removeprefix("torch.")] = here
    waves = [*wind_scene.meadow_wind(), *wind_scene.close_wind()]
    return {
        "largest_relative_change_of_length": lengths,
        "mean_lean": mean_leans(land),
        "displacement_beside_integral": [
            {"steps": steps, "metres": displacement_error(waves, steps)}
            for steps in (size.quadrature // 2, size.quadrature)
        ],
    }


def draw(path: Path, land: Meadow, hung: Mapping[str, Hung], size: Size) -> None:
    """Write the sheet as PNG."""
    figure = Figure(figsize=(14.0, 19.6), layout="constrained")
    parts = figure.subfigures(3, 1, height_ratios=(12.4, 1.9, 5.3), squeeze=False)
    top, middle, bottom = parts[:, 0]
    _draw_meadows(top, land, MEADOW_TIMES[:: size.stride])
    _draw_plants(middle)
    _draw_hung(bottom, hung, size)
    figure.savefig(path, dpi=75)


def _draw_meadows(part: SubFigure, land: Meadow, times: Sequence[float]) -> None:
    waves = wind_scene.meadow_wind()
    rows = part.subplots(len(times), 2, width_ratios=(1.0, 4.0), squeeze=False)
    for (beside, strip), seconds in zip(rows, times, strict=True):
        wind_sheet.draw_curve(beside, waves[0], MIDDLE, seconds)
        wind_sheet.draw_meadow(strip, land, waves, seconds)
        wind_sheet.draw_arrows(strip, waves, MIDDLE, seconds)
    rows[-1, 0].set_xlabel("metres to the right; shaded:\nwhat the picture shows 9 m away", fontsize="small")
    part.suptitle("A drawn gust travels through a meadow; red: keyframes")


def _draw_plants(part: SubFigure) -> None:
    for axes, flexibility in zip(part.subplots(1, len(FLEXIBILITIES)), FLEXIBILITIES, strict=True):
        wind_sheet.draw_plants(axes, PLANT_SPEEDS, flexibility, PLANT)
    part.suptitle("One plant in rising wind; dots at quarters of its stem, dotted: path of a tip that keeps its length")


def _draw_hung(part: SubFigure, hung: Mapping[str, Hung], size: Size) -> None:
    waves, times = wind_scene.close_wind(), HUNG_TIMES[:: size.stride]
    for row, (name, one) in zip(part.subplots(len(hung), len(times), squeeze=False), hung.items(), strict=True):
        chains = moved(one, size)
        for axes, seconds in zip(row, times, strict=True):
            DRAWN[name](axes, chains[round(seconds * size.rate)])
            speed = wind.velocity(waves[:1], one.root[0], one.root.new_tensor(seconds))[0]
            axes.set_title(f"t = {seconds:g} s, {float(speed):.1f} m/s", loc="left", fontsize="small")
    part.suptitle("Chains of bones in a gust and its eddies: cloth from a bar, and hair")


def tables(content: Mapping[str, Any]) -> str:
    """Text of the tables."""
    lengths = content["largest_relative_change_of_length"]
    names = list(lengths["float64"])
    return "\n\n".join(
        [
            records.table(
                ["change of length", *names],
                [[kind, *(f"{row[name]:.1e}" for name in names)] for kind, row in lengths.items()],
            ),
            records.table(
                ["wind in m/s", "mean lean in degrees"],
                [[f"{row['speed']:g}", f"{row['degrees']:.1f}"] for row in content["mean_lean"]],
            ),
            records.table(
                ["steps of the integral", "off by m"],
                [[str(row["steps"]), f"{row['metres']:.1e}"] for row in content["displacement_beside_integral"]],
            ),
        ]
    )


@torch.no_grad()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the numbers, and draw the sheet."""
    parser = argparse.ArgumentParser(description="plants, cloth and hair in the wind")
    parser.add_argument("--size", choices=tuple(SIZES), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    size = SIZES[given.size]
    land = wind_scene.meadow(size.blades, near=4.0, far=200.0)
    hung = {"banner": wind_scene.banner(size.chains, size.joints), "hair": wind_scene.hair(size.strands, size.joints)}
    content = measured(land, hung, size)
    print(tables(content))
    records.write(given.out / "wind.json", content)
    draw(given.out / "wind.png", land, hung, size)


if __name__ == "__main__":
    main()
