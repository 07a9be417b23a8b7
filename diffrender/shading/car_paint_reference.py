"""Car paint by slow and plain means: light is traced through the varnish by angles, and summed over sky and facets.

The coat's facets are Walter's [1] by the tangent of their angle with Smith's function, their Fresnel by the angles of
incidence and refraction. What flakes send to an eye is how densely traced rays of one light come out about it, by the
determinant of the tracing, which is differentiated. The base coat is the basic material, which is not under test, under
one light at a time and under every part of the sky; which flake lies where is given too.

[1] B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, section 5.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading import brdf, flakes
from diffrender.shading.brdf import Geometry
from diffrender.shading.microfacet import LEAST_COSINE, MIRROR_SPREAD
from diffrender.shading.painted_surface import CarPaint, CarPaintView

_INDEX = 1.5
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
        total = total + irradiance * (_coat(paint, eye, light) * cosine)[..., None]
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


def _fresnel(index: float, angle: Tensor) -> Tensor:
    """Of unpolarised light by its angle of incidence and that of refraction."""
    # Not straight down, where both are 0.
    angle = angle.clip(min=1e-5)
    bent = torch.asin(torch.sin(angle) / index)
    across = torch.sin(angle - bent) / torch.sin(angle + bent)
    within = torch.tan(angle - bent) / torch.tan(angle + bent)
    return (across**2 + within**2) / 2


def _hidden(cosine: Tensor, spread: Tensor) -> Tensor:
    """Smith's Lambda of GGX."""
    return 0.5 * (torch.sqrt(1 + spread**2 * (1 / cosine**2 - 1)) - 1)


def _coat(paint: CarPaint, eye: Tensor, light: Tensor) -> Tensor:
    """BRDF of the coat's surface."""
    spread = torch.sqrt(paint.coat_roughness**4 + MIRROR_SPREAD**2)
    risen = light[..., 2] > 0
    light = torch.where(risen[..., None], light, _up(light))
    half = (eye + light) / (eye + light).norm(dim=-1, keepdim=True)
    tangent = half[..., :2].norm(dim=-1) / half[..., 2]
    facets = 1 / (math.pi * spread**2 * half[..., 2] ** 4 * (1 + (tangent / spread) ** 2) ** 2)
    seen = 1 / (1 + _hidden(eye[..., 2], spread) + _hidden(light[..., 2], spread))
    angle = torch.acos((half * eye).sum(-1).clip(0, 1))
    found = _fresnel(_INDEX, angle) * facets * seen / (4 * eye[..., 2] * light[..., 2])
    return torch.where(risen, found, 0 * found)


def _facets(paint: CarPaint, eye: Tensor) -> tuple[Tensor, Tensor]:
    """Weights of facets as an eye meets them with the coat's Fresnel, and the directions that they mirror it to."""
    spread = torch.sqrt(paint.coat_roughness**4 + MIRROR_SPREAD**2)
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
    reach = 1 / (1 + _hidden(towards[..., 2], spread) + _hidden(risen, spread))
    weight = 3 * share**2 * reach * cos_half / (towards[..., 2] * cosine) / (_SHARES * _TURNS)
    weight = weight * _fresnel(_INDEX, torch.acos(cos_half.clip(0, 1)))
    return torch.where(seen, weight, 0 * weight), light


def _through(paint: CarPaint, direction: Tensor) -> Tensor:
    """Share that crosses the coat's surface and depth from or to a direction."""
    direction = torch.cat([direction[..., :2], direction[..., 2:].clip(LEAST_COSINE, 1)], -1)
    length = direction / direction.norm(dim=-1, keepdim=True)
    surface = 1 - _facets(paint, length)[0].sum((-2, -1))
    bent = torch.asin(torch.sin(torch.acos(length[..., 2].clip(0, 1))) / _INDEX)
    return surface[..., None] * torch.exp(-paint.coat_depth / torch.cos(bent)[..., None])


def _sky(view: CarPaintView, frame: Tensor, direction: Tensor) -> Tensor:
    """Radiance of the sky in directions of the surface's own frame, of any number of axes after those of the places."""
    extra = (1,) * (direction.ndim - frame.ndim + 1)
    rise = (frame[..., 2].reshape(*frame.shape[:-2], *extra, 3) * direction).sum(-1, keepdim=True)
    return view.lights.sky.mean + view.lights.sky.gradient * rise


def _coat_of_sky(paint: CarPaint, view: CarPaintView, frame: Tensor, eye: Tensor) -> Tensor:
    weight, light = _facets(paint, eye)
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
    return _INDEX * mirrored[:2]


def _inside(direction: Tensor) -> Tensor:
    angle = torch.asin(direction[..., :2].norm(dim=-1, keepdim=True).clip(max=1) / _INDEX)
    return torch.cat([direction[..., :2] / _INDEX, torch.cos(angle)], -1)


def _glint(paint: CarPaint, view: CarPaintView, eye: Tensor, light: Tensor) -> Tensor:
    """BRDF of flakes, by how densely traced rays come out about the eye."""
    from_light, from_eye = _inside(light), _inside(eye)
    middle = from_light + from_eye
    slope = middle[..., :2] / middle[..., 2:]
    tracing = torch.func.vmap(torch.func.jacfwd(_out))(slope, from_light)
    facing = 1 + (slope * from_light[..., :2]).sum(-1) / from_light[..., 2]
    found: Tensor = _density(paint, view, slope) * facing / torch.linalg.det(tracing).abs()
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
    sine = _INDEX * light[..., :2].norm(dim=-1)
    leaves = (sine < 1) & (light[..., 2] > 0) & (facing > 0)
    outside = torch.cat([_INDEX * light[..., :2], torch.cos(torch.asin(sine.clip(max=1)))[..., None]], -1)
    crossed = (1 - _fresnel(_INDEX, torch.asin(sine.clip(max=1)))) * facing / (_SHARES * _TURNS)
    depth = torch.exp(-paint.coat_depth / light[..., 2:].abs())
    found = torch.where(leaves[..., None], crossed[..., None] * depth * _sky(view, frame, outside), 0 * outside)
    return paint.flake_colour * found.sum((-3, -2))
