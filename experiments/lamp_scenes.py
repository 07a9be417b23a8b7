"""A hall of balls under many lamps, to see local lights on: what is seen, and lists of the lamps that reach its tiles.

Balls and lamps lie by chance, from a seed; the camera stands at one end of a long floor that ends at a wall. Rays meet
all of it exactly, by which maps of shadows are drawn and judged.
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.geometry import light_grid
from diffrender.geometry.light_grid import Depths, Spheres
from diffrender.rays import Perspective, pixel_centres
from diffrender.shading import lamps as of_lamps
from diffrender.shading.lamps import Lamps, Lists, LitView, Places
from diffrender.shading.light_profile import Profile, Profiles, even

EYE = (0.0, 0.0, 2.2)  # [m]
LENGTH, WIDTH, HEIGHT = 60.0, 16.0, 4.0  # of the hall [m]: ahead, to either side, and of the highest lamps
BALLS = 24
SPAN = (0.5, 100.0)  # of slices [m]


@dataclass(frozen=True)
class Balls:
    """What lies in the hall."""

    middle: Float[Tensor, "balls 3"]
    radius: Float[Tensor, " balls"]
    colour: Float[Tensor, "balls 3"]


@dataclass(frozen=True)
class Seen:
    """A picture's surfaces: nearest hits of a camera's rays."""

    camera: Perspective
    balls: Balls
    position: Float[Tensor, "height width 3"]
    normal: Float[Tensor, "height width 3"]
    to_eye: Float[Tensor, "height width 3"]
    base: Float[Tensor, "height width 3"]
    roughness: Float[Tensor, "height width"]
    metallic: Float[Tensor, "height width"]


def camera(width: int, height: int) -> Perspective:
    """Eyes of one who looks down the hall."""
    return Perspective(width, height, math.radians(70.0), math.radians(-9.0))


def seen(eyes: Perspective, draw: torch.Generator) -> Seen:
    """Floor, end wall and balls."""
    direction = eyes.direction(*pixel_centres(eyes, slice(None), torch.zeros((), dtype=torch.float64)))
    eye, balls = direction.new_tensor(EYE), _balls(draw)
    way, which = met(balls, eye, direction)
    position = eye + way[..., None] * direction
    of_ball = (which - 2).clamp(min=0)
    normal = (position - balls.middle[of_ball]) / balls.radius[of_ball][..., None]
    normal = torch.where((which == 0)[..., None], direction.new_tensor((0.0, 0.0, 1.0)), normal)
    normal = torch.where((which == 1)[..., None], direction.new_tensor((-1.0, 0.0, 0.0)), normal)
    is_ball = which >= 2
    checks = ((position[..., 0].floor() + position[..., 1].floor()) % 2.0)[..., None]
    flat = 0.35 + 0.25 * checks * torch.ones(3, dtype=torch.float64)
    base = torch.where(is_ball[..., None], balls.colour[of_ball], flat)
    roughness = torch.where(is_ball, 0.15 + 0.14 * (of_ball % 5).to(way), 0.4 + 0.0 * way)
    return Seen(eyes, balls, position, normal, -direction, base, roughness, (is_ball & (of_ball % 3 == 0)).to(way))


def met(
    balls: Balls, origin: Float[Tensor, "*#batch 3"], direction: Float[Tensor, "*batch 3"]
) -> tuple[Tensor, Tensor]:
    """Way to what rays first meet [m], infinite where nothing is, and what it is: floor, wall, or from 2 on a ball."""
    down, ahead = direction[..., 2], direction[..., 0]
    to_floor = torch.where(down < 0.0, -origin[..., 2] / down.clamp(max=-1e-9), math.inf)
    to_wall = torch.where(ahead > 0.0, (LENGTH - origin[..., 0]) / ahead.clamp(min=1e-9), math.inf)
    ways = torch.cat([to_floor[..., None], to_wall[..., None], _to_balls(balls, origin, direction)], -1)
    way, which = ways.min(-1)
    return way, which


def lamps(count: int, draw: torch.Generator) -> Lamps:
    """Points, spots that look down, and measured lamps, in equal parts; the more of them, the nearer each ends."""

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64)

    place = uniform(count, 3)
    position = torch.stack(
        [LENGTH * place[:, 0], WIDTH * (2.0 * place[:, 1] - 1.0), 0.2 + HEIGHT * place[:, 2] ** 2], -1
    )
    # As many lamps reach a place on average, however many there are.
    reach = math.sqrt(8.0 * LENGTH * WIDTH / max(count, 1)) * (0.5 + uniform(count))
    hue = torch.nn.functional.normalize(0.15 + uniform(count, 3), dim=-1)
    points = of_lamps.points(position, hue * (0.25 * reach**2)[:, None], reach)
    lean = torch.nn.functional.normalize(
        torch.cat([uniform(count, 2) - 0.5, -torch.ones(count, 1, dtype=torch.float64)], -1), dim=-1
    )
    spots = of_lamps.spots(points, lean, 0.4, 0.8)
    number = torch.arange(count)
    is_spot = number % 3 == 1
    cones = {
        name: torch.where(is_spot, getattr(spots, name), getattr(points, name)) for name in ("cos_inner", "cos_outer")
    }
    return replace(spots, profile=torch.where(number % 3 == 2, 0, of_lamps.NO_PROFILE), **cones)


def profiles() -> Profiles:
    """One lamp that shines more to two sides, measured every ten degrees."""
    down, turn = (torch.linspace(0.0, end, count, dtype=torch.float64) for end, count in ((180.0, 19), (360.0, 37)))
    down, turn = down.deg2rad(), turn.deg2rad()
    strength = (
        0.2 + 1.5 * torch.sin(down[:, None]) ** 4 * torch.cos(turn) ** 2 + torch.cos(down[:, None]).clamp(min=0.0)
    )
    return even([Profile(down, turn, strength)], len(down), len(turn))


def view(shown: Seen, given: Lamps, tile: int) -> LitView:
    """The picture tile by tile, and the lists of lamps for each."""
    parts = {name: one for name, one in vars(shown).items() if name not in ("camera", "balls")}
    tiles = {name: light_grid.to_tiles(one, tile) for name, one in parts.items()}
    of_depth = light_grid.slice_of(
        depth(shown, shown.position), Depths(*(shown.position.new_tensor(end) for end in SPAN))
    )
    places = Places(slice=light_grid.to_tiles(of_depth, tile), **tiles)
    return LitView(places, given, lists(shown, given, places, tile), profiles())


def lists(shown: Seen, given: Lamps, places: Places, tile: int) -> Lists:
    """Lists of lamps for the tiles of a picture: those of `light_grid`."""
    middle = light_grid.in_view(shown.camera, given.position.new_tensor(EYE), given.position)
    spheres, span = Spheres(middle, given.reach), Depths(*(middle.new_tensor(end) for end in SPAN))
    far = light_grid.to_tiles(depth(shown, shown.position), tile)
    sides = light_grid.side_planes(shown.camera, tile, far).flatten(0, 1)
    listed = light_grid.lists(sides, light_grid.depth_bounds(far), spheres)
    cells = light_grid.cells(listed, spheres, span)
    return Lists(listed, cells.first, cells.last, of_lamps.most_in_slices(places, cells.first, cells.last))


def depth(shown: Seen, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """How far ahead of the eye places are [m]."""
    return light_grid.in_view(shown.camera, position.new_tensor(EYE), position)[..., 2]


def _balls(draw: torch.Generator) -> Balls:
    place = torch.rand(BALLS, 6, generator=draw, dtype=torch.float64)
    radius = 0.3 + 0.9 * place[:, 0]
    ahead = 4.0 + 0.6 * LENGTH * place[:, 1] ** 2
    middle = torch.stack([ahead, (2.0 * place[:, 2] - 1.0) * 0.6 * ahead.clamp(max=WIDTH), radius], -1)
    return Balls(middle, radius, 0.15 + 0.8 * place[:, 3:])


def _to_balls(balls: Balls, origin: Tensor, direction: Tensor) -> Float[Tensor, "*batch balls"]:
    """Length of rays to every ball, infinite where they miss it."""
    towards = balls.middle - origin[..., None, :]
    along = (direction[..., None, :] * towards).sum(-1)
    square = towards.square().sum(-1) - along.square()
    inside = balls.radius.square() - square
    way = along - inside.clamp(min=0.0).sqrt()
    return torch.where((inside > 0.0) & (way > 0.0), way, math.inf)
