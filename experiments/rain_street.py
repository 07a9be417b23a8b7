"""A street for rain to fall on: houses, a shelter, two people; its picture without rain, its distances and heights."""

import math
from dataclasses import dataclass, replace
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import defaults
from diffrender.rays import Perspective, pixel_centres
from diffrender.weather.rain_drops import Drops, Moment, Rain, thrown
from diffrender.weather.rain_landing import Obstacles, heights_from_above
from diffrender.weather.rain_tiles import Screen
from diffrender.weather.rain_view import RainView

EYE = (0.0, 0.0, 1.7)
FIELD = math.radians(62.0)
PITCH = 0.06
CENTRE, MAP_SIZE = (20.0, 0.0), 768  # of the map from above [m], and cells on a side of it
ZENITH, HORIZON = (0.50, 0.56, 0.64), (0.20, 0.23, 0.27)  # radiance of an overcast sky

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """Walls along the axes, of one reflectance."""

    low: Place
    high: Place
    colour: Place


SHELTER = Box((6.5, -4.6, 2.5), (11.0, -1.4, 2.65), (0.30, 0.32, 0.36))
_POST = (0.16, 0.17, 0.18)
BOXES = (
    Box((3.0, 6.0, 0.0), (22.0, 14.0, 8.0), (0.20, 0.13, 0.11)),
    Box((25.0, 5.0, 0.0), (48.0, 14.0, 11.0), (0.15, 0.15, 0.17)),
    Box((14.0, -18.0, 0.0), (40.0, -7.0, 9.0), (0.13, 0.14, 0.13)),
    Box((60.0, -30.0, 0.0), (75.0, 25.0, 16.0), (0.16, 0.16, 0.18)),
    SHELTER,
    *(Box((x, y, 0.0), (x + 0.1, y + 0.1, 2.5), _POST) for x in (6.6, 10.8) for y in (-4.5, -1.6)),
)


@dataclass(frozen=True)
class Person:
    """A standing capsule."""

    x: float
    y: float
    radius: float
    height: float
    colour: Place


PEOPLE = (Person(8.6, -3.0, 0.24, 1.75, (0.35, 0.10, 0.08)), Person(6.0, 1.3, 0.26, 1.8, (0.10, 0.14, 0.24)))
_SPHERES = 6  # that a person is to rain


def surface(place: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch"]:
    """Altitude of what is seen from above [m]."""
    top = torch.zeros_like(place[..., 0])
    for box in BOXES:
        low, high = (place.new_tensor(corner[:2]) for corner in (box.low, box.high))
        inside = ((place >= low) & (place <= high)).all(-1)
        top = torch.where(inside & (top < box.high[2]), box.high[2], top)
    return top


def obstacles(radius: Tensor, size: int = MAP_SIZE) -> Obstacles:
    """What rain meets in the street."""
    spheres = [
        (person.x, person.y, person.radius + step * (person.height - 2.0 * person.radius) / (_SPHERES - 1))
        for person in PEOPLE
        for step in range(_SPHERES)
    ]
    sizes = torch.tensor([person.radius for person in PEOPLE for _ in range(_SPHERES)])
    bodies = torch.tensor(spheres)
    return Obstacles(_heights(float(radius), size), torch.tensor(CENTRE), bodies, torch.zeros_like(bodies), sizes)


@cache
def _heights(radius: float, size: int) -> Tensor:
    return heights_from_above(surface, torch.tensor(CENTRE), torch.tensor(radius), size)


@dataclass(frozen=True)
class Seen:
    """The street without rain."""

    screen: Screen
    background: Float[Tensor, "height width 3"]
    light: Float[Tensor, "height width 3"]  # on drops


def rain_view(
    rain: Rain, drops: Drops, size: tuple[int, int], moment: Moment, what_falls: tuple[float, float]
) -> RainView:
    """The street in rain, in a picture so wide and high; of what falls, the radius [m] and how many one stands for."""
    seen = street(*size, moment.eye)
    radius, number = (moment.eye.new_tensor(one) for one in what_falls)
    return RainView(drops, obstacles(rain.depth_map_radius), moment, radius, number, *vars(seen).values())


def hard_views() -> dict[str, RainView]:
    """Small pictures of the street with more streaks than a tile has: a storm, a fast camera and no exposure."""
    rain, eye = defaults(Rain), torch.tensor(EYE)
    drops = thrown(300, torch.Generator().manual_seed(0), torch.float32)
    found = {}
    for name, wind, speed, exposure in (
        ("storm", 20.0, 0.0, 0.02),
        ("fast", 0.0, 30.0, 0.02),
        ("at rest", 0.0, 0.0, 0.0),
    ):
        moment = Moment(
            eye=eye,
            velocity=torch.tensor([speed, 0.0, 0.0]),
            emitter=eye,
            time=torch.tensor(4.2),
            exposure=torch.tensor(exposure),
            wind=torch.tensor([0.0, wind, 0.0]),
        )
        view = rain_view(rain, drops, (20, 12), moment, (0.01, 30.0))
        found[name] = replace(view, obstacles=obstacles(rain.depth_map_radius, size=64))
    return found


def street(width: int, height: int, eye: Tensor) -> Seen:
    """The street from an eye, under an overcast sky."""
    camera = Perspective(width, height, FIELD, PITCH)
    direction = camera.direction(*pixel_centres(camera, slice(None), eye))
    distance, colour = _ground(direction, eye)
    for box in BOXES:
        distance, colour = _nearer(distance, colour, *_box(box, direction, eye))
    for person in PEOPLE:
        distance, colour = _nearer(distance, colour, *_person(person, direction, eye))
    sky = _sky(direction)
    # The veil of rain beyond the drops that are drawn: half of the light is lost in 150 m.
    veil = torch.exp(-distance.clamp(max=1e4) * (math.log(2.0) / 150.0))[..., None]
    haze = eye.new_tensor(HORIZON)
    background = torch.where(distance[..., None].isinf(), sky, haze + (colour - haze) * veil)
    light = 0.7 * eye.new_tensor(ZENITH) + 0.3 * _blurred(background)
    return Seen(Screen(direction, distance, eye.new_tensor(FIELD / width)), background, light)


def _sky(direction: Tensor) -> Tensor:
    up = direction[..., 2:].clamp(0.0, 1.0)
    return direction.new_tensor(HORIZON) + (direction.new_tensor(ZENITH) - direction.new_tensor(HORIZON)) * up


def _blurred(picture: Tensor) -> Tensor:
    """Mean over a quarter of the picture's width round each pixel."""
    planes, side = picture.movedim(-1, 0)[None], 2 * (picture.shape[1] // 8) + 1
    for axis in (0, 1):
        window = (side, 1) if axis else (1, side)
        margin = (0, 0, side // 2, side // 2) if axis else (side // 2, side // 2, 0, 0)
        planes = torch.nn.functional.avg_pool2d(
            torch.nn.functional.pad(planes, margin, mode="replicate"), window, stride=1
        )
    return planes[0].movedim(0, -1)


def _nearer(distance: Tensor, colour: Tensor, other: Tensor, its: Tensor) -> tuple[Tensor, Tensor]:
    is_nearer = other < distance
    return torch.where(is_nearer, other, distance), torch.where(is_nearer[..., None], its, colour)


def _ground(direction: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
    """Wet asphalt with paving, dry and lighter where something is above it; it mirrors the sky at a glance."""
    down = -direction[..., 2]
    distance = torch.where(down > 0.0, eye[2] / down.clamp(min=1e-6), torch.inf)
    place = eye[:2] + direction[..., :2] * distance.clamp(max=1e3)[..., None]
    dry = (surface(place) > 0.0)[..., None]
    slabs = ((torch.remainder(place, 1.5) < 0.04).any(-1) & (place[..., 1].abs() > 3.0))[..., None]
    albedo = torch.where(dry, direction.new_tensor([0.17, 0.16, 0.15]), direction.new_tensor([0.05, 0.05, 0.055]))
    albedo = torch.where(slabs, 0.6 * albedo, albedo)
    mirror = (0.02 + 0.98 * (1.0 - down.clamp(0.0, 1.0)) ** 5)[..., None] * torch.where(dry, 0.0, 0.5)
    return distance, 0.6 * albedo + mirror * direction.new_tensor(HORIZON)


def _box(box: Box, direction: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
    low, high = (direction.new_tensor(corner) for corner in (box.low, box.high))
    ends = torch.stack([low - eye, high - eye], -1)[..., :] / torch.where(direction == 0.0, 1e-9, direction)[..., None]
    first, last = ends.amin(-1), ends.amax(-1)
    enters, axis = first.max(-1)
    meets = (enters < last.amin(-1)) & (enters > 0.0)
    distance = torch.where(meets, enters, torch.inf)
    place = eye + direction * enters.clamp(0.0, 1e3)[..., None]
    # The underside is dark, fronts get less light than tops.
    light = direction.new_tensor([0.42, 0.5, 0.25])[axis][..., None]
    along = torch.where(axis == 0, place[..., 1], place[..., 0])
    is_tall = box.high[2] > 5.0
    windows = (torch.remainder(along, 2.4) > 1.3) & (torch.remainder(place[..., 2], 2.9) > 1.2) & (axis < 2) & is_tall
    colour = torch.where(windows[..., None], direction.new_tensor([0.05, 0.06, 0.07]), direction.new_tensor(box.colour))
    return distance, colour * light


def _person(person: Person, direction: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest of a cylinder and the spheres at its ends."""
    from_axis = eye - eye.new_tensor([person.x, person.y, 0.0])
    low, high = person.radius, person.height - person.radius
    flat = direction[..., :2]
    reached = _met(flat, from_axis[:2].expand_as(flat), person.radius)
    altitude = eye[2] + direction[..., 2] * reached
    distance = torch.where((altitude > low) & (altitude < high), reached, torch.inf)
    for middle in (low, high):
        offset = (from_axis - eye.new_tensor([0.0, 0.0, middle])).expand_as(direction)
        distance = torch.minimum(distance, _met(direction, offset, person.radius))
    place = eye + direction * distance.clamp(max=1e3)[..., None]
    lit = 0.25 + 0.35 * ((place[..., 2] - middle) / person.radius).clamp(0.0, 1.0)
    skin = direction.new_tensor([0.45, 0.33, 0.27])
    is_head = place[..., 2] > person.height - 0.32
    colour = torch.where(is_head[..., None], skin, direction.new_tensor(person.colour))
    return distance, colour * lit[..., None]


def _met(direction: Tensor, offset: Tensor, radius: float) -> Tensor:
    """Distance to a circle or a sphere round the origin."""
    square, along = (direction * direction).sum(-1), (direction * offset).sum(-1)
    inside = along * along - square * ((offset * offset).sum(-1) - radius * radius)
    first = (-along - inside.clamp(min=0.0).sqrt()) / square
    return torch.where((inside > 0.0) & (first > 0.0), first, torch.inf)
