"""Rain by brute force: round drops at many instants of the exposure, seen through many places of every pixel's filter.

Where a drop lands is looked for at every quarter of a millisecond of its path. Nothing but the dice, the light
and the shares in which drops are there is shared with `rain`.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import smooth_rise
from diffrender.weather.rain_drops import Falls, Rain, falls
from diffrender.weather.rain_landing import height_under, level_share
from diffrender.weather.rain_splashes import SPLASH, leaps, shrunk, sides
from diffrender.weather.rain_streaks import CLEAR, DARKEST, FILTER, SOFT, WHOLE
from diffrender.weather.rain_tiles import Screen
from diffrender.weather.rain_view import RainView

_STEP = 2.5e-4  # in which paths are looked at [s]
_INSTANTS = 16
_PLACES = 12  # across a pixel's filter, and as many down
_MOVES = (0.7548777, 0.5698403)  # of the places from instant to instant, which fill the filter evenly
_REACH = 3.5  # of the filter [standard deviations]


def instants(rain: Rain, view: RainView) -> Float[Tensor, "*batch height width 3"]:
    """Mean of pictures of rain that stands still [W/(m² sr)]."""
    fall = falls(rain, view.drops, view.moment)
    landed = _landed(rain, fall, view)
    passed = torch.zeros_like(view.screen.distance)
    for number in range(_INSTANTS):
        before = view.moment.exposure[..., None] * ((number + 0.5) / _INSTANTS)
        places = _filter(view.screen, number)
        passed = passed + _passed(view, places, *_seen(rain, fall, view, landed, before)) / _INSTANTS
    passed = passed ** view.drop_number[..., None, None]
    return view.light + (view.background - view.light) * passed[..., None]


def _at(fall: Falls, age: Tensor) -> Tensor:
    """Places at an age; drops may have a further axis, for ages."""
    ages = age[..., None]
    start, velocity = (
        one.reshape(*one.shape[:-1], *[1] * (age.ndim - one.ndim + 1), 3) for one in (fall.start, fall.velocity)
    )
    pull = torch.stack([torch.zeros_like(fall.gravity)] * 2 + [-fall.gravity], -1)
    return start + velocity * ages + 0.5 * pull * ages * ages


def _landed(rain: Rain, fall: Falls, view: RainView) -> Float[Tensor, "*batch drops"]:
    """Age at which drops are first found below the heights or within a body; infinite where they are not."""
    ages = torch.arange(0.0, float(fall.age.max()) + _STEP, _STEP).to(fall.age)
    there = _at(fall, ages.expand(*fall.age.shape, -1))
    eye, obstacles = view.moment.eye, view.obstacles
    flat = there.flatten(-3, -2)
    hit = flat[..., 2] < height_under(rain, obstacles, eye, flat)
    hit = hit.reshape(there.shape[:-1])
    for number in range(obstacles.body.shape[-2]):
        then = (ages - fall.age[..., None])[..., None]
        centre, moving = (one[..., None, None, number, :] for one in (obstacles.body, obstacles.body_velocity))
        from_centre = there + eye[..., None, None, :] - centre - moving * then
        hit = hit | (torch.linalg.vector_norm(from_centre, dim=-1) < obstacles.body_radius[..., None, None, number])
    first = hit.long().cumsum(-1).eq(0).sum(-1)
    return torch.where(hit.any(-1), first * _STEP, math.inf)


def _seen(rain: Rain, fall: Falls, view: RainView, landed: Tensor, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Places relative to the eye, sizes and weights of all drops and droplets some time before the shutter closed."""
    age = fall.age - before
    radius = view.drop_radius[..., None].expand_as(age)
    back = (view.moment.velocity * before)[..., None, :]
    drop = _at(fall, age) + back, radius, fall.weight * ((age >= 0.0) & (age <= landed))
    since = age - landed
    splashes = (since > 0.0) & (since < SPLASH)
    since = torch.where(splashes, since, torch.zeros_like(since))[..., None]
    ground = _at(fall, torch.where(splashes, landed, age))
    level = level_share(rain, view.obstacles, view.moment.eye, ground)
    ground = (ground + back)[..., None, :]
    leap = leaps(view.drops) * since[..., None] + sides(view.drops) * radius[..., None, None]
    down = 0.5 * fall.gravity * since * since
    droplet = ground + leap - torch.stack([torch.zeros_like(down), torch.zeros_like(down), down], -1)
    small = (radius[..., None] * shrunk(since)).expand(droplet.shape[:-1])
    weight = (fall.weight * level * splashes)[..., None].expand(droplet.shape[:-1])
    return (
        torch.cat([drop[0], droplet.flatten(-3, -2)], -2),
        torch.cat([drop[1], small.flatten(-2)], -1),
        torch.cat([drop[2], weight.flatten(-2)], -1),
    )


def _passed(
    view: RainView, places: tuple[Tensor, Tensor], there: Tensor, radius: Tensor, weight: Tensor
) -> Float[Tensor, "*batch height width"]:
    """Share of each pixel's light that passes between round drops at rest."""
    screen, (towards, share) = view.screen, places
    far = torch.linalg.vector_norm(there, dim=-1)
    weight = DARKEST * weight * smooth_rise(far - CLEAR, far.new_tensor(WHOLE - CLEAR))
    flat = towards.flatten(-4, -2)
    depth = flat @ there.mT
    beside = (far * far)[..., None, :] - depth * depth
    meets = (depth > 0.0) & (beside < (radius * radius)[..., None, :])
    distance = screen.distance[..., None].expand(towards.shape[:-1]).flatten(-3)
    hidden = weight[..., None, :] * meets * smooth_rise(distance[..., None] + SOFT - depth, depth.new_tensor(SOFT))
    passed = (1.0 - hidden).prod(-1).reshape(towards.shape[:-1])
    mean: Tensor = (passed * share).sum(-1)
    return mean


def _filter(
    screen: Screen, number: int
) -> tuple[Float[Tensor, "*batch height width places 3"], Float[Tensor, " places"]]:
    """Directions in each pixel's filter, and their weights; of each instant others, between those of the rest."""
    ahead = screen.direction
    aside = torch.linalg.cross(ahead, ahead.roll(1, -1) + ahead.new_tensor([0.3, 0.1, 0.2]))
    aside = aside / torch.linalg.vector_norm(aside, dim=-1, keepdim=True)
    below = torch.linalg.cross(ahead, aside)
    steps = [
        _REACH * (2.0 * (torch.arange(_PLACES).to(ahead) + number * move % 1.0) / _PLACES - 1.0) for move in _MOVES
    ]
    x, y = torch.cartesian_prod(*steps).unbind(-1)
    weight = torch.exp(-0.5 * (x * x + y * y))
    wide = (FILTER * screen.pixel)[..., None, None, None, None]
    offset = x[:, None] * aside[..., None, :] + y[:, None] * below[..., None, :]
    towards = ahead[..., None, :] + wide * offset
    return towards / torch.linalg.vector_norm(towards, dim=-1, keepdim=True), weight / weight.sum()
