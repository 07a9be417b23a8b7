"""A clear coat by slow and plain means: Walter's facets [1] by the tangent of their angle, Fresnel by that of rays.

Everything is in the surface's own frame, whose z is the normal; eyes are above it.

[1] B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, section 5.
"""

import math

import torch
from torch import Tensor

from diffrender.shading.brdf_reference import hidden, spread_of
from diffrender.shading.microfacet import LEAST_COSINE

_SHARES, _TURNS = 160, 64  # facets


def fresnel(index: float, angle: Tensor) -> Tensor:
    """Of unpolarised light by its angle of incidence and that of refraction."""
    # Not straight down, where both are 0.
    angle = angle.clip(min=1e-5)
    bent = torch.asin(torch.sin(angle) / index)
    across = torch.sin(angle - bent) / torch.sin(angle + bent)
    within = torch.tan(angle - bent) / torch.tan(angle + bent)
    return (across**2 + within**2) / 2


def mirrored(index: float, roughness: Tensor, eye: Tensor, light: Tensor) -> Tensor:
    """BRDF of the coat's surface."""
    spread = spread_of(roughness)
    risen = light[..., 2] > 0
    light = torch.where(risen[..., None], light, light.new_tensor([0.0, 0.0, 1.0]))
    half = (eye + light) / (eye + light).norm(dim=-1, keepdim=True)
    tangent = half[..., :2].norm(dim=-1) / half[..., 2]
    share = 1 / (math.pi * spread**2 * half[..., 2] ** 4 * (1 + (tangent / spread) ** 2) ** 2)
    seen = 1 / (1 + hidden(eye[..., 2], spread) + hidden(light[..., 2], spread))
    angle = torch.acos((half * eye).sum(-1).clip(0, 1))
    found = fresnel(index, angle) * share * seen / (4 * eye[..., 2] * light[..., 2])
    return torch.where(risen, found, 0 * found)


def facets(index: float, roughness: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
    """Weights of facets as an eye meets them with the coat's Fresnel, and the directions that they mirror it to."""
    spread = spread_of(roughness)
    share = ((torch.arange(_SHARES, dtype=eye.dtype) + 0.5) / _SHARES)[:, None]
    turn = (torch.arange(_TURNS, dtype=eye.dtype) + 0.5) * (2 * math.pi / _TURNS)
    tangent = spread * torch.sqrt(1 / share**3 - 1)
    cosine = 1 / torch.sqrt(1 + tangent**2)
    sine = tangent * cosine
    facet = torch.stack([sine * torch.cos(turn), sine * torch.sin(turn), cosine.expand(-1, _TURNS)], -1)
    towards = eye[..., None, None, :]
    cos_half = (facet * towards).sum(-1)
    light = 2 * cos_half[..., None] * facet - towards
    seen = (cos_half > 0) & (light[..., 2] > 0)
    risen = torch.where(seen, light[..., 2], 1 + 0 * cos_half)
    reach = 1 / (1 + hidden(towards[..., 2], spread) + hidden(risen, spread))
    weight = 3 * share**2 * reach * cos_half / (towards[..., 2] * cosine) / (_SHARES * _TURNS)
    weight = weight * fresnel(index, torch.acos(cos_half.clip(0, 1)))
    return torch.where(seen, weight, 0 * weight), light


def crossed(index: float, roughness: Tensor, direction: Tensor) -> Tensor:
    """Share that crosses the coat's surface from or to a direction."""
    direction = torch.cat([direction[..., :2], direction[..., 2:].clip(LEAST_COSINE, 1)], -1)
    return 1 - facets(index, roughness, direction / direction.norm(dim=-1, keepdim=True))[0].sum((-2, -1))
