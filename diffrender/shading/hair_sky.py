"""Mean directions of a strand's lobes, which is all that a sky of one radiance and a gradient asks of them.

A lobe along the strand is von Mises' and Fisher's, which has a place for every two shares of its light: the height over
its middle, and the turn round it [1]. The height along the strand is its mean over few such places. The cosine, and the
logistic's mean round the strand, likewise.

[1] E. d'Eon, S. Marschner, J. Hanika, "Importance Sampling for Physically-Based Hair Fiber Models", SIGGRAPH Asia 2013
    Technical Briefs.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import gauss_legendre, opacity
from diffrender.shading.hair_fibre import Ways

_HEIGHTS, _TURNS, _ROUND = 8, 6, 32  # places in a lobe; and in the logistic, of which there is one for all strands


def sky_moments(
    ways: Ways,
    mirror_angle: Float[Tensor, "*#batch 4"],
    variance: Float[Tensor, "*#batch 4"],
    scale: Float[Tensor, "*#batch"],
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Share of light alike from all directions, and its mean direction along the strand and across it, to the eye.

    Directions are weighed by the share.
    """
    share = ways.shares.sum(-3)
    sine, cosine = _mean_along(mirror_angle, variance)
    turned = (torch.cos(ways.azimuth)[..., None] * ways.shares[..., :3, :]).sum(-3)
    across = turned * _mean_around(scale)[..., None, None]
    aside = (across * cosine[..., :3, None]).sum(-2)
    return share.sum(-2), (share * sine[..., None]).sum(-2), aside


def _mean_along(mirror_angle: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Mean sine and cosine of angles along the strand, of each lobe."""
    place, weight = gauss_legendre(_HEIGHTS)
    share, weight = (0.5 + 0.5 * place).to(mirror_angle), (0.5 * weight).to(mirror_angle)
    narrow = variance[..., None, None]
    # What is missing to a cosine of 1 from the lobe's middle.
    missing = -narrow * torch.log1p(-share[:, None] * opacity(2.0 / narrow))
    aside = torch.sqrt(missing * (2.0 - missing))
    turn = (torch.arange(_TURNS).to(mirror_angle) + 0.5) * (math.pi / _TURNS)
    middle = mirror_angle[..., None, None]
    sine = aside * torch.cos(turn) * torch.cos(middle) - (1.0 - missing) * torch.sin(middle)
    # By what is across the strand, for the root of 1 - sine² has no digits near it.
    cosine = torch.sqrt(
        ((1.0 - missing) * torch.cos(middle) + aside * torch.cos(turn) * torch.sin(middle)).square()
        + (aside * torch.sin(turn)).square()
    )
    return (sine.mean(-1) * weight).sum(-1), (cosine.mean(-1) * weight).sum(-1)


def _mean_around(scale: Tensor) -> Tensor:
    """Mean cosine of the cut logistic."""
    place, weight = gauss_legendre(_ROUND)
    half = (0.5 + 0.5 * place).to(scale)
    reach = torch.tanh(0.5 * math.pi / scale[..., None])
    angle = 2.0 * scale[..., None] * torch.atanh(half * reach)
    return (torch.cos(angle) * (0.5 * weight).to(scale)).sum(-1)
