"""The basic material by slow and plain means: no formula of `brdf` but its model, and no tables.

Facets are Walter's [1] by the tangents of their angles, hidden by Smith's function of both directions together [2]; the
sky is summed over facets that are drawn for each place as they lie in the world.

[1] B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, section 5.
[2] E. Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014, section 5.3.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading.brdf import DIELECTRIC, Geometry, Material
from diffrender.shading.microfacet import LEAST_COSINE, MIRROR_SPREAD
from diffrender.surfaces import EvenSky, Lights, Surface

_SHARES, _TURNS = 160, 64  # facets


def lit(surface: Surface, to_eye: Float[Tensor, "*#batch 3"], lights: Lights) -> Float[Tensor, "*batch 3"]:
    """Radiance of all lights and the sky that a surface sends to the eye [W/(m² sr)]."""
    of = material(surface.base, surface.roughness, surface.metallic)
    total = reflected_sky(of, Geometry(surface.normal, to_eye, to_eye), lights.sky)
    for to_light, irradiance in zip(lights.to_light, lights.irradiance, strict=True):
        towards = to_light + torch.zeros_like(surface.normal)
        total = total + irradiance * reflected(of, Geometry(surface.normal, to_eye, towards))
    return total


def material(
    base: Float[Tensor, "*#batch 3"], roughness: Float[Tensor, "*#batch"], metallic: Float[Tensor, "*#batch"]
) -> Material:
    """Material of a base colour."""
    metal = metallic[..., None]
    return Material(base * (1 - metal), DIELECTRIC * (1 - metal) + base * metal, roughness)


def reflected(material: Material, geometry: Geometry) -> Float[Tensor, "*batch 3"]:
    """BRDF times the light's cosine [1/sr]: facets above ground that is lit and seen through their Fresnel."""
    normal, to_eye, to_light = geometry.normal, geometry.to_eye, geometry.to_light
    cos_eye = (normal * to_eye).sum(-1).clip(LEAST_COSINE, 1)
    cos_light = (normal * to_light).sum(-1)
    is_lit = cos_light > 0
    cos_light = torch.where(is_lit, cos_light, 0.5)
    half = to_eye + to_light
    half = half / half.norm(dim=-1, keepdim=True)
    # From the sine: the cosine of a mirror's facet has too few digits.
    sine = torch.linalg.cross(half, normal + torch.zeros_like(half)).norm(dim=-1)
    cos_facet, cos_half = (half * normal).sum(-1), (half * to_light).sum(-1)
    spread = spread_of(material.roughness)
    facets = 1 / (math.pi * spread**2 * cos_facet**4 * (1 + (sine / cos_facet / spread) ** 2) ** 2)
    seen = 1 / (1 + hidden(cos_eye, spread) + hidden(cos_light, spread))
    fresnel = material.straight + (1 - material.straight) * (1 - cos_half[..., None]) ** 5
    mirrored = fresnel * (facets * seen / (4 * cos_eye * cos_light))[..., None]
    crossed = (1 - (1 - cos_eye) ** 5) * (1 - (1 - cos_light) ** 5)
    ground = material.diffuse * (1 - material.straight) * crossed[..., None] / math.pi
    return torch.where(is_lit[..., None], (mirrored + ground) * cos_light[..., None], 0.0)


def reflected_sky(material: Material, geometry: Geometry, sky: EvenSky) -> Float[Tensor, "*batch 3"]:
    """Radiance of a sky that a surface sends to the eye [W/(m² sr)]; its direction of light is not looked at."""
    normal = geometry.normal + torch.zeros_like(geometry.to_eye)
    share = (torch.arange(_SHARES, dtype=normal.dtype) + 0.5) / _SHARES
    turn = (torch.arange(_TURNS, dtype=normal.dtype) + 0.5) * (2 * math.pi / _TURNS)
    # Any two directions across the normal.
    axis = torch.eye(3, dtype=normal.dtype)[normal.abs().argmin(-1)]
    first = torch.linalg.cross(normal, axis)
    first = first / first.norm(dim=-1, keepdim=True)
    second = torch.linalg.cross(normal, first)

    def around(cosine: Tensor) -> Tensor:
        sine = torch.sqrt(1 - cosine**2)[..., None]
        flat = (
            first[..., None, None, :] * torch.cos(turn)[:, None] + second[..., None, None, :] * torch.sin(turn)[:, None]
        )
        whole: Tensor = normal[..., None, None, :] * cosine[..., None] + flat * sine
        return whole

    def radiance(direction: Tensor) -> Tensor:
        seen: Tensor = sky.mean[..., None, None, :] + sky.gradient[..., None, None, :] * direction[..., 2:]
        return seen

    eye = geometry.to_eye[..., None, None, :]
    cos_eye = (normal * geometry.to_eye).sum(-1).clip(LEAST_COSINE, 1)[..., None, None]
    wide = (spread_of(material.roughness) + torch.zeros_like(normal[..., 0]))[..., None, None]
    # Facets by the density D cos: most of them where little is left, in the tail.
    left = (share**3)[:, None]
    cos_facet = (1 / torch.sqrt(1 + wide**2 * (1 / left - 1))).expand(*wide.shape[:-2], _SHARES, _TURNS)
    facet = around(cos_facet)
    cos_half = (facet * eye).sum(-1)
    light = 2 * cos_half[..., None] * facet - eye
    cos_light = torch.einsum("...i,...jki->...jk", normal, light)
    seen = 1 / (1 + hidden(cos_eye, wide) + hidden(cos_light, wide))
    weight = seen * cos_half / (cos_eye * cos_facet) * (3 * share**2)[:, None]
    weight = torch.where((cos_half > 0) & (cos_light > 0), weight, 0 * weight)[..., None]
    fresnel = material.straight[..., None, None, :]
    fresnel = fresnel + (1 - fresnel) * (1 - cos_half[..., None].clip(0, 1)) ** 5
    mirrored = (weight * fresnel * radiance(light)).mean((-3, -2))
    cosine = torch.sqrt(share)[:, None].expand_as(cos_facet)
    crossed = ((1 - (1 - cosine[..., None]) ** 5) * radiance(around(cosine))).mean((-3, -2))
    ground = material.diffuse * (1 - material.straight) * (1 - (1 - cos_eye[..., 0]) ** 5)
    sent: Tensor = mirrored + ground * crossed
    return sent


def spread_of(roughness: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Spread of facets' slopes."""
    return torch.sqrt(roughness**4 + MIRROR_SPREAD**2)


def hidden(cosine: Float[Tensor, "*#batch"], spread: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Smith's Lambda of GGX: facets that others hide from a direction, over those that are seen."""
    return 0.5 * (torch.sqrt(1 + spread**2 * (1 / cosine**2 - 1)) - 1)
