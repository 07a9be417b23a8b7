"""A clear coat, such as varnish or tears: a surface between air and a clear body, over layers that it dims.

Facets of the surface are GGX's, as everywhere here. They mirror by Fresnel's own formulas and not by Schlick's, which
at 80 degrees are a twentieth apart for varnish. What is below gets what a light's direction lets through, and of what
it sends the eye gets what the eye's direction lets through: 1 - the share that the coat mirrors. So the coat and
anything below it that sends no more than it gets, together send no more than they get. Light that the coat throws back
down is lost, as is what rough facets scatter twice.

Gradient: exact, of the table the slope of its cell; 0 of what turns a light below the horizon, and of an eye below it.
"""

import math
from functools import cache

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from diffrender.numerics import gauss_legendre, lookup
from diffrender.shading.brdf import Geometry, cosines
from diffrender.shading.microfacet import LEAST_COSINE, fifth_power, fresnel_exact, ggx, spread_squared, visible_smith
from diffrender.shading.mirroring_facets import mirroring
from diffrender.surfaces import EvenSky

_COSINES, _ROUGHNESSES = 65, 33  # of the table
_NODES = 16  # of means over directions


def mirrored(index: float, roughness: Float[Tensor, "*#batch"], geometry: Geometry) -> Float[Tensor, "*batch"]:
    """Share of a light's irradiance that the coat sends to the eye [1/sr]; 0 for a light below the surface."""
    found, spread = cosines(geometry), spread_squared(roughness)
    facets = ggx(geometry.to_eye + geometry.to_light, geometry.normal, spread)
    return facets * visible_smith(found.eye, found.light, spread) * fresnel_exact(index, found.half)


def mirrored_sky(
    index: float, roughness: Float[Tensor, "*#batch"], geometry: Geometry, sky: EvenSky
) -> Float[Tensor, "*batch 3"]:
    """Radiance of a sky that the coat sends to the eye [W/(m² sr)]; the direction of light is not looked at."""
    cos_eye = (geometry.normal * geometry.to_eye).sum(-1).clamp(LEAST_COSINE, 1.0)
    return of_sky(moments(index, roughness, cos_eye), geometry, sky)


def of_sky(moments: Float[Tensor, "*#batch 3"], geometry: Geometry, sky: EvenSky) -> Float[Tensor, "*batch 3"]:
    """Radiance of a sky of which an eye sees a share, from a mean direction, as in `moments` [W/(m² sr)]."""
    share, along, aside = moments[..., None].unbind(-2)
    up, rise = geometry.normal[..., 2:], geometry.to_eye[..., 2:]
    cos_eye = (geometry.normal * geometry.to_eye).sum(-1, keepdim=True).clamp(LEAST_COSINE, 1.0)
    return share * sky.mean + (along * up - aside * (rise - cos_eye * up)) * sky.gradient


def crossed(index: float, roughness: Float[Tensor, "*#batch"], cosine: Float[Tensor, "*#batch"]) -> Tensor:
    """Share of light from or to a direction that is not mirrored and gets through the surface, from 0 to 1."""
    return 1.0 - moments(index, roughness, cosine.clamp(LEAST_COSINE, 1.0))[..., 0]


def to_ground(normal: Float[Tensor, "*#batch 3"], to_light: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch"]:
    """Radiance of a white diffuse ground of the basic material over a light's irradiance [1/sr], but for constants."""
    cosine = (normal * to_light).sum(-1).clamp(0.0, 1.0)
    return cosine * (1.0 - fifth_power(1.0 - cosine)) / math.pi


@cache
def to_ground_nodes() -> tuple[Tensor, Tensor]:
    """Cosines and weights of the same over an even sky of radiance 1."""
    place, weight = gauss_legendre(_NODES)
    cosine = 0.5 + 0.5 * place
    return cosine, weight * cosine * (1.0 - fifth_power(1.0 - cosine))


def refracted(
    index: float | Float[Tensor, ""], normal: Float[Tensor, "*#batch 3"], towards: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Unit direction inside the body that leads to one outside, by Snell's law.

    Of index 1.5 it is at most 42 degrees from the normal, whose cosine is 0.745. Directions below the surface are bent
    as if they were above.
    """
    cosine = (normal * towards).sum(-1, keepdim=True)
    within = torch.sqrt((index * index - 1.0) + cosine * cosine) / index
    return (towards - cosine * normal) / index + within * normal


def moments(
    index: float, roughness: Float[Tensor, "*#batch"], cosine: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3"]:
    """What the coat mirrors of an even sky: the share, and its mean direction along the normal and away from the eye.

    The last is over the sine of the eye's angle, so that it ends well at normal incidence. By symmetry the share is
    also what is mirrored of a light from that direction.
    """
    row, column = cosine.sqrt() * (_COSINES - 1.0), roughness * (_ROUGHNESSES - 1.0)
    row, column = row + 0.0 * column, column + 0.0 * row
    return lookup(_moments(index).to(cosine), row, column)


@cache
def _moments(index: float) -> Float64[Tensor, "65 33 3"]:
    """Table of `moments` over the root of the cosine and roughness, by sums over `mirroring_facets`. Made once."""
    cosine = torch.linspace(0.0, 1.0, _COSINES, dtype=torch.float64).square()
    roughness = torch.linspace(0.0, 1.0, _ROUGHNESSES, dtype=torch.float64)
    return torch.stack([_column(index, one, cosine) for one in roughness], 1)


def _column(index: float, roughness: Tensor, cosine: Tensor) -> Tensor:
    """Of one roughness."""
    met = mirroring(cosine, spread_squared(roughness))
    weight = met.weight * fresnel_exact(index, met.cos_half.clamp(0.0, 1.0))
    parts = (torch.ones_like(weight), met.cos_light, met.aside)
    return torch.stack([(weight * part).mean((1, 2)) for part in parts], -1)
