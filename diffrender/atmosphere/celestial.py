"""The sun: where it stands, how strongly it shines, and its disc with a darkened limb.

Exposure is multiplied before drawing, not after [3]: `pre_exposed` takes a sun to its share in an exposed picture.

Gradient: exact inside the disc; which rays meet the disc is not differentiated, so moving the sun moves no light across
its edge. The darkened limb falls to 0 with an endless slope, so gradients grow towards the edge.

[1] D. Hestroffer, C. Magnan, "Wavelength dependency of the Solar limb darkening", Astronomy & Astrophysics 333, 1998.
[2] H. Neckel, D. Labs, "Solar limb darkening 1986-1990 (303 to 1099 nm)", Solar Physics 153, 1994, table 1.
[3] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016 Talks.
"""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import SUN_RADIUS, WAVELENGTH
from diffrender.effect import Effect, Rung
from diffrender.parameters import parameter, record
from diffrender.rays import Rays, from_angles

SOLID_ANGLE = 4.0 * math.pi * math.sin(SUN_RADIUS / 2.0) ** 2  # [sr]; over a year it varies by 3.4 % either way
LIMB_EXPONENTS = tuple(0.292e-6 / wavelength - 0.023 for wavelength in WAVELENGTH)  # [1], from 416 to 1099 nm


@record
class Sun:
    """A sun above the atmosphere."""

    elevation: Float[Tensor, ""] = parameter(
        math.radians(45.0),
        bounds=(-math.pi / 2, math.pi / 2),
        unit="rad",
        about="above the horizon",
        in_files=("degrees", 180.0 / math.pi),
    )
    azimuth: Float[Tensor, ""] = parameter(
        0.0,
        bounds=(-math.pi, math.pi),
        unit="rad",
        about="of the middle of the disc, from the direction under the middle of the picture",
        in_files=("degrees to the right", -180.0 / math.pi),
    )
    irradiance: Float[Tensor, "3"] = parameter(
        (1.474, 1.8504, 1.91198),
        bounds=(1e-9, 1e9),
        unit="W/m^2",
        scale="log",
        about="on a surface facing the sun above the atmosphere; its ratios are the white balance of the picture",
    )


@record
class SunView:
    """Rays, and the share of sunlight that reaches their eye through the atmosphere; 0 behind the Earth or a cloud."""

    rays: Rays
    transmittance: Float[Tensor, "*#batch 3"]


def to_sun(sun: Sun) -> Float[Tensor, "3"]:
    """Unit direction towards the middle of the sun."""
    return from_angles(sun.elevation, sun.azimuth)


def pre_exposed(sun: Sun, exposure: Float[Tensor, ""]) -> Sun:
    """Sun whose irradiance is already exposed, so that what is drawn from it fits a half float [3]."""
    return replace(sun, irradiance=sun.irradiance * exposure)


def render(sun: Sun, seen: SunView) -> Float[Tensor, "*batch 3"]:
    """Radiance of the disc with its limb darkened, 0 beside it [W/(m^2 sr)].

    The power law of [1], cos(emission)^exponent, over its exact mean: summed over the disc's solid angle it gives the
    irradiance. The limb is redder than the middle.
    """
    share = _share_within(sun, seen.rays)[..., None]
    inside = share < 1.0
    squared_cosine = torch.where(inside, 1.0 - share, torch.ones_like(share))
    half = squared_cosine.new_tensor(LIMB_EXPONENTS) / 2.0
    profile = (1.0 + half) * squared_cosine**half
    return torch.where(inside, _mean_radiance(sun, seen) * profile, torch.zeros_like(profile))


def uniform_disc(sun: Sun, seen: SunView) -> Float[Tensor, "*batch 3"]:
    """Radiance of an evenly bright disc, 0 beside it [W/(m^2 sr)]."""
    inside = (_share_within(sun, seen.rays) < 1.0)[..., None]
    mean = _mean_radiance(sun, seen)
    return torch.where(inside, mean, torch.zeros_like(mean))


def skip(_sun: Sun, seen: SunView) -> Float[Tensor, "*batch 3"]:
    """No disc: 0."""
    return torch.zeros_like(seen.rays.direction)


def _mean_radiance(sun: Sun, seen: SunView) -> Float[Tensor, "*#batch 3"]:
    return sun.irradiance * seen.transmittance / SOLID_ANGLE


def _share_within(sun: Sun, rays: Rays) -> Float[Tensor, "*batch"]:
    """Share of the disc's solid angle nearer to its middle than a ray: 0 in the middle, 1 at the edge, more beside it.

    From the chord between the directions, exactly: the cosine of their angle takes only 180 float32 values across a
    disc this small. Equal to the squared sine of the angle of emission, up to a share of SUN_RADIUS^2 / 4.
    """
    chord = rays.direction - to_sun(sun)
    return (chord * chord).sum(-1) / (2.0 * math.sin(SUN_RADIUS / 2.0)) ** 2


# Polynomials of the measured radiance in cos(emission), from the constant up, by wavelength [m] [2].
MEASURED = {
    427.930e-9: (0.14249, 1.28796, -1.19564, 1.68603, -1.36658, 0.44572),
    443.885e-9: (0.16220, 1.24893, -0.92165, 0.89978, -0.50148, 0.11220),
    541.760e-9: (0.26073, 1.27428, -1.30352, 1.47085, -0.96618, 0.26384),
    559.950e-9: (0.26892, 1.34319, -1.58427, 1.91271, -1.31350, 0.37295),
    669.400e-9: (0.34685, 1.37539, -2.04425, 2.70493, -1.94290, 0.55999),
    700.875e-9: (0.37885, 1.25553, -1.70908, 2.19647, -1.59554, 0.47378),
}


def measured(sun: Sun, seen: SunView) -> Float[Tensor, "*batch 3"]:
    """Radiance of the disc by the measured polynomials of [2], scaled to the irradiance by quadrature [W/(m^2 sr)]."""
    direction = seen.rays.direction
    middle = to_sun(sun).expand_as(direction)
    sine = torch.linalg.vector_norm(torch.linalg.cross(direction, middle), dim=-1)
    angle = torch.atan2(sine, (direction * middle).sum(-1))
    step = SUN_RADIUS / 10_000
    ring = (torch.arange(10_000).to(angle) + 0.5) * step
    whole = (_measured_profile(ring) * (2.0 * math.pi * step * torch.sin(ring))[:, None]).sum(0)
    radiance = sun.irradiance * seen.transmittance * _measured_profile(angle) / whole
    return torch.where((angle < SUN_RADIUS)[..., None], radiance, torch.zeros_like(radiance))


def _measured_profile(angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
    """Radiance over that of the middle at an angle from it [rad]; the wavelengths between those of [2] by lerp."""
    emission = torch.asin((torch.sin(angle) / math.sin(SUN_RADIUS)).clamp(max=1.0))
    powers = torch.cos(emission)[..., None, None] ** torch.arange(6).to(angle)
    below, above = (angle.new_tensor(list(MEASURED.values())[offset::2]) for offset in (0, 1))
    first, last = (angle.new_tensor(list(MEASURED)[offset::2]) for offset in (0, 1))
    weight = (angle.new_tensor(WAVELENGTH).flip(0) - first) / (last - first)
    return (powers * torch.lerp(below, above, weight[:, None])).sum(-1).flip(-1)


def largest_change(sun: Sun, seen: SunView) -> Float[Tensor, ""]:
    """Radiance of the disc's middle, in its brightest channel [W/(m^2 sr)]; 0 where no ray meets the disc."""
    brightest = (_mean_radiance(sun, seen) * (1.0 + sun.irradiance.new_tensor(LIMB_EXPONENTS) / 2.0)).amax()
    is_seen = (_share_within(sun, seen.rays) < 1.0).any()
    return torch.where(is_seen, brightest, torch.zeros_like(brightest))


def example_inputs(dtype: torch.dtype) -> SunView:
    """Rays to the middle, inside and outside the edge of suns in front, behind, at the zenith and the nadir."""
    angles = torch.tensor([[1.0, 0.0], [1.0, 4.0], [2.0, 0.0], [-2.0, -4.0]], dtype=torch.float64) * (math.pi / 4)
    elevation, azimuth = angles.unbind(-1)
    from_middle = SUN_RADIUS * torch.tensor([0.0, 0.5, 0.9, 1.05, 2.0], dtype=torch.float64)[:, None]
    turn = torch.arange(5, dtype=torch.float64)[:, None]
    middle = from_angles(elevation, azimuth)[:, None]
    up = from_angles(elevation + math.pi / 2, azimuth)[:, None]
    left = from_angles(torch.zeros_like(elevation), azimuth + math.pi / 2)[:, None]
    aside = torch.cos(turn) * up + torch.sin(turn) * left
    direction = torch.cos(from_middle) * middle + torch.sin(from_middle) * aside
    rays = Rays(
        origin=torch.zeros(3, dtype=dtype),
        direction=direction.flatten(0, 1).to(dtype),
        length=torch.tensor(math.inf, dtype=dtype),
    )
    return SunView(rays, torch.tensor([0.9, 0.8, 0.6], dtype=dtype))


EFFECT = Effect(
    parameters=Sun,
    prefix="SUN",
    rungs={"skip": Rung(skip), "uniform disc": Rung(uniform_disc), "limb darkened": Rung(render)},
    reference=measured,
    # The power law of [1] against measurements [2]; at the very edge it is 0, and the sun 0.2 to 0.4 of its mean.
    tolerance=0.01,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
