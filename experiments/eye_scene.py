"""An eye that looks past the camera, to see eyes on: a ball with a bulging cornea under a sun and an even sky."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.rays import Perspective, from_angles, pixel_centres
from diffrender.shading import eye_ball
from diffrender.shading.eye_ball import CORNEA, EyeView
from diffrender.surfaces import EvenSky, Lights

DISTANCE = 6.0  # of the eyeball's middle from the camera [eyeball radii]
WIDE = 0.5  # field of view [rad]
RIM = 0.5  # radius of the iris that the cornea is over [eyeball radii]
GAZE = (-6.0, 28.0)  # elevation, and azimuth from the direction to the camera [degrees]
RINGS, TURNS = 64, 1024  # of the iris' picture


def picture_view(width: int, height: int, gaze: tuple[float, float] = GAZE) -> EyeView:
    """The eye; pixels beside it see its rim."""
    place, direction, _ = _met(width, height, gaze)
    towards = gaze_of(gaze, place)
    up = torch.linalg.cross(towards, torch.linalg.cross(place.new_tensor((0.0, 0.0, 1.0)), towards))
    return EyeView(
        normal=eye_ball.surface(place, towards, RIM),
        to_eye=-direction,
        place=place,
        gaze=towards.expand_as(place),
        up=(up / torch.linalg.vector_norm(up)).expand_as(place),
        iris=eye_ball.fibres(RINGS, TURNS),
        lights=lights(place),
    )


def is_eye(width: int, height: int, gaze: tuple[float, float] = GAZE) -> Bool[Tensor, "{height} {width}"]:
    """Which pixels show the eye and not what is beside it."""
    return _met(width, height, gaze)[2]


def gaze_of(angles: tuple[float, float], like: Float[Tensor, "*batch 3"]) -> Float[Tensor, "3"]:
    """Direction of a gaze by its elevation and azimuth from the camera [degrees]."""
    elevation, azimuth = like.new_tensor(angles).deg2rad()
    return from_angles(elevation, azimuth + math.pi)


def lights(like: Float[Tensor, "*batch 3"]) -> Lights:
    """A sun over the camera's left shoulder, a window on its right, and a sky."""
    elevation, azimuth = torch.deg2rad(like.new_tensor([[35.0, 10.0], [145.0, -110.0]]))
    irradiance = like.new_tensor([(2.4, 2.2, 2.0), (0.5, 0.6, 0.8)])
    sky = EvenSky(like.new_tensor((0.26, 0.28, 0.32)), like.new_tensor((0.2, 0.22, 0.25)))
    return Lights(from_angles(elevation, azimuth), irradiance, sky)


def _met(width: int, height: int, gaze: tuple[float, float]) -> tuple[Tensor, Tensor, Tensor]:
    """Places on the surface from the eyeball's middle, directions of pixels, and whether the eye is met."""
    camera = Perspective(width, height, WIDE)
    direction = camera.direction(*pixel_centres(camera, slice(None), torch.zeros((), dtype=torch.float64)))
    origin = direction.new_tensor((-DISTANCE, 0.0, 0.0))
    towards = gaze_of(gaze, direction)
    middle = (math.sqrt(1.0 - RIM**2) - math.sqrt(CORNEA**2 - RIM**2)) * towards
    ball, is_ball = _sphere(origin, direction, 1.0)
    bulge, is_bulge = _sphere(origin - middle, direction, CORNEA)
    bulge = bulge + middle
    is_cornea = is_bulge & ((bulge * towards).sum(-1) > math.sqrt(1.0 - RIM**2))
    return torch.where(is_cornea[..., None], bulge, ball), direction, is_ball | is_cornea


def _sphere(origin: Tensor, direction: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Nearest point of a ball about 0 on rays, or its rim's, and whether it is met."""
    along = (origin * direction).sum(-1)
    nearest = origin - along[..., None] * direction
    under = radius**2 - nearest.square().sum(-1)
    met = nearest - under.clamp(min=0.0).sqrt()[..., None] * direction
    length = torch.linalg.vector_norm(met, dim=-1, keepdim=True)
    return met * (radius / length), under > 0.0
