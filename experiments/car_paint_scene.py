"""A painted ball to see car paint on, so wide that flakes show, in a low sun, a lamp behind it and an even sky."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.rays import Perspective, from_angles, pixel_centres
from diffrender.shading.painted_surface import CarPaintView
from diffrender.surfaces import EvenSky, Lights

RADIUS = 0.12  # of the ball [m]
DISTANCE = 0.5  # of its middle from the eye [m]
WIDE = 0.72  # field of view [rad]


def picture_view(width: int, height: int) -> CarPaintView:
    """The ball; pixels beside it see its rim."""
    direction, depth, _ = _met(width, height)
    position = direction * depth[..., None]
    normal = position - position.new_tensor((DISTANCE, 0.0, 0.0))
    normal = normal / torch.linalg.vector_norm(normal, dim=-1, keepdim=True)
    # Longitude and height on the ball from its top down, as long as on its side.
    turn = torch.atan2(normal[..., 1], -normal[..., 0])
    tangent = torch.stack([torch.sin(turn), torch.cos(turn), torch.zeros_like(turn)], -1)
    facing = -(direction * normal).sum(-1)
    return CarPaintView(
        normal=normal,
        to_eye=-direction,
        tangent=tangent,
        place=RADIUS * torch.stack([turn, torch.asin(normal[..., 2])], -1),
        # Of a pixel's sides across and along the slant: their geometric mean.
        footprint=depth * (2.0 * math.tan(0.5 * WIDE) / width) / facing.clamp(min=0.05).sqrt(),
        lights=lights(direction),
    )


def is_ball(width: int, height: int) -> Bool[Tensor, "{height} {width}"]:
    """Which pixels show the ball and not what is beside it."""
    return _met(width, height)[2]


def lights(like: Float[Tensor, "*batch 3"]) -> Lights:
    """A sun over the eye's left shoulder, a cold lamp from behind on the right, and a sky."""
    elevation, azimuth = torch.deg2rad(like.new_tensor([[42.0, 14.0], [145.0, -48.0]]))
    irradiance = like.new_tensor([(3.2, 2.9, 2.5), (1.2, 1.5, 1.9)])
    sky = EvenSky(like.new_tensor((0.28, 0.3, 0.34)), like.new_tensor((0.22, 0.25, 0.28)))
    return Lights(from_angles(elevation, azimuth), irradiance, sky)


def _met(width: int, height: int) -> tuple[Tensor, Tensor, Tensor]:
    """Directions of all pixels, how far along them the ball is, and whether it is met; else where it is nearest."""
    camera = Perspective(width, height, WIDE)
    direction = camera.direction(*pixel_centres(camera, slice(None), torch.zeros((), dtype=torch.float64)))
    along = direction[..., 0] * DISTANCE
    under = along.square() - (DISTANCE**2 - RADIUS**2)
    return direction, along - under.clamp(min=0.0).sqrt(), under > 0.0
