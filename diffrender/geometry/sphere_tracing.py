"""Sphere tracing: where rays meet a surface that is given by a distance, and what of the light reaches it [1].

A distance is any function of points that is 0 on the surface, negative inside, and outside at most the way to the
surface. Rays step by it, 1.5 times as far as is safe; where the balls round both ends of a step do not touch, the step
is taken back to the safe one [2]. Rays that have arrived stand still, so that all take the same number of steps.
Newton's steps then find the surface to the last digits.

Gradient: how far a hit is, by the implicit function theorem: one Newton step from a hit that is held still has its
value and derivatives, forward and backward. Whether a ray hits at all is not differentiated. The way to the place where
light passes nearest to an occluder is not either, which is exact where the distance is smooth: it is least there.

[1] J. Hart, "Sphere Tracing", The Visual Computer 12(10), 1996.
[2] B. Keinert et al., "Enhanced Sphere Tracing", STAG 2014, section 3.1.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.numerics import safe_sqrt, smooth_rise
from diffrender.parameters import record
from diffrender.rays import Rays

Distance = Callable[[Tensor], Tensor]

RELAXED = 1.5  # of a safe step
_POLISHES = 4  # Newton's steps at the end: from 1e-2 to all digits
_SECANTS = 6  # of the piece of a ray where light passes nearest to an occluder: to 1e-7 of it
_STEEPEST = 1e-3  # least fall of the distance along a ray that Newton's steps divide by
_ARRIVED = 2.0 / 3.0  # of a number's digits must be 0 in the distance of a hit, in the radius that bounds the shape


@record
class Span:
    """Piece of a ray: lengths where it begins and ends [m], the same where it is empty."""

    near: Float[Tensor, "*batch"]
    far: Float[Tensor, "*batch"]


@record
class Hit:
    """Where rays meet a surface: the way there [m] and the place; both mean nothing where `is_hit` is false."""

    length: Float[Tensor, "*batch"]
    position: Float[Tensor, "*batch 3"]
    is_hit: Bool[Tensor, "*batch"]


def within_ball(rays: Rays, radius: Float[Tensor, ""]) -> Span:
    """Piece of each ray inside a ball round the origin; empty where it misses.

    >>> span = within_ball(
    ...     Rays(torch.tensor([-3.0, 0, 0]), torch.tensor([1.0, 0, 0]), torch.tensor(9.0)), torch.tensor(1.0))
    >>> span.near, span.far
    (tensor(2.), tensor(4.))
    """
    middle = -(rays.origin * rays.direction).sum(-1)
    nearest = rays.origin + middle[..., None] * rays.direction
    half = safe_sqrt(radius * radius - nearest.square().sum(-1))
    near = torch.minimum((middle - half).clamp(min=0.0), rays.length)
    return Span(near, torch.maximum(torch.minimum(middle + half, rays.length), near))


def gradient(distance: Distance, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Gradient of a distance by the place; itself differentiable, forward and backward."""
    found: Tensor = torch.func.grad(lambda place: distance(place).sum())(position)
    return found


def arrived(
    still: Distance, rays: Rays, span: Span, radius: Float[Tensor, ""], steps: int
) -> tuple[Float[Tensor, "*batch"], Bool[Tensor, "*batch"]]:
    """How far it is to the surface [m], and whether it is met at all, within a span and so many steps; held still.

    A ray that begins inside the shape meets nothing.
    """
    with torch.no_grad():
        length = _marched(still, rays, span, steps)
        for _ in range(_POLISHES):
            place = _at(rays, length)
            step = torch.div(*_falling(still, place, rays.direction))
            # A step that is longer than what the march leaves is that of a ray that passes by.
            length = length + step.clamp(-0.1 * radius, 0.1 * radius)
        is_near = still(_at(rays, length)).abs() <= torch.finfo(length.dtype).eps ** _ARRIVED * radius
        begins_outside = still(_at(rays, span.near)) > 0.0
        return length.detach(), is_near & begins_outside & (length < span.far) & (length > span.near)


def _marched(still: Distance, rays: Rays, span: Span, steps: int) -> Tensor:
    length, step, safe = span.near, torch.zeros_like(span.near), torch.zeros_like(span.near)
    for _ in range(steps):
        free = still(_at(rays, length))
        is_torn = (safe + free < step) & (step > safe)
        back = safe - step
        safe = torch.where(is_torn, safe, free)
        taken = torch.where(is_torn, back, torch.where(free > 0.0, RELAXED * free, free))
        step = torch.where(is_torn, safe, taken)
        length = torch.minimum(torch.maximum(length + taken, span.near), span.far)
    return length


def _at(rays: Rays, length: Tensor) -> Tensor:
    return rays.origin + length[..., None] * rays.direction


def _falling(still: Distance, place: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Distance, and how fast it falls along rays, away from 0."""
    towards, free = _slope_and_value(still, place)
    fall = -(towards * direction).sum(-1)
    return free, torch.where(fall.abs() < _STEEPEST, torch.full_like(fall, _STEEPEST), fall).detach()


def _slope_and_value(still: Distance, place: Tensor) -> tuple[Tensor, Tensor]:
    def summed(at: Tensor) -> tuple[Tensor, Tensor]:
        free = still(at)
        return free.sum(), free

    slope, free = torch.func.grad(summed, has_aux=True)(place)
    return slope, free


def meet(distance: Distance, still: Distance, rays: Rays, found: tuple[Tensor, Tensor]) -> Hit:
    """Where rays meet a surface, from what `arrived` found: one Newton step, through which derivatives pass."""
    length, is_hit = found
    place = _at(rays, length)
    direction = rays.direction.detach()
    step = distance(place) / _falling(still, place.detach(), direction)[1]
    exact = length + torch.where(is_hit, step, torch.zeros_like(step))
    return Hit(exact, _at(rays, exact), is_hit)


def nearest_pass(still: Distance, rays: Rays, span: Span, steps: int) -> Float[Tensor, "*batch"]:
    """How far along a ray the distance is least in proportion to the way there [m]; the span begins away from 0."""
    with torch.no_grad():
        length, lengths, shares = span.near, [], []
        for _ in range(steps):
            free = still(_at(rays, length))
            lengths.append(length)
            shares.append(free / length)
            length = torch.minimum(length + free.clamp(min=0.0), span.far)
        along = torch.stack(lengths)
        least = torch.stack(shares).argmin(0, keepdim=True)
        low = along.gather(0, (least - 1).clamp(min=0))[0]
        high = along.gather(0, (least + 1).clamp(max=steps - 1))[0]
        return _least_between(still, rays, low, high).detach()


def _least_between(still: Distance, rays: Rays, low: Tensor, high: Tensor) -> Tensor:
    """Where the distance is least in proportion to the way, between two lengths, by the Illinois rule on its slope."""

    def rise(length: Tensor) -> Tensor:
        slope, free = _slope_and_value(still, _at(rays, length))
        return length * (slope * rays.direction).sum(-1) - free

    falls, rises = rise(low), rise(high)
    at_low, at_high = falls >= 0.0, rises <= 0.0
    at_end = torch.where(at_low, low, high)
    length, side = low, torch.zeros_like(low)
    for _ in range(_SECANTS):
        apart = rises - falls
        length = (low * rises - high * falls) / torch.where(apart > 0.0, apart, torch.ones_like(apart))
        slope = rise(length)
        is_right = slope > 0.0
        # An end that stays twice counts half, or the other would creep.
        falls = torch.where(is_right, torch.where(side > 0.0, 0.5 * falls, falls), slope)
        rises = torch.where(is_right, slope, torch.where(side < 0.0, 0.5 * rises, rises))
        low, high = torch.where(is_right, low, length), torch.where(is_right, length, high)
        side = torch.where(is_right, torch.ones_like(side), -torch.ones_like(side))
    return torch.where(at_low | at_high, at_end, length)


def soft_shadow(
    distance: Distance, rays: Rays, passing: Float[Tensor, "*batch"], spread: Float[Tensor, ""]
) -> Float[Tensor, "*batch"]:
    """Share of a light that reaches the origins of rays towards it, from 0 to 1, by where `nearest_pass` found them.

    0 where the ray is blocked; 1 where nothing comes nearer than `spread` in proportion to the way, which is about the
    tangent of the light's angular radius: turned up, softer and darker. The half of a penumbra that lies behind the
    edge of the shadow is left black.
    """
    return smooth_rise(distance(_at(rays, passing)) / passing, spread)


def openness(
    distance: Distance, position: Float[Tensor, "*batch 3"], normal: Float[Tensor, "*batch 3"], reach: Float[Tensor, ""]
) -> Float[Tensor, "*batch"]:
    """Share of the sky that a place sees by its surroundings up to a reach [m]: 1 on what is round, less in clefts.

    `normal` is as long as the distance's gradient. Quilez' estimate [1]: over a plane the distance grows as fast as the
    way from it; less where something else is near.

    [1] I. Quilez, "Ambient occlusion in distance fields", in "Rendering Worlds with Two Triangles", NVScene 2008.
    """
    slope = torch.linalg.vector_norm(normal, dim=-1, keepdim=True)
    up = normal / torch.where(slope > 0.0, slope, torch.ones_like(slope))
    found = torch.zeros_like(position[..., 0])
    for share in (0.25, 0.5, 1.0):
        way = share * reach
        found = found + smooth_rise(distance(position + way * up), way * slope[..., 0].clamp(min=_STEEPEST)) / 3.0
    return found
