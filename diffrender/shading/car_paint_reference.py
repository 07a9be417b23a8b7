"""Car paint by slow and plain means: light is traced through the varnish by angles, and summed over sky and facets.

The coat is that of `clear_coat_reference`. What flakes send to an eye is how densely traced rays of one light come out
about it, by the determinant of the tracing, which is differentiated. The base coat is the basic material, which is not
under test, under one light at a time and under every part of the sky; which flake lies where is given too.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading import brdf, flakes
from diffrender.shading.brdf import Geometry
from diffrender.shading.clear_coat_reference import crossed, facets, fresnel, mirrored
from diffrender.shading.microfacet import LEAST_COSINE
from diffrender.shading.painted_surface import VARNISH, CarPaint, CarPaintView

_SHARES, _TURNS = 160, 64  # facets and flakes
_RISES, _AROUND = 24, 48  # directions of the sky over the base coat


def reference(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """Radiance of car paint towards the eye [W/(m² sr)]."""
    across = torch.linalg.cross(view.normal, view.tangent)
    frame = torch.stack([view.tangent, across, view.normal], -2)  # world to the surface's own
    eye = torch.einsum("...ij,...j", frame, view.to_eye)
    eye = torch.cat([eye[..., :2], eye[..., 2:].clip(LEAST_COSINE, 1)], -1)
    total = _coat_of_sky(paint, view, frame, eye)
    below = _ground_of_sky(paint, view, frame, eye) + paint.flake_amount * _flakes_of_sky(paint, view, frame, eye)
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        light = torch.einsum("...ij,...j", frame, to_light.expand_as(view.normal))
        cosine = light[..., 2].clip(0, 1)
        total = total + irradiance * (mirrored(VARNISH, paint.coat_roughness, eye, light) * cosine)[..., None]
        entered = irradiance * _through(paint, light)
        ground = brdf.reflected(_matt(paint, eye), Geometry(_up(eye), eye, light))
        flaked = paint.flake_colour * (_glint(paint, view, eye, light) * cosine)[..., None]
        below = below + entered * ((1 - paint.flake_amount) * ground + paint.flake_amount * flaked)
    return total + _through(paint, eye) * below


def _up(eye: Tensor) -> Tensor:
    return torch.tensor([0.0, 0.0, 1.0], dtype=eye.dtype).expand_as(eye)


def _matt(paint: CarPaint, eye: Tensor) -> brdf.Material:
    one = torch.ones_like(eye[..., 0])
    return brdf.material(paint.base.expand_as(eye), one, 0 * one)


def _through(paint: CarPaint, direction: Tensor) -> Tensor:
    """Share that crosses the coat's surface and depth from or to a direction."""
    direction = torch.cat([direction[..., :2], direction[..., 2:].clip(LEAST_COSINE, 1)], -1)
    length = direction / direction.norm(dim=-1, keepdim=True)
    surface = crossed(VARNISH, paint.coat_roughness, direction)
    bent = torch.asin(torch.sin(torch.acos(length[..., 2].clip(0, 1))) / VARNISH)
    return surface[..., None] * torch.exp(-paint.coat_depth / torch.cos(bent)[..., None])


def _sky(view: CarPaintView, frame: Tensor, direction: Tensor) -> Tensor:
    """Radiance of the sky in directions of the surface's own frame, of any number of axes after those of the places."""
    extra = (1,) * (direction.ndim - frame.ndim + 1)
    rise = (frame[..., 2].reshape(*frame.shape[:-2], *extra, 3) * direction).sum(-1, keepdim=True)
    return view.lights.sky.mean + view.lights.sky.gradient * rise


def _coat_of_sky(paint: CarPaint, view: CarPaintView, frame: Tensor, eye: Tensor) -> Tensor:
    weight, light = facets(VARNISH, paint.coat_roughness, eye)
    return (weight[..., None] * _sky(view, frame, light)).sum((-3, -2))


def _ground_of_sky(paint: CarPaint, view: CarPaintView, frame: Tensor, eye: Tensor) -> Tensor:
    """Radiance of the base coat in the sky, what crosses the coat to it counted, what crosses to the eye not."""
    rise = torch.sqrt((torch.arange(_RISES, dtype=eye.dtype) + 0.5) / _RISES)
    turn = (torch.arange(_AROUND, dtype=eye.dtype) + 0.5) * (2 * math.pi / _AROUND)
    level = torch.sqrt(1 - rise**2)
    through = _through(paint, torch.stack([level, 0 * level, rise], -1))[:, None]
    flat = torch.stack([torch.cos(turn), torch.sin(turn)], -1)
    light = torch.cat([level[:, None, None] * flat, rise[:, None, None].expand(-1, _AROUND, 1)], -1)
    light = light.expand(*eye.shape[:-1], *light.shape)
    towards = eye[..., None, None, :].expand_as(light)
    share = brdf.reflected(_matt(paint, towards), Geometry(_up(towards), towards, light))
    # Nodes are even in the squared cosine: each is pi / (count cosine) wide.
    solid = math.pi / (_RISES * _AROUND) / rise[:, None, None]
    ground = (share * through * _sky(view, frame, light) * solid).sum((-3, -2))
    return (1 - paint.flake_amount) * ground


def _out(slope: Tensor, inside: Tensor) -> Tensor:
    """Direction outside, along the surface, of a ray inside that a flake of that slope mirrors."""
    flake = torch.stack([slope[0], slope[1], torch.ones_like(slope[0])])
    flake = flake / flake.norm()
    mirrored: Tensor = 2 * (flake @ inside) * flake - inside
    return VARNISH * mirrored[:2]


def _inside(direction: Tensor) -> Tensor:
    angle = torch.asin(direction[..., :2].norm(dim=-1, keepdim=True).clip(max=1) / VARNISH)
    return torch.cat([direction[..., :2] / VARNISH, torch.cos(angle)], -1)


def _glint(paint: CarPaint, view: CarPaintView, eye: Tensor, light: Tensor) -> Tensor:
    """BRDF of flakes, by how densely traced rays come out about the eye."""
    from_light, from_eye = _inside(light), _inside(eye)
    middle = from_light + from_eye
    slope = middle[..., :2] / middle[..., 2:]
    tracing = torch.func.vmap(torch.func.jacfwd(_out))(slope.reshape(-1, 2), from_light.reshape(-1, 3))
    facing = 1 + (slope * from_light[..., :2]).sum(-1) / from_light[..., 2]
    found: Tensor = _density(paint, view, slope) * facing / torch.linalg.det(tracing).abs().reshape(facing.shape)
    return found


def _density(paint: CarPaint, view: CarPaintView, slope: Tensor) -> Tensor:
    """Flakes per slope that a pixel sees: of two sizes of cells, by the deviations that means of flakes have."""
    place = view.place / paint.flake_size
    size = (view.footprint / paint.flake_size).clip(min=1)
    lower = torch.floor(torch.log2(size))
    even = torch.exp(-(slope.norm(dim=-1) ** 2) / paint.flake_spread**2) / (math.pi * paint.flake_spread**2)
    total = even
    for level, share in ((lower, 1 - torch.log2(size) + lower), (lower + 1, torch.log2(size) - lower)):
        mean = flakes.drawn(paint.flake_spread, flakes.cell(place, level), level)
        one = torch.exp(-((slope - mean).norm(dim=-1) ** 2) / flakes.WAVY**2) / (math.pi * flakes.WAVY**2)
        total = total + share * (one - even) / torch.sqrt(4.0**level)
    return total


def _flakes_of_sky(paint: CarPaint, view: CarPaintView, frame: Tensor, eye: Tensor) -> Tensor:
    """Radiance of even flakes in the sky, each ray with the depth that it crosses on its way in."""
    share = ((torch.arange(_SHARES, dtype=eye.dtype) + 0.5) / _SHARES)[:, None]
    turn = (torch.arange(_TURNS, dtype=eye.dtype) + 0.5) * (2 * math.pi / _TURNS)
    far = paint.flake_spread * torch.sqrt(-torch.log(share))
    flake = torch.stack([far * torch.cos(turn), far * torch.sin(turn), torch.ones_like(far * turn)], -1)
    inside = _inside(eye)[..., None, None, :]
    facing = (flake * inside).sum(-1) / inside[..., 2]
    flake = flake / flake.norm(dim=-1, keepdim=True)
    light = 2 * (flake * inside).sum(-1, keepdim=True) * flake - inside
    sine = VARNISH * light[..., :2].norm(dim=-1)
    leaves = (sine < 1) & (light[..., 2] > 0) & (facing > 0)
    outside = torch.cat([VARNISH * light[..., :2], torch.cos(torch.asin(sine.clip(max=1)))[..., None]], -1)
    through = (1 - fresnel(VARNISH, torch.asin(sine.clip(max=1)))) * facing / (_SHARES * _TURNS)
    depth = torch.exp(-paint.coat_depth / light[..., 2:].abs())
    found = torch.where(leaves[..., None], through[..., None] * depth * _sky(view, frame, outside), 0 * outside)
    return paint.flake_colour * found.sum((-3, -2))
