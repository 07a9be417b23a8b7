"""Albedo of rough ground under a film of water, by optics: light that is sent up is thrown back by the water [1].

[1] J. Lekner, M. Dorf, "Why some things are darker when wet", Applied Optics 27(7), 1988, equations 2 and 9.
"""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading.microfacet import fresnel_exact

WATER_INDEX = 1.33
_NODES = 4096


def wet_albedo(dry: Float[Tensor, "*batch"], index: float = WATER_INDEX) -> Float[Tensor, "*batch"]:
    """Share of sunlight from above that ground reflects under a clear film, by what it reflects dry.

    Dark ground keeps half of it under water, white ground nearly all. Light under the film is even, and goes round
    between ground and film until it leaves or is swallowed.

    >>> wet_albedo(torch.tensor([0.1, 0.3, 0.5, 0.8]))
    tensor([0.0543, 0.1808, 0.3386, 0.6651])
    """
    enters = 1.0 - ((index - 1.0) / (index + 1.0)) ** 2
    thrown_back = 1.0 - (1.0 - diffuse_reflectance(index)) / index**2
    return enters * dry * (1.0 - thrown_back) / (1.0 - thrown_back * dry)


@cache
def diffuse_reflectance(index: float) -> float:
    """Share of light, alike from all directions, that a clear medium reflects: the mean of Fresnel's by the cosine."""
    cosine = (torch.arange(_NODES, dtype=torch.float64) + 0.5) / _NODES
    return float((2.0 * cosine * fresnel_exact(index, cosine)).mean())
