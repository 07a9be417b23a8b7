"""The sun: where it stands, how strongly it shines, and its disc with a darkened limb.

[1] D. Hestroffer, C. Magnan, "Wavelength dependency of the Solar limb darkening", Astronomy & Astrophysics 333, 1998.
"""

import math

from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles


@record
class Sun:
    """A sun above the atmosphere."""

    elevation: Float[Tensor, ""] = parameter(
        math.radians(45.0), bounds=(-math.pi / 2, math.pi / 2), unit="rad", about="above the horizon",
        in_files=("degrees", 180.0 / math.pi),
    )
    azimuth: Float[Tensor, ""] = parameter(
        0.0, bounds=(-math.pi, math.pi), unit="rad", about="from +x towards +y, the left of the picture",
        in_files=("degrees to the right", -180.0 / math.pi),
    )
    irradiance: Float[Tensor, "3"] = parameter(
        (1.474, 1.8504, 1.91198), bounds=(1e-9, 1e9), unit="W/m^2", scale="log",
        about="on a surface facing the sun above the atmosphere; its ratios are the white balance of the picture",
    )


def to_sun(sun: Sun) -> Float[Tensor, "3"]:
    """Unit direction towards the middle of the sun."""
    return from_angles(sun.elevation, sun.azimuth)
