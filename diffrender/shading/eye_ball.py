"""Eyes' parameters, and the places on eyeballs that they are drawn on, with the hard cases among the examples.

Lengths are in radii of the eyeball, of some 12 mm. Its front is a cornea, a smaller ball that bulges out of it: of the
radius `CORNEA`, so that it meets the eyeball at the iris' rim.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.surfaces import EvenSky, Lights

CORNEA = 0.65  # radius of its ball: 7.8 mm, as of Gullstrand's eye
LEAST_DESCENT = 0.1  # along the gaze, of a bent ray that is followed to the iris; flatter ones end beside it
PUPIL_EDGE = 0.02  # width of the pupil's soft border [eyeball radii]
RIM_LEFT = 0.2  # share of its colour that the iris keeps at its rim
TEARS = 1.336  # index of refraction of their film


@record
class Eye:
    """An eye: its iris behind the cornea, its white, and the tears over both."""

    iris_radius: Float[Tensor, ""] = parameter(
        0.5, bounds=(0.35, 0.6), unit="1", about="of the iris, in eyeball radii: turned up, larger"
    )
    iris_depth: Float[Tensor, ""] = parameter(
        0.05, bounds=(0.0, 0.25), unit="1", about="of the iris under its rim, in eyeball radii: turned up, deeper"
    )
    iris_colour: Float[Tensor, "3"] = parameter(
        (0.16, 0.3, 0.42), bounds=(0.0, 1.0), unit="1", about="of the iris: turned up, paler"
    )
    iris_bowl: Float[Tensor, ""] = parameter(
        0.5, bounds=(0.0, 1.0), unit="1",
        about="slope of the iris at its rim: turned up, the side away from a light is the brighter one",
    )  # fmt: skip
    pupil_radius: Float[Tensor, ""] = parameter(
        0.18, bounds=(0.05, 0.3), unit="1", about="of the pupil, in eyeball radii: turned up, darker eyes"
    )
    sclera_colour: Float[Tensor, "3"] = parameter(
        (0.75, 0.68, 0.64), bounds=(0.0, 1.0), unit="1", about="of the white of the eye: turned up, whiter"
    )
    limbus_width: Float[Tensor, ""] = parameter(
        0.1, bounds=(0.02, 0.25), unit="1", about="of the iris' dark rim, in eyeball radii: turned up, softer"
    )
    refraction: Float[Tensor, ""] = parameter(
        1.336, bounds=(1.05, 1.6), unit="1", about="index of what fills the cornea: turned up, the iris comes nearer"
    )
    wet_roughness: Float[Tensor, ""] = parameter(
        0.1, bounds=(0.0, 1.0), unit="1", about="of the film of tears: turned up, duller"
    )


@record
class EyeView:
    """Places on an eye, and its light, exposed already.

    Attributes:
        normal: of the wet surface, bulge of the cornea and all.
        place: from the eyeball's middle [eyeball radii].
        gaze: unit vector along which the eye looks.
        up: unit vector across the gaze, from which the iris' angles count.
        iris: brightness of the iris over its colour, by distance from the middle to the rim and by angle; its first
            column is to be its last.
    """

    normal: Float[Tensor, "*#batch 3"]
    to_eye: Float[Tensor, "*#batch 3"]
    place: Float[Tensor, "*#batch 3"]
    gaze: Float[Tensor, "*#batch 3"]
    up: Float[Tensor, "*#batch 3"]
    iris: Float[Tensor, "rings turns"]
    lights: Lights


def fibres(rings: int, turns: int) -> Float[Tensor, "{rings} {turns}"]:
    """Brightness of an iris of fibres: a pale ragged ring about the pupil, dark furrows, a dark rim; from 0 to 1."""
    rise = torch.linspace(0.0, 1.0, rings, dtype=torch.float64)[:, None]
    turn = torch.linspace(0.0, 2.0 * math.pi, turns, dtype=torch.float64)
    wave = sum(torch.sin(count * turn + phase + sway * rise) / len(_FIBRES) for count, phase, sway in _FIBRES)
    ragged = rise + 0.06 * torch.sin(9.0 * turn) + 0.04 * torch.sin(23.0 * turn + 1.0)
    ring = torch.exp(-(((ragged - 0.5) / 0.12) ** 2))
    return (0.55 + 0.3 * ring + 0.6 * wave).clamp(0.05, 1.0)


# Whole waves round the iris, their phase, and how they sway from pupil to rim.
_FIBRES = ((31, 0.3, 2.0), (47, 1.9, -3.0), (73, 4.0, 2.0), (90, 2.2, -1.0), (113, 5.1, 3.0))

# Angles from the gaze to the place and round it, elevation of the eye over the wet surface and its azimuth [degrees].
_EXAMPLES = (
    (0.1, 20.0, 89.0, 10.0),  # the middle of the pupil
    (8.0, 20.0, 80.0, 10.0),
    (13.0, 100.0, 60.0, 200.0),
    (16.0, 310.0, 50.0, 130.0),
    (18.0, 170.0, 30.0, 90.0),
    (20.0, 45.0, 75.0, 300.0),
    (22.0, 260.0, 10.0, 80.0),
    (25.0, 150.0, 60.0, 330.0),
    (28.0, 75.0, 40.0, 250.0),  # in the iris' rim
    (31.0, 220.0, 70.0, 40.0),
    (34.0, 10.0, 20.0, 190.0),
    (45.0, 340.0, 65.0, 310.0),
    (70.0, 130.0, 3.0, 140.0),  # grazing
    (120.0, 240.0, 45.0, 60.0),  # at the back of the eyeball
)


def surface(place: Float[Tensor, "*batch 3"], gaze: Float[Tensor, "*#batch 3"], rim: float) -> Tensor:
    """Unit normal of the eyeball, or of a cornea over an iris of that radius, at a place on either."""
    middle = math.sqrt(1.0 - rim**2) - math.sqrt(CORNEA**2 - rim**2)
    height = (place * gaze).sum(-1, keepdim=True)
    is_cornea = height > math.sqrt(1.0 - rim**2)
    return torch.nn.functional.normalize(torch.where(is_cornea, place - middle * gaze, place), dim=-1)


def on_cornea(direction: Float[Tensor, "*batch 3"], gaze: Float[Tensor, "*#batch 3"], rim: float) -> Tensor:
    """Place of the eye's surface in a direction from the eyeball's middle."""
    middle = math.sqrt(1.0 - rim**2) - math.sqrt(CORNEA**2 - rim**2)
    along = middle * (direction * gaze).sum(-1, keepdim=True)
    length = along + torch.sqrt((along.square() + CORNEA**2 - middle**2).clamp(min=0.0))
    is_cornea = (direction * gaze).sum(-1, keepdim=True) > math.sqrt(1.0 - rim**2)
    return torch.where(is_cornea, length * direction, direction)


def example_inputs(dtype: torch.dtype) -> EyeView:
    """Pupil, iris, its rim and the white, straight on, grazing, and the back of the ball."""
    away, turn, seen_at, around = torch.tensor(_EXAMPLES, dtype=torch.float64).deg2rad().unbind(-1)

    def single(*numbers: float) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64)

    # All of it leant over, so that no gaze is an axis.
    leant = torch.stack([single(0.8, 0.0, 0.6), single(-0.36, 0.8, 0.48), single(-0.48, -0.6, 0.64)])
    gaze, up = leant[:, 2], leant[:, 0]
    place = on_cornea(from_angles(0.5 * math.pi - away, turn) @ leant.T, gaze, 0.5)
    normal = surface(place, gaze, 0.5)
    across = torch.nn.functional.normalize(torch.linalg.cross(normal, single(0.3, 0.9, 0.1).expand_as(normal)), dim=-1)
    along = torch.linalg.cross(normal, across)
    local = from_angles(seen_at, around)
    to_eye = local[:, :1] * across + local[:, 1:2] * along + local[:, 2:] * normal
    to_light = from_angles(single(50.0, 12.0).deg2rad(), single(0.0, 130.0).deg2rad()) @ leant.T
    sky = EvenSky(single(0.5, 0.55, 0.65).to(dtype), single(0.25, 0.25, 0.2).to(dtype))
    irradiance = torch.stack([single(3.0, 2.8, 2.5), single(0.7, 0.8, 1.0)])
    return EyeView(
        normal=normal.to(dtype),
        to_eye=to_eye.to(dtype),
        place=place.to(dtype),
        gaze=gaze.expand_as(place).to(dtype),
        up=up.expand_as(place).to(dtype),
        iris=fibres(9, 65).to(dtype),
        lights=Lights(to_light.to(dtype), irradiance.to(dtype), sky),
    )
