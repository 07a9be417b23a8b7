"""Transparent layers by plain means: light that is followed from the background forward through one pane after another.

Refracted rays are vectors; each face reflects by Fresnel's two amplitudes; the glass dims over the length of the way;
light goes to and fro between the faces BOUNCES times. The sky is summed over facets that are drawn as GGX spreads them
[1], of which each is a pane of its own angle; of what it would mirror the share that other facets hide stays in the
pane. Dust is lit by a sum over directions. As in what is under test, nothing is mirrored from pane to pane.

[1] E. Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014.
"""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.shading.brdf_reference import hidden, spread_of
from diffrender.shading.transparent_view import TINTED_THICKNESS, Transparent, TransparentView
from diffrender.surfaces import EvenSky

BOUNCES = 64
_SHARES, _TURNS = 64, 32  # facets


@record
class _Met:
    """Panes that rays meet, with axes for facets: the normal towards the eye, the eye, and the glass."""

    normal: Float[Tensor, "*batch 1 1 3"]
    to_eye: Float[Tensor, "*batch 1 1 3"]
    glass: Transparent


def reference(glass: Transparent, view: TransparentView) -> Float[Tensor, "*batch 3"]:
    """Radiance towards the eye [W/(m² sr)] of all layers over their background."""
    sent, passed = _drawn(glass, view)
    light, count = view.background, view.depth.shape[-1]
    left = torch.where(view.depth < view.background_depth[..., None], view.depth, -math.inf)
    for _ in range(count):
        # Of equal depths the last one is the farthest.
        farthest = count - 1 - left.flip(-1).argmax(-1, keepdim=True)
        is_left = left.gather(-1, farthest) > -math.inf
        of_layer = farthest[..., None].expand(*farthest.shape, 3)
        after = sent.gather(-2, of_layer)[..., 0, :] + passed.gather(-2, of_layer)[..., 0, :] * light
        light = torch.where(is_left, after, light)
        left = left.scatter(-1, farthest, -math.inf)
    return light


def _drawn(glass: Transparent, view: TransparentView) -> tuple[Tensor, Tensor]:
    """Light that each layer sends to the eye, and the share that it lets through."""
    to_eye = view.to_eye[..., None, :].expand_as(view.normal)
    normal = view.normal * torch.sign(torch.einsum("...i,...i", view.normal, to_eye))[..., None]
    met = _Met(normal[..., None, None, :], to_eye[..., None, None, :], glass)
    clean, passed = _of_sky(met, view.lights.sky)
    dusty = _dusty(met, view.lights.sky)
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        clean = clean + irradiance * _of_light(met, to_light)
        dusty = dusty + irradiance * torch.relu(normal @ to_light)[..., None] / math.pi
    share = (glass.dust * view.dust)[..., None]
    return share * glass.dust_colour * dusty + (1 - share) * clean, (1 - share) * passed


def _of_sky(met: _Met, sky: EvenSky) -> tuple[Tensor, Tensor]:
    """Light of the sky that clean panes send to the eye, and the share that they let through."""
    spread = _spread(met)
    share = _middles(_SHARES)[:, None]
    left = share**3  # of facets that are steeper: most of them where little is left, in the tail
    cos_facet = (1 / torch.sqrt(1 + spread**2 * (1 / left - 1))).expand(*met.normal.shape[:-3], -1, _TURNS)
    facet = _around(met.normal, cos_facet)
    cos_eye, cos_half = ((met.to_eye * one).sum(-1) for one in (met.normal, facet))
    to_light = 2 * cos_half[..., None] * facet - met.to_eye
    cos_light = (to_light * met.normal).sum(-1)
    from_eye = 1 + hidden(cos_eye, spread)
    escapes = from_eye / (from_eye + hidden(cos_light, spread))
    escapes = torch.where(cos_light > 0, escapes, 0 * escapes)
    # Facets as the eye sees them, by the density with which they are drawn.
    weight = share**2 * cos_half / cos_facet
    weight = torch.where(cos_half > 0, weight, 0 * weight)[..., None]
    weight = weight / weight.sum((-3, -2), keepdim=True)
    back, through = _followed(met, facet, escapes)
    return (weight * back * _seen(sky, to_light)).sum((-3, -2)), (weight * through).sum((-3, -2))


def _of_light(met: _Met, to_light: Tensor) -> Tensor:
    """Share of a light's irradiance that clean panes send to the eye [1/sr], by the tangent of the facets' angle."""
    half = met.to_eye + to_light
    half = half / half.norm(dim=-1, keepdim=True)
    cos_eye, cos_light, cos_facet = ((met.normal * one).sum(-1) for one in (met.to_eye, to_light, half))
    spread = _spread(met)
    tangent = torch.linalg.cross(met.normal, half).norm(dim=-1) / cos_facet
    facets = 1 / (math.pi * spread**2 * cos_facet**4 * (1 + (tangent / spread) ** 2) ** 2)
    seen = 1 / (1 + hidden(cos_eye, spread) + hidden(cos_light, spread))
    back, _ = _followed(replace(met, normal=half), half, torch.ones_like(cos_facet))
    shone = back * (facets * seen / (4 * cos_eye))[..., None]
    return torch.where((cos_light > 0)[..., None], shone, 0 * shone)[..., 0, 0, :]


def _followed(met: _Met, facet: Tensor, escapes: Tensor) -> tuple[Tensor, Tensor]:
    """Shares of what the eye would send to facets that come back, and that leave on the other side of the pane.

    The way through is that of level faces. `escapes` is the share of what a facet mirrors that leaves it.
    """
    glass, from_eye = met.glass, -met.to_eye
    index = glass.index[..., None, None]
    cos_outside = (met.to_eye * facet).sum(-1).clamp(min=0)
    cos_inside = -(_refracted(from_eye, facet, index) * facet).sum(-1)
    across = (cos_outside - index * cos_inside) / (cos_outside + index * cos_inside)
    within = (index * cos_outside - cos_inside) / (index * cos_outside + cos_inside)
    level = -(_refracted(from_eye, met.normal, index) * met.normal).sum(-1)
    absorption = -torch.log(glass.tint) / TINTED_THICKNESS
    kept = torch.exp(-absorption[..., None, None, :] * (glass.thickness[..., None, None] / level)[..., None])
    back, through = torch.zeros_like(kept + across[..., None]), torch.zeros_like(kept + across[..., None])
    for amplitude in (across, within):
        face = (amplitude**2 * escapes)[..., None]
        back = back + face / 2
        inner = (1 - face) * kept / 2
        for _ in range(0, BOUNCES, 2):
            through = through + inner * (1 - face)
            inner = inner * face * kept
            back = back + inner * (1 - face)
            inner = inner * face * kept
    return back, through


def _refracted(ray: Tensor, normal: Tensor, index: Tensor) -> Tensor:
    """Unit direction of a ray in the glass, by Snell's law for vectors."""
    cosine, index = -(ray * normal).sum(-1, keepdim=True), index[..., None]
    return ray / index + (cosine / index - torch.sqrt(1 - (1 - cosine**2) / index**2)) * normal


def _dusty(met: _Met, sky: EvenSky) -> Tensor:
    """Mean radiance of the sky by the cosine over a pane."""
    cosine = torch.sqrt(_middles(_SHARES))[:, None].expand(*met.normal.shape[:-3], -1, _TURNS)
    return _seen(sky, _around(met.normal, cosine)).mean((-3, -2))


def _around(normal: Tensor, cosine: Tensor) -> Tensor:
    """Directions at angles from normals, at even turns round them."""
    turn = (_middles(_TURNS) * 2 * math.pi)[:, None]
    helper = torch.eye(3, dtype=normal.dtype)[normal.abs().argmin(-1)]
    first = torch.linalg.cross(normal, helper)
    first = first / first.norm(dim=-1, keepdim=True)
    flat = first * torch.cos(turn) + torch.linalg.cross(normal, first) * torch.sin(turn)
    directions: Tensor = normal * cosine[..., None] + flat * torch.sqrt(1 - cosine**2)[..., None]
    return directions


def _seen(sky: EvenSky, direction: Tensor) -> Tensor:
    mean, gradient = (one[..., None, None, None, :] for one in (sky.mean, sky.gradient))
    return mean + gradient * direction[..., 2:]


def _middles(count: int) -> Tensor:
    return (torch.arange(count, dtype=torch.float64) + 0.5) / count


def _spread(met: _Met) -> Tensor:
    return spread_of(met.glass.roughness[..., None, None])
