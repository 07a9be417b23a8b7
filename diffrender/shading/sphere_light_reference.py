"""Light of a sphere by summing the BRDF over its disc, which shares nothing with the fast ways but the BRDF.

Directions are taken along arcs from the mirror's direction outwards, where smooth surfaces look, between the edges of
the disc and above the horizon; both are known exactly for every azimuth. Steps near the mirror's direction are as fine
as the facets ask. Works in float64.
"""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import gauss_legendre
from diffrender.parameters import record
from diffrender.rays import unit
from diffrender.shading import brdf
from diffrender.shading.brdf import Geometry
from diffrender.shading.microfacet import LEAST_COSINE, spread_squared, visible_smith
from diffrender.shading.sphere_surface import SphereLight, SphereView

NODES = (96, 192)  # along an arc and round; examples differ by 2e-7 of their own values from twice as many
_NO_SIDE = 1e-6  # sine below which the light has no side of the mirror's direction


@record
class _Frame:
    """Where the sphere stands round the mirror's direction.

    Attributes:
        towards: across the mirror's direction, on the side of the light's centre.
        across: to both.
        apart: angle of the light's centre from the mirror's direction [rad].
        sine: of the light's angular radius.
    """

    mirror: Float[Tensor, "*batch 3"]
    towards: Float[Tensor, "*batch 3"]
    across: Float[Tensor, "*batch 3"]
    apart: Float[Tensor, "*batch"]
    sine: Float[Tensor, "*#batch"]


def summed(
    light: SphereLight, view: SphereView, nodes: tuple[int, int] = NODES, visible: brdf.Visible = visible_smith
) -> Float[Tensor, "*batch 3"]:
    """Radiance of a surface towards the eye [W/(m² sr)], by so many directions along arcs and round."""
    frame = _frame(light, view)
    azimuth, width = _round(frame, nodes[1])
    arc = (torch.cos(azimuth)[..., None] * frame.towards[..., None, :]
           + torch.sin(azimuth)[..., None] * frame.across[..., None, :])  # fmt: skip
    ends = _ends(frame, azimuth, (view.normal[..., None, :] * arc).sum(-1), (view.normal * frame.mirror).sum(-1))
    cos_eye = (view.normal * view.to_eye).sum(-1).clamp(min=LEAST_COSINE)
    angle, step = _along(ends, 2.0 * spread_squared(view.roughness).sqrt() * cos_eye, nodes[0])
    mirror, arc = frame.mirror[..., None, None, :], arc[..., None, :]
    to_light = torch.cos(angle)[..., None] * mirror + torch.sin(angle)[..., None] * arc
    geometry = Geometry(view.normal[..., None, None, :], view.to_eye[..., None, None, :], to_light)
    made = brdf.material(view.base, view.roughness, view.metallic)
    made = replace(made, **{name: getattr(made, name)[..., None, None, :] for name in ("diffuse", "straight")})
    made = replace(made, roughness=made.roughness[..., None, None])
    solid_angle = torch.sin(angle) * step * width[..., None]
    return light.radiance * (brdf.reflected(made, geometry, visible) * solid_angle[..., None]).sum((-3, -2))


def _frame(light: SphereLight, view: SphereView) -> _Frame:
    away = view.centre - view.position
    distance = away.norm(dim=-1)
    to_centre = away / distance[..., None]
    mirror = unit(2.0 * (view.normal * view.to_eye).sum(-1, keepdim=True) * view.normal - view.to_eye)
    aside = _across(mirror, to_centre)
    apart = torch.atan2(aside.norm(dim=-1), (mirror * to_centre).sum(-1))
    no_side = aside.norm(dim=-1, keepdim=True) < _NO_SIDE
    towards = unit(torch.where(no_side, _across(mirror, torch.eye(3).to(mirror)[mirror.abs().argmin(-1)]), aside))
    return _Frame(mirror, towards, torch.linalg.cross(mirror, towards), apart, light.radius / distance)


def _across(axis: Tensor, vector: Tensor) -> Tensor:
    return vector - (axis * vector).sum(-1, keepdim=True) * axis


def _round(frame: _Frame, count: int) -> tuple[Tensor, Tensor]:
    """Azimuths from the light's side, and their widths.

    All round where the disc covers the mirror's direction or its opposite; else over the disc, finest at its sides.
    """
    turn, width = gauss_legendre(count)
    sine = torch.sin(frame.apart)
    covers = frame.sine >= sine
    half = torch.asin(frame.sine / torch.where(covers, torch.ones_like(sine), sine))[..., None]
    quarter = 0.5 * math.pi
    over_disc = half * torch.sin(quarter * turn), half * quarter * torch.cos(quarter * turn) * width
    all_round = [(math.pi * one).expand_as(over_disc[0]) for one in (turn, width)]
    return torch.where(covers[..., None], all_round[0], over_disc[0]), torch.where(
        covers[..., None], all_round[1], over_disc[1]
    )


def _ends(frame: _Frame, azimuth: Tensor, rising: Tensor, cos_mirror: Tensor) -> tuple[Tensor, Tensor]:
    """Angles from the mirror's direction at which an arc enters the disc, and leaves it or meets the horizon.

    `rising` is the normal's component along the arc.
    """
    along, beside = torch.cos(frame.apart)[..., None], torch.sin(frame.apart)[..., None] * torch.cos(azimuth)
    middle = torch.atan2(beside, along)
    middle = torch.where((along < 0.0) & (middle < 0.0), middle + 2.0 * math.pi, middle)
    half = torch.acos((torch.sqrt(1.0 - frame.sine**2)[..., None] / torch.hypot(along, beside)).clamp(max=1.0))
    nearest = (middle - half).clamp(min=0.0)
    horizon = 0.5 * math.pi + torch.atan2(rising, cos_mirror[..., None])
    return nearest, torch.maximum(torch.minimum((middle + half).clamp(max=math.pi), horizon), nearest)


def _along(ends: tuple[Tensor, Tensor], fine: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Angles between two, and their steps: even below a fine angle, and in proportion beyond it."""
    place, share = gauss_legendre(count)
    fine = fine[..., None]
    low, high = (torch.asinh(end / fine)[..., None] for end in ends)
    stretched = low + 0.5 * (high - low) * (1.0 + place)
    fine = fine[..., None]
    return fine * torch.sinh(stretched), fine * torch.cosh(stretched) * 0.5 * (high - low) * share
