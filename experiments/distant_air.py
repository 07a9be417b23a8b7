"""Aerial perspective and far fog on hills: how far the tables are from the march, and what every number looks like.

Errors of aerial perspective are of all rungs against the march, of what the air adds to black objects, by the sun, the
haze and how steeply rays rise. The sheet shows rows of hills at 0.5 to 32 km under a sky: aerial perspective by
distance scale, sun and tint in the upper rows, far fog in the lower, each but the first with one number changed.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from diffrender.atmosphere import aerial_perspective, far_fog, sky
from diffrender.atmosphere.aerial_perspective import AerialPerspective, AerialView
from diffrender.atmosphere.far_fog import FarFog, FarFogView
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.parameters import defaults
from diffrender.rays import Perspective, Rays, from_angles, pixel_centres
from experiments import records

SUNS = (60.0, 20.0, 5.0, 1.0, -4.0)  # elevations [degrees]
HAZES = (0.1, 1.0, 10.0)  # in units of a clear day's
LENGTHS = (1e2, 1e3, 3e3, 1e4, 3e4, 1e5)  # [m]
AZIMUTHS = (0.0, 20.0, 60.0, 120.0, 180.0)  # from the sun's [degrees]
CLIMBS: Mapping[str, tuple[float, float]] = {  # elevation of the ray [degrees] and height of the eye [m]
    "level": (0.0, 2.0),
    "2 degrees up": (2.0, 2.0),
    "10 degrees up": (10.0, 2.0),
    "2 degrees down from 4 km": (-2.0, 4e3),
}
IRRADIANCE = (1.474, 1.8504, 1.91198)  # [W/m^2]
EYE = 60.0  # of the sheet [m]
HILLS = 5e2 * 2.0 ** torch.arange(7.0)  # distances of the rows of hills [m]

# Panels of the sheet: elevation of the sun [degrees], and the numbers that are changed.
AERIAL: Sequence[tuple[str, float, Mapping[str, Any]]] = (
    ("aerial perspective, sun at 20°", 20.0, {}),
    ("distance × 4", 20.0, {"distance_scale": 4.0}),
    ("distance × 4, tint 1.6, 1, 0.6", 20.0, {"distance_scale": 4.0, "tint": (1.6, 1.0, 0.6)}),
    ("distance × 4, sun at 2°", 2.0, {"distance_scale": 4.0}),
)
NOON = {"thickness": 0.5, "extinction": 5.0, "tint": (0.23, 0.5, 0.82)}
FAR: Sequence[tuple[str, Mapping[str, Any]]] = (
    ("far fog, talk's noon", {}),
    ("EXTINCTION 20", {"extinction": 20.0}),
    ("THICKNESS 0.1", {"thickness": 0.1}),
    ("ZNEAR 3000", {"znear": 3e3}),
    ("ZFAR 2000", {"zfar": 2e3}),
    ("HEIGHT_DECAY 2", {"height_decay": 0.02}),
    ("DISTANCE_DECAY 0.2", {"distance_decay": 0.002}),
    ("STANDARD_HEIGHT 150, DEPTH_DECAY 2", {"standard_height": 150.0, "depth_decay": 0.02}),
)


def _looked(direction: Tensor, sun: float, eye: float) -> SkyView:
    to_sun = from_angles(*torch.deg2rad(direction.new_tensor([sun, 0.0])))
    return SkyView(direction, to_sun, direction.new_tensor(IRRADIANCE), direction.new_tensor(eye))


def black_objects(sun: float, haze: float, elevation: float, eye: float) -> AerialView:
    """Black objects at every length and azimuth."""
    length, azimuth = torch.meshgrid(
        torch.tensor(LENGTHS, dtype=torch.float64), torch.tensor(AZIMUTHS, dtype=torch.float64), indexing="ij"
    )
    direction = from_angles(torch.full_like(azimuth, elevation).deg2rad(), azimuth.deg2rad())
    air = sky.medium(replace(defaults(Sky, torch.float64), mie_scale=length.new_tensor(haze)))
    return aerial_perspective.through(air, _looked(direction, sun, eye), length, torch.zeros_like(direction))


def rows(suns: Sequence[float], hazes: Sequence[float]) -> list[dict[str, Any]]:
    """Relative error of both kinds of tables: root of the mean square, and largest."""
    found = []
    plain = defaults(AerialPerspective, torch.float64)
    for sun in suns:
        for haze in hazes:
            for climb, (elevation, eye) in CLIMBS.items():
                seen = black_objects(sun, haze, elevation, eye)
                wanted = aerial_perspective.render(plain, seen)
                row: dict[str, Any] = {"sun_degrees": sun, "haze": haze, "rays": climb}
                for name in ("two tables", "three tables"):
                    error = aerial_perspective.EFFECT.rungs[name](plain, seen) / wanted - 1.0
                    told = {
                        "root_mean_square": float(error.square().mean().sqrt()),
                        "largest": float(error.abs().max()),
                    }
                    row[name.replace(" ", "_")] = told
                found.append(row)
    return found


def hills(width: int, height: int) -> tuple[Float[Tensor, "h w 3"], Float[Tensor, "h w"]]:
    """Directions of a picture of hills, and distances along them; infinite where the sky is seen."""
    camera = Perspective(width, height, field_of_view=math.radians(40.0), pitch=math.radians(2.5))
    direction = camera.direction(*pixel_centres(camera, slice(None), torch.zeros(())))
    across = torch.hypot(direction[..., 0], direction[..., 1])
    place = HILLS * (direction[..., 1] / across)[..., None]
    # Three waves for each row, so that none looks like another; as wide as they are far, and up to 500 m high.
    phase = torch.arange(len(HILLS)).to(place)
    wave = torch.sin(9.0 * place / HILLS + 2.1 * phase) + 0.4 * torch.sin(31.0 * place / HILLS + phase)
    tops = 0.028 * HILLS.clamp(max=1.6e4) * (1.0 + 0.5 * wave)
    meets = (EYE + direction[..., 2:] / across[..., None] * HILLS) < tops
    ground = torch.where(direction[..., 2] < 0.0, -EYE / direction[..., 2].clamp(max=-1e-6), torch.inf)
    far = torch.where(meets, HILLS / across[..., None], torch.inf).amin(-1)
    return direction, torch.minimum(far, ground)


def _changed(kind: type[Any], changes: Mapping[str, Any]) -> Any:
    return replace(defaults(kind), **{name: torch.tensor(value) for name, value in changes.items()})


def _backdrop(seen: SkyView, length: Tensor) -> Tensor:
    """Dark green hills lit by the sun, before a sky."""
    lit = seen.irradiance * seen.to_sun[2].clamp(min=0.05) * torch.tensor([0.03, 0.045, 0.02]) / math.pi
    behind = sky.EFFECT.rungs["tables"](defaults(Sky), seen)
    return torch.where(length[..., None].isinf(), behind, lit)


def sheet(width: int, height: int) -> dict[str, Float[Tensor, "h w 3"]]:
    """Pictures by title."""
    direction, length = hills(width, height)
    found = {}
    for title, sun, changes in AERIAL:
        view = _looked(direction, sun, EYE)
        seen = aerial_perspective.through(sky.medium(defaults(Sky)), view, length, _backdrop(view, length))
        drawn = aerial_perspective.EFFECT.rungs["three tables"](_changed(AerialPerspective, changes), seen)
        # The sky has its air already.
        found[title] = torch.where(length[..., None].isinf(), seen.background, drawn)
    high = _looked(direction, 20.0, EYE)
    rays = Rays(direction.new_tensor([0.0, 0.0, EYE]), direction, length)
    light = _backdrop(high, torch.full_like(length, torch.inf)).amax((0, 1))
    for title, changes in FAR:
        fogged = FarFogView(rays, _backdrop(high, length), light, direction.new_tensor(0.0))
        found[title] = far_fog.render(_changed(FarFog, {**NOON, **changes}), fogged)
    return found


def draw(path: Path, width: int, height: int) -> None:
    """Write the sheet as PNG, every picture exposed by its own brightest place."""
    pictures = sheet(width, height)
    figure = Figure(figsize=(13.0, 6.6), layout="constrained")
    for place, (title, picture) in zip(figure.subplots(3, 4).flat, pictures.items(), strict=True):
        shown = (picture / picture.quantile(0.97)).clamp(0.0, 1.0) ** (1.0 / 2.2)
        place.imshow(shown.numpy(), interpolation="nearest")
        place.set_title(title, fontsize="small")
        place.set_axis_off()
    figure.savefig(path, dpi=90)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the errors, and draw the sheet."""
    parser = argparse.ArgumentParser(description="errors and looks of aerial perspective and far fog")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    full = given.size == "full"
    found = rows(SUNS if full else SUNS[1:2], HAZES if full else HAZES[1:2])
    names = ("two_tables", "three_tables")
    lines = [
        [f"{row['sun_degrees']:g}", f"{row['haze']:g}", row["rays"]]
        + [f"{row[name][kind]:.3f}" for name in names for kind in ("root_mean_square", "largest")]
        for row in found
    ]
    print(records.table(["sun", "haze", "rays", "two: rms", "largest", "three: rms", "largest"], lines))
    records.write(given.out / "distant_air.json", {"lengths": LENGTHS, "azimuths": AZIMUTHS, "records": found})
    draw(given.out / "distant_air.png", *((300, 180) if full else (16, 10)))


if __name__ == "__main__":
    main()
