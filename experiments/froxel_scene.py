"""A hall of posts under a roof with holes, as froxel fog is shown and measured in: distances, light and shadow."""

import math
from dataclasses import dataclass, replace
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.atmosphere import froxel_grid, froxel_lights
from diffrender.atmosphere.froxel_grid import Eye, Grid
from diffrender.atmosphere.froxel_lights import Lights, LocalLights, Shadow, Sunlight
from diffrender.atmosphere.froxel_shadow import light_box, percentage_closer
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.atmosphere.volumes import repeating_noise
from diffrender.rays import from_angles
from diffrender.weather import wind
from diffrender.weather.drawn_curve import DrawnCurve
from diffrender.weather.wind import Wave

EYE = (0.0, 0.0, 1.7)
SUN = (math.radians(40.0), math.radians(20.0))  # elevation, azimuth: ahead to the left
IRRADIANCE, SKY, ROOM = (26.0, 22.0, 16.0), (2.2, 2.7, 3.4), (0.045, 0.055, 0.07)  # sun, sky, light from all around
ROOF, WALL, SIDE = 12.0, 70.0, 14.0  # height of the roof, distances of the walls [m]
POSTS = tuple((x, y) for x in (12.0, 24.0, 36.0, 48.0, 60.0) for y in (-8.0, 8.0))
POST_RADIUS = 0.55
HOLES, HOLE_RADIUS = (14.0, 9.0), 1.5  # their distances along and across, and their size [m]
BOX_CENTRE, BOX_WIDTH, BOX_DEPTH = (34.0, 0.0, 5.0), 46.0, 46.0
LAYERS, TEXELS, BLUR = 96, 384, 1
SHADOW_RISE = 1.0  # [m]
LAMP = (15.0, 2.5, 6.5)


@dataclass(frozen=True)
class Seen:
    """What a picture shows without fog: radiance, and distance from the eye [m]."""

    radiance: Float[Tensor, "height width 3"]
    distance: Float[Tensor, "height width"]


def eye() -> Eye:
    """A camera that looks down the hall, slightly up."""
    elevation, azimuth = torch.tensor([5.0, 2.0]).deg2rad()
    return froxel_grid.eye_at(torch.tensor(EYE), elevation, azimuth, torch.tensor([0.72, 0.72 * 9.0 / 16.0]))


def is_hole(position: Float[Tensor, "*batch 3"]) -> Tensor:
    """Whether the roof is open there: round holes in rows, every second row moved by half."""
    row = torch.floor(position[..., 0] / HOLES[0])
    across = position[..., 1] + 0.5 * HOLES[1] * torch.remainder(row, 2.0)
    from_row = torch.remainder(position[..., 0], HOLES[0]) - 0.5 * HOLES[0]
    from_column = torch.remainder(across, HOLES[1]) - 0.5 * HOLES[1]
    return torch.hypot(from_row, from_column) < HOLE_RADIUS


def sun() -> Sunlight:
    """The sun through the roof's holes, its shadow blurred."""
    to_sun = from_angles(torch.tensor(SUN[0]), torch.tensor(SUN[1]))
    box = light_box(to_sun, torch.tensor(BOX_CENTRE), BOX_WIDTH, BOX_DEPTH)
    middle = (torch.arange(TEXELS) + 0.5) / TEXELS
    row, column = torch.meshgrid(middle, middle, indexing="ij")
    first = torch.stack([torch.zeros_like(row), row, column], -1)
    begin = (first - box[:, 3]) @ torch.linalg.inv(box[:, :3]).mT
    # Above what is seen of the roof, whose underside would else be lit by the layers over it.
    down = (begin[..., 2] - (ROOF + SHADOW_RISE)) / to_sun[2]
    meets = begin - down[..., None] * to_sun
    depth = torch.where(is_hole(meets), torch.inf, down / (2.0 * BOX_DEPTH))
    shadow = Shadow(percentage_closer(depth, LAYERS, BLUR), box)
    return Sunlight(to_sun, torch.tensor(IRRADIANCE), shadow)


def lamps() -> LocalLights:
    """A spot that hangs between the posts and shines down and ahead, and a small round lamp by the wall."""
    down = torch.tensor([0.25, -0.12, -1.0])
    return LocalLights(
        position=torch.tensor([LAMP, (20.0, -5.5, 2.2)]),
        intensity=torch.tensor([[420.0, 360.0, 260.0], [9.0, 16.0, 26.0]]),
        size=torch.tensor([0.3, 0.25]),
        reach=torch.tensor([30.0, 14.0]),
        ahead=torch.stack([down / torch.linalg.vector_norm(down), torch.tensor([0.0, 0.0, -1.0])]),
        cos_edge=torch.tensor([math.cos(math.radians(27.0)), -2.0]),
        cos_full=torch.tensor([math.cos(math.radians(20.0)), -1.0]),
        share=torch.ones(2),
    )


def probe() -> Float[Tensor, "4 3"]:
    """Light from all around: of the hall's colour, a little more from above."""
    room = torch.tensor(ROOM) * math.sqrt(4.0 * math.pi)
    return torch.stack([room, 0.0 * room, 0.3 * room, 0.0 * room])


def breeze(seconds: float) -> Float[Tensor, "3"]:
    """How far a drawn wind has carried the noise: a steady draught to the right and gusts down the hall [m]."""
    still, gust = (DrawnCurve(*torch.tensor(pair)) for pair in (([0.0], [1.0]), ([0.0, 0.3, 0.5], [0.0, 1.0, 0.1])))
    right, ahead = torch.tensor([0.0, -1.0, 0.0]), torch.tensor([1.0, 0.0, 0.0])
    waves = [
        Wave(still, right, torch.tensor(1.2), torch.tensor(math.inf), torch.tensor(10.0)),
        Wave(gust, ahead, torch.tensor(0.8), torch.tensor(60.0), torch.tensor(6.0)),
    ]
    return wind.displacement(waves, torch.zeros(3), torch.tensor(seconds))


def seen(at: Eye, width: int, height: int, lights: Lights) -> Seen:
    """The hall without fog: the nearest of its surfaces, lit by the lights that there are."""
    direction, _ = froxel_grid.directions(at, height, width)
    distance, normal = _nearest(at.position, direction)
    position = at.position + distance[..., None] * direction
    is_open = (position[..., 2] > ROOF - 0.01) & is_hole(position)
    room = torch.full_like(position, 0.0) if lights.probe is None else torch.tensor(ROOM).expand_as(position)
    lit = room * math.pi
    if lights.sun is not None:
        assert lights.sun.shadow is not None
        # A step off the surface, which else shadows itself.
        share = froxel_lights.visibility(lights.sun.shadow, position + 0.3 * normal)
        facing = (normal * lights.sun.to_sun).sum(-1).clamp(min=0.0)
        lit = lit + (share * facing)[..., None] * lights.sun.irradiance
    if lights.local is not None:
        lit = lit + _lamplight(lights.local, position, normal)
    colour = torch.where(position[..., 2:] < 0.01, torch.tensor([0.16, 0.15, 0.13]), torch.tensor([0.34, 0.30, 0.26]))
    sky = torch.tensor(SKY) if lights.sun is not None else torch.zeros(3)
    radiance = torch.where(is_open[..., None], sky, colour * lit / math.pi)
    return Seen(radiance, torch.where(is_open, torch.inf, distance))


def _lamplight(lamps: LocalLights, position: Tensor, normal: Tensor) -> Tensor:
    total = torch.zeros_like(position)
    for number in range(len(lamps.size)):
        # An even phase function of 1/(4 pi) is light from all around: this is the irradiance of what faces the lamp.
        one = LocalLights(**{name: value[number : number + 1] for name, value in vars(lamps).items()})
        even = froxel_lights.of_local(one, torch.tensor(0.0), position, normal) * (4.0 * math.pi)
        towards = lamps.position[number] - position
        facing = (towards * normal).sum(-1) / torch.linalg.vector_norm(towards, dim=-1)
        total = total + even * facing.clamp(min=0.0)[..., None]
    return total


def _nearest(origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Distance to the hall's surfaces, and the normal of the nearest."""
    planes = ((2, 0.0, 1.0), (2, ROOF, -1.0), (0, WALL, -1.0), (1, SIDE, -1.0), (1, -SIDE, 1.0))
    distance = torch.full_like(direction[..., 0], 1e6)
    normal = torch.zeros_like(direction)
    for axis, place, facing in planes:
        ahead = (place - origin[axis]) / direction[..., axis]
        is_nearer = (ahead > 0.0) & (ahead < distance)
        distance = torch.where(is_nearer, ahead, distance)
        across = torch.zeros(3)
        across[axis] = facing
        normal = torch.where(is_nearer[..., None], across, normal)
    level = direction[..., :2]
    square = (level * level).sum(-1)
    for x, y in POSTS:
        away = origin[:2] - torch.tensor([x, y])
        half = (level * away).sum(-1)
        rest = half * half - square * ((away * away).sum() - POST_RADIUS**2)
        ahead = (-half - torch.sqrt(rest.clamp(min=0.0))) / square
        is_nearer = (rest > 0.0) & (ahead > 0.0) & (ahead < distance)
        distance = torch.where(is_nearer, ahead, distance)
        out = (away + ahead[..., None] * level) / POST_RADIUS
        normal = torch.where(is_nearer[..., None], torch.cat([out, torch.zeros_like(out[..., :1])], -1), normal)
    return distance, normal


@cache
def noise() -> Float[Tensor, "32 32 32"]:
    """Noise of the hall's fog."""
    return repeating_noise(32, torch.Generator().manual_seed(0)).float()


def frame(width: int, height: int, lights: Lights, seconds: float = 0.0, grid: Grid | None = None) -> FroxelView:
    """One frame of the hall under some of its lights, the noise moved by so long a wind."""
    shown = seen(eye(), width, height, lights)
    return FroxelView(grid or Grid(), eye(), shown.radiance, shown.distance, lights, noise(), breeze(seconds))


def still(one: FroxelView, count: int) -> FroxelView:
    """A sequence of so many frames in which nothing moves."""

    def often(tensor: Tensor) -> Tensor:
        return tensor.expand(count, *tensor.shape)

    moving = (one.eye, one.background, one.distance, one.lights, one.displacement)
    around, background, distance, lights, displacement = pytree.tree_map_only(Tensor, often, moving)
    return replace(one, eye=around, background=background, distance=distance, lights=lights, displacement=displacement)
