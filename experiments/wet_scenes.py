"""A street and a wall to see rain on: dry surfaces by formula, the light of a rainy day, and what puddles mirror.

Cobbles lie in rows, each with its own height, colour and edges; the ground under them dips. All of it is by sines and
hashes of places: nothing is read, nothing drawn by chance.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.rays import Camera, Perspective, from_angles, pixel_centres, unit
from diffrender.shading import brdf, ripples, trickles, wetness
from diffrender.shading.drying import DryBoxes
from diffrender.shading.wet_surface import Wetness, WetView
from diffrender.surfaces import EvenSky

COBBLE = (0.2, 0.14)  # along and across a row [m]
ROUND = 0.018  # height of a cobble over its joints [m]
LONG_AGO = 1e6  # [s]
SMALL = 1e-3  # of differences that give normals [m]
SUN = (24.0, -14.0)  # elevation and azimuth [degrees]
HOUSE = 9.0  # how far ahead a house stands [m]
NOWHERE = ((0.0, 0.0, -1e3), (1.0, 1.0, 1.0), 0.1)  # of a dry box in which nothing is


@dataclass(frozen=True)
class Weather:
    """What is not of the record: a moment, a dry box by middle, half size and border, and for how long it has stood."""

    time: float = 4.0
    eye: float = 1.6  # height over the ground [m]
    sun: tuple[float, float] = SUN
    box: tuple[tuple[float, float, float], tuple[float, float, float], float] = NOWHERE
    elapsed: float = LONG_AGO


def street_camera(width: int, height: int) -> Camera:
    """Eyes of one who looks down the street."""
    return Perspective(width, height, math.radians(62.0), math.radians(-14.0))


def puddle_camera(width: int, height: int) -> Camera:
    """The same, looking at a puddle ahead."""
    return Perspective(width, height, math.radians(40.0), math.radians(-24.0))


def street(camera: Camera, weather: Weather) -> WetView:
    """Ground of a street below a camera; what lies above the horizon is far ground, for `shown` to cover."""
    to_eye, direction = _from_eye(camera)
    falls = torch.where(direction[..., 2] < -1e-2, -direction[..., 2], 1.0)
    place = direction * (weather.eye / falls)[..., None]
    flat = torch.stack([place[..., 0], place[..., 1], torch.zeros_like(falls)], -1)
    height, shade = _cobbles(flat[..., 0], flat[..., 1])
    # Far cobbles are smaller than a pixel.
    seen = torch.exp(-place.norm(dim=-1) / 9.0)
    terrain = _terrain(flat[..., 0], flat[..., 1])
    normal = _bumped(flat, seen)
    base = (0.30 * shade * (0.45 + 0.55 * height))[..., None] * height.new_tensor((1.0, 0.95, 0.86))
    return view(weather, flat, normal, to_eye, (base, 0.86 - 0.16 * height, height, terrain))


def wall(camera: Camera, weather: Weather) -> WetView:
    """A smooth plastered wall 2 m ahead, in light that grazes it."""
    to_eye, direction = _from_eye(camera)
    place = direction * (2.0 / direction[..., :1].clamp(min=0.1))
    y, z = place[..., 1], place[..., 2]
    # Courses of stones, and plaster between them.
    row = (z / 0.31).floor()
    stone = (y + 0.27 * row) / 0.55
    joint = torch.minimum(_edge(z / 0.31, 0.05), _edge(stone, 0.03))
    shade = 0.8 + 0.4 * _hash(row, stone.floor())
    normal = torch.stack([-torch.ones_like(y), 0.02 * torch.sin(9.0 * y + 3.0 * z), 0.02 * torch.cos(7.0 * z)], -1)
    base = (0.34 * shade * (0.6 + 0.4 * joint))[..., None] * place.new_tensor((1.0, 0.86, 0.7))
    flat = torch.ones_like(y)
    return view(weather, place, unit(normal), to_eye, (base, 0.72 * flat, flat, flat))


def radiance(rain: Wetness, view: WetView) -> Float[Tensor, "*batch 3"]:
    """Radiance of a wet street, with the house and the windows that it mirrors in place of the even sky.

    Of the mirror's share, as reflections found on the screen or in a cube of pictures would give.
    """
    drawn = wetness.render(rain, view)
    found = wetness.running(rain, view)
    normal, material = wetness.wet_normal(rain, view, found), wetness.wet_material(rain, view, found)
    cosine = (normal * view.to_eye).sum(-1).clamp(1e-3, 1.0)
    mirrored = 2.0 * cosine[..., None] * normal - view.to_eye
    share = brdf.moments(cosine, material.roughness)[..., 0, :]
    strength = material.straight * share[..., :1] + share[..., 1:]
    sharp = (1.0 - material.roughness).clamp(min=0.0) ** 4
    even = view.sky.mean + view.sky.gradient * mirrored[..., 2:]
    return drawn + strength * sharp[..., None] * (around(view.position, mirrored, view.sky) - even)


def around(origin: Tensor, direction: Tensor, sky: EvenSky) -> Float[Tensor, "*batch 3"]:
    """Radiance of the house at the end of the street, its lit windows, and the sky above."""
    above = sky.mean + sky.gradient * direction[..., 2:].clamp(min=0.0)
    ahead = direction[..., 0].clamp(min=1e-4)
    hit = origin + direction * ((HOUSE - origin[..., 0]) / ahead)[..., None]
    y, z = hit[..., 1], hit[..., 2]
    roof = 3.4 - 0.55 * (y - 1.2).abs()
    is_house = (direction[..., 0] > 1e-3) & (z < roof.clamp(max=3.0)) & (y > -2.2) & (y < 4.6)
    window = (((y + 9.3) % 1.5 - 0.75).abs() < 0.33) & (((z - 0.2) % 1.6 - 0.85).abs() < 0.42) & (z > 0.0)
    lit, stone = (sky.mean.new_tensor(colour) for colour in ((3.2, 1.9, 0.7), (0.1, 0.08, 0.07)))
    facade = torch.where(window[..., None], lit, stone)
    return torch.where(is_house[..., None], facade, above)


def shown(camera: Camera, rain: Wetness, weather: Weather) -> Float[Tensor, "height width 3"]:
    """Picture of the street: wet ground, and above it the house and the sky."""
    view = street(camera, weather)
    _, direction = _from_eye(camera)
    eye = direction.new_tensor((0.0, 0.0, weather.eye))
    is_ground = (direction[..., 2] < -1e-2) & (weather.eye * direction[..., 0] < HOUSE * -direction[..., 2])
    return torch.where(is_ground[..., None], radiance(rain, view), around(eye, direction, view.sky))


def _from_eye(camera: Camera) -> tuple[Tensor, Tensor]:
    direction = camera.direction(*pixel_centres(camera, slice(None), torch.zeros((), dtype=torch.float64)))
    return -direction, direction


def view(weather: Weather, place: Tensor, normal: Tensor, to_eye: Tensor, looks: tuple[Tensor, ...]) -> WetView:
    """View of surfaces of a base colour, roughness, height and terrain."""
    base, roughness, height, terrain = looks
    middle, half, border = (place.new_tensor(one) for one in weather.box)
    elevation, azimuth = torch.deg2rad(place.new_tensor(weather.sun))
    return WetView(
        position=place,
        normal=normal,
        to_eye=to_eye,
        base=base.clamp(0.0, 1.0),
        roughness=roughness,
        metallic=torch.zeros_like(roughness),
        height=height,
        terrain=terrain,
        to_light=from_angles(elevation, azimuth),
        irradiance=place.new_tensor((1.1, 1.0, 0.85)),
        sky=EvenSky(place.new_tensor((0.5, 0.56, 0.64)), place.new_tensor((0.35, 0.37, 0.38))),
        open=torch.ones_like(height),
        held=torch.ones_like(height),
        elapsed=place.new_tensor(weather.elapsed),
        time=place.new_tensor(weather.time),
        boxes=DryBoxes(middle[None], half[None], border[None]),
        drops=ripples.drops(9, torch.Generator().manual_seed(3)),
        waves=trickles.waves(16, torch.Generator().manual_seed(4)),
    )


def _bumped(place: Tensor, seen: Tensor) -> Tensor:
    """Unit normal of the cobbles at places on the ground, flatter where less of them is seen."""
    x, y = place[..., 0], place[..., 1]
    slopes = [
        (_metres(x + dx, y + dy) - _metres(x - dx, y - dy)) / (2.0 * SMALL) for dx, dy in ((SMALL, 0.0), (0.0, SMALL))
    ]
    return unit(torch.stack([-slopes[0] * seen, -slopes[1] * seen, torch.ones_like(x)], -1))


def _metres(x: Tensor, y: Tensor) -> Tensor:
    rough = 0.0006 * torch.sin(171.0 * x + 31.0 * y) * torch.sin(143.0 * y - 57.0 * x)
    return ROUND * _cobbles(x, y)[0] + rough


def _cobbles(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Height map from 0 in joints to 1, and how bright each cobble is."""
    wavy = x + 0.012 * torch.sin(5.0 * y) + 0.006 * torch.sin(23.0 * y + 7.0 * x)
    row = (wavy / COBBLE[0]).floor()
    across = y / COBBLE[1] + 0.5 * row + 0.25 * torch.sin(3.1 * row) + 0.04 * torch.sin(19.0 * x)
    own = _hash(row, across.floor())
    # Two cushions multiplied: corners are rounder than edges.
    dome = _edge(wavy / COBBLE[0], 0.30) * _edge(across, 0.34)
    return dome * (0.78 + 0.22 * own), 0.75 + 0.5 * _hash(across.floor(), row + 7.0)


def _edge(place: Tensor, width: float) -> Tensor:
    """1 inside of whole numbers' cells, smoothly 0 at their borders."""
    inner = 0.5 - (place - place.floor() - 0.5).abs()
    share = (inner / width).clamp(0.0, 1.0)
    return share * (2.0 - share)


def _terrain(x: Tensor, y: Tensor) -> Tensor:
    """Dips of the ground, from 0."""
    waves = torch.sin(1.15 * x + 0.4 * y + 1.38) * torch.cos(0.95 * y - 0.35 * x + 1.33)
    small = torch.sin(2.9 * x - 1.7 * y) * torch.sin(2.3 * y + 1.1 * x + 2.0)
    return (0.5 + 0.42 * waves + 0.14 * small).clamp(0.0, 1.0)


def _hash(x: Tensor, y: Tensor) -> Tensor:
    turned = torch.sin(12.9898 * x + 78.233 * y) * 43758.5453
    return turned - turned.floor()
