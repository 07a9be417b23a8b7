"""What is looked at: directions into the sky from one eye, the sun, and the angles between them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import horizon_cosine
from diffrender.numerics import safe_sqrt
from diffrender.parameters import record
from diffrender.rays import from_angles

ROW_SCALE = 0.05  # share of the way to the zenith over which the rows of tables are dense above the horizon

_UP, _ROUND = 32, 12  # directions from the horizon to the zenith, and round half of the sky


@record
class SkyView:
    """What is looked at: directions from one eye, and the sun above the air, its irradiance already exposed."""

    direction: Float[Tensor, "*batch 3"]
    to_sun: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]  # [W/m^2]
    eye_altitude: Float[Tensor, ""]  # [m]


def chord_square(view: SkyView) -> Float[Tensor, "*batch"]:
    """Square of the distance between unit vectors along each view and to the sun: twice 1 - cos."""
    return (view.direction - view.to_sun).square().sum(-1)


def elevation(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Angle above the horizontal [rad]."""
    return torch.atan2(direction[..., 2], safe_sqrt(direction[..., :2].square().sum(-1)))


def horizon(eye_altitude: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """Elevation of the ground's edge [rad]: 0 for an eye on the ground, negative above."""
    return torch.asin(horizon_cosine(eye_altitude))


def cos_azimuth(view: SkyView) -> Float[Tensor, "*batch"]:
    """Cosine of the azimuth between view and sun; 0 at the zenith, where all azimuths look the same."""
    across = (view.direction[..., :2] * view.to_sun[:2]).sum(-1)
    square = view.direction[..., :2].square().sum(-1) * view.to_sun[:2].square().sum(-1)
    apart = square > 1e-12
    return torch.where(apart, across / torch.sqrt(torch.where(apart, square, torch.ones_like(square))), across * 0.0)


def row_elevations(eye_altitude: Float[Tensor, ""], rows: int) -> Float[Tensor, " rows"]:
    """Elevations of a table's rows [rad], from the ground's edge to the zenith, dense above that edge."""
    rise = ROW_SCALE * torch.expm1(torch.linspace(0.0, math.log1p(1.0 / ROW_SCALE), rows).to(eye_altitude))
    lowest = horizon(eye_altitude)
    # A thousandth of a degree above the ground's edge, where rays still leave for space.
    return lowest + 2e-5 + (math.pi / 2.0 - 2e-5 - lowest) * rise


def row(view: SkyView, rows: int) -> Float[Tensor, "*batch"]:
    """Fractional row of a table in which each view lies; just below 0 under the ground's edge."""
    lowest = horizon(view.eye_altitude)
    above = (elevation(view.direction) - lowest) / (math.pi / 2.0 - lowest)
    # Half the smallest step below the horizon, so that the logarithm stays finite where the picture is black.
    return torch.log1p(torch.clamp(above, min=-0.02) / ROW_SCALE) / math.log1p(1.0 / ROW_SCALE) * (rows - 1)


def upper_half(view: SkyView) -> tuple[SkyView, Float[Tensor, "rows columns 1"]]:
    """Directions all over the sky under a sun as high, and what each adds to light on level ground [sr].

    Half of the sky, on one side of the sun, stands for both. The irradiance is 1; rays are dense at the horizon.
    """
    place = (torch.arange(_UP).to(view.direction) + 0.5) / _UP
    height = (math.pi / 2.0 * place.square())[:, None]
    around = ((torch.arange(_ROUND).to(place) + 0.5) * (math.pi / _ROUND)).expand(_UP, -1)
    level = safe_sqrt(view.to_sun[:2].square().sum())
    seen = SkyView(
        direction=from_angles(height.expand_as(around), around),
        to_sun=torch.stack([level, torch.zeros_like(level), view.to_sun[2]]),
        irradiance=torch.ones_like(view.irradiance),
        eye_altitude=view.eye_altitude,
    )
    solid_angle = 2.0 * math.pi / _ROUND * torch.cos(height) * (math.pi / _UP) * place[:, None]
    return seen, (solid_angle * torch.sin(height)).expand_as(around)[..., None]
