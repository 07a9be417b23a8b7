"""Facets that an eye meets, and the lights that they mirror to it: nodes of sums over an even sky.

They are drawn as GGX spreads them: of a share s of all facets the square of the slope is above spread² (1 - s) / s. The
nodes are even in the cube root of the share, whose steps are finest in the tail, and in angles round the normal.
"""

import math

import torch
from jaxtyping import Float64
from torch import Tensor

from diffrender.parameters import record
from diffrender.shading.microfacet import LEAST_COSINE, visible_smith

_SHARES, _TURNS = 48, 24  # nodes; with fewer turns white metal sends 0.05 % too much


@record
class MirroringFacets:
    """Facets as eyes of some cosines meet them.

    Attributes:
        weight: share of an even sky that they would send to the eye if they mirrored all; 0 of those that are unseen.
        cos_half: of the eye with the facet's normal.
        cos_light: of the surface's normal with the light.
        aside: of the light's direction, how far it is away from the eye along the surface, over the eye's own sine.
    """

    weight: Float64[Tensor, "cosines shares turns"]
    cos_half: Float64[Tensor, "cosines shares turns"]
    cos_light: Float64[Tensor, "cosines shares turns"]
    aside: Float64[Tensor, "cosines shares turns"]


def mirroring(cosine: Float64[Tensor, " cosines"], spread_square: Float64[Tensor, ""]) -> MirroringFacets:
    """Facets of a spread of slopes, squared, that eyes meet; the mean over shares and turns is the sum over the sky."""
    left = (torch.arange(_SHARES, dtype=torch.float64) + 0.5) / _SHARES
    turn = (torch.arange(_TURNS, dtype=torch.float64) + 0.5) * (math.pi / _TURNS)
    # Not straight down, where the sine is 0 and the plane of the mirror none.
    cos_eye = cosine.clamp(LEAST_COSINE, 1.0 - 2e-3)[:, None, None]
    slope_square = spread_square * (left**-3 - 1.0)
    cos_facet = (1.0 + slope_square).rsqrt()[:, None]
    sin_facet = slope_square.sqrt()[:, None] * cos_facet * torch.cos(turn)
    sin_eye = (1.0 - cos_eye * cos_eye).sqrt()
    cos_half = cos_eye * cos_facet + sin_eye * sin_facet  # the eye lies at +sine in the plane of the first tangent
    cos_light = 2.0 * cos_half * cos_facet - cos_eye
    is_seen = (cos_half > 0.0) & (cos_light > 0.0)
    reach = visible_smith(cos_eye.expand_as(cos_light), cos_light.clamp(min=0.0), spread_square)
    # Density of lights is that of facets, D cos_facet, over 4 cos_half.
    weight = 3.0 * left.square()[:, None] * 4.0 * reach * cos_half / cos_facet
    weight = torch.where(is_seen, weight, torch.zeros_like(weight))
    aside = (sin_eye - 2.0 * cos_half * sin_facet) / sin_eye
    return MirroringFacets(weight, cos_half, cos_light, aside)
