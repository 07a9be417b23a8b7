"""Small pictures of rain with its hard cases: at a pixel's centre, behind the camera, at rest, landing, sheltered.

Drops are huge and pixels coarse, so that a dozen of each fill the pictures.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.parameters import defaults
from diffrender.rays import Perspective, pixel_centres
from diffrender.weather.rain_drops import Drops, Moment, Rain, enough, falls, place, thrown
from diffrender.weather.rain_landing import Obstacles, heights_from_above, landing_age
from diffrender.weather.rain_splashes import SPLASH
from diffrender.weather.rain_tiles import Screen
from diffrender.weather.rain_view import RainView

_WIDTH, _HEIGHT, _FIELD = 6, 4, 0.5
# Pitch [rad]; velocity of the eye along x, wind along x and y [m/s]; time and exposure [s].
_MOMENTS = (
    (0.0, 0.0, 0.0, 0.0, 0.31, 0.01),
    (0.2, 12.0, 6.0, 3.0, 7.9, 0.02),
    (-0.3, 0.0, -4.0, 2.0, 1.3, 0.05),
    (-0.3, -3.0, 2.0, 8.0, 2.2, 0.0),  # drops at rest
    (1.2, 1.0, 1.0, 0.0, 5.7, 0.01),  # nearly along the streaks
)
_EYE = (0.0, 0.0, 1.7)
_TRIED, _NEAREST = 6000, 2.0  # drops, and how near the nearest may be [m]
_IN_VIEW = 0.97  # cosine of the angle to the middle of a picture
_SIZE = 0.1  # radius of the drops [m]


def example_inputs(dtype: torch.dtype) -> RainView:
    """Level, tilted up and down in wind, at rest and moving, over ground with a step and two moving bodies."""
    numbers = torch.tensor(_MOMENTS, dtype=torch.float64)
    moment = _moment(numbers)
    cameras = [Perspective(_WIDTH, _HEIGHT, _FIELD, float(pitch)) for pitch in numbers[:, 0]]
    direction = torch.stack([one.direction(*pixel_centres(one, slice(None), numbers)) for one in cameras])
    obstacles = _obstacles()
    drops = _drops_in_view(moment, obstacles, direction.mean((1, 2)))
    # One of the pixels looks at the middle of a streak.
    fall = falls(defaults(Rain, torch.float64), drops, moment)
    middle = place(fall, fall.age - 0.5 * moment.exposure[:, None])[0, 0]
    direction[0, 1, 3] = middle / middle.norm()
    down = -direction[..., 2]
    distance = torch.where(down > 0.0, _EYE[2] / down.clamp(min=1e-6), torch.full_like(down, math.inf))
    shade = torch.linspace(0.01, 0.03, direction[..., 0].numel(), dtype=torch.float64).reshape(down.shape)
    colour = torch.tensor([0.8, 1.0, 1.2], dtype=torch.float64)
    view = RainView(
        drops=drops,
        obstacles=obstacles,
        moment=moment,
        drop_radius=torch.tensor(_SIZE, dtype=torch.float64),
        drop_number=torch.tensor(1.5, dtype=torch.float64),
        screen=Screen(direction, distance, torch.tensor(_FIELD / _WIDTH, dtype=torch.float64)),
        background=shade[..., None] * colour,
        light=colour.expand(1, 1, 3),
    )
    converted: RainView = pytree.tree_map_only(Tensor, lambda tensor: tensor.to(dtype), view)
    return converted


def _moment(numbers: Float[Tensor, "moments 6"]) -> Moment:
    _, ahead, wind_x, wind_y, time, exposure = numbers.unbind(-1)
    still = torch.zeros_like(ahead)
    eye = numbers.new_tensor(_EYE).expand(len(numbers), 3)
    return Moment(
        eye=eye,
        velocity=torch.stack([ahead, still, still], -1),
        emitter=eye[0],
        time=time,
        exposure=exposure,
        wind=torch.stack([wind_x, wind_y, still], -1),
    )


def _drops_in_view(moment: Moment, obstacles: Obstacles, towards: Float[Tensor, "moments 3"]) -> Drops:
    """Of many drops the two nearest before each camera, in the air or just landed, and two behind the first."""
    rain = defaults(Rain, torch.float64)
    drops = thrown(_TRIED, torch.Generator().manual_seed(0), torch.float64)
    fall = falls(rain, drops, moment)
    landed = landing_age(rain, fall, obstacles, moment.eye)
    there = place(fall, torch.minimum(fall.age, landed))
    far = torch.linalg.vector_norm(there, dim=-1)
    cosine = (there @ towards[..., None])[..., 0] / far / torch.linalg.vector_norm(towards, dim=-1, keepdim=True)
    # Of a crown that is too young, the droplets hide each other.
    is_there = (fall.age < landed) | ((fall.age - landed - 0.5 * SPLASH).abs() < 0.25 * SPLASH)
    near = fall.weight * torch.exp(-0.2 * far) * (far > _NEAREST) * is_there
    before, behind = (near * (sign * cosine > _IN_VIEW) for sign in (1.0, -1.0))
    best = [*before.topk(2, -1).indices.flatten().tolist(), *behind[0].topk(2).indices.tolist()]
    ranks = torch.linspace(0.5, 0.9 * float(enough(rain)), len(best), dtype=torch.float64)
    return Drops(drops.chance[best], ranks)


def _obstacles() -> Obstacles:
    """A step in the ground to the left, and a sphere that comes and one that goes."""
    centre = torch.tensor([1.0, -2.0], dtype=torch.float64)
    heights = heights_from_above(_ground, centre, torch.tensor(100.0, dtype=torch.float64), 24)
    bodies = torch.tensor([[6.0, 1.0, 1.0], [9.0, -2.0, 1.5]], dtype=torch.float64)
    moving = torch.tensor([[-1.0, 0.0, 0.0], [2.0, 0.5, 0.0]], dtype=torch.float64)
    return Obstacles(heights, centre, bodies, moving, torch.tensor([1.0, 1.5], dtype=torch.float64))


def _ground(place: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch"]:
    return 0.3 * torch.sin(0.05 * place[..., 0]) + 3.0 * (place[..., 1] > 12.0)
