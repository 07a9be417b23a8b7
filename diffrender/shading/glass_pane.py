"""A thin pane of glass: what it mirrors and what it lets through, with all reflections between its two faces.

Each face reflects by Fresnel's equations [1] and the glass dims by Beer's law on the slanted way through it. Of light
that swings across or within the plane of incidence the pane reflects and passes

    T = (1 - R)² t / (1 - R² t²)        R' = R (1 + t T)

the sums over all ways between its faces [2], R of one face, t the share that one way through leaves; without a tint
R' = 2R / (1 + R). A pane is thin: what is seen through it is not moved. It is thick beside waves of light: no colours
of soap films.

Rough faces are GGX facets. A light's highlight takes R' at the angle of those that mirror it. The sky has one mirror
for all facets, whose R is that of the pane's own angle times what roughness makes of Schlick's Fresnel, by the table of
`brdf`; that is ours. What facets do not mirror goes through the pane, also what they lose by hiding each other: clear
glass of any roughness takes no light of sky and background together. Of rough panes that graze the sky's share is off,
most where little is bent: of an index of 1.1 at 86 degrees by a tenth of the sky. Lights are mirrored by up to 0.7 % of
their light more than is missing from what passes. What is seen through rough faces is not blurred.

Dust lies on the face towards the eye, as Lambert's, lit from that side only.

Gradient: exact, of the table the slope of the cell; 0 by what turns a pane seen closer to its edge than LEAST_COSINE.

[1] M. Born, E. Wolf, "Principles of Optics", 7th edition 1999, section 1.5.2, equations 21.
[2] G. Stokes, "On the intensity of the light reflected from or transmitted through a pile of plates", Proceedings of
    the Royal Society of London 11, 1862.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.shading import brdf
from diffrender.shading.brdf import Geometry
from diffrender.shading.microfacet import (
    LEAST_COSINE,
    fifth_power,
    fresnel_polarised,
    ggx,
    spread_squared,
    visible_smith,
)
from diffrender.shading.transparent_view import TINTED_THICKNESS, Transparent, TransparentView
from diffrender.surfaces import EvenSky

_LAMBERT_ALONG = 2.0 / 3.0  # mean over directions by the cosine of the cosine itself
# Added to what Schlick's mirror reflects straight on, so that its mean over facets has a share of it at an index of 1.
# The value fits best.
_FAINT = 0.01


@record
class Pane:
    """What layers do to rays: the light that they send to the eye [W/(m² sr)], and the share that they let through."""

    sent: Float[Tensor, "*batch 3"]
    passed: Float[Tensor, "*batch 3"]


def panes(glass: Transparent, view: TransparentView) -> Pane:
    """Every layer by itself, as if nothing were before it; those behind what is opaque, and absent ones, do nothing."""
    to_eye = view.to_eye[..., None, :] + torch.zeros_like(view.normal)
    is_turned = (view.normal * to_eye).sum(-1, keepdim=True) < 0.0
    geometry = Geometry(torch.where(is_turned, -view.normal, view.normal), to_eye, to_eye)
    clean = _of_sky(glass, geometry, view.lights.sky)
    glints, lit = torch.zeros_like(to_eye), _from_sky(geometry, view.lights.sky)
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        towards = Geometry(geometry.normal, to_eye, to_light.expand_as(to_eye))
        glints = glints + irradiance * _glint(glass, towards)
        lit = lit + irradiance * brdf.cosines(towards).light[..., None] / math.pi
    covered = (glass.dust * view.dust)[..., None]
    sent = torch.lerp(clean.sent + glints, glass.dust_colour * lit, covered)
    passed = clean.passed * (1.0 - covered)
    is_seen = (view.depth < view.background_depth[..., None])[..., None]
    return Pane(
        torch.where(is_seen, sent, torch.zeros_like(sent)), torch.where(is_seen, passed, torch.ones_like(passed))
    )


def mirrored_and_passed(
    glass: Transparent, cosine: Float[Tensor, "*#batch"], roughened: Float[Tensor, "*#batch"]
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Share of light that a pane reflects and that it lets through, by the cosine of its angle.

    Their sum is 1 for clear glass. `roughened` is what each face's reflection is multiplied by.
    """
    cos_inside = torch.sqrt((glass.index - 1.0) * (glass.index + 1.0) + cosine * cosine) / glass.index
    ways = glass.thickness / (TINTED_THICKNESS * cos_inside)
    kept = torch.exp(torch.log(glass.tint) * ways[..., None])
    mirrored, passed = torch.zeros_like(kept), torch.zeros_like(kept)
    for swinging in fresnel_polarised(glass.index, cosine):
        face = (swinging * roughened)[..., None]
        through = (1.0 - face).square() * kept / (1.0 - (face * kept).square())
        mirrored = mirrored + 0.5 * face * (1.0 + kept * through)
        passed = passed + 0.5 * through
    return mirrored, passed


def _of_sky(glass: Transparent, geometry: Geometry, sky: EvenSky) -> Pane:
    """Clean glass under the sky alone."""
    cosine = brdf.cosines(geometry).eye
    by_table = brdf.moments(cosine, glass.roughness)
    # With the cosine's axes: torch's forward mode gives a number without any a double tangent.
    straight = ((glass.index - 1.0) / (glass.index + 1.0)).square() + torch.full_like(cosine, _FAINT)
    share, along, aside = (straight[..., None] * by_table[..., 0] + by_table[..., 1]).unbind(-1)
    level = straight + (1.0 - straight) * fifth_power(1.0 - cosine)
    mirrored, passed = mirrored_and_passed(glass, cosine, share / level)
    up, rise = geometry.normal[..., 2], geometry.to_eye[..., 2]
    elevation = (along * up - aside * (rise - cosine * up)) / share
    radiance = sky.mean[..., None, :] + sky.gradient[..., None, :] * elevation[..., None]
    return Pane(mirrored * radiance, passed)


def _glint(glass: Transparent, geometry: Geometry) -> Tensor:
    """Share of a light's irradiance that clean glass mirrors to the eye [1/sr]."""
    found, spread = brdf.cosines(geometry), spread_squared(glass.roughness)
    facets = ggx(geometry.to_eye + geometry.to_light, geometry.normal, spread)
    # A light right behind the pane has no half vector; it is not mirrored.
    cos_half = found.half.clamp(min=LEAST_COSINE)
    mirrored, _ = mirrored_and_passed(glass, cos_half, torch.ones_like(cos_half))
    return mirrored * (facets * visible_smith(found.eye, found.light, spread))[..., None]


def _from_sky(geometry: Geometry, sky: EvenSky) -> Tensor:
    """Irradiance of the sky over pi."""
    up = geometry.normal[..., 2:]
    return sky.mean[..., None, :] + sky.gradient[..., None, :] * _LAMBERT_ALONG * up
