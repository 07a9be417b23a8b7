"""The colour of fog where an engine has one colour, and perhaps a cone of light round the sun, for ours.

Ours is the radiance of fog without end along level rays, which the phase function brightens towards the sun.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import nnls
from torch import Tensor

from diffrender.atmosphere.height_fog import HeightFog
from fit.export.account import Difference, difference
from fit.export.described import Described, endless_fog

_DIMMEST = 1e-12  # radiance, so that black fog has a logarithm


@dataclass(frozen=True)
class Cone:
    """Even light, and light towards the sun times the cosine to a power, both by channel; and how near it comes."""

    even: tuple[float, ...]
    towards_sun: tuple[float, ...]
    exponent: float
    difference: Difference


def cone(weather: Described, fog: HeightFog, exponents: Sequence[float]) -> Cone:
    """The best cone among some exponents, by least squares of the relative differences, no light below 0."""
    direction, radiance = endless_fog(weather, fog)
    cosine = (direction @ weather.to_sun).clamp(min=0.0)
    return min((_cone(cosine, radiance, exponent) for exponent in exponents), key=lambda one: one.difference.mean)


def _cone(cosine: Float[Tensor, " n"], radiance: Float[Tensor, "n 3"], exponent: float) -> Cone:
    basis = torch.stack([torch.ones_like(cosine), cosine**exponent], -1).double()
    weight = 1.0 / radiance.double().mean(-1).clamp(min=_DIMMEST)
    parts = np.array([nnls((basis * weight[:, None]).numpy(), (c * weight).numpy())[0] for c in radiance.double().mT])
    found = basis @ torch.from_numpy(parts).mT
    even, towards = (tuple(float(one) for one in part) for part in parts.T)
    return Cone(even, towards, exponent, difference(radiance.double(), found))


def even(weather: Described, fog: HeightFog) -> tuple[tuple[float, ...], Difference]:
    """Geometric mean of the colour all round the horizon, which the sun's side does not outweigh; how near it comes."""
    _, radiance = endless_fog(weather, fog)
    mean = radiance.clamp(min=_DIMMEST).log().mean(0).exp()
    return tuple(mean.tolist()), difference(radiance, mean.expand_as(radiance))
