"""Light that wanders under a surface before it leaves: Burley's normalised diffusion [1], and places to sample it at.

Of the light that enters at a point, the share that leaves on a unit of area at a distance r is, but for the albedo,

    R(r) = (exp(-r / d) + exp(-r / 3d)) / (8 pi d r)

with d = mean free path / (1.9 - A + 3.5 (A - 0.8)²) for light that enters diffusely into what reflects A of it. Its
integral over the plane is 1, and 1 - (exp(-r / d) + 3 exp(-r / 3d)) / 4 of it lies within r, which a cubic equation
turns back into r [2]. So places can be chosen beforehand, in widths d, that each stand for the same share of the light.

[1] P. Christensen, B. Burley, "Approximate Reflectance Profiles for Efficient Subsurface Scattering", Pixar Technical
    Memo 15-04, 2015: the profile, and the scale for "diffuse surface transmission".
[2] E. Golubev, "Efficient Screen-Space Subsurface Scattering Using Burley's Normalized Diffusion in Real-Time",
    SIGGRAPH 2018 course "Advances in Real-Time Rendering in Games", and "Sampling Burley's Normalized Diffusion
    Profiles", zero-radiance.github.io, 2019.
[3] J. Jimenez et al., "Separable Subsurface Scattering", Computer Graphics Forum 34(6), 2015: the profile integrated
    along lines.
"""

import math
from functools import cache

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from diffrender.numerics import gauss_legendre, safe_sqrt

_GOLDEN_TURN = math.pi * (3.0 - math.sqrt(5.0))
_NODES, _HALVINGS = 256, 60  # of the line's quadrature over angles, and of the search for its places
_FARTHEST = 200.0  # in widths; exp(-200 / 3) of the light lies beyond


def width(albedo: Float[Tensor, "*#batch"], mean_free_path: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """The profile's d [m], of an albedo from 0 to 1 and the path that light goes between two collisions [m].

    >>> width(torch.tensor([0.0, 0.8, 1.0]), torch.ones(3))
    tensor([0.2415, 0.9091, 0.9615])
    """
    from_bright = albedo - 0.8
    return mean_free_path / (1.9 - albedo + 3.5 * from_bright * from_bright)


def reach(distance: Float[Tensor, "*#batch"], planned: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Light from a distance over that from where it was thought to be, both in widths and above 0.

    1 where both are the same, less for what is farther. By the difference of both distances, as far out the profile
    itself underflows.
    """
    shrunk = torch.exp((planned - distance) / 3.0) * planned / distance
    return shrunk * (1.0 + torch.exp(-2.0 / 3.0 * distance)) / (1.0 + torch.exp(-2.0 / 3.0 * planned))


def disc(count: int) -> Float64[Tensor, "{count} 2"]:
    """Places in a plane that each stand for the same share of the profile's light, in widths from where it leaves.

    On a spiral that turns by the golden angle, so that they are even round the middle too. The first stands in the
    middle itself, for the nearest share, so that a place always has its own light whatever is around it.
    """
    place = torch.arange(count, dtype=torch.float64)
    left = 1.0 - (place + 0.5) / count
    left[0] = 1.0
    # exp(-r / 3d) is the root x of x³ + 3x = 4 left.
    radius = -3.0 * torch.log(2.0 * torch.sinh(torch.asinh(2.0 * left) / 3.0))
    radius[0] = 0.0
    return radius[:, None] * torch.stack([torch.cos(_GOLDEN_TURN * place), torch.sin(_GOLDEN_TURN * place)], -1)


@cache
def line(count: int) -> Float64[Tensor, " {count}"]:
    """Places along a line with the same shares of the profile summed across it [3], in widths; an odd number of them.

    What falls off from a straight edge is exactly such a sum, of what bends it is not.
    """
    node, weight = gauss_legendre(_NODES)
    cosine = torch.cos(0.25 * math.pi * (1.0 + node))
    wanted = (torch.arange(1, count // 2 + 1, dtype=torch.float64) / count * 2.0)[:, None]
    low, high = torch.zeros_like(wanted), torch.full_like(wanted, _FARTHEST)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        is_short = (_within(middle / cosine) * 0.5 * weight).sum(-1, keepdim=True) < wanted
        low, high = torch.where(is_short, middle, low), torch.where(is_short, high, middle)
    return torch.cat([-low.flip(0)[:, 0], low.new_zeros(1), low[:, 0]])


def _within(distance: Tensor) -> Tensor:
    """Share of light within a distance, in widths."""
    return 1.0 - 0.25 * torch.exp(-distance) - 0.75 * torch.exp(-distance / 3.0)


def inverse_root(
    across: Float[Tensor, "*batch 3"], down: Float[Tensor, "*batch 3"]
) -> tuple[Float[Tensor, "*batch 2 2"], Float[Tensor, "*batch"]]:
    """Steps of a grid that make even circles on a surface, whose own steps are given [m]; and the area of a cell [m²].

    The matrix turns a place in the plane [m] into one of the grid: the inverse root of the steps' scalar products.
    """
    own, mixed, other = (across * across).sum(-1), (across * down).sum(-1), (down * down).sum(-1)
    # Not from the products: their difference has no digits left where the surface grazes.
    area = safe_sqrt(torch.linalg.cross(across, down).square().sum(-1))
    is_none = area == 0.0
    divisor = torch.where(is_none, torch.ones_like(area), area * torch.sqrt(own + other + 2.0 * area))
    rows = [torch.stack(row, -1) for row in ((other + area, -mixed), (-mixed, own + area))]
    return torch.stack(rows, -2) / divisor[..., None, None], area
