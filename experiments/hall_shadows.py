"""Shadows in the hall of balls: maps of its lamps in an atlas, and whether a lamp really is seen from a place."""

import math
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.geometry import shadow_atlas
from diffrender.geometry.shadow_atlas import Square
from diffrender.shading import lamp_shadow
from diffrender.shading.lamp_shadow import Shadows, Squares
from diffrender.shading.lamps import Group, Lamps, LitView
from experiments import lamp_scenes
from experiments.lamp_scenes import Balls, Seen

NOTHING = 1e3  # in texels that nothing catches [m]
SOFTNESS = 0.5  # [widths of a texel]
DETAIL = 4.0  # texels along a map for a pixel that its lamp's sphere is high
OFF = 1e-6  # how far rays begin off what they leave [m]


def squares(shown: Seen, lamps: Lamps, atlas: int, least: int) -> tuple[Square, ...]:
    """Squares of lamps, as large as what they light is on the screen; of size 0 for those that find no room."""
    height = shown.camera.height
    tangent = math.tan(shown.camera.field_of_view / 2.0) * height / shown.camera.width
    depths = lamp_scenes.depth(shown, lamps.position).clamp(min=0.0).tolist()
    wanted = [
        DETAIL * shadow_atlas.wanted_size(reach, far, tangent, height)
        for reach, far in zip(lamps.reach.tolist(), depths, strict=True)
    ]
    sizes = [shadow_atlas.map_size(one, before=0, least=least, most=atlas // 2) for one in wanted]
    return shadow_atlas.packed(sizes, atlas, least)


def shadows(balls: Balls, lamps: Lamps, given: tuple[Square, ...], atlas: int) -> Shadows:
    """Maps of lamps in an atlas, each in its square, ray by ray."""
    corner = torch.tensor([[square.y, square.x] for square in given]).reshape(-1, 2)
    size = torch.tensor([square.size for square in given], dtype=torch.long)
    whole = Squares(corner, size, lamp_shadow.span(lamps.cos_outer, size))
    depths = lamps.position.new_full((atlas, atlas), -NOTHING)
    for number, square in enumerate(given):
        rows, columns = (slice(start, start + square.size) for start in (square.y, square.x))
        depths[rows, columns] = -_way(balls, lamps, number, whole)
    return Shadows(whole, depths, depths.new_tensor(SOFTNESS))


def _way(balls: Balls, lamps: Lamps, number: int, of: Squares) -> Float[Tensor, "size size"]:
    parts = lamp_shadow.texel_directions(int(of.size[number]), of.span[number])
    across, axis = lamps.across[number], lamps.axis[number]
    direction = parts @ torch.stack([across, torch.linalg.cross(across, axis), axis])
    way, _ = lamp_scenes.met(balls, lamps.position[number], direction)
    return way.clamp(max=NOTHING)


def shaded(shown: Seen, given: Lamps, count: int, tile: int, atlas: int) -> LitView:
    """View of a hall in which the first so many lamps cast shadows, where they find room in an atlas."""
    least = 4 * lamp_shadow.MARGIN
    found = squares(shown, some(given, torch.arange(count)), atlas, least)
    is_kept = torch.tensor([square.size > 0 for square in found] + [False] * (len(given.reach) - count))
    plain = lamp_scenes.view(shown, some(given, ~is_kept), tile)
    with_maps = some(given, is_kept)
    kept = tuple(square for square in found if square.size)
    lists = lamp_scenes.lists(shown, with_maps, plain.places, tile)
    group = Group(with_maps, lists, shadows(shown.balls, with_maps, kept, atlas))
    return LitView(plain.places, plain.lamps, plain.lists, plain.profiles, group)


def some(lamps: Lamps, which: Tensor) -> Lamps:
    """Lamps of some numbers, or of a mask."""
    found: Lamps = pytree.tree_map(lambda value: value[which], lamps)
    return found


def alone(group: Group, number: int) -> Group:
    """One lamp of a group, with its map."""
    assert group.shadows is not None
    which = torch.tensor([number])
    squares: Squares = pytree.tree_map(lambda value: value[which], group.shadows.squares)
    return replace(group, lamps=some(group.lamps, which), shadows=replace(group.shadows, squares=squares))


def is_seen(balls: Balls, place: Float[Tensor, "*batch 3"], lamp: Float[Tensor, "*#batch 3"]) -> Bool[Tensor, "*batch"]:
    """Whether nothing is between places and lamps."""
    towards = lamp - place
    way: Tensor = torch.linalg.vector_norm(towards, dim=-1, keepdim=True)
    direction = towards / way
    free, _ = lamp_scenes.met(balls, place + OFF * direction, direction)
    is_free: Tensor = free + 2.0 * OFF >= way[..., 0]
    return is_free
