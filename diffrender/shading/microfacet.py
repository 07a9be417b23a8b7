"""Torrance and Sparrow's surfaces of tiny mirrors [1]: how their normals are spread, hide each other, and reflect.

Roughness is the one that artists set, from 0 to 1; the spread of the facets' slopes is its square [2]. All takes
cosines between unit vectors. Nothing here is scattered twice between facets, so that rough surfaces lose light: of a
white metal at roughness 1 up to 69 %.

[1] K. Torrance, E. Sparrow, "Theory for off-specular reflection from roughened surfaces", JOSA 57(9), 1967.
[2] B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013 course "Physically Based Shading".
[3] B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, equations 33 and 34.
[4] E. Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014, equation 99.
[5] C. Schlick, "An Inexpensive BRDF Model for Physically-based Rendering", Eurographics 1994, equations 15 and 19.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

# Spread of slopes that a mirror keeps. The sun's disc blurs its own reflection by its radius of 0.00465 rad, slopes by
# half of that; a mirror without any would show a point light infinitely bright and not at all beside it.
MIRROR_SPREAD = 0.0023
# Of the eye over a surface: bumps bend normals away from it, where facets are not defined.
LEAST_COSINE = 1e-3


def spread_squared(roughness: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Square of the spread of facets' slopes, from 5e-6 of a mirror to 1.

    Gradient: 0 at roughness 0, as the fourth power has.
    """
    square = roughness * roughness
    return square * square + MIRROR_SPREAD**2


def ggx(
    half: Float[Tensor, "*#batch 3"], normal: Float[Tensor, "*#batch 3"], spread_square: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch"]:
    """Share of facets that face a direction, GGX [1/sr] [3]; the direction need not be of unit length.

    From the cross product with the normal: 1 - cos² has no digits left in float32 where a mirror's facets are. 0 for
    no direction at all, as half-way between opposite ones.
    """
    along = (half * normal).sum(-1)
    aside = torch.linalg.cross(half.expand_as(half + normal), normal.expand_as(half + normal)).square().sum(-1)
    length_square = half.square().sum(-1)
    is_none = length_square == 0.0
    below = torch.where(is_none, torch.ones_like(aside), spread_square * along * along + aside)
    ratio = length_square / below
    return spread_square * ratio * ratio / math.pi


def visible_smith(
    cos_eye: Float[Tensor, "*#batch"], cos_light: Float[Tensor, "*#batch"], spread_square: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch"]:
    """Smith's share of GGX facets that eye and light both see, over 4 cos_eye, height-correlated [4].

    So it is times the cosine of the light already: 0 for a light at the horizon, and nothing is divided by 0 there.
    The eye has to be above the surface.
    """
    from_eye = torch.sqrt(cos_eye * cos_eye * (1.0 - spread_square) + spread_square)
    from_light = torch.sqrt(cos_light * cos_light * (1.0 - spread_square) + spread_square)
    return 0.5 * cos_light / (cos_light * from_eye + cos_eye * from_light)


def visible_schlick(
    cos_eye: Float[Tensor, "*#batch"], cos_light: Float[Tensor, "*#batch"], spread_square: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch"]:
    """The same by Schlick's rational function [5], eye and light each for itself, with k half of the spread [2].

    Without its square roots, and never brighter: by a sixth darker where eye and light are over 30 degrees high, and by
    a factor of five where both graze the roughest surface at 3.
    """
    k = 0.5 * torch.sqrt(spread_square)
    return 0.25 * cos_light / ((cos_eye * (1.0 - k) + k) * (cos_light * (1.0 - k) + k))


def fresnel_schlick(
    straight: Float[Tensor, "*#batch 3"], cosine: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3"]:
    """Share of light that a mirror reflects, by its share at normal incidence: Schlick's fifth power [5]."""
    return straight + (1.0 - straight) * fifth_power(1.0 - cosine)[..., None]


def fifth_power(x: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """x⁵ by products, whose derivative at 0 is exact."""
    square = x * x
    return square * square * x


def fresnel_exact(index: float | Float[Tensor, "*#batch"], cosine: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Share of unpolarised light that a clear medium reflects, by its index of refraction over the air's.

    >>> fresnel_exact(1.33, torch.tensor([1.0, 0.5, 0.0]))
    tensor([0.0201, 0.0591, 1.0000])
    """
    across, within = fresnel_polarised(index, cosine)
    return 0.5 * (across + within)


def fresnel_polarised(
    index: float | Float[Tensor, "*#batch"], cosine: Float[Tensor, "*#batch"]
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """The same of light that swings across the plane of incidence, and of light that swings within it.

    In products of index - 1, so that nothing is left of them, nor of their gradients, at an index of 1.

    >>> fresnel_polarised(1.5, torch.tensor([1.0, 0.5]))
    (tensor([0.0400, 0.1766]), tensor([0.0400, 0.0018]))
    """
    denser = (index - 1.0) * (index + 1.0)
    bent = torch.sqrt(denser + cosine * cosine)
    across = denser / (cosine + bent).square()
    within = denser * ((index * index + 1.0) * cosine * cosine - 1.0) / (index * index * cosine + bent).square()
    return across.square(), within.square()
