"""Where a point light stands best for a sphere: Karis' place [1], and the Decima engine's with the larger N·H [2].

A point light is put where the sphere sends most to the eye. Where the mirror's direction meets the sphere that is its
own; else a place on the sphere's edge. Karis takes the one nearest to the mirror's direction, which at grazing angles
leaves ragged highlights, because facets are most where N·H is largest. The talk goes there by one step of Newton's.
With x for the tangent of half the angle round the edge, and f for the logarithm of (N·H)² and its derivatives by x at
Karis' place,

    x = -f' / (f'² + f'')    the talk's step, on (N·H)² itself
    x = -f' / f''            on the logarithm

The first goes astray where f'² outweighs f'', on up to a sixth of surfaces that light and eye graze, and is worse there
than Karis' place. The second never is: f'' is below -2 sine² everywhere, of the sphere's angular radius
(`experiments.sphere_light` has the table).

Gradient: exact but for the choice whether the mirror's direction meets the sphere, where value and gradient agree.

[1] B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013 course "Physically Based Shading".
[2] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games", slides 4 to 15.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.shading.brdf import Geometry
from diffrender.shading.microfacet import LEAST_COSINE

_ONE_DIRECTION = 1e-12  # square of the sine below which nothing lies aside


@record
class Slopes:
    """Derivatives of f round the edge at Karis' place, over the sphere's sine; the second lacks that of its square."""

    first: Float[Tensor, "*batch"]
    second: Float[Tensor, "*batch"]
    sine: Float[Tensor, "*#batch"]


# Numerator and denominator of x; the quotient itself may be infinite.
Step = Callable[[Slopes], tuple[Tensor, Tensor]]


def no_step(slopes: Slopes) -> tuple[Tensor, Tensor]:
    """Karis' place."""
    return torch.zeros_like(slopes.first), torch.ones_like(slopes.first)


def talk_step(slopes: Slopes) -> tuple[Tensor, Tensor]:
    """Newton's step for the largest (N·H)²."""
    return slopes.first, -slopes.second - slopes.sine * slopes.first.square()


def guarded_step(slopes: Slopes) -> tuple[Tensor, Tensor]:
    """Newton's step for the largest logarithm of N·H, kept from turning back where rounding would."""
    return slopes.first, torch.maximum(-slopes.second, slopes.sine.expand_as(slopes.second))


def bent(geometry: Geometry, sine: Float[Tensor, "*#batch"], step: Step) -> Float[Tensor, "*batch 3"]:
    """Unit vector towards the point that a sphere is seen as; the geometry's light is its centre."""
    normal, to_eye, to_centre = geometry.normal, geometry.to_eye, geometry.to_light
    mirror = 2.0 * _dot(normal, to_eye)[..., None] * normal - to_eye
    along = _dot(mirror, to_centre)
    off = mirror - along[..., None] * to_centre
    off_square = _dot(off, off)
    is_mirrored = (along > 0.0) & (off_square <= sine * sine)
    # Where that is so the edge is not looked at, and where the light is opposite no side of it is better.
    is_one = is_mirrored | (off_square < _ONE_DIRECTION)
    aside = off / torch.where(is_one, torch.ones_like(off_square), off_square).sqrt()[..., None]
    across = torch.linalg.cross(aside, to_centre.expand_as(aside))
    middle = torch.sqrt((1.0 - sine) * (1.0 + sine))[..., None] * to_centre
    over, under = step(_slopes(geometry, middle + sine[..., None] * aside, (aside, across), sine))
    # The talk's step is 0 / 0 where f does not bend.
    under = torch.where(is_one | ((over == 0.0) & (under == 0.0)), torch.ones_like(under), under)
    whole = over * over + under * under
    cos_turn, sin_turn = ((under * under - over * over) / whole)[..., None], (2.0 * over * under / whole)[..., None]
    edge = middle + sine[..., None] * (cos_turn * aside + sin_turn * across)
    return torch.where(is_mirrored[..., None], mirror, edge)


def _slopes(geometry: Geometry, nearest: Tensor, axes: tuple[Tensor, Tensor], sine: Tensor) -> Slopes:
    """At Karis' place, from the normal's and the half vector's components across the sphere's direction.

    f is 2 log N·(L + V) - log |L + V|²; the constant terms of f'' cancel on paper, and would not in float32.
    """
    half = nearest + geometry.to_eye
    height = _dot(geometry.normal, half).clamp(min=LEAST_COSINE)
    length = (0.5 * _dot(half, half)).clamp(min=0.5 * LEAST_COSINE**2)
    (up_aside, up_across), (eye_aside, eye_across) = (
        [_dot(one, axis) / by for axis in axes] for one, by in ((geometry.normal, height), (geometry.to_eye, length))
    )
    squares = 4.0 * eye_across * eye_across - 8.0 * up_across * up_across
    return Slopes(4.0 * up_across - 2.0 * eye_across, 4.0 * eye_aside - 8.0 * up_aside + sine * squares, sine)


def _dot(one: Tensor, other: Tensor) -> Tensor:
    return (one * other).sum(-1)
