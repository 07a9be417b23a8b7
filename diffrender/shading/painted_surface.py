"""Car paint's parameters, and the painted surfaces that it is drawn on, with the hard cases among the examples."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.shading.flakes import WIDEST
from diffrender.surfaces import EvenSky, Lights

VARNISH = 1.5  # index of refraction of the clear coat


@record
class CarPaint:
    """Paint of three layers: a matt base coat, metal flakes over it, and a clear coat over both."""

    base: Float[Tensor, "3"] = parameter(
        (0.03, 0.07, 0.25), bounds=(0.0, 1.0), unit="1", about="colour of the base coat: turned up, paler"
    )
    flake_colour: Float[Tensor, "3"] = parameter(
        (0.45, 0.6, 0.9), bounds=(0.0, 1.0), unit="1", about="what a flake reflects: turned up, brighter glints"
    )
    flake_amount: Float[Tensor, ""] = parameter(
        0.35, bounds=(0.0, 1.0), unit="1", about="share of the base coat that flakes hide: turned up, more metallic"
    )
    flake_spread: Float[Tensor, ""] = parameter(
        0.2, bounds=(0.08, WIDEST), unit="1",
        about="slopes of the flakes: turned up, the sheen is wider and fainter and glints are farther apart",
    )  # fmt: skip
    flake_size: Float[Tensor, ""] = parameter(
        3e-4, bounds=(2e-5, 5e-3), unit="m", scale="log", about="width of a flake: turned up, coarser glints"
    )
    coat_roughness: Float[Tensor, ""] = parameter(
        0.05, bounds=(0.0, 1.0), unit="1", about="of the clear coat: turned up, from polished to matt"
    )
    coat_depth: Float[Tensor, "3"] = parameter(
        (0.04, 0.03, 0.02), bounds=(0.0, 4.0), unit="1",
        about="optical depth of the clear coat straight down: turned up, candy-coloured, deeper at the rim",
    )  # fmt: skip


@record
class CarPaintView:
    """Painted surfaces, and their light, exposed already.

    Attributes:
        tangent: unit vector across the normal along which the first of the two coordinates grows.
        place: coordinates on the surface, which the sheet of flakes is laid over [m].
        footprint: width of a pixel on the surface [m].
    """

    normal: Float[Tensor, "*#batch 3"]
    to_eye: Float[Tensor, "*#batch 3"]
    tangent: Float[Tensor, "*#batch 3"]
    place: Float[Tensor, "*#batch 2"]
    footprint: Float[Tensor, "*#batch"]
    lights: Lights


# Elevation of the eye over the surface and its azimuth from the first light's [degrees]; pixel's width [m].
_EXAMPLES = (
    (42.0, 180.0, 3.7e-4),  # beside the first light's mirror
    (44.0, 177.0, 3.4e-4),
    (40.0, 170.0, 7.1e-4),
    (55.0, 185.0, 1e-4),
    (35.0, 190.0, 2.3e-3),
    (60.0, 150.0, 1.3e-3),
    (70.0, 120.0, 5.7e-3),
    (90.0, 0.0, 4e-4),  # straight down
    (89.0, 40.0, 2.5e-4),
    (30.0, 90.0, 0.031),  # from far away
    (10.0, 180.0, 2.1e-3),
    (9.0, 156.0, 4.3e-3),  # beside where the second light, which grazes, is mirrored
    (1.0, 150.0, 0.021),  # grazing
    (-0.5, 170.0, 1.1e-3),  # turned away from the eye
    (50.0, 10.0, 0.0),  # as if by a pixel of no size
)


def example_inputs(dtype: torch.dtype) -> CarPaintView:
    """Paint in a light's mirror and beside it, straight down, grazing and turned away, from near and from far."""
    table = torch.tensor(_EXAMPLES, dtype=torch.float64)
    seen_at, turn, footprint = table.unbind(-1)

    def single(*numbers: float) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64)

    # All of it leant over, so that no normal is an axis.
    leant = torch.stack([single(0.8, 0.0, 0.6), single(-0.36, 0.8, 0.48), single(-0.48, -0.6, 0.64)])
    to_light = from_angles(single(45.0, 6.0).deg2rad(), single(0.0, -20.0).deg2rad())
    count = torch.arange(len(table), dtype=torch.float64)
    sky = EvenSky(single(0.5, 0.55, 0.65).to(dtype), single(0.25, 0.25, 0.2).to(dtype))
    irradiance = torch.stack([single(3.0, 2.8, 2.5), single(0.4, 0.5, 0.7)])
    return CarPaintView(
        normal=leant[:, 2].expand(len(table), 3).to(dtype),
        to_eye=(from_angles(seen_at.deg2rad(), turn.deg2rad()) @ leant.T).to(dtype),
        tangent=leant[:, 0].expand(len(table), 3).to(dtype),
        place=torch.stack([0.0131737 * count - 0.0503371, 0.3011191 - 0.0371933 * count], -1).to(dtype),
        footprint=footprint.to(dtype),
        lights=Lights((to_light @ leant.T).to(dtype), irradiance.to(dtype), sky),
    )
