"""Streaks: round drops in motion, as a pixel sees them through its filter while the shutter is open.

A pixel weighs what lies round it by a Gaussian of half its side. A drop is drawn as a square of the same area whose
sides lie along its motion; what it hides of a pixel, averaged over the exposure, is then a product of two integrals of
the Gaussian: across the streak one over the drop's width, along it the mean over the exposure of one over its length.
Both lie in [0, 1] for any size, and a streak of no length is a drop at rest. The streak's nearest point to the ray
tells the distance, and so the size; over a streak of very uneven distance that is right where it meets the ray only.

Far fewer drops can be drawn than fall: heavy rain has 3000 a second on every square metre. So one may stand for many,
which would hide the same one after the other.

Gradient: exact of places, sizes and weights of streaks.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import smooth_rise
from diffrender.parameters import record

FILTER = 0.5  # standard deviation of a pixel's filter [pixels]
DARKEST = 0.95  # most that one drop hides: it shines through, and the logarithm of what is left is finite
SOFT = 0.2  # depth over which a drop goes behind the scene, so that none is cut where it lands [m]
CLEAR, WHOLE = 0.25, 0.75  # distances from the eye up to which a drop is not drawn, and from which on it is whole [m]

_LEAST = 1e-4  # length that is added to every streak across the ray, so that all have a direction [m]
_ALONG = 1e-4  # squared sine of the angle to the ray within which a streak is drawn as if at that angle
_SHORT = 0.5  # length of a streak below which a series stands for a difference [standard deviations]


@record
class Streaks:
    """Straight ways of drops relative to the eye while the shutter was open."""

    start: Float[Tensor, "*batch streaks 3"]  # [m]
    way: Float[Tensor, "*batch streaks 3"]  # to where they were as it closed [m]
    radius: Float[Tensor, "*batch streaks"]  # of the drops [m]
    weight: Float[Tensor, "*batch streaks"]  # of what they hide, in [0, 1]
    number: Float[Tensor, "*#batch"]  # of real drops that each stands for


def featured(streaks: Streaks) -> Float[Tensor, "*batch streaks features"]:
    """What coverage is made of: start, way, way × start, their products, half the width, and the weight."""
    half = 0.5 * math.sqrt(math.pi) * streaks.radius
    way = streaks.way + _LEAST * _across(streaks.start)
    start = streaks.start
    square = (way * way).sum(-1)
    both = (start * way).sum(-1)
    closest = torch.clamp(-both / square, 0.0, 1.0)
    from_eye = torch.linalg.vector_norm(start + closest[..., None] * way, dim=-1)
    weight = DARKEST * streaks.weight * smooth_rise(from_eye - CLEAR, from_eye.new_tensor(WHOLE - CLEAR))
    scalars = torch.stack([both, square, half, weight], -1)
    return torch.cat([start, way, torch.linalg.cross(way, start), scalars], -1)


def _across(place: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Level unit vector across the direction to a place; any where that is straight up or down."""
    x, y, _ = place.unbind(-1)
    far = torch.hypot(x, y)
    upright = far == 0.0
    level = torch.stack([-y, x, torch.zeros_like(x)], -1) / torch.where(upright, torch.ones_like(far), far)[..., None]
    return torch.where(upright[..., None], level.new_tensor([1.0, 0.0, 0.0]), level)


def seen(
    features: Float[Tensor, "*batch streaks features"], direction: Float[Tensor, "*batch rays 3"], sigma: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Of rays and streaks: depth [m], and in deviations of the filter the place across, both ends along, half width.

    The origin is the ray; the depth is 1 where a streak's nearest point lies behind the eye, told by a width of 0.
    """
    start, way, normal = (features[..., place : place + 3] for place in (0, 3, 6))
    both, square, half = (features[..., None, :, place] for place in (9, 10, 11))
    ahead, along, across = (direction @ one.mT for one in (start, way, normal))
    # The part of the way that is seen from the side, and how far along it the ray is passed.
    side = torch.sqrt(square * (1.0 + _ALONG) - along * along)
    inner = both - ahead * along
    passed = torch.clamp(-inner / (side * side), 0.0, 1.0)
    depth = ahead + passed * along
    is_ahead = depth > 0.0
    depth = torch.where(is_ahead, depth, torch.ones_like(depth))
    scale = 1.0 / (depth * sigma)
    first = inner / side * scale
    half = half * scale * is_ahead.to(scale)
    return depth, across / side * scale, first, first + side * scale, half


def hidden_by(features: Tensor, direction: Tensor, distance: Tensor, sigma: Tensor) -> Float[Tensor, "*batch rays s"]:
    """Share of each ray's pixel that each streak hides."""
    depth, across, first, last, half = seen(features, direction, sigma)
    wide = _normal(across + half) - _normal(across - half)
    in_front = smooth_rise(distance[..., None] + SOFT - depth, depth.new_tensor(SOFT))
    return features[..., None, :, 12] * wide * _mean(first, last, half) * in_front


def _mean(first: Tensor, last: Tensor, half: Tensor) -> Tensor:
    """Mean over places from the first to the last of the filter's weight within half a width of them."""
    length = last - first
    is_short = length < _SHORT
    middle = 0.5 * (first + last)
    curved = (half - middle) * _density(middle - half) - (middle + half) * _density(middle + half)
    near = _normal(middle + half) - _normal(middle - half) + torch.where(is_short, length * length / 24.0, 0.0) * curved
    far = (_ramp(last, half) - _ramp(first, half)) / torch.where(is_short, torch.ones_like(length), length)
    return torch.where(is_short, near, far)


def _ramp(place: Tensor, half: Tensor) -> Tensor:
    """Integral up to a place of the filter's weight within half a width: from 0 to twice that half."""
    # Beyond, it is one of its ends; there the difference would lose its digits.
    bound = (half + 6.0).detach()
    place = torch.minimum(torch.maximum(place, -bound), bound)
    return _rise(place + half) - _rise(place - half)


def _rise(place: Tensor) -> Tensor:
    return place * _normal(place) + _density(place)


def _normal(place: Tensor) -> Tensor:
    return 0.5 + 0.5 * torch.erf(place * math.sqrt(0.5))


def _density(place: Tensor) -> Tensor:
    return torch.exp(-0.5 * place * place) / math.sqrt(2.0 * math.pi)
