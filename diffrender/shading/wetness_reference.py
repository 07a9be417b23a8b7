"""Wetness by slow and plain means: the same published model [1], with no formula of the fast one but its constants.

What is wet of a material is told in gloss and not in roughness, as published. Water is followed through time by small
steps; every ring of a tile is looked at for every place; rivulets are differences of their film's thickness. What
the soaked material sends to the eye is summed by `brdf_reference`.

[1] S. Lagarde, "Water drop 2b" and "Water drop 3b", seblagarde.wordpress.com, 2013.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading import ripples, trickles
from diffrender.shading.brdf import Geometry, Material
from diffrender.shading.brdf_reference import material, reflected, reflected_sky
from diffrender.shading.wet_surface import LEVEL, POROUS_FROM, POROUS_OVER, SHORE, STEEP, WATER, Wetness, WetView

_STEPS = 256  # of time
_SMALL = 1e-5  # of differences [m]


def reference(wetness: Wetness, view: WetView) -> Float[Tensor, "*batch 3"]:
    """Radiance of a wet surface towards the eye [W/(m² sr)]."""
    rained = view.open * _outside(view)
    held = _followed(wetness, view, rained)
    hole = torch.minimum(wetness.hole_flood * held, 1 - view.height)
    puddle = _saturated((wetness.puddle_flood * held - view.terrain) / SHORE)
    place = _saturated((view.normal[..., 2] - STEEP) / (LEVEL - STEEP))
    flooded = torch.maximum(hole, puddle) * (3 * place**2 - 2 * place**3)
    wet = _saturated(wetness.amount * held + flooded)
    strength = wetness.trickle_strength * wetness.amount * held
    lean, film = _rivulets(view)
    bare = torch.exp(-strength * film)
    wet, mirror = 1 - (1 - wet) * bare, 1 - (1 - flooded) * bare
    gloss = 1 - view.roughness
    porosity = _saturated(((1 - gloss) - POROUS_FROM) / POROUS_OVER)
    one = torch.ones_like(porosity)
    factor = torch.lerp(one, wetness.soaked_albedo.expand_as(one), (1 - view.metallic) * porosity)
    diffuse = view.base * (1 - view.metallic[..., None]) * torch.lerp(one, factor, wet)[..., None]
    gloss = torch.lerp(torch.lerp(one, gloss, torch.lerp(one, factor, 0.5 * wet)), one, mirror)
    straight = material(view.base, view.roughness, view.metallic).straight
    straight = straight * (1 - mirror[..., None]) + WATER * mirror[..., None]
    normal = view.normal + strength[..., None] * lean
    level = _ringed(wetness, view, wetness.rain * rained)
    normal = normal * (1 - flooded[..., None]) + level * flooded[..., None]
    normal = normal / normal.norm(dim=-1, keepdim=True)
    soaked = Material(diffuse, straight, 1 - gloss)
    geometry = Geometry(normal, view.to_eye, view.to_light + torch.zeros_like(normal))
    return view.irradiance * reflected(soaked, geometry) + reflected_sky(soaked, geometry, view.sky)


def _saturated(x: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(x, torch.zeros_like(x)), torch.ones_like(x))


def _outside(view: WetView) -> Tensor:
    """Share of the rain that boxes let fall, box by box and axis by axis."""
    outside = torch.ones_like(view.height)
    for middle, half, border in zip(view.boxes.middle, view.boxes.half_size, view.boxes.border, strict=True):
        inside = torch.ones_like(outside)
        for axis in range(3):
            edge = half[axis] - torch.abs(view.position[..., axis] - middle[axis])
            share = _saturated(edge / border)
            inside = inside * (3 * share**2 - 2 * share**3)
        outside = outside * (1 - inside)
    return outside


def _followed(wetness: Wetness, view: WetView, towards: Tensor) -> Tensor:
    """Water held after a time, by the trapezoidal rule."""
    held, small = view.held + torch.zeros_like(towards), view.elapsed / _STEPS
    for _ in range(_STEPS):
        half = 0.5 * small / torch.where(towards < held, wetness.drying_time, wetness.soaking_time)
        held = (held * (1 - half) + 2 * half * towards) / (1 + half)
    return held


def _rivulets(view: WetView) -> tuple[Tensor, Tensor]:
    """Rivulets' part of the normal, from differences of the film on the two walls of the axes, and their film."""
    sides, film = [], torch.zeros_like(view.height)
    for axis, facing in ((0, 1), (1, 0)):
        gradient = torch.zeros_like(view.normal)
        for along in (axis, 2):
            away = torch.zeros(3, dtype=view.normal.dtype)
            away[along] = _SMALL
            thicker, thinner = (_film(view, view.position + sign * away, axis) for sign in (1, -1))
            gradient[..., along] = (thicker - thinner) / (2 * _SMALL)
        sides.append(view.normal[..., facing, None] ** 2 * gradient)
        film = film + view.normal[..., facing] ** 2 * _film(view, view.position, axis)
    whole = -trickles._STEEPEST * (sides[0] + sides[1])
    # The film that slopes are of is thicker by a factor, so that they are 1 and not it.
    thickest = torch.sqrt((view.waves[:, 0] ** 2).sum()) / math.sqrt(len(view.waves))
    lean: Tensor = torch.linalg.cross(view.normal, torch.linalg.cross(whole, view.normal))
    return lean, film * thickest


def _film(view: WetView, position: Tensor, axis: int) -> Tensor:
    total = torch.zeros_like(view.height)
    for across, down, speed, start in view.waves:
        total = total + torch.sin(across * position[..., axis] - down * (position[..., 2] + speed * view.time) + start)
    steepest = torch.sqrt((view.waves[:, 0] ** 2).sum())
    return torch.where(total > 0, total**2, 0 * total) / (math.sqrt(len(view.waves)) * steepest)


def _ringed(wetness: Wetness, view: WetView, rain: Tensor) -> Tensor:
    """Normal of water under rings, of which every drop of the tile is asked."""
    lean = torch.zeros_like(view.normal[..., :2])
    for layer, of_layer in enumerate(view.drops):
        strength = _saturated(4 * (rain - layer / 4))
        rows, columns = of_layer.shape[:2]
        for row in range(rows):
            for column in range(columns):
                across, down, reach, phase = of_layer[row, column]
                centre = torch.stack([column + across, row + down])
                size = torch.tensor([columns, rows], dtype=lean.dtype)
                aside = view.position[..., :2] / ripples.CELL + torch.tensor(ripples._ASIDE[layer], dtype=lean.dtype)
                aside = (aside - centre + size / 2) % size - size / 2
                far = aside.norm(dim=-1) / reach
                age = phase + ripples.DROPS_PER_SECOND * (ripples._RATES[layer] * view.time + ripples._LATER[layer])
                age = age - torch.floor(age)
                wave = torch.sin(math.pi * torch.clip(9 * (age - far), 0, 3))
                slope = _saturated(0.2 + 0.8 * strength - age) * torch.relu(1 - far) * wave * (2 - far) / reach
                lean = lean + (strength * slope)[..., None] * aside
    lean = ripples._STEEPEST * wetness.ripple_strength * lean
    return torch.cat([lean, torch.ones_like(lean[..., :1])], -1) / torch.sqrt(1 + (lean**2).sum(-1, keepdim=True))
