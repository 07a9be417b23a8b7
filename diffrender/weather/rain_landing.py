"""Where drops land: on the heights that are seen from above, and on moving bodies such as characters.

The heights are an orthographic depth map from the top, as in the talk [1], over a square of twice DEPTH_MAP_RADIUS. A
drop ends where its path first meets them, so that the lee of a roof stays dry. All below a roof is solid to drops: none
is driven under its edge, and what ends at that side or at a wall does not splash. The path is looked at at 17 levels
from the highest point of the map to the lowest, then halved where it first lies below: what is thinner than the drop's
way between two levels, seen from the side, may be missed.

Bodies are spheres in uniform motion; a character is a few of them.

Gradient: exact of the age at which a drop lands, by its path, the heights and the bodies. Between which levels the path
first meets the map, and whether it meets a body, is not differentiated.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Rain".
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import lookup, safe_sqrt, smooth_rise
from diffrender.parameters import record
from diffrender.weather.rain_drops import Falls, Rain, place

LEVELS = 17
HALVINGS = 6
TANGENTS = 2
NEARBY = 1e-3  # way to either side over which the slope of the map is found [s]
NEVER = 1e4  # age of landing of what does not land, far beyond any life [s]


@record
class Obstacles:
    """What rain falls on: altitudes over a square, row by x and column by y from the lower corner, and spheres."""

    heights: Float[Tensor, "rows columns"]  # of the middles of equal cells [m]
    centre: Float[Tensor, "*#batch 2"]  # of the square, x and y [m]
    body: Float[Tensor, "*#batch bodies 3"]  # centres as the shutter closes [m]
    body_velocity: Float[Tensor, "*#batch bodies 3"]  # [m/s]
    body_radius: Float[Tensor, "*#batch bodies"]  # [m]


def heights_from_above(
    surface: Callable[[Tensor], Tensor], centre: Float[Tensor, "2"], radius: Float[Tensor, ""], size: int
) -> Float[Tensor, "{size} {size}"]:
    """Altitudes [m] of a surface, a function of places (..., 2), in the middles of size x size cells of a square.

    >>> heights_from_above(lambda place: place[..., 0], torch.tensor([1.0, 0.0]), torch.tensor(2.0), 2)
    tensor([[0., 0.],
            [2., 2.]])
    """
    across = radius * ((torch.arange(size).to(centre) + 0.5) * (2.0 / size) - 1.0)
    x, y = torch.meshgrid(centre[0] + across, centre[1] + across, indexing="ij")
    return surface(torch.stack([x, y], -1))


def height_under(
    rain: Rain, obstacles: Obstacles, eye: Float[Tensor, "*batch 3"], there: Float[Tensor, "*batch drops 3"]
) -> Float[Tensor, "*batch drops"]:
    """Height of the map under places relative to an eye, relative to it too [m]."""
    side = torch.tensor(obstacles.heights.shape).to(there) / (2.0 * rain.depth_map_radius)
    from_corner = there[..., :2] + (eye[..., :2] - obstacles.centre)[..., None, :] + rain.depth_map_radius
    row, column = (from_corner * side - 0.5).unbind(-1)
    return lookup(obstacles.heights, row, column) - eye[..., None, 2]


def landing_age(
    rain: Rain, fall: Falls, obstacles: Obstacles, eye: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch drops"]:
    """Age at which drops land [s]; `NEVER` for those that do not, 0 for those that began below the heights."""
    earliest = _on_heights(rain, fall, obstacles, eye)
    bodies = (obstacles.body - eye[..., None, :], obstacles.body_velocity)
    each = zip(*(one.unbind(-2) for one in bodies), obstacles.body_radius.unbind(-1), strict=True)
    for centre, moving, radius in each:
        earliest = torch.minimum(earliest, _on_body(fall, centre, moving, radius))
    return earliest


def level_share(
    rain: Rain, obstacles: Obstacles, eye: Float[Tensor, "*batch 3"], there: Float[Tensor, "*batch drops 3"]
) -> Float[Tensor, "*batch drops"]:
    """Share of a splash that there is on the slope of the map: all up to a gradient of 1, none from 2 on."""
    half = rain.depth_map_radius / torch.tensor(obstacles.heights.shape).to(there)
    square = torch.zeros_like(there[..., 2])
    for axis in (0, 1):
        # Half a cell to either side, so that edges between cells are as steep as they are anywhere.
        step = half[axis] * torch.eye(3).to(there)[axis]
        rise = height_under(rain, obstacles, eye, there + step) - height_under(rain, obstacles, eye, there - step)
        gradient = rise / (2.0 * half[axis])
        square = square + gradient * gradient
    return 1.0 - smooth_rise(safe_sqrt(square) - 1.0, torch.ones_like(square))


def _on_heights(rain: Rain, fall: Falls, obstacles: Obstacles, eye: Tensor) -> Tensor:
    known, still = obstacles.heights.detach(), _detached(fall)
    top, bottom = (end - eye.detach()[..., None, 2] for end in (known.amax(), known.amin()))

    def above(level: Tensor) -> Tensor:
        """Height over the map where paths pass a level; there may be an axis of levels before all others."""
        there = place(still, _age_at(still, level))
        under = height_under(rain, obstacles, eye.expand(*level.shape[:-1], 3), there)
        return (torch.minimum(level, still.start[..., 2]) - under).detach()

    high, low = _bracket(above, top, bottom, fall.age)
    first, last, over, below = _age_at(still, high), _age_at(still, low), above(high), above(low)
    crosses = over > below
    share = torch.where(crosses, over, 0.0) / torch.where(crosses, over - below, 1.0)
    age = first + (last - first) * share.clamp(0.0, 1.0)
    # One step of Newton's method from the secant's end: its gradient is that of the age, on level ground too.
    there = place(fall, age)
    left = there[..., 2] - height_under(rain, obstacles, eye, there)
    aside = still.velocity * still.velocity.new_tensor([NEARBY, NEARBY, 0.0])
    before, after = (height_under(rain, obstacles, eye, there.detach() + side * aside).detach() for side in (-1.0, 1.0))
    sinks = still.gravity * age - still.velocity[..., 2] + (after - before) / (2.0 * NEARBY)
    sinking = sinks > 0.0
    return torch.relu(age + torch.where(sinking, left, 0.0) / torch.where(sinking, sinks, 1.0))


def _bracket(above: Callable[[Tensor], Tensor], top: Tensor, bottom: Tensor, like: Tensor) -> tuple[Tensor, Tensor]:
    """Levels between which a path first comes below the map: one where it is over it, one where it is not."""
    shares = torch.arange(LEVELS, device=like.device).to(like) / (LEVELS - 1)
    shares = shares.reshape(LEVELS, *[1] * like.ndim)
    levels = (top + shares * (bottom - top)).expand(LEVELS, *like.shape)
    passed = (above(levels) > 0.0).long().cumprod(0).sum(0, keepdim=True)
    high, low = (levels.gather(0, index.clamp(0, LEVELS - 1))[0] for index in (passed - 1, passed))
    for _ in range(HALVINGS):
        middle = 0.5 * (high + low)
        is_over = above(middle) > 0.0
        high, low = torch.where(is_over, middle, high), torch.where(is_over, low, middle)
    return high, low


def _detached(fall: Falls) -> Falls:
    return replace(fall, **{name: value.detach() for name, value in vars(fall).items()})


def _age_at(fall: Falls, level: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Age at which drops fall through a level [s]: 0 where they began below it, `NEVER` where they hang still."""
    drop = torch.relu(fall.start[..., 2] - level)
    speed = -fall.velocity[..., 2]
    # Twice the mean speed; a quotient, for the root's own formula cancels where gravity is weak.
    speeds = speed + safe_sqrt(speed * speed + 2.0 * fall.gravity * drop)
    falls_at_all = speeds > 0.0
    age = 2.0 * drop / torch.where(falls_at_all, speeds, torch.ones_like(speeds))
    return torch.where(falls_at_all, age, NEVER * (drop > 0.0).to(drop)).clamp(max=NEVER)


def _on_body(fall: Falls, centre: Tensor, moving: Tensor, radius: Tensor) -> Float[Tensor, "*batch drops"]:
    """Age at which drops meet a sphere, along tangents of their paths: at its height, then where that one met it."""
    age = _age_at(fall, centre[..., None, 2])
    for _ in range(TANGENTS):
        offset = place(fall, age) - (centre[..., None, :] - moving[..., None, :] * (fall.age - age)[..., None])
        level = torch.zeros_like(age)
        down = torch.stack([level, level, -fall.gravity * age], -1)
        speed = fall.velocity + down - moving[..., None, :]
        along, square = (offset * speed).sum(-1), (speed * speed).sum(-1)
        inside = along * along - square * ((offset * offset).sum(-1) - (radius * radius)[..., None])
        meets = (inside > 0.0) & (square > 0.0)
        met = age - (along + safe_sqrt(inside)) / torch.where(meets, square, torch.ones_like(square))
        age = torch.where(meets, met, age)
    return torch.where(meets & (met >= 0.0), met, torch.full_like(met, NEVER))
