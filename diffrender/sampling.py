"""Directions: at random over the sphere and the hemisphere, in fixed even patterns, and by the blog's three angles [1].

The blog takes the direction at an angle a3 in the xy plane and turns it by a2 about z and by a1 about x. The first two
are one angle s = a2 + a3, so that what comes is (cos s, cos a1 sin s, sin a1 sin s): a1 is an even longitude round x,
but s, the angle from x, is a sum of two even ones. Its density is a triangle where an even sphere has sin(s) / 2.
So the directions are not even: 8 / pi² = 0.81 times as dense as even ones at both poles of x, 4 / pi = 1.27 times on
the great circle between them. Weighed by `evenness` they are; no other ranges of a2 and a3 would do.

Gradient: of directions by the numbers they are made from, but at the poles.

[1] "Random vectors directions within a sphere", on the blog that this project takes its fractals from.
[2] A. Gonzalez, "Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices", Mathematical
    Geosciences 42, 2010.
[3] M. Roberts, "The unreasonable effectiveness of quasirandom sequences", extremelearning.com.au, 2018.
"""

import math

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from diffrender.numerics import safe_sqrt

_GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0
_PLASTIC = 1.32471795724474602596  # the root of x³ = x + 1, the golden number of two dimensions [3]


def random_pairs(count: int, generator: Generator, dtype: torch.dtype = torch.float64) -> Float[Tensor, "{count} 2"]:
    """Pairs of independent numbers, even over [0, 1)."""
    return torch.rand(count, 2, generator=generator, dtype=dtype)


def even_pairs(count: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "{count} 2"]:
    """Pairs that fill the unit square evenly however many are taken from the first on: the R2 sequence [3].

    >>> even_pairs(2)
    tensor([[0.2549, 0.0698],
            [0.0098, 0.6397]], dtype=torch.float64)
    """
    # In float64: the fraction of a large multiple has lost as many digits as the multiple has.
    step = torch.tensor([1.0 / _PLASTIC, 1.0 / _PLASTIC**2], dtype=torch.float64)
    return torch.remainder(0.5 + torch.arange(1, count + 1, dtype=torch.float64)[:, None] * step, 1.0).to(dtype)


def on_sphere(pair: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
    """Unit directions from pairs in [0, 1): even over the sphere where the pairs are over the square.

    >>> on_sphere(torch.tensor([0.0, 0.0]))
    tensor([0., 0., 1.])
    """
    height = 1.0 - 2.0 * pair[..., 0]
    return _at_height(height, safe_sqrt((1.0 - height) * (1.0 + height)), pair[..., 1])


def by_cosine(pair: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
    """Unit directions of the upper hemisphere from pairs in [0, 1), as dense as cos / pi: as matt surfaces see light.

    >>> by_cosine(torch.tensor([0.75, 0.0])).round(decimals=4)
    tensor([0.8660, 0.0000, 0.5000])
    """
    return _at_height(safe_sqrt(1.0 - pair[..., 0]), safe_sqrt(pair[..., 0]), pair[..., 1])


def fibonacci(count: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "{count} 3"]:
    """Unit directions on a spiral from pole to pole, each of the same solid angle: the Fibonacci lattice [2].

    The most even of all here; what it is for must know how many it wants.

    >>> fibonacci(1).round(decimals=4) + 0.0
    tensor([[1., 0., 0.]], dtype=torch.float64)
    """
    place = torch.arange(count, dtype=torch.float64)
    pair = torch.stack([(place + 0.5) / count, torch.remainder(place / _GOLDEN, 1.0)], -1)
    return on_sphere(pair).to(dtype)


def _at_height(height: Tensor, level: Tensor, turn: Tensor) -> Tensor:
    azimuth = 2.0 * math.pi * turn
    return torch.stack([level * torch.cos(azimuth), level * torch.sin(azimuth), height], -1)


def random_three_angles(
    count: int, generator: Generator, dtype: torch.dtype = torch.float64
) -> Float[Tensor, "{count} 3"]:
    """The blog's angles a1, a2 and a3 [rad]: even over [-pi, pi), [0, pi/2] and [0, pi/2] [1]."""
    share = torch.rand(count, 3, generator=generator, dtype=dtype)
    return share * share.new_tensor([2.0 * math.pi, math.pi / 2, math.pi / 2]) - share.new_tensor([math.pi, 0.0, 0.0])


def from_three_angles(angles: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Unit direction of the blog's three angles [rad], letter for letter [1].

    >>> from_three_angles(torch.tensor([0.0, 0.0, 0.0]))
    tensor([1., 0., 0.])
    """
    first, second, third = angles.unbind(-1)
    x = torch.cos(second) * torch.cos(third) - torch.sin(second) * torch.sin(third)
    across = torch.cos(second) * torch.sin(third) + torch.sin(second) * torch.cos(third)
    return torch.stack([x, torch.cos(first) * across, torch.sin(first) * across], -1)


def three_angles_density(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """How dense the blog's directions are [1/sr]: 2 / pi³ at both poles of x, 1 / pi² on the circle between them.

    >>> 4 * math.pi * three_angles_density(torch.eye(3))
    tensor([0.8106, 1.2732, 1.2732])
    """
    return 1.0 / (4.0 * math.pi * evenness(direction))


def evenness(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Weight of a direction of the blog's that makes means over them those over the sphere: pi² sin(s) / (8 s).

    s is the angle from the nearer pole of x. From pi / 4 on the great circle to pi² / 8 at both poles.

    >>> evenness(torch.eye(3))
    tensor([1.2337, 0.7854, 0.7854])
    """
    level = safe_sqrt(direction[..., 1].square() + direction[..., 2].square())
    angle = torch.atan2(level, direction[..., 0].abs())
    is_pole = level <= 0.0
    share = torch.where(is_pole, torch.ones_like(level), level / torch.where(is_pole, torch.ones_like(angle), angle))
    return math.pi**2 / 8.0 * share
