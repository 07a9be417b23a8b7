"""Lights in near fog: the sun with its blurred shadow, point and spot lights, and a probe of light from all around.

Each is the light that a speck of fog sends to the eye per scattering coefficient: irradiance times phase function,
Henyey and Greenstein's, by tensors that arrive with every frame.

Local lights are balls of a size: within it their light and its direction even out, so that fog in the middle of a lamp
is finite. They end smoothly at their reach [1]. What they do not have: shadows.

[1] S. Lagarde, C. de Rousiers, "Moving Frostbite to physically based rendering", SIGGRAPH 2014 course "Physically
    Based Shading", section 3.1.2: the window that ends a light.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import scattering
from diffrender.atmosphere.volumes import trilinear
from diffrender.images import clamped
from diffrender.numerics import smooth_rise
from diffrender.parameters import record
from diffrender.spherical_harmonics import BANDS, basis


@record
class Shadow:
    """How much of the sun is seen from places in a box of the world; outside, what is seen at the box's border."""

    lit: Float[Tensor, "*frames layers rows columns"]  # from 0 to 1
    to_box: Float[Tensor, "*frames 3 4"]  # affine, from the world to layer, row and column, each from 0 to 1


@record
class Sunlight:
    """Parallel light."""

    to_sun: Float[Tensor, "*frames 3"]
    irradiance: Float[Tensor, "*frames 3"]  # [W/m²]
    shadow: Shadow | None


@record
class LocalLights:
    """Point lights and spots; of a point light both cosines are -2 and -1."""

    position: Float[Tensor, "*frames lights 3"]  # [m]
    intensity: Float[Tensor, "*frames lights 3"]  # [W/sr]
    size: Float[Tensor, "*frames lights"]  # radius of the lamp [m]
    reach: Float[Tensor, "*frames lights"]  # distance where the light ends [m]
    ahead: Float[Tensor, "*frames lights 3"]  # unit axis of the cone
    cos_edge: Float[Tensor, "*frames lights"]  # where the cone begins, from outside
    cos_full: Float[Tensor, "*frames lights"]  # where it has its whole light
    share: Float[Tensor, "*frames lights"]  # of its light that shines on the fog, as an artist chooses: 0 for none


@record
class Lights:
    """All that may shine on the fog; what is None does not."""

    sun: Sunlight | None
    local: LocalLights | None
    probe: Float[Tensor, "*frames coefficients 3"] | None  # radiance in 1, 4 or 9 spherical harmonics [W/(m² sr)]


def visibility(shadow: Shadow, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Share of the sun that is seen from places in the world."""
    box = position.matmul(shadow.to_box[:, :3].mT) + shadow.to_box[:, 3]
    cells = box * box.new_tensor(shadow.lit.shape)
    return trilinear(shadow.lit[..., None], cells, clamped)[..., 0]


def of_sun(
    sun: Sunlight, asymmetry: Tensor, position: Float[Tensor, "*batch 3"], direction: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Sunlight sent to the eye per scattering coefficient [W/(m² sr)]."""
    apart = direction - sun.to_sun
    light = scattering.henyey_greenstein((apart * apart).sum(-1), asymmetry)[..., None] * sun.irradiance
    if sun.shadow is None:
        return light + torch.zeros_like(position)
    return light * visibility(sun.shadow, position)[..., None]


def of_local(
    lights: LocalLights, asymmetry: Tensor, position: Float[Tensor, "*batch 3"], direction: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Light of all local lights sent to the eye per scattering coefficient [W/(m² sr)]; a step for each."""
    total = torch.zeros_like(position)
    for number in range(lights.position.shape[-2]):
        to_light = lights.position[number] - position
        square, size = (to_light * to_light).sum(-1), lights.size[number]
        even = square + size * size
        nearness = torch.rsqrt(even)
        # Shorter than unit within the lamp, where light comes from all sides.
        to_lamp = to_light * nearness[..., None]
        phase = scattering.henyey_greenstein(2.0 - 2.0 * (to_lamp * direction).sum(-1), asymmetry)
        cosine = -(to_lamp * lights.ahead[number]).sum(-1)
        edge = lights.cos_edge[number]
        cone = smooth_rise(cosine - edge, lights.cos_full[number] - edge)
        falloff = cone * _window(square / lights.reach[number].square()) / even
        total = total + (phase * falloff)[..., None] * (lights.share[number] * lights.intensity[number])
    return total


def _window(square: Tensor) -> Tensor:
    """From 1 at a light to 0 at its reach, without a kink; of the squared distance in reaches."""
    left = torch.relu(1.0 - square * square)
    return left * left


def of_probe(
    probe: Float[Tensor, "coefficients 3"], asymmetry: Tensor, direction: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Light from all around sent to the eye per scattering coefficient [W/(m² sr)].

    Exact for what the harmonics hold: the phase function dims each band by a power of its mean cosine.
    """
    count = len(probe)
    powers = torch.stack([torch.ones_like(asymmetry), asymmetry, asymmetry * asymmetry])
    dimmed = probe * powers[torch.tensor(BANDS[:count], device=probe.device)][:, None]
    return basis(direction)[..., :count] @ dimmed


def brightest(lights: Lights, asymmetry: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Bounds on the light of sun, local lights and probe sent to the eye per scattering coefficient [W/(m² sr)].

    As if every eye looked along the peak of the phase function, out of the midst of every lamp.
    """
    backwards = 1.0 - asymmetry.abs()
    peak = (1.0 + asymmetry.abs()) / (4.0 * math.pi * backwards * backwards)
    none = torch.zeros(3).to(peak)
    sun = none if lights.sun is None else peak * lights.sun.irradiance.reshape(-1, 3).amax(0)
    if lights.local is None:
        local = none
    else:
        near = (lights.local.share / lights.local.size.square())[..., None] * lights.local.intensity
        local = peak * near.sum(-2).reshape(-1, 3).amax(0)
    # No harmonic is larger than 1.1.
    probe = none if lights.probe is None else 1.1 * lights.probe.abs().sum(-2).reshape(-1, 3).amax(0)
    return sun, local, probe
