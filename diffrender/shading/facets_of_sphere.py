"""Facets that mirror a sphere to the eye: how many, by a closed form of GGX, and which one is their mean.

Directions of light are drawn on a plane across the eye's direction, as far out as the tangent of half their angle from
it: by this stereographic map a sphere is a disc, and the half vector is the very point, as a direction from the eye
one unit before the plane. There GGX times solid angle is, with nothing left over,

    4 spread² / (pi √A) dx dy / Q²,    Q = x² + y² + q,    q = spread² / A,    A = cos² eye + spread² sin² eye

where y is across to the plane of eye and normal, and x in it, measured from the peak and times √A. So a sphere is an
ellipse, of matrix M (its boundary is p' M⁻¹ p = 1 around it) and middle m, and 1 / Q² over an ellipse is the light of
an evenly bright one at a point √q over the peak. Its vector lies along the axis of the cone between them [1, 2], which
is normal to the confocal ellipsoid through the point. With t for the square of the ellipsoid's third axis,

    m' (M + t)⁻¹ m + q / t = 1                                                     the largest root
    integral of 1 / Q² = pi √|M| / (√|M + t| (q + |mean|²)),    mean = t (M + t)⁻¹ m

So there is no table as of linearly transformed cosines [1], and nothing is fitted. What the facets reflect, by Fresnel
and by what hides them, is taken of the mean one: within 2 % on metals and 3 % on others while the sphere is above the
horizon and its sine at most 0.2, and 6 % and 16 % at a sine of 0.5 (`experiments.sphere_light`).

A sphere that the horizon cuts is an ellipse too, by `risen_sphere`.

Gradient: exact, through the steps to the root.

[1] E. Heitz et al., "Real-Time Polygonal-Light Shading with Linearly Transformed Cosines", ACM TOG 35(4), 2016.
[2] E. Heitz, S. Hill, "Real-Time Line- and Disk-Light Shading with Linearly Transformed Cosines", SIGGRAPH 2017
    course "Physically Based Shading": vector irradiance of an ellipse along its axis.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.shading.brdf import Geometry
from diffrender.shading.risen_sphere import Risen, cosine, direction

_STEPS = 4  # to the root; leave 1e-7 of the integral, three 5e-4 for large spheres
_NOWHERE = 1e-24  # square of a distance below which the peak is in the middle
_LEAST_WIDE = 1e-6  # of the plane's unit, for spheres that reach to the eye's opposite


@record
class Facets:
    """Facets that mirror a sphere to the eye.

    Attributes:
        density: GGX summed over the sphere's directions, over pi, its sine's square and its stretch [1/sr].
        cos_half: of the eye with the mean one's normal.
        cos_light: of the surface's normal with where the mean one mirrors; negative below the horizon.
    """

    density: Float[Tensor, "*batch"]
    cos_half: Float[Tensor, "*batch"]
    cos_light: Float[Tensor, "*batch"]


@record
class _Ellipse:
    """Picture of a sphere on the plane of facets, times a scale, from the peak; matrix by its three numbers and root.

    Attributes:
        middle: along and across.
        matrix: of boundary squared: along, across, both.
        area: square root of the matrix' determinant.
        height: q of Q, times the scale's square.
    """

    middle: tuple[Tensor, Tensor]
    matrix: tuple[Tensor, Tensor, Tensor]
    area: Tensor
    height: Tensor


def facets_of(geometry: Geometry, of: Risen, spread: Float[Tensor, "*#batch"]) -> Facets:
    """Facets that mirror a sphere to the eye, by the square of the spread of their slopes."""
    normal, to_eye = geometry.normal, geometry.to_eye
    cos_eye = _dot(normal, to_eye)
    tilt = normal - cos_eye[..., None] * to_eye
    flat = cos_eye * cos_eye + spread * _dot(tilt, tilt)
    along, _ = direction(tilt, _any_across(to_eye))
    across = torch.linalg.cross(to_eye, along)
    # Differences of cosines lose their digits where light and eye are opposite.
    scale = 0.5 * (to_eye + of.to_centre).square().sum(-1)
    scale = (scale - of.sine.square() / (1.0 + cosine(of.sine))).clamp(min=_LEAST_WIDE)
    aside = of.to_centre - _dot(of.to_centre, to_eye)[..., None] * to_eye
    peak = (scale * (1.0 - spread) * cos_eye / flat)[..., None] * tilt
    # The way from where the disc would meet the horizon to its middle.
    lifted, _ = direction(cos_eye[..., None] * aside - scale[..., None] * tilt, torch.zeros_like(tilt))
    root = flat.sqrt()
    middle = root * _dot(aside - peak, along), _dot(aside - peak, across)
    way = _dot(lifted, along), _dot(lifted, across)
    height = spread * scale.square() / flat
    mean, density = _over(_picture(middle, way, of, root, height))
    # Half vector, of any length; along the eye it is the scale.
    half = scale[..., None] * to_eye + peak + (mean[0] / root)[..., None] * along + mean[1][..., None] * across
    length_square = _dot(half, half)
    return Facets(
        density=4.0 / math.pi * spread * scale.square() * density,
        cos_half=(scale / length_square.sqrt()).clamp(max=1.0),
        cos_light=2.0 * scale * _dot(normal, half) / length_square - cos_eye,
    )


def _picture(
    middle: tuple[Tensor, Tensor], lifted: tuple[Tensor, Tensor], of: Risen, root: Tensor, height: Tensor
) -> _Ellipse:
    """The disc, stretched across the way that it was lifted by, and all times the root along."""
    square, wider = of.sine.square(), of.wider.square()
    by_way = square * (1.0 - wider)
    matrix = (
        root.square() * (square * wider + by_way * lifted[0].square()),
        square * wider + by_way * lifted[1].square(),
        root * by_way * lifted[0] * lifted[1],
    )
    return _Ellipse(middle, matrix, root * square * of.wider, height)


def _over(ellipse: _Ellipse) -> tuple[tuple[Tensor, Tensor], Tensor]:
    """Mean of the facets in an ellipse, and the integral of 1 / Q² over its area and pi.

    Each step takes the ellipse for a circle, whose root is that of a square, as wide as has the right value and slope
    where the last step has led; the first one for a circle around it.
    """
    (x, y), (xx, yy, xy), q = ellipse.middle, ellipse.matrix, ellipse.height
    square, offset = torch.maximum(xx, yy) + xy.abs(), x * x + y * y
    for _ in range(_STEPS):
        half = 0.5 * (offset + q - square)
        larger = torch.sqrt(half * half + q * square) + half.abs()
        root = torch.where(half > 0.0, larger, q * square / larger)
        determinant = ellipse.area.square() + root * (xx + yy) + root.square()
        along, across = ((yy + root) * x - xy * y) / determinant, ((xx + root) * y - xy * x) / determinant
        value, slope = x * along + y * across, along * along + across * across
        is_none = slope < _NOWHERE
        ratio = torch.where(is_none, square + root, value / torch.where(is_none, torch.ones_like(slope), slope))
        square, offset = ratio - root, value * ratio
    mean = root * along, root * across
    return mean, 1.0 / (determinant.sqrt() * (q + mean[0].square() + mean[1].square()))


def _any_across(axis: Tensor) -> Tensor:
    """A unit vector across another."""
    x, y, z = axis.unbind(-1)
    nothing = torch.zeros_like(x)
    steep = torch.stack([z, nothing, -x], -1)
    across = torch.where((z.abs() > 0.5)[..., None], steep, torch.stack([-y, x, nothing], -1))
    return direction(across, across)[0]


def _dot(one: Tensor, other: Tensor) -> Tensor:
    product: Tensor = (one * other).sum(-1)
    return product
