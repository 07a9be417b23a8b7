"""The sky by quadrature along straight rays: slow and trusted, sharing with `sky.render` only the model itself.

No closed form of a column, no table of transmittance, no step that is exact for its medium: Gauss and Legendre's rule
between the heights where densities bend, along rays towards the eye, round every point and towards the sun.
Light scattered more than once is as `multiple_scattering.mean_radiance` defines it, at the nodes of a polynomial in
height and sun instead of a bilinear table.

[1] G. Golub, J. Welsch, "Calculation of Gauss quadrature rules", Mathematics of Computation 23, 1969.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import PLANET_RADIUS, SUN_RADIUS, TOP, Medium, density
from diffrender.parameters import record

# Heights [m] between which the rule is applied; the ozone's tent bends at 10, 25 and 40 km.
FINE = (0.0, 0.3e3, 1e3, 2e3, 4e3, 7e3, 10e3, 15e3, 20e3, 25e3, 30e3, 40e3, 60e3, TOP)
COARSE = (0.0, 2e3, 10e3, 25e3, 40e3, TOP)


@record
class Nodes:
    """Where a rule evaluates rays through the shell."""

    distance: Float[Tensor, "*batch panels n"]  # [m]
    half: Float[Tensor, "*batch panels 1"]  # of the panels' lengths [m]
    height: Float[Tensor, "*batch panels n"]  # [m]


def gauss_legendre(count: int) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Places in [-1, 1] and weights of the rule that is exact up to the power 2 count - 1 [1]."""
    order = torch.arange(1, count, dtype=torch.float64)
    beside = order / torch.sqrt(4.0 * order * order - 1.0)
    place, vectors = torch.linalg.eigh(torch.diag(beside, 1) + torch.diag(beside, -1))
    return place, 2.0 * vectors[0].square()


def running_weights(count: int) -> Float[Tensor, "n n"]:
    """Weights of the integral from -1 to each place of the rule, exact up to the power count - 1."""
    place, _ = gauss_legendre(count)
    power = torch.arange(count)
    integral = (place[:, None] ** (power + 1) - (-1.0) ** (power + 1)) / (power + 1)
    return torch.linalg.solve(place[:, None] ** power, integral, left=False)


def nodes(height: Tensor, cosine: Tensor, borders: tuple[float, ...], count: int) -> Nodes:
    """Nodes of rays from a height at a cosine from the zenith to the ground or to space.

    Places on a ray are counted from its lowest point; crossings of the borders divide it into panels.
    """
    start = (PLANET_RADIUS + height) * cosine
    lowest_square = (PLANET_RADIUS + height).square() * (1.0 - cosine * cosine)
    border = PLANET_RADIUS + torch.tensor(borders, dtype=torch.float64)
    crossing = torch.sqrt(torch.relu(border.square() - lowest_square[..., None]))
    lands = (cosine < 0.0) & (lowest_square < PLANET_RADIUS**2)
    end = torch.where(lands, -crossing[..., 0], crossing[..., -1])
    limit = torch.cat([-crossing.flip(-1), crossing], -1)
    limit = torch.maximum(torch.minimum(limit, end[..., None]), start[..., None])
    half = (limit[..., 1:, None] - limit[..., :-1, None]) / 2.0
    along = limit[..., :-1, None] + half * (1.0 + gauss_legendre(count)[0])
    above = torch.sqrt(lowest_square[..., None, None] + along.square()) - PLANET_RADIUS
    return Nodes(along - start[..., None, None], half, torch.relu(above))


def sunlight(air: Medium, height: Tensor, cosine: Tensor, borders: tuple[float, ...], count: int) -> Tensor:
    """Sunlight that reaches points, over that above the air, by channel: 0 in the earth's shadow.

    The visible segment of an even disc over the disc, through the air towards the middle of the segment.
    """
    dip = torch.acos(PLANET_RADIUS / (PLANET_RADIUS + height))
    rise = ((math.pi / 2.0 - torch.acos(cosine) + dip) / SUN_RADIUS).clamp(-1.0, 1.0)
    share = 0.5 + (torch.asin(rise) + rise * torch.sqrt(1.0 - rise.square())) / math.pi
    middle = 2.0 / (3.0 * math.pi) * (1.0 - rise.square()).pow(1.5) / share.clamp(min=1e-9)
    towards = torch.cos(torch.acos(cosine) - SUN_RADIUS * middle)
    ray = nodes(height, towards, borders, count)
    weight = gauss_legendre(count)[1]
    column = ((density(ray.height) * weight[:, None]).sum(-2) * ray.half).sum(-2)
    return share[..., None] * torch.exp(-column @ air.extinction())


def sun_cosine(height: Tensor, cosine: Tensor, cos_sun: Tensor, cos_angle: Tensor, at: Nodes) -> Tensor:
    """Cosine of the sun's local zenith angle at nodes; `cos_angle` is that between ray and sun."""
    along = ((PLANET_RADIUS + height) * cos_sun)[..., None, None] + at.distance * cos_angle[..., None, None]
    return (along / (PLANET_RADIUS + at.height)).clamp(-1.0, 1.0)
