"""Real spherical harmonics: what light from all around is stored in, smoothed to a few numbers."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

BANDS = (0, 1, 1, 1, 2, 2, 2, 2, 2)  # to which each belongs


def basis(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 9"]:
    """The nine of order 2 in a unit direction, orthonormal over the sphere; the first 1 and 4 are those of orders 0, 1.

    Within a band they go from -order to order: y, z, x; xy, yz, 3z² - 1, xz, x² - y².

    >>> basis(torch.tensor([0.0, 0.0, 1.0]))[:4]
    tensor([0.2821, 0.0000, 0.4886, 0.0000])
    """
    x, y, z = direction.unbind(-1)
    even, first = math.sqrt(0.25 / math.pi), math.sqrt(0.75 / math.pi)
    second = math.sqrt(15.0 / math.pi) / 2.0
    parts = (
        torch.full_like(x, even), first * y, first * z, first * x,
        second * x * y, second * y * z, second / math.sqrt(12.0) * (3.0 * z * z - 1.0), second * x * z,
        second / 2.0 * (x * x - y * y),
    )  # fmt: skip
    return torch.stack(parts, -1)
