"""What hair is drawn from: the parameters of its strands, a view of them, and example strands with the hard cases."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.surfaces import EvenSky, Lights


@record
class Hair:
    """Strands that are all of a kind; the index of refraction is `hair_fibre.INDEX`."""

    colour: Float[Tensor, "3"] = parameter(
        (0.62, 0.40, 0.20), bounds=(0.01, 1.0), unit="1",
        about="share of light that is left after the middle of one strand: turned up, paler; 1 is white",
    )  # fmt: skip
    longitudinal_roughness: Float[Tensor, ""] = parameter(
        0.3, bounds=(0.05, 1.0), unit="1", about="along strands: turned up, highlights spread and fade along them"
    )
    azimuthal_roughness: Float[Tensor, ""] = parameter(
        0.3, bounds=(0.1, 1.0), unit="1", about="round strands: turned up, milkier, and less glow against the light"
    )
    tilt: Float[Tensor, ""] = parameter(
        math.radians(2.0), bounds=(0.0, math.radians(10.0)), unit="rad", in_files=("degrees", math.degrees(1.0)),
        about="of the scales: turned up, the white highlight moves to the root and the coloured one to the tip",
    )  # fmt: skip


@record
class HairView:
    """Strands that are seen one to a pixel, and their lights, exposed already.

    Strands are thinner than pixels: what is seen is their mean across. None shades another but by `reaching` and
    `open`, as of a shadow map and of ambient occlusion.
    """

    tangent: Float[Tensor, "*#batch 3"]  # unit vector along the strand, from root to tip
    normal: Float[Tensor, "*#batch 3"]  # of the body of hair, away from the head
    to_eye: Float[Tensor, "*#batch 3"]
    shift: Float[Tensor, "*#batch"]  # by which a strand's scales lean more than all, at random [rad]
    reaching: Float[Tensor, "*#batch lights"]  # share of each light that other strands and the head let through
    open: Float[Tensor, "*#batch"]  # the same of the sky
    lights: Lights


# Of lights along and across the strands, ahead and behind. Elevations and azimuths in degrees.
_LIGHTS = ((20.0, 0.0), (-35.0, 170.0), (0.0, 90.0))
# The strand's elevation and azimuth, the eye's, the shift [degrees]; shares that reach it of light and sky.
_EXAMPLES = (
    (90.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0),  # across the eye, which looks along the first light's azimuth
    (90.0, 0.0, -20.0, 0.0, 0.0, 1.0, 1.0),  # in the middle of the mirrored highlight
    (90.0, 0.0, 33.0, -12.0, 1.0, 1.0, 0.9),  # against the second light
    (80.0, 30.0, 20.0, 60.0, -2.0, 0.9, 0.8),
    (60.0, 200.0, 10.0, 30.0, 3.0, 1.0, 1.0),
    (30.0, -80.0, 40.0, 20.0, 0.0, 0.7, 0.7),
    (5.0, 85.0, 20.0, -50.0, 1.0, 1.0, 1.0),
    (-40.0, 120.0, -10.0, 140.0, -3.0, 0.5, 0.6),
    (-85.0, 10.0, 60.0, 100.0, 2.0, 1.0, 1.0),
    (10.0, 40.0, 10.0, 40.5, 0.0, 1.0, 1.0),  # nearly along the eye
    (10.0, 40.0, 10.0, 40.0, 0.0, 1.0, 1.0),  # along it
    (20.0, 0.0, -15.0, 60.0, 1.0, 1.0, 1.0),  # along a light
    (-20.0, 180.0, 50.0, 200.0, 0.0, 1.0, 1.0),  # and away from it
    (45.0, 90.0, 35.0, -10.0, 0.0, 0.0, 0.0),  # in the dark
)


def example_inputs(dtype: torch.dtype) -> HairView:
    """Strands across the eye and along it, along a light, in and beside highlights, against the light, in the dark."""
    degrees = torch.tensor(_EXAMPLES, dtype=torch.float64)
    up, around, eye_up, eye_around, shift, reaching, is_open = degrees.unbind(-1)
    lights = torch.tensor(_LIGHTS, dtype=torch.float64).deg2rad()
    tangent = from_angles(up.deg2rad(), around.deg2rad())
    to_eye = from_angles(eye_up.deg2rad(), eye_around.deg2rad())

    def single(*numbers: float) -> Tensor:
        return torch.tensor(numbers, dtype=dtype)

    return HairView(
        tangent=tangent.to(dtype),
        normal=_towards_eye(tangent, to_eye).to(dtype),
        to_eye=to_eye.to(dtype),
        shift=shift.deg2rad().to(dtype),
        reaching=(reaching[:, None] * torch.tensor([1.0, 0.7, 0.9])).to(dtype),
        open=is_open.to(dtype),
        lights=Lights(
            from_angles(*lights.unbind(-1)).to(dtype),
            torch.stack([single(3.0, 2.8, 2.5), single(4.0, 4.2, 5.0), single(0.5, 1.0, 0.8)]),
            EvenSky(single(0.3, 0.35, 0.45), single(0.15, 0.15, 0.1)),
        ),
    )


def _towards_eye(tangent: Tensor, to_eye: Tensor) -> Tensor:
    """Unit vector across the strand, on the eye's side of it and a little up, for none looks along it by both."""
    aside = to_eye + to_eye.new_tensor((0.1, -0.2, 0.3))
    across = aside - (aside * tangent).sum(-1, keepdim=True) * tangent
    return torch.nn.functional.normalize(across, dim=-1)
