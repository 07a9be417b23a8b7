"""An even layer of cloud: what lights it from above, and how it looks from below.

[1] P. Moon, D. Spencer, "Illumination from a non-uniform sky", Transactions of the Illuminating Engineering Society 37,
    1942; ISO 15469:2004, sky type 16.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import multiple_scattering as multiple
from diffrender.atmosphere import scattering
from diffrender.atmosphere.scattering import Medium
from diffrender.parameters import record

TOP = 2e3  # height at which the layer is lit [m]


@record
class CloudTop:
    """How the sun stands over the layer."""

    column: Float[Tensor, "3"]  # from the layer to the sun [m]
    irradiance: Float[Tensor, ""]  # over the sun's, by angle and shadow alone
    cos_sun: Float[Tensor, ""]


def cloud_top(cos_sun: Float[Tensor, ""]) -> CloudTop:
    """The layer under a sun; depends on nothing else."""
    top = torch.full_like(cos_sun, TOP)
    irradiance = torch.relu(cos_sun) * scattering.sunlit(top, cos_sun)
    return CloudTop(scattering.column(top, scattering.to_visible_sun(top, cos_sun)), irradiance, cos_sun)


def sunlight(air: Medium, top: CloudTop) -> Float[Tensor, "3"]:
    """Irradiance of the layer by the sun, over the sun's."""
    return scattering.transmittance(air, top.column) * top.irradiance


def skylight(top: CloudTop, mean: Float[Tensor, "heights suns 3"], suns: Float[Tensor, "2"]) -> Float[Tensor, "3"]:
    """Irradiance of the layer by half a sphere of mean radiance, over the sun's."""
    cos_sun = top.cos_sun[None]
    return math.pi * multiple.look_up(mean, suns, torch.full_like(cos_sun, TOP), cos_sun)[0]


def zenith_radiance(irradiance: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """Radiance straight up that goes with an irradiance of the ground [1]."""
    return irradiance * (9.0 / (7.0 * math.pi))


def gradation(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 1"]:
    """Radiance over that straight up: falls to a third at the horizon, everywhere alike [1]."""
    return (1.0 + 2.0 * direction[..., 2:]) / 3.0
