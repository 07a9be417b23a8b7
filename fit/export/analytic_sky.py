"""Skies of engines in a few numbers: the Preetham family of three.js' `Sky` and of Godot's PhysicalSkyMaterial.

Both descend from one shader, in which extinction and in-scatter are physical in form and the rest is taste. Directions
are ours: z up.

Gradient: exact in every parameter.

[1] three.js r187, examples/jsm/objects/Sky.js; after A. Preetham, P. Shirley, B. Smits, "A practical analytic model for
    daylight", SIGGRAPH 1999.
[2] Godot 4.3, scene/resources/3d/sky_material.cpp, PhysicalSkyMaterial.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import safe_sqrt

# Scattering at the ground by channel [1/m]: of the air, and of haze over turbidity and mieCoefficient [1].
_RAYLEIGH = (5.804542996261093e-6, 1.3562911419845635e-5, 3.0265902468824876e-5)
_MIE = tuple(0.434 * 0.2 * 10e-18 * constant for constant in (1.8399918514433978e14, 2.7798023919660528e14,
             4.0790479543861094e14))  # fmt: skip
_RAYLEIGH_LENGTH, _MIE_LENGTH = 8.4e3, 1.25e3  # to the zenith [m]
_CUTOFF, _STEEPNESS, _BRIGHTEST = 1.6110731556870734, 1.5, 1000.0  # of the sun's fading at the horizon [1]
_EXPOSURE, _NIGHT = 0.04, (0.0, 0.0003, 0.00075)  # what the shader multiplies with and adds [1]


@dataclass(frozen=True)
class Dial:
    """A parameter of an engine's sky: where a fit begins, and the range that the fit may use."""

    name: str
    start: float
    low: float
    high: float


THREE_DIALS = (
    Dial("turbidity", 6.0, 0.1, 20.0),
    Dial("rayleigh", 1.5, 0.01, 4.0),
    Dial("mieCoefficient", 0.005, 1e-4, 0.1),
    Dial("mieDirectionalG", 0.7, 0.0, 0.98),
)
GODOT_DIALS = (
    Dial("rayleigh_coefficient", 2.0, 0.05, 64.0),
    Dial("mie_coefficient", 0.005, 1e-3, 1.0),
    Dial("mie_eccentricity", 0.7, 0.0, 0.98),
    *(Dial(f"rayleigh_color_{c}", v, 0.01, 1.0) for c, v in zip("rgb", (0.3, 0.405, 0.6), strict=True)),
    *(Dial(f"mie_color_{c}", v, 0.01, 1.0) for c, v in zip("rgb", (0.69, 0.729, 0.812), strict=True)),
)
_DARKEST = 1e-30  # radiance, before Godot's root
GODOT_TURBIDITY = 10.0  # only its product with mie_coefficient shows


def three_sky(dials: Float[Tensor, " dials"], direction: Float[Tensor, "n 3"], to_sun: Float[Tensor, "3"]) -> Tensor:
    """Radiance of three.js' `Sky` for a sunPosition of length 1, without its disc and clouds [1]."""
    turbidity, rayleigh, mie, g = dials.unbind()
    energy = _BRIGHTEST * torch.relu(1.0 - torch.exp(-(_CUTOFF - torch.acos(to_sun[2])) / _STEEPNESS))
    by_air = direction.new_tensor(_RAYLEIGH) * rayleigh
    by_haze = direction.new_tensor(_MIE) * turbidity * mie
    zenith = torch.acos(torch.clamp(direction[:, 2], min=0.0))
    mass = 1.0 / (torch.cos(zenith) + 0.15 * (93.885 - torch.rad2deg(zenith)) ** -1.253)
    light, passed = _scattered(by_air, by_haze, mass, direction @ to_sun, g)
    glow = _reddened(energy * light, passed, to_sun)
    return (glow + 0.1 * passed) * _EXPOSURE + direction.new_tensor(_NIGHT)


def godot_sky(dials: Float[Tensor, " dials"], direction: Float[Tensor, "n 3"], to_sun: Float[Tensor, "3"]) -> Tensor:
    """Radiance of Godot's PhysicalSkyMaterial for a light of energy 1, above the horizon and without its disc [2].

    Colours are linear here; Godot's editor shows and its files hold them encoded in sRGB.
    """
    energy = torch.relu(0.757 * to_sun[2])
    fade = torch.exp(torch.clamp(to_sun[2], max=0.0))
    by_air = (dials[0] - (1.0 - fade)) * dials[3:6] * 1e-4
    by_haze = GODOT_TURBIDITY * dials[1] * dials[6:9] * 4.34e-4
    height = torch.clamp(direction[:, 2], min=0.0)
    mass = 1.0 / (height + 0.15 * (3.885 + 54.5 * height) ** -1.253)
    light, passed = _scattered(by_air, by_haze, mass, direction @ to_sun, dials[2])
    # Under a sun that has set there is no light, and the root's slope would be endless.
    glow = torch.clamp(_reddened(energy * light, passed, to_sun), min=_DARKEST)
    return glow ** (1.0 / (1.2 + 1.2 * fade))


def _scattered(by_air: Tensor, by_haze: Tensor, mass: Tensor, cosine: Tensor, g: Tensor) -> tuple[Tensor, Tensor]:
    """Share of light scattered per extinction, and the share that passes, by direction and channel."""
    passed = torch.exp(-mass[:, None] * (by_air * _RAYLEIGH_LENGTH + by_haze * _MIE_LENGTH))
    # Of half the cosine and a half, as in both shaders: a slip that their looks have grown on.
    air_phase = 3.0 / (16.0 * math.pi) * (1.0 + (0.5 * cosine + 0.5) ** 2)
    haze_phase = (1.0 - g * g) / (4.0 * math.pi) / (1.0 - 2.0 * g * cosine + g * g) ** 1.5
    light = (by_air * air_phase[:, None] + by_haze * haze_phase[:, None]) / (by_air + by_haze)
    return light, passed


def _reddened(light: Tensor, passed: Tensor, to_sun: Tensor) -> Tensor:
    low = torch.clamp((1.0 - to_sun[2]) ** 5, 0.0, 1.0)
    return (light * (1.0 - passed)) ** 1.5 * torch.lerp(torch.ones_like(light), safe_sqrt(light * passed), low)
