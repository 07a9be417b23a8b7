"""Light that a surface sends to the eye: GGX facets above Lambert's diffuse ground, of a light and of an even sky.

A material is given by base colour, roughness and metalness. What reaches the diffuse ground has crossed the surface,
and crosses it again on its way out [1]: Lambert's even light times 1 - Fresnel of both directions. So no material
reflects more than it gets: scaled to reflect all at roughness 0, white ones of roughness 0.3 sent 0.1 % too much.

The sky is one radiance and a gradient with height, as overcast skies nearly are. Its reflection needs no more of the
facets than their mean direction, whose tables are exact but for their cells; there is no "split sum".

Gradient: exact, of the tables the slope of the cell. 0 of what turns a light below the horizon, and of an eye below
it, which is taken as just above.

[1] P. Shirley et al., "A Practitioners' Assessment of Light Reflection Models", Pacific Graphics 1997.
[2] B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013 course "Physically Based Shading": table of the
    reflected share, split into that of the colour at normal incidence and of white.
"""

import math
from collections.abc import Callable
from functools import cache

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from diffrender.numerics import lookup
from diffrender.parameters import record
from diffrender.shading.microfacet import (
    LEAST_COSINE,
    fifth_power,
    fresnel_schlick,
    ggx,
    spread_squared,
    visible_smith,
)
from diffrender.shading.mirroring_facets import mirroring
from diffrender.surfaces import EvenSky, Lights, Surface

DIELECTRIC = 0.04  # share that what is no metal reflects at normal incidence; refraction 1.5
# Means over directions by the cosine, of 1 - (1 - x)^5 and of that times x: of Schlick's Fresnel in closed form.
_CROSSED, _CROSSED_ALONG = 20.0 / 21.0, 2.0 / 3.0 - 1.0 / 84.0
_COSINES, _ROUGHNESSES = 65, 33  # of the tables


@record
class Material:
    """What light meets: diffuse colour, share reflected at normal incidence, roughness, all from 0 to 1."""

    diffuse: Float[Tensor, "*#batch 3"]
    straight: Float[Tensor, "*#batch 3"]
    roughness: Float[Tensor, "*#batch"]


@record
class Geometry:
    """Unit vectors at a surface: its normal, and directions towards the eye and a light."""

    normal: Float[Tensor, "*#batch 3"]
    to_eye: Float[Tensor, "*#batch 3"]
    to_light: Float[Tensor, "*#batch 3"]


@record
class Cosines:
    """Of the normal with eye and light, and of the half vector with either; from 0 to 1."""

    eye: Float[Tensor, "*#batch"]
    light: Float[Tensor, "*#batch"]
    half: Float[Tensor, "*#batch"]


Visible = Callable[[Tensor, Tensor, Tensor], Tensor]


def material(
    base: Float[Tensor, "*#batch 3"], roughness: Float[Tensor, "*#batch"], metallic: Float[Tensor, "*#batch"]
) -> Material:
    """Material of a base colour: what a metal reflects, and of all else the colour of its ground."""
    metal = metallic[..., None]
    return Material(base * (1.0 - metal), torch.lerp(torch.full_like(base, DIELECTRIC), base, metal), roughness)


def lit(
    surface: Surface, to_eye: Float[Tensor, "*#batch 3"], lights: Lights, visible: Visible = visible_smith
) -> Float[Tensor, "*batch 3"]:
    """Radiance of all lights and the sky that a surface of the basic material sends to the eye [W/(m² sr)]."""
    of = material(surface.base, surface.roughness, surface.metallic)
    total = reflected_sky(of, Geometry(surface.normal, to_eye, surface.normal), lights.sky)
    for to_light, irradiance in zip(lights.to_light, lights.irradiance, strict=True):
        towards = to_light.expand_as(surface.normal)
        total = total + irradiance * reflected(of, Geometry(surface.normal, to_eye, towards), visible)
    return total


def reflected(material: Material, geometry: Geometry, visible: Visible = visible_smith) -> Float[Tensor, "*batch 3"]:
    """Share of a light's irradiance that is sent to the eye [1/sr]: the BRDF times the light's cosine.

    0 for a light below the surface.
    """
    found, spread = cosines(geometry), spread_squared(material.roughness)
    facets = ggx(geometry.to_eye + geometry.to_light, geometry.normal, spread)
    return sent(material, facets * visible(found.eye, found.light, spread), found)


def cosines(geometry: Geometry) -> Cosines:
    """Cosines at a surface, of an eye that is above it and a light that may have set."""
    to_eye, to_light = ((geometry.normal * one).sum(-1) for one in (geometry.to_eye, geometry.to_light))
    # Of the half vector with either direction: |l + v| / 2.
    half = 0.5 * torch.linalg.vector_norm(geometry.to_eye + geometry.to_light, dim=-1)
    return Cosines(to_eye.clamp(LEAST_COSINE, 1.0), to_light.clamp(0.0, 1.0), half.clamp(max=1.0))


def sent(material: Material, facets: Float[Tensor, "*#batch"], cosines: Cosines) -> Float[Tensor, "*batch 3"]:
    """The same of so many facets that mirror the light to the eye and are seen by both [1/sr], with the ground's share.

    What lights of a size are made of, whose facets are counted otherwise than of a point.
    """
    mirrored = fresnel_schlick(material.straight, cosines.half) * facets[..., None]
    return mirrored + ground(material, cosines.eye) * entered(cosines.light)[..., None]


def entered(cos_light: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of a light's irradiance that reaches the ground under a surface, as radiance of white ground [1/sr]."""
    return cos_light / math.pi * _crossed(cos_light)


def entered_sky(normal: Float[Tensor, "*#batch 3"], sky: EvenSky) -> Float[Tensor, "*batch 3"]:
    """Radiance of white ground by what reaches it of a sky through a surface [W/(m² sr)]."""
    return sky.mean * _CROSSED + sky.gradient * (normal[..., 2:] * _CROSSED_ALONG)


def ground(material: Material, cos_eye: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """Share of the light which has entered that the diffuse ground sends through the surface to the eye."""
    return material.diffuse * (1.0 - material.straight) * _crossed(cos_eye)[..., None]


def reflected_sky(material: Material, geometry: Geometry, sky: EvenSky) -> Float[Tensor, "*batch 3"]:
    """Radiance of a sky that a surface sends to the eye [W/(m² sr)]; its direction of light is not looked at."""
    cos_eye = ((geometry.normal * geometry.to_eye).sum(-1)).clamp(LEAST_COSINE, 1.0)
    up, rise = geometry.normal[..., 2], geometry.to_eye[..., 2]
    share, along, aside = moments(cos_eye, material.roughness).unbind(-2)
    # Components along the normal, and in the mirror direction's own plane.
    elevation = along * up[..., None] - aside * (rise - cos_eye * up)[..., None]
    weights = share[..., None, :] * sky.mean[..., None] + elevation[..., None, :] * sky.gradient[..., None]
    mirrored = material.straight * weights[..., 0] + weights[..., 1]
    return mirrored + ground(material, cos_eye) * entered_sky(geometry.normal, sky)


def albedo(material: Material, cos_eye: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """Share of light, alike from all directions, that goes to an eye; by symmetry, share of a light that is reflected.

    At most 1, and below it by what rough facets lose.
    """
    cosine = cos_eye.clamp(LEAST_COSINE, 1.0)
    share = moments(cosine, material.roughness)[..., 0, :]
    return material.straight * share[..., :1] + share[..., 1:] + ground(material, cosine) * _CROSSED


def moments(cos_eye: Float[Tensor, "*#batch"], roughness: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3 2"]:
    """What facets reflect of an even sky: the share, and its mean direction along the normal and in the mirror's plane.

    Each split into what the colour at normal incidence is multiplied by, and what is added to it as white [2]. The last
    is over the sine of the eye's angle, so that it ends well at normal incidence.
    """
    row, column = cos_eye.sqrt() * (_COSINES - 1.0), roughness * (_ROUGHNESSES - 1.0)
    row, column = row + 0.0 * column, column + 0.0 * row
    return lookup(_known_moments().to(cos_eye), row, column)


def _crossed(cosine: Tensor) -> Tensor:
    """Share that crosses a surface, over that at normal incidence."""
    return 1.0 - fifth_power(1.0 - cosine)


@torch.compiler.assume_constant_result  # type: ignore[untyped-decorator]
def _known_moments() -> Float64[Tensor, "65 33 3 2"]:
    """The table below, made outside of what is compiled: torch.compile looks through a `cache`, and took minutes."""
    return _moments()


@cache
def _moments() -> Float64[Tensor, "65 33 3 2"]:
    """Table of `moments` over the root of the cosine and roughness, by sums over `mirroring_facets`. Made once."""
    cosine = torch.linspace(0.0, 1.0, _COSINES, dtype=torch.float64).square()
    roughness = torch.linspace(0.0, 1.0, _ROUGHNESSES, dtype=torch.float64)
    return torch.stack([_column(one, cosine) for one in roughness], 1)


def _column(roughness: Tensor, cosine: Tensor) -> Tensor:
    """Of one roughness."""
    met = mirroring(cosine, spread_squared(roughness))
    tilted = fifth_power(1.0 - met.cos_half.clamp(0.0, 1.0))
    split = torch.stack([met.weight * (1.0 - tilted), met.weight * tilted], -1)
    parts = (torch.ones_like(met.weight), met.cos_light, met.aside)
    return torch.stack([(split * part[..., None]).mean((1, 2)) for part in parts], -2)
