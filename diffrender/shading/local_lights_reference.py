"""Light of many lamps by slow and plain means: lamp by lamp, with no formula of the fast one but its model.

A lamp's disc is summed ring by ring, and what surfaces reflect is that of `brdf_reference`. Profiles and maps of
shadows are looked up corner by corner, each with the weight of a tent: every texel of a lamp's square by how near it is
on the octahedron, which is unfolded face by face.
"""

import itertools
import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading.brdf import Geometry
from diffrender.shading.brdf_reference import material, reflected
from diffrender.shading.lamp_shadow import LIFT, Shadows
from diffrender.shading.lamps import Lamps, LitView, LocalLights, Places
from diffrender.shading.light_profile import Profiles

_RINGS = 16  # of equal area


def reference(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """Radiance of all lamps' light that surfaces send to the eye [W/(m² sr)]."""
    total = torch.zeros_like(view.places.position)
    for group in view.groups:
        for number in range(len(group.lamps.reach)):
            lamp = Lamps(**{name: value[number] for name, value in vars(group.lamps).items()})
            light = _of_lamp(lights, view, lamp)
            if group.shadows is not None:
                light = light * _seen(view.places, lamp, group.shadows, number)[..., None]
            total = total + light
    return total * lights.intensity_scale


def _of_lamp(lights: LocalLights, view: LitView, lamp: Lamps) -> Tensor:
    towards = lamp.position - view.places.position
    distance = towards.norm(dim=-1)
    to_light = towards / distance[..., None]
    share = distance / (lamp.reach * lights.reach_scale)
    window = torch.where(share < 1, (1 - share**4) ** 2, 0.0)
    strength = _disc(distance, lights.source_radius) * window * _cone(lamp, to_light)
    if view.profiles is not None and lamp.profile >= 0:
        strength = strength * _profile(view.profiles, lamp, to_light)
    places = view.places
    of = material(places.base, places.roughness, places.metallic)
    return lamp.intensity * strength[..., None] * reflected(of, Geometry(places.normal, places.to_eye, to_light))


def _disc(distance: Tensor, radius: Tensor) -> Tensor:
    """Irradiance by a disc of evenly bright rings, over its intensity: both cosines are those of the way to a ring."""
    total = torch.zeros_like(distance)
    for ring in range(_RINGS):
        way_square = distance**2 + radius**2 * (ring + 0.5) / _RINGS
        total = total + (distance / way_square) ** 2 / _RINGS
    return total


def _cone(lamp: Lamps, to_light: Tensor) -> Tensor:
    cosine = -(to_light * lamp.axis).sum(-1)
    share = ((cosine - lamp.cos_outer) / (lamp.cos_inner - lamp.cos_outer)).clamp(0, 1)
    return 3 * share**2 - 2 * share**3


def _profile(profiles: Profiles, lamp: Lamps, to_light: Tensor) -> Tensor:
    """Sum over all corners of a table of their intensity by what is left of them at a direction."""
    table = profiles.intensity[lamp.profile]
    rows, columns = table.shape
    vertical = torch.acos((-(to_light * lamp.axis).sum(-1)).clamp(-1, 1))
    side = torch.linalg.cross(lamp.across, lamp.axis)
    horizontal = torch.atan2(-(to_light * side).sum(-1), -(to_light * lamp.across).sum(-1)) % (2 * math.pi)
    step = math.pi / (rows - 1), 2 * math.pi / (columns - 1)
    of_row = torch.relu(1 - (vertical[..., None] / step[0] - torch.arange(rows)).abs())
    of_column = torch.relu(1 - (horizontal[..., None] / step[1] - torch.arange(columns)).abs())
    found = torch.einsum("...r,rc,...c->...", of_row, table, of_column)
    measured = (vertical >= profiles.first[lamp.profile]) & (vertical <= profiles.last[lamp.profile])
    return torch.where(measured, found, 0.0)


def _seen(places: Places, lamp: Lamps, shadows: Shadows, number: int) -> Tensor:
    """Comparisons with all texels of a lamp's square, as they weigh at nine places in it, a texel apart."""
    squares = shadows.squares
    size, span = int(squares.size[number]), squares.span[number]
    down, across = squares.corner[number].tolist()
    texels = shadows.atlas[down : down + size, across : across + size]
    away = places.position - lamp.position
    width = 2 * span / size * away.norm(dim=-1) * _octahedral(lamp, away) ** 2
    away = away + LIFT * width[..., None] * places.normal
    place = _unfolded(lamp, away)
    number_of = torch.arange(size)
    deeper = away.norm(dim=-1)[..., None, None] + texels
    lit = 1 / (1 + torch.exp(deeper / (shadows.softness * width)[..., None, None]))
    total = torch.zeros_like(width)
    for tap in torch.cartesian_prod(torch.arange(-1, 2), torch.arange(-1, 2)):
        at = ((place + span) / (2 * span / size) - 0.5 + tap).clamp(0, size - 1)
        of_row, of_column = (torch.relu(1 - (at[..., axis, None] - number_of).abs()) for axis in (0, 1))
        total = total + torch.einsum("...r,...rc,...c->...", of_row, lit, of_column)
    return total / 9


def _octahedral(lamp: Lamps, away: Tensor) -> Tensor:
    """Sum of a unit direction's parts along the lamp's three axes: over the way to the octahedron's face, 1."""
    axes = torch.stack([lamp.across, torch.linalg.cross(lamp.across, lamp.axis), lamp.axis])
    total: Tensor = (away @ axes.T).abs().sum(-1) / away.norm(dim=-1)
    return total


def _unfolded(lamp: Lamps, away: Tensor) -> Tensor:
    """Place on the octahedron's square: where a direction meets the plane of its face, turned over if it is behind."""
    across, axis = lamp.across, lamp.axis
    side = torch.linalg.cross(across, axis)
    total = torch.zeros_like(away[..., :2])
    corners = [-1.0, 1.0]
    for right, up, front in itertools.product(corners, corners, corners):
        plane = right * across + up * side + front * axis
        met = away / (away * plane).sum(-1, keepdim=True)
        x, y, ahead = ((met * one).sum(-1) for one in (across, side, axis))
        is_here = (x * right >= 0) & (y * up >= 0) & (ahead * front > 0) & ((away * plane).sum(-1) > 0)
        # Mirrored at the square's edge, x + y = 1 in this quadrant.
        flat = torch.stack([x, y] if front > 0 else [right * (1 - y * up), up * (1 - x * right)], -1)
        total = torch.where(is_here[..., None], flat, total)
    return total
