"""A small scene in which local lights have all that they may have: the hard cases of their tests and experiments."""

import math
from dataclasses import replace

import torch
from torch import Tensor
from torch.utils import _pytree as pytree  # torch has no public name for it

from diffrender.rays import from_angles
from diffrender.shading.lamp_shadow import Shadows, Squares, span, texel_directions
from diffrender.shading.lamps import (
    NO_PROFILE,
    Group,
    Lamps,
    Lists,
    LitView,
    Places,
    most_in_slices,
    points,
    spots,
)
from diffrender.shading.light_profile import Profile, Profiles, even

# Height, azimuth [degrees] and distance of a lamp from its tile's middle, reach, intensity; elevation of its axis.
_LAMPS = (
    (40.0, 20.0, 2.0, 6.0, 30.0, -60.0),
    (80.0, 140.0, 0.4, 3.0, 6.0, -90.0),  # near
    (15.0, 250.0, 3.0, 3.4, 90.0, -20.0),  # where its light ends
    (50.0, 300.0, 2.5, 8.0, 60.0, -50.0),
    (0.5, 10.0, 2.0, 5.0, 60.0, 0.0),  # grazing
    (-30.0, 80.0, 1.5, 5.0, 40.0, 30.0),  # below the surface
    (60.0, 200.0, 6.0, 5.0, 99.0, -70.0),  # out of reach
    (89.0, 0.0, 1.8, 7.0, 50.0, -90.0),
    (35.0, 170.0, 1.2, 4.0, 20.0, 80.0),  # turned away
)
# Roughness, metallic, brightness of the base; elevation and azimuth of the eye [degrees].
_SURFACES = (
    (0.5, 0.0, 0.4, 40.0, 200.0),
    (1.0, 0.0, 0.8, 25.0, 100.0),
    (0.2, 1.0, 0.7, 60.0, 20.0),
    (0.0, 0.0, 0.3, 35.0, 10.0),  # a mirror
    (0.6, 1.0, 0.9, 3.0, 300.0),  # grazing
    (0.35, 0.0, 0.0, 89.9, 0.0),  # black, straight down
)
_SLICES = 4
_SHADOWED = (0, 1, 3, 7)  # lamps that stand once more, with shadows
_SIZES = (16, 32, 16, 16)  # of their maps
_BALLS = (
    (0.9, 0.3, 0.5, 0.3),
    (2.1, -0.1, 0.4, 0.25),
    (2.8, -0.5, 1.15, 0.2),
    (4.5, 0.0, 1.0, 0.3),
)  # middle and radius [m]
_NOTHING = 100.0  # in texels that nothing catches [m]


def example_inputs(dtype: torch.dtype) -> LitView:
    """Six tiles of four places on grounds and mirrors, under points, spots and measured lamps: near, grazing, away."""
    lamp = torch.tensor(_LAMPS, dtype=torch.float64)
    surface = torch.tensor(_SURFACES, dtype=torch.float64)
    tile, pixel = torch.arange(len(surface), dtype=torch.float64), torch.arange(4, dtype=torch.float64)
    place = torch.stack(
        [0.9 * tile[:, None] + 0.0 * pixel, 0.15 * pixel + 0.0 * tile[:, None], 0.0 * tile[:, None] * pixel], -1
    )
    lean = torch.stack([0.1 * torch.sin(tile), 0.1 * torch.cos(tile), torch.ones_like(tile)], -1)
    rough, metal, bright, *eye = surface.unbind(-1)
    to_eye = from_angles(*(angle.deg2rad() for angle in eye))
    base = bright[:, None] * torch.tensor([1.0, 0.9, 0.75], dtype=torch.float64)

    def of_tile(value: Tensor) -> Tensor:
        return value[:, None].expand(len(surface), 4, *value.shape[1:]).clone()

    slices = of_tile(tile.long()) % _SLICES
    unit = torch.nn.functional.normalize(lean, dim=-1)
    places = Places(place, of_tile(unit), of_tile(to_eye), of_tile(base), of_tile(rough), of_tile(metal), slices)
    lamps = _example_lamps(lamp)
    own = _example_lists(places, lamps)
    double = LitView(places, lamps, own, _example_profiles(), _shadowed(places, lamps))
    view: LitView = pytree.tree_map_only(
        Tensor, lambda tensor: tensor.to(dtype) if tensor.is_floating_point() else tensor, double
    )
    return view


def _example_lamps(lamp: Tensor) -> Lamps:
    rise, turn, distance, reach, strength, tilt = lamp.unbind(-1)
    number = torch.arange(len(lamp), dtype=torch.float64)
    middle = torch.stack([0.6 * number, 0.2 + 0.0 * number, 0.0 * number], -1)
    towards = from_angles(rise.deg2rad(), turn.deg2rad())
    colour = strength[:, None] * torch.tensor([1.0, 0.8, 0.6], dtype=torch.float64)
    lamps = points(middle + distance[:, None] * towards, colour, reach)
    spot = spots(lamps, from_angles(tilt.deg2rad(), turn.deg2rad() + math.pi), 0.3, 0.9)
    is_point = number % 3 == 1
    cones = {
        name: torch.where(is_point, getattr(lamps, name), getattr(spot, name)) for name in ("cos_inner", "cos_outer")
    }
    profile = torch.where(number % 3 == 2, (number // 3).long() % 2, NO_PROFILE)
    return replace(spot, profile=profile, **cones)


def _example_profiles() -> Profiles:
    """A downlight, and a lamp that shines to two sides more than to the others."""
    down, turn = (torch.linspace(0.0, end, count, dtype=torch.float64) for end, count in ((180.0, 19), (360.0, 37)))
    down, turn = down.deg2rad(), turn.deg2rad()
    batwing = 0.3 + torch.sin(down[:, None]) ** 2 * torch.cos(turn) ** 2
    below = torch.cos(down[:10, None]).clamp(min=0.0) + 0.0 * turn
    return even([Profile(down[:10], turn, below), Profile(down, turn, batwing)], len(down), len(turn))


def _shadowed(places: Places, lamps: Lamps) -> Group:
    """Some of the lamps once more, further up, whose light balls catch: two spots, a point and a measured lamp."""
    number = torch.tensor(_SHADOWED)
    again: Lamps = pytree.tree_map(lambda value: value[number], lamps)
    again = replace(again, position=again.position + again.position.new_tensor((0.3, 0.0, 0.4)))
    sizes = torch.tensor(_SIZES)
    corners = torch.tensor([[0, 32], [0, 0], [16, 32], [0, 48]])
    squares = Squares(corners, sizes, span(again.cos_outer, sizes))
    atlas = torch.full((32, 64), -_NOTHING, dtype=torch.float64)
    for lamp, (down, across), size in zip(range(len(sizes)), corners.tolist(), _SIZES, strict=True):
        atlas[down : down + size, across : across + size] = -_caught(again, lamp, squares)
    softness = torch.tensor(0.7, dtype=torch.float64)
    return Group(again, _example_lists(places, again), Shadows(squares, atlas, softness))


def _caught(lamps: Lamps, number: int, squares: Squares) -> Tensor:
    """How far directions of a lamp's texels are free of balls [m]."""
    parts = texel_directions(int(squares.size[number]), squares.span[number])
    across, axis = lamps.across[number], lamps.axis[number]
    frame = torch.stack([across, torch.linalg.cross(across, axis), axis])
    direction, ball = parts @ frame, parts.new_tensor(_BALLS)
    towards = ball[:, :3] - lamps.position[number]
    along = direction @ towards.T
    inside = ball[:, 3] ** 2 - (towards.square().sum(-1) - along.square())
    is_met = (inside > 0.0) & (along > 0.0)
    way = torch.where(is_met, along - inside.clamp(min=0.0).sqrt(), _NOTHING)
    return way.amin(-1)


def _example_lists(places: Places, lamps: Lamps) -> Lists:
    """Lists of what reaches any place of a tile; all of it in the slice in which the tile lies, none in others."""
    distance = torch.linalg.vector_norm(lamps.position - places.position[..., None, :], dim=-1)
    reached = (distance <= lamps.reach).any(1)
    longest = int(reached.sum(-1).max())
    # A stable sort of what is not reached leaves the others in front, in their order.
    listed = (~reached).long().argsort(dim=-1, stable=True)[:, :longest]
    listed = torch.where(reached.gather(-1, listed), listed, -1)
    first = torch.zeros(len(listed), _SLICES, dtype=torch.long)
    is_own = torch.arange(_SLICES) == places.slice[:, :1]
    last = torch.where(is_own, reached.sum(-1, keepdim=True) - 1, -1)
    return Lists(listed, first, last, most_in_slices(places, first, last))
