"""How well height fog stands in for the far fog of FFXV's weather files, and far fog for height fog.

Columns of rays are drawn by one fog in white light over black, so that the picture is the fog's opacity, and the other
is fitted to that by least squares. Errors are those of opacity: times the difference between the fog's colour and what
is behind it, those of any picture. Colours need no fit, because both send light on alike: TINT is the ambient tint at
an albedo of 1 and without sun.

Height fog starts at the eye, never ends and knows no distance, so it cannot follow ZNEAR, ZFAR, DISTANCE_DECAY, and a
layer that thins downwards. Far fog is grey, ends within 100 km and thins by no less than 10 m; but for that it holds
height fog exactly, with ZNEAR at 0, and the fit starts there.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import least_squares
from torch import Tensor

from diffrender.atmosphere import far_fog, height_fog
from diffrender.atmosphere.far_fog import FarFog, FarFogView
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.parameters import defaults, specifications
from diffrender.rays import Rays, from_angles
from experiments import plots, records

EYES = (2.0, 60.0, 300.0)  # [m]
ELEVATIONS = (-5.0, -1.0, -0.3, 0.0, 0.3, 1.0, 2.0, 5.0, 10.0, 20.0, 45.0, 90.0)  # [degrees]
LENGTHS = (100.0, 300.0, 1e3, 2e3, 4e3, 8e3, 2e4)  # [m], and the sky
SMALL_EYES, SMALL_LENGTHS = EYES[:1], LENGTHS[2::2]
LOWEST = -100.0  # altitude that no ray falls below [m]

NOON = {"thickness": 0.5, "extinction": 5.0}
# Far fogs by what they change of the talk's midnight.
FAR_FOGS: Mapping[str, Mapping[str, float]] = {
    "midnight": {},
    "noon": NOON,
    "from the eye": {"znear": 0.0},
    "no distance decay": {"distance_decay": 0.0},
    "from the eye, no distance decay": {"znear": 0.0, "distance_decay": 0.0},
    "thin": {"thickness": 300.0},
    "dense": {"thickness": 20_000.0},
    "begins at 2 km": {"znear": 2_000.0},
    "ends at 2 km": {"zfar": 2_000.0},
    "low": {"height_decay": 0.02},
    "floating at 200 m": {"standard_height": 200.0, "bottom_height": -100.0, "depth_decay": 0.01},
}
# Height fogs by what they change of the default.
HEIGHT_FOGS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "thin": {"extinction": 1e-4},
    "dense": {"extinction": 1e-2},
    "low": {"scale_height": 20.0},
    "thinner than 10 m": {"scale_height": 5.0},
    "high": {"scale_height": 1_000.0, "extinction": 1e-4},
    "air": {"scale_height": 8_000.0, "extinction": 2e-5},
    "coloured": {"extinction_tint": (0.8, 1.0, 1.2)},
}
OF_HEIGHT_FOG = ("extinction", "scale_height")
OF_FAR_FOG = ("thickness", "znear", "zfar", "height_decay", "distance_decay")


@dataclass(frozen=True)
class Fit:
    """A fog fitted to another's picture."""

    fog: Any
    root_mean_square: float  # of the error of opacity
    largest: float

    def told(self, searched: Sequence[str]) -> dict[str, Any]:
        """The fit as JSON."""
        found = {name: float(getattr(self.fog, name)) for name in searched}
        return {"root_mean_square": self.root_mean_square, "largest": self.largest, "found": found}


def changed(kind: type[Any], changes: Mapping[str, Any]) -> Any:
    """Record of defaults but for some values, in float64."""
    made = {name: torch.tensor(value, dtype=torch.float64) for name, value in changes.items()}
    return replace(defaults(kind, torch.float64), **made)


def columns(eyes: Sequence[float], lengths: Sequence[float]) -> Rays:
    """Rays of every eye, elevation and length, the sky among them, but for what would fall below the lowest ground."""
    axes = [torch.tensor(axis, dtype=torch.float64) for axis in (eyes, ELEVATIONS, (*lengths, torch.inf))]
    eye, elevation, length = (axis.flatten() for axis in torch.meshgrid(*axes, indexing="ij"))
    kept = eye + length * torch.sin(elevation.deg2rad()).clamp(max=0.0).nan_to_num() >= LOWEST
    kept &= ~(length.isinf() & (elevation < 0.0))
    nothing = torch.zeros_like(eye)
    direction = from_angles(elevation.deg2rad(), nothing)
    return Rays(torch.stack([nothing, nothing, eye], -1)[kept], direction[kept], length[kept])


def far_opacity(fog: FarFog, rays: Rays) -> Float[Tensor, "n 3"]:
    """Picture of far fog in white light over black."""
    black, white = torch.zeros(3, dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    return far_fog.render(replace(fog, tint=white), FarFogView(rays, black, white, black[0]))


def height_opacity(fog: HeightFog, rays: Rays) -> Float[Tensor, "n 3"]:
    """Picture of height fog in white light from all around over black, without sun."""
    black, white = torch.zeros(3, dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return height_fog.render_flat(replace(fog, albedo=white), FogView(rays, black, up, black, white))


def fitted(start: Any, searched: Sequence[str], draw: Callable[[Any], Tensor], wanted: Tensor) -> Fit:
    """Fog whose picture is nearest to what is wanted, by the searched scalars within their bounds."""
    known = specifications(type(start))

    def fog(point: Tensor) -> Any:
        places = zip(searched, point.unbind(), strict=True)
        return replace(start, **{name: known[name].from_unit(place) for name, place in places})

    def residuals(point: NDArray[np.float64]) -> NDArray[np.float64]:
        return (draw(fog(torch.from_numpy(point))) - wanted).flatten().numpy()

    def jacobian(point: NDArray[np.float64]) -> NDArray[np.float64]:
        found = torch.func.jacfwd(lambda one: (draw(fog(one)) - wanted).flatten())(torch.from_numpy(point))
        assert isinstance(found, Tensor)
        return found.numpy()

    first = torch.stack([known[name].to_unit(getattr(start, name)) for name in searched]).clamp(0.0, 1.0)
    minimum = least_squares(residuals, first.numpy(), jacobian, bounds=(0.0, 1.0), x_scale="jac", xtol=1e-12)
    best = fog(torch.from_numpy(minimum.x))
    error = draw(best) - wanted
    return Fit(best, float(error.square().mean().sqrt()), float(error.abs().max()))


def to_height_fog(fog: FarFog, rays: Rays) -> Fit:
    """Height fog of a far fog: as dense as that at ZNEAR, and searched from there."""
    density = fog.thickness * fog.extinction / (fog.zfar - fog.znear)
    start = changed(HeightFog, {"base_height": float(fog.standard_height)})
    start = replace(start, extinction=density, scale_height=1.0 / fog.height_decay)
    return fitted(start, OF_HEIGHT_FOG, lambda one: height_opacity(one, rays), far_opacity(fog, rays))


def to_far_fog(fog: HeightFog, rays: Rays) -> Fit:
    """Far fog of a height fog: exactly that one as far as the bounds go, and searched from there."""
    known = specifications(FarFog)
    (_, steepest), (_, farthest) = known["height_decay"].bounds, known["zfar"].bounds
    start = changed(FarFog, {"znear": 0.0, "zfar": farthest, "distance_decay": 0.0, "standard_height": LOWEST})
    # Of fog at the lowest altitude, where no dense fog may be thicker than 1/m but for that.
    dense = fog.extinction * torch.exp((fog.base_height - LOWEST) / fog.scale_height) * farthest
    decay = torch.clamp(1.0 / fog.scale_height, max=steepest)
    thickness = torch.clamp(dense / start.extinction, max=known["thickness"].bounds[1])
    start = replace(start, thickness=thickness, extinction=torch.clamp(dense / thickness, max=1e2), height_decay=decay)
    return fitted(start, OF_FAR_FOG, lambda one: far_opacity(one, rays), height_opacity(fog, rays))


def opacities(fogs: Sequence[tuple[str, FarFog, HeightFog]]) -> list[dict[str, Any]]:
    """Opacity of far fogs and their height fogs against distance, along rays of three elevations."""
    distance = torch.logspace(1.5, 4.5, 31, dtype=torch.float64)
    found = []
    for name, far, height in fogs:
        for elevation in (0.0, 2.0, 10.0):
            direction = from_angles(*torch.deg2rad(torch.tensor([elevation, 0.0], dtype=torch.float64)))
            origin = torch.tensor([0.0, 0.0, EYES[0]], dtype=torch.float64)
            rays = Rays(origin, direction.expand(len(distance), 3), distance)
            drawn = {"far": far_opacity(far, rays)[:, 0], "height": height_opacity(height, rays)[:, 0]}
            row = {"fog": name, "elevation_degrees": elevation, "distance": [round(one) for one in distance.tolist()]}
            found.append(row | {way: [round(one, 4) for one in opacity.tolist()] for way, opacity in drawn.items()})
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the errors of both ways, and write them as JSON and as a chart."""
    parser = argparse.ArgumentParser(description="far fog as height fog, and back")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    rays = columns(*((EYES, LENGTHS) if given.size == "full" else (SMALL_EYES, SMALL_LENGTHS)))
    count = len(FAR_FOGS) if given.size == "full" else 1
    far = {name: changed(FarFog, changes) for name, changes in list(FAR_FOGS.items())[:count]}
    height = {name: changed(HeightFog, changes) for name, changes in list(HEIGHT_FOGS.items())[:count]}
    as_height = {name: to_height_fog(fog, rays) for name, fog in far.items()}
    as_far = {name: to_far_fog(fog, rays) for name, fog in height.items()}
    content = {
        "rays": len(rays.length),
        "far_as_height": [{"fog": name} | fit.told(OF_HEIGHT_FOG) for name, fit in as_height.items()],
        "height_as_far": [{"fog": name} | fit.told((*OF_FAR_FOG, "extinction")) for name, fit in as_far.items()],
        "opacities": opacities([(name, fog, as_height[name].fog) for name, fog in far.items()]),
    }
    for way in ("far_as_height", "height_as_far"):
        print(table(content[way]))
    written = given.out / "far_fog_conversion.json"
    records.write(written, content)
    plots.far_fog_conversion(written)


def table(rows: Any) -> str:
    """Text of the errors of one way and of what was found."""
    names = list(rows[0]["found"])
    lines = [
        [
            row["fog"], f"{row['root_mean_square']:.2g}", f"{row['largest']:.2g}",
            *(f"{row['found'][name]:.4g}" for name in names),
        ]
        for row in rows
    ]  # fmt: skip
    return records.table(["fog", "rms", "largest", *names], lines)


if __name__ == "__main__":
    main()
