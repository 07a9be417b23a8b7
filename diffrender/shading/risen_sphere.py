"""What is above the horizon of a sphere that shines: how much it lights the ground, and a whole sphere in its stead.

The light of what has risen is a closed form. Its shape, a disc with a straight edge, is none that facets have one for.
So the largest sphere above the horizon stands for it that is as high at its top, stretched along the horizon until it
lights level ground as much. This keeps the height of a reflection and roughly its width. Rough surfaces, whose
reflections have no shape, have it brighter instead: stretched ones reach over the horizon at grazing angles, and were
four times too bright.

Smooth surfaces are better off with the uncut sphere, as they mirror next to nothing from below the horizon to the eye;
but not if it reaches to the eye's opposite, where the facets that mirror it lie edgewise. Theirs goes down to half as
far below the horizon as the eye is above. Against sums, a large sphere that the horizon cuts stays off where a mirror
shows it at a grazing angle (`experiments.sphere_light`).

Gradient: exact, with a kink where a sphere begins to set; 0 when all has set.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import atan_lack
from diffrender.parameters import record
from diffrender.shading.brdf import Geometry

_SMOOTH = 0.05  # spread of facets, up to which spheres are not cut
_ROUGH = 0.2  # square of the spread, from which spheres are made brighter rather than wider
_MOST_STRETCHED = 0.9  # share of what is missing; the rest is made up by brightness, that nothing is divided by 0
_LEAST_SEEN = 0.02  # share of a setting sphere's radius, below which what is above gets no smaller, only darker
_NO_LIGHT = 1e-9  # cosine that stands for 0 where next to nothing has risen
_NO_SIDE = 1e-6  # length below which a vector has no direction
_OVERHEAD = 0.9999  # sine of an eye straight above


@record
class Risen:
    """A sphere above the horizon in the stead of one that may be cut.

    Attributes:
        to_centre: unit vector.
        sine: of its angular radius.
        mean_cosine: at the surface.
        wider: how many times it is stretched along the horizon; 1 where nothing is cut.
        brighter: how many times it shines as bright; 1 where nothing is cut, 0 when all has set.
    """

    to_centre: Float[Tensor, "*batch 3"]
    sine: Float[Tensor, "*batch"]
    mean_cosine: Float[Tensor, "*batch"]
    wider: Float[Tensor, "*batch"]
    brighter: Float[Tensor, "*batch"]


def mean_cosine(height: Float[Tensor, "*#batch"], sine: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Mean over a sphere's disc of a surface's cosine, 0 below its horizon, by its centre's and its radius' sine.

    That of the centre where all is above. Else, with p for the height over the sine s, c for the sphere's cosine,
    e = √(1 - p²) / c and r = (x - atan x) / x³ at x = e s, the closed form s (p angle + e (1 - r e²)) / pi, where the
    angle is that of (-p, e). Of a small sphere that is a disc's, as r is 1/3.

    >>> mean_cosine(torch.tensor([-0.3, 0.0, 0.3]), torch.tensor(0.2))
    tensor([0.0000, 0.0430, 0.3000])
    """
    place = height / sine
    is_cut = place.abs() < 1.0
    place = torch.where(is_cut, place, torch.zeros_like(place))
    edge = torch.sqrt((1.0 - place) * (1.0 + place)) / cosine(sine)
    angle = torch.atan2(edge, -place)
    part = sine * (place * angle + edge * (1.0 - edge.square() * atan_lack(edge * sine))) / math.pi
    return torch.where(is_cut, part, height.clamp(0.0, 1.0))


def risen(geometry: Geometry, sine: Float[Tensor, "*#batch"], spread: Float[Tensor, "*#batch"]) -> Risen:
    """What stands for a sphere around the geometry's light, on facets of so wide a spread, squared."""
    normal, to_centre = geometry.normal, geometry.to_light
    height = (normal * to_centre).sum(-1)
    up, level = direction(normal - height[..., None] * to_centre, torch.zeros_like(to_centre))
    radius = torch.atan2(sine, cosine(sine))
    below = 0.5 * torch.asin((normal * geometry.to_eye).sum(-1).clamp(0.0, _OVERHEAD)) / (1.0 + spread / _SMOOTH**2)
    lift = 0.5 * torch.relu(radius - below - torch.atan2(height, level))
    lift = torch.minimum(lift, (1.0 - _LEAST_SEEN) * radius)
    lifted = torch.cos(lift)[..., None] * to_centre + torch.sin(lift)[..., None] * up
    smaller = torch.sin(radius - lift)
    mean = mean_cosine((normal * lifted).sum(-1), smaller)
    mean = torch.maximum(mean, (0.5 * _LEAST_SEEN * sine).clamp(min=_NO_LIGHT))
    more = mean_cosine(height, sine) * (sine / smaller).square() / mean
    wider = 1.0 + (more - 1.0) * _MOST_STRETCHED / (1.0 + spread / _ROUGH)
    return Risen(lifted, smaller, mean, wider, more / wider)


def cosine(sine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Cosine of an angle up to a quarter turn, by its sine."""
    return torch.sqrt((1.0 - sine) * (1.0 + sine))


def direction(
    vector: Float[Tensor, "*batch 3"], otherwise: Float[Tensor, "*batch 3"]
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch"]]:
    """Unit vector and length; of a vector of next to no length another one, and 0."""
    square = vector.square().sum(-1)
    is_none = square < _NO_SIDE**2
    length = torch.where(is_none, torch.ones_like(square), square).sqrt()
    unit = torch.where(is_none[..., None], otherwise, vector / length[..., None])
    return unit, torch.where(is_none, torch.zeros_like(length), length)
