"""Light scattered more than once in the shell: Hillaire's series over orders, isotropic from the second one on [1].

[1] S. Hillaire, "A scalable and production ready sky and atmosphere rendering technique", EGSR, 2020, section 5.5.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import (
    PLANET_RADIUS,
    TOP,
    Medium,
    Paths,
    horizon_cosine,
    paths,
    step_weights,
    transmittance,
)
from diffrender.numerics import lookup, safe_sqrt

HEIGHTS, SUNS, STEPS = 8, 12, 8  # of the table
_SUN_SCALE = 0.06  # cosine over which the table's columns are dense round the horizon
_EDGE_TO_TOP = math.sqrt(TOP * (2.0 * PLANET_RADIUS + TOP))  # length of a ray from the ground's edge to space [m]
_DARK = 1e-12  # mean radiance [1/sr] far below that of the deepest twilight

# Gauss and Legendre's rule on [0, 1]: place and weight of each of its five nodes.
_GAUSS_5 = ((0.04691007703066802, 0.11846344252809454), (0.23076534494715845, 0.23931433524968324), (0.5, 64.0 / 225.0),
            (0.7692346550528415, 0.23931433524968324), (0.953089922969332, 0.11846344252809454))  # fmt: skip


def sun_range(cos_sun: Float[Tensor, ""], eye_altitude: Float[Tensor, ""]) -> Float[Tensor, "2"]:
    """Lowest and highest cosine of the sun's local zenith angle over all points of an eye's rays."""
    to_edge, beyond = safe_sqrt(eye_altitude * (2.0 * PLANET_RADIUS + eye_altitude)), _EDGE_TO_TOP
    # Cosine and sine of the angle, at the planet's middle, between the eye and the end of its longest ray.
    whole = (PLANET_RADIUS + eye_altitude) * (PLANET_RADIUS + TOP)
    cosine = (PLANET_RADIUS * PLANET_RADIUS - to_edge * beyond) / whole
    sine = PLANET_RADIUS * (to_edge + beyond) / whole
    sin_sun = safe_sqrt(1.0 - cos_sun * cos_sun)
    low = torch.where(cos_sun > -cosine, cos_sun * cosine - sin_sun * sine, -torch.ones_like(cos_sun))
    high = torch.where(cos_sun < cosine, cos_sun * cosine + sin_sun * sine, torch.ones_like(cos_sun))
    return torch.stack([low, high])


def _from_edge(like: Tensor) -> tuple[Tensor, Tensor]:
    """Nodes in [0, 1], dense where a sphere of directions meets the ground's edge, and weights of their sum."""
    place, weight = like.new_tensor(_GAUSS_5).unbind(-1)
    return place * place, 2.0 * place * weight


def table_paths(suns: Float[Tensor, "2"], heights: int = HEIGHTS, columns: int = SUNS, steps: int = STEPS) -> Paths:
    """Rays in all directions from every cell of the table of mean radiance: (heights, suns, directions, azimuths).

    Directions are Gauss nodes above and below the local horizon, where radiance jumps, times three azimuths, which are
    exact for sources that vary with the azimuth's cosine up to its fifth power: those of a twilight.
    """
    height = _heights(heights, suns)
    first, last = _scaled(suns).unbind()
    sun = _SUN_SCALE * torch.sinh(torch.lerp(first, last, torch.linspace(0.0, 1.0, columns).to(suns)))
    sun = torch.clamp(sun, -1.0, 1.0)[None, :, None, None]
    place, _ = _from_edge(suns)
    edge = horizon_cosine(height)[:, None]
    up, down = edge + (1.0 - edge) * place, edge - (1.0 + edge) * place
    view = torch.cat([up, down], -1)[:, None, :, None]
    azimuth = suns.new_tensor([math.sqrt(0.75), 0.0, -math.sqrt(0.75)])
    angle = view * sun + safe_sqrt(1.0 - view * view) * safe_sqrt(1.0 - sun * sun) * azimuth
    return paths(height[:, None, None, None], view, sun, angle, steps)


def mean_radiance(medium: Medium, around: Paths) -> Float[Tensor, "heights suns 3"]:
    """Mean over the sphere of the radiance of light scattered at least once, per irradiance of the sun [1/sr].

    The first order is isotropic too; every later one is the same share of the one before, so that they sum to
    1 / (1 - share). Ground bounces count as scattering.
    """
    once, share = first_order(medium, around)
    return once / (1.0 - share)


def first_order(medium: Medium, around: Paths) -> tuple[Float[Tensor, "heights suns 3"], Float[Tensor, "heights 1 3"]]:
    """Mean radiance of light scattered once [1/sr], and the share of a point's light that is scattered back to it."""
    edge = horizon_cosine(_heights(around.step.shape[0], around.step))[:, None]
    _, weight = _from_edge(around.step)
    solid = torch.cat([(1.0 - edge) * weight, (1.0 + edge) * weight], -1)[:, None, :, None, None] / 2.0
    steps, through = step_weights(medium, around)
    # Solid angles first: rays of all suns share them, so that the largest tensors are multiplied and summed once.
    source = steps * (around.density @ medium.scattering()) * solid[..., None, :]
    lit = transmittance(medium, around.sun_column) * around.sunlit
    once = (source / (4.0 * math.pi * around.sunlit.shape[3]) * lit).sum((2, 3, 4))
    ground = around.ground * transmittance(medium, around.ground_column) * medium.ground_albedo / math.pi
    return once + (through * ground * solid).mean(3).sum(2), source.sum((2, 3, 4))


def look_up(
    table: Float[Tensor, "heights suns 3"], suns: Float[Tensor, "2"], height: Tensor, cos_sun: Tensor
) -> Float[Tensor, "*batch 3"]:
    """Mean radiance at a height [m] and cosine of the sun's zenith angle, from a table over a range of suns."""
    # Cube root with a floor of a tenth of a cell, where its slope would be infinite.
    row = torch.clamp(height / TOP, min=1e-6).pow(1.0 / 3.0) * (table.shape[0] - 1)
    first, last = _scaled(suns).unbind()
    column = (_scaled(cos_sun) - first) / (last - first) * (table.shape[1] - 1)
    # Between the cells of its logarithm: in twilight it falls by a factor of ten from one to the next.
    found = lookup(torch.log1p(table / _DARK), row.expand_as(column), column)
    return _DARK * torch.expm1(found)


def _scaled(cos_sun: Tensor) -> Tensor:
    return torch.asinh(cos_sun / _SUN_SCALE)


def _heights(count: int, like: Tensor) -> Tensor:
    return TOP * torch.linspace(0.0, 1.0, count).to(like).pow(3)
