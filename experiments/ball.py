"""A ball that fills a picture, as materials are shown on."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.rays import from_angles
from diffrender.surfaces import EvenSky, Lights

EYE_PITCH = 0.25  # downwards [rad]
RADIUS = 0.94  # of the ball, in half of the picture's height


@dataclass(frozen=True)
class Ball:
    """Which pixels show the ball, and of those the unit normals and directions to the eye."""

    shown: Bool[Tensor, "height width"]
    normal: Float[Tensor, "pixels 3"]
    to_eye: Float[Tensor, "pixels 3"]


def ball(width: int, height: int) -> Ball:
    """A ball seen from afar and a little above."""
    x, y = (torch.arange(count, dtype=torch.float64) + 0.5 for count in (width, height))
    left, up = torch.meshgrid(0.5 * width - x, 0.5 * height - y, indexing="xy")
    left, up = (2.0 * one / (RADIUS * height) for one in (left, up))
    shown = left.square() + up.square() < 1.0
    left, up = left[shown], up[shown]
    near = torch.sqrt(1.0 - left.square() - up.square())
    forward = from_angles(*left.new_tensor([[-EYE_PITCH], [0.0]]))[0]
    sideways = forward.new_tensor((0.0, 1.0, 0.0))
    upwards = torch.linalg.cross(forward, sideways)
    normal = left[:, None] * sideways + up[:, None] * upwards - near[:, None] * forward
    return Ball(shown, normal, (-forward).expand_as(normal))


def studio() -> Lights:
    """A key light from the left above, a rim light from behind at the right, and a soft sky."""
    angles = torch.tensor([[42.0, 145.0], [18.0, -38.0]], dtype=torch.float64).deg2rad()
    irradiance = torch.tensor([[3.2, 3.0, 2.7], [1.4, 1.6, 2.0]], dtype=torch.float64)
    sky = EvenSky(irradiance.new_tensor((0.22, 0.26, 0.32)), irradiance.new_tensor((0.18, 0.22, 0.26)))
    return Lights(from_angles(*angles.unbind(-1)), irradiance, sky)
