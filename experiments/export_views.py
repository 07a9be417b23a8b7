"""The views in which exports are compared: a camera above a grey plain, looking at the horizon all round, and up.

Directions are in the library's axes. What another renderer shows at a pixel is compared with what ours draws along the
ray through its centre.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.rays import Rays
from fit.export.described import Described, fogged, sky_radiance

EYE = 10.0  # height of the camera above the plain and above the weather's altitude 0 [m]
GROUND = 0.5  # radiance of the plain, over the mean of the sky
FARTHEST = 12_000.0  # half the side of the plain [m]; what lies further is not compared
ROUND_SUN = math.radians(0.5)  # nearer to the sun's middle is its disc, which is a light and not compared
# Name -> where the camera looks, and its up.
VIEWS = {
    "ahead": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "left": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "behind": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "right": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "up": ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)),
}


@dataclass(frozen=True, eq=False)
class View:
    """What our formulas draw in one view of 90 by 90 degrees.

    Attributes:
        radiance: of the sky and, with fog, of the plain too, both behind it.
        compared: pixels that count; without fog those of the sky.
    """

    radiance: Float[Tensor, "n n 3"]
    compared: Bool[Tensor, "n n"]


def directions(name: str, pixels: int) -> Float[Tensor, "n n 3"]:
    """Unit directions through the centres of a view's pixels, row 0 on top."""
    forward, up = (torch.tensor(one, dtype=torch.float64) for one in VIEWS[name])
    right = torch.linalg.cross(forward, up)
    place = (2.0 * torch.arange(pixels, dtype=torch.float64) + 1.0) / pixels - 1.0
    towards = forward + place[None, :, None] * right - place[:, None, None] * up
    return torch.nn.functional.normalize(towards, dim=-1).float()


def plain(weather: Described) -> float:
    """Radiance of the plain."""
    return GROUND * float(weather.skylight.mean())


def ours(weather: Described, name: str, pixels: int) -> View:
    """A view by `fit render`'s sky and `fit fog`'s fog."""
    direction = directions(name, pixels)
    flat = direction.flatten(0, 1)
    sky = sky_radiance(weather, flat)
    above = flat[:, 2] > 0.0
    fog = weather.scene.height_fog
    if fog is None:
        seen, compared = sky, above
    else:
        distance = torch.where(above, torch.full_like(flat[:, 2], math.inf), EYE / -flat[:, 2])
        background = torch.where(above[:, None], sky, torch.full_like(sky, plain(weather)))
        rays = Rays(torch.tensor([0.0, 0.0, EYE]), flat, distance)
        seen = fogged(weather, fog, rays, background)
        compared = above | (distance * flat[:, :2].abs().amax(-1) < FARTHEST)
    compared &= flat @ weather.to_sun < math.cos(ROUND_SUN)
    return View(seen.reshape(direction.shape), compared.reshape(direction.shape[:2]))
