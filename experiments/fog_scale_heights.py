"""What one scale height costs where two species thin at different heights: air slowly, haze fast.

The truth is a quadrature of single scattering through both, over flat ground, under one sun. The closed form sees one
fog: the extinction of both at the ground, their shares of it by channel, and one scale height, which is the mean of
the two weighted by optical depth, the smaller, or the larger. Beside that, each species is drawn alone and the light of
both added.
"""

import argparse
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffrender.atmosphere import height_fog, scattering
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.parameters import defaults
from diffrender.rays import Rays, from_angles
from experiments import plots, records

ASYMMETRY, HAZE_ALBEDO = 0.76, 0.9
EYE = 2.0  # above the ground [m]
SCALE_HEIGHTS = (100.0, 400.0, 1_200.0, 8_000.0)  # of the haze [m]; the last is that of the air
HAZES = (1.0, 10.0, 100.0)  # haze in units of a clear day's, at the ground
LENGTHS = (1e3, 1e4, 5e4)  # of rays [m]
SUNS = (5.0, 30.0)  # elevation [degrees]
RAYS, POINTS = 12, 4_000  # rays up to 30 degrees, and points of each in the quadrature
SMALL_POINTS, SMALL_HAZES, SMALL_LENGTHS = 500, (10.0,), (1e4,)


@dataclass(frozen=True, eq=False)
class Air:
    """Two species [1/m at the ground, m], air and haze, and the rays and sun they are seen with."""

    extinction: Tensor  # (2, 3)
    scattering: Tensor  # (2, 3)
    scale_height: Tensor  # (2,)
    view: FogView


def air(haze: float, scale_height: float, length: float, sun: float) -> Air:
    """Air and haze of the sky's constants, the haze in its own amount and scale height."""
    molecules = torch.tensor(scattering.RAYLEIGH, dtype=torch.float64)
    droplets = torch.full_like(molecules, haze * scattering.HAZE)
    elevation = torch.deg2rad(torch.linspace(0.0, 30.0, RAYS, dtype=torch.float64))
    direction = from_angles(elevation, torch.full_like(elevation, 0.4))
    origin = torch.tensor([0.0, 0.0, EYE], dtype=torch.float64)
    rays = Rays(origin, direction, torch.full_like(elevation, length))
    to_sun = from_angles(torch.tensor(math.radians(sun), dtype=torch.float64), torch.tensor(0.0, dtype=torch.float64))
    nothing, one = torch.zeros(3, dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    return Air(
        extinction=torch.stack([molecules, droplets]),
        scattering=torch.stack([molecules, HAZE_ALBEDO * droplets]),
        scale_height=torch.tensor([scattering.RAYLEIGH_HEIGHT, scale_height], dtype=torch.float64),
        view=FogView(rays, nothing, to_sun, one, nothing),
    )


def quadrature(both: Air, points: int) -> tuple[Tensor, Tensor]:
    """Sunlight scattered to the eye per irradiance [1/sr], and transmittance, by the midpoint rule along rays."""
    rays, view = both.view.rays, both.view
    # Dense near the eye, where the haze is.
    border = torch.linspace(0.0, 1.0, points + 1, dtype=torch.float64).square()
    middle, step = (border[1:] + border[:-1]) / 2.0, border[1:] - border[:-1]
    altitude = EYE + rays.direction[:, None, 2] * rays.length[:, None] * middle
    density = torch.exp(-altitude[..., None] / both.scale_height)
    passed = (density @ both.extinction) * (rays.length[:, None] * step)[..., None]
    depth = torch.cumsum(passed, 1) - passed / 2.0
    above = (density * both.scale_height) @ both.extinction / view.to_sun[2]
    through = (
        torch.exp(-depth - above)[..., None, :] * density[..., None] * (rays.length[:, None] * step)[..., None, None]
    )
    return (through.sum(1) * both.scattering * phases(both)).sum(1), torch.exp(-passed.sum(1))


def phases(both: Air) -> Tensor:
    """Phase functions of air and haze along each ray [1/sr]: (rays, 2, 1)."""
    chord_square = (both.view.rays.direction - both.view.to_sun).square().sum(-1)
    droplets = scattering.henyey_greenstein(chord_square, torch.tensor(ASYMMETRY, dtype=torch.float64))
    return torch.stack([scattering.rayleigh_phase(chord_square), droplets], -1)[..., None]


def fog(extinction: Tensor, scattered: Tensor, scale_height: Tensor) -> HeightFog:
    """One fog of species (n, 3), air first, that share a scale height."""
    total, light = extinction.sum(0), scattered.sum(0)
    changed = {
        "extinction": total.mean(),
        "extinction_tint": total / total.mean(),
        "scale_height": scale_height,
        "albedo": light / total,
        "rayleigh_share": scattered[0] / light,
        "asymmetry": torch.tensor(ASYMMETRY, dtype=torch.float64),
    }
    return HeightFog(**(vars(defaults(HeightFog, torch.float64)) | changed))


def one_height(both: Air, scale_height: Tensor) -> tuple[Tensor, Tensor]:
    """The closed form of one fog with a scale height: scattered sunlight and transmittance."""
    single = fog(both.extinction, both.scattering, scale_height)
    return height_fog.render_flat(single, both.view), torch.exp(-height_fog.optical_depth(single, both.view.rays))


def each_alone(both: Air) -> tuple[Tensor, Tensor]:
    """Closed forms of both species, one under sunlight that the other has dimmed and behind half of the other's depth.

    So a game draws it, where the air comes from a sky's tables and the fog is given the sunlight at the eye.
    """
    no_air = torch.zeros(3, dtype=torch.float64)
    apart = [
        fog(both.extinction[:1], both.scattering[:1], both.scale_height[0]),
        fog(both.extinction[1:], torch.stack([no_air, both.scattering[1]]), both.scale_height[1]),
    ]
    depths = [height_fog.optical_depth(one, both.view.rays) for one in apart]
    above = [one.scale_height * height_fog.extinction(one) / both.view.to_sun[2] for one in apart]
    light = [height_fog.render_flat(one, both.view) for one in apart]
    others = ((0, 1), (1, 0))
    total = sum(light[one] * torch.exp(-depths[other] / 2.0 - above[other]) for one, other in others)
    assert isinstance(total, Tensor)
    return total, torch.exp(-depths[0] - depths[1])


def rows(points: int, lengths: Sequence[float], hazes: Sequence[float]) -> list[dict[str, Any]]:
    """Errors of each way for each air."""
    found = []
    for sun, length, scale_height, haze in itertools.product(SUNS, lengths, SCALE_HEIGHTS, hazes):
        row = {"sun_degrees": sun, "length": length, "scale_height": scale_height, "haze": haze}
        found.append(row | errors(air(haze, scale_height, length, sun), points))
    return found


def errors(both: Air, points: int) -> dict[str, float]:
    """Largest error over the rays: of scattered light over the brightest, and of transmittance."""
    truth, through = quadrature(both, points)
    depth = (both.extinction * both.scale_height[:, None]).mean(-1)
    mean = (depth * both.scale_height).sum() / depth.sum()
    ways = {
        "mean height": one_height(both, mean),
        "haze's height": one_height(both, both.scale_height[1]),
        "air's height": one_height(both, both.scale_height[0]),
        "each alone": each_alone(both),
    }
    told = {}
    for name, (light, passed) in ways.items():
        told[f"{name}, light"] = float((light - truth).abs().max() / truth.max())
        told[f"{name}, transmittance"] = float((passed - through).abs().max())
    return told


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it as JSON and as a chart."""
    parser = argparse.ArgumentParser(description="what one scale height costs")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    full, small = (POINTS, LENGTHS, HAZES), (SMALL_POINTS, SMALL_LENGTHS, SMALL_HAZES)
    found = rows(*(full if given.size == "full" else small))
    print(table(found))
    written = given.out / "fog_scale_heights.json"
    records.write(written, {"records": found})
    plots.fog_scale_heights(written)


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """Text of the table."""
    names = [name for name in found[0] if ", " in name]
    given = ("scale_height", "haze", "length", "sun_degrees")
    lines = [[f"{row[name]:g}" for name in given] + [f"{row[name]:.3f}" for name in names] for row in found]
    return records.table([*given, *names], lines)


if __name__ == "__main__":
    main()
