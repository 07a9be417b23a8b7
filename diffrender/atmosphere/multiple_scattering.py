"""Light scattered more than once in the shell: Hillaire's series over orders, isotropic from the second one on [1].

[1] S. Hillaire, "A scalable and production ready sky and atmosphere rendering technique", EGSR, 2020, section 5.5.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import (
    TOP,
    Medium,
    Paths,
    horizon_cosine,
    paths,
    step_weights,
    transmittance,
)
from diffrender.numerics import lookup, safe_sqrt

HEIGHTS, SUNS, STEPS = 8, 16, 8  # of the table
_SUN_SCALE = 0.06  # cosine over which the table's columns are dense round the horizon
_LOWEST_SUN = -0.35  # cosine: 20 degrees below the horizon
_DARK = 1e-12  # mean radiance [1/sr] far below that of the deepest twilight

# Gauss and Legendre's rule on [0, 1]: place and weight of each of its six nodes.
_GAUSS_6 = ((0.03376524289842397, 0.08566224618958512), (0.1693953067668678, 0.18038078652406936),
            (0.3806904069584016, 0.23395696728634555), (0.6193095930415985, 0.23395696728634555),
            (0.8306046932331322, 0.18038078652406936), (0.966234757101576, 0.08566224618958512))  # fmt: skip


def _from_edge(like: Tensor) -> tuple[Tensor, Tensor]:
    """Nodes in [0, 1], dense where a sphere of directions meets the ground's edge, and weights of their sum."""
    place, weight = like.new_tensor(_GAUSS_6).unbind(-1)
    return place * place, 2.0 * place * weight


def table_paths(like: Tensor, heights: int = HEIGHTS, suns: int = SUNS, steps: int = STEPS) -> Paths:
    """Rays in all directions from every cell of the table of mean radiance: (heights, suns, directions).

    Directions are Gauss nodes above and below the local horizon, where radiance jumps, times two azimuths, which are
    exact for sources that vary with the azimuth's cosine up to its cube.
    """
    height = _heights(heights, like)
    sun = _SUN_SCALE * torch.sinh(torch.linspace(*_sun_range(), suns).to(like))
    place, _ = _from_edge(like)
    edge = horizon_cosine(height)[:, None]
    up, down = edge + (1.0 - edge) * place, edge - (1.0 + edge) * place
    view = torch.cat([up, down], -1)[:, None, :, None]
    sun = sun[None, :, None, None]
    azimuth = torch.tensor([math.sqrt(0.5), -math.sqrt(0.5)]).to(like)
    angle = view * sun + safe_sqrt(1.0 - view * view) * safe_sqrt(1.0 - sun * sun) * azimuth
    return paths(height[:, None, None, None], view, sun, angle, steps)


def mean_radiance(medium: Medium, around: Paths) -> Float[Tensor, "heights suns 3"]:
    """Mean over the sphere of the radiance of light scattered at least once, per irradiance of the sun [1/sr].

    The first order is isotropic too; every later one is the same share of the one before, so that they sum to
    1 / (1 - share). Ground bounces count as scattering.
    """
    edge = horizon_cosine(_heights(around.step.shape[0], around.step))[:, None]
    _, weight = _from_edge(around.step)
    solid = torch.cat([(1.0 - edge) * weight, (1.0 + edge) * weight], -1)[:, None, :, None] / 2.0
    steps, through = step_weights(medium, around)
    source = steps * (around.density @ medium.scattering())
    lit = transmittance(medium, around.sun_column) * around.sunlit
    bounced = through * around.ground * transmittance(medium, around.ground_column) * medium.ground_albedo / math.pi
    first = (source * lit).sum(-2) / (4.0 * math.pi) + bounced
    share = (source.sum(-2).mean(3) * solid).sum(2)
    return (first.mean(3) * solid).sum(2) / (1.0 - share)


def look_up(table: Float[Tensor, "heights suns 3"], height: Tensor, cos_sun: Tensor) -> Float[Tensor, "*batch 3"]:
    """Mean radiance at a height [m] and cosine of the sun's zenith angle."""
    low, high = _sun_range()
    # Cube root with a floor of a tenth of a cell, where its slope would be infinite.
    row = torch.clamp(height / TOP, min=1e-6).pow(1.0 / 3.0) * (table.shape[0] - 1)
    column = (torch.asinh(cos_sun / _SUN_SCALE) - low) / (high - low) * (table.shape[1] - 1)
    # Between the cells of its logarithm: in twilight it falls by a factor of ten from one to the next.
    found = lookup(torch.log1p(table / _DARK), row.expand_as(column), column)
    return _DARK * torch.expm1(found)


def _heights(count: int, like: Tensor) -> Tensor:
    return TOP * torch.linspace(0.0, 1.0, count).to(like).pow(3)


def _sun_range() -> tuple[float, float]:
    return math.asinh(_LOWEST_SUN / _SUN_SCALE), math.asinh(1.0 / _SUN_SCALE)
