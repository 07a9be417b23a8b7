"""What transparent things are drawn from: the glass that they are of, and the layers of it that each ray meets."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.surfaces import EvenSky, Lights

TINTED_THICKNESS = 0.01  # of glass whose colour is the parameter `tint` [m]


@record
class Transparent:
    """Thin panes of glass, or films; its fields broadcast against the layers, so that each may be of its own glass."""

    tint: Float[Tensor, "*#layers 3"] = parameter(
        (0.80, 0.92, 0.86), bounds=(0.01, 1.0), unit="1",
        about="share of light that is left straight through 10 mm of the glass: turned up, clearer",
    )  # fmt: skip
    thickness: Float[Tensor, "*#layers"] = parameter(
        0.006, bounds=(1e-4, 0.1), unit="m", about="of a pane: turned up, deeper in colour", scale="log"
    )
    index: Float[Tensor, "*#layers"] = parameter(
        1.52, bounds=(1.0, 2.5), unit="1", about="of refraction: turned up, a brighter mirror; 1 mirrors nothing"
    )
    roughness: Float[Tensor, "*#layers"] = parameter(
        0.15, bounds=(0.0, 1.0), unit="1", about="of the faces: turned up, broader highlights"
    )
    dust: Float[Tensor, "*#layers"] = parameter(
        0.4, bounds=(0.0, 1.0), unit="1", about="share that dust covers where its map is 1: turned up, less is seen"
    )
    dust_colour: Float[Tensor, "*#layers 3"] = parameter(
        (0.45, 0.41, 0.35), bounds=(0.0, 1.0), unit="1", about="share of light that dust reflects: turned up, brighter"
    )


@record
class TransparentView:
    """Layers that the ray of each pixel meets, in any order, what is opaque behind them, and the light.

    Layers are as many for all pixels; one at an infinite depth is none, and its normal may be any. A thing that is met
    twice, as a bottle is, has two layers. Normals may point to either side.
    """

    depth: Float[Tensor, "*#batch layers"]  # [m]
    normal: Float[Tensor, "*#batch layers 3"]  # unit vectors
    dust: Float[Tensor, "*#batch layers"]  # map of dust, dirt or smoke, from 0 to 1
    background: Float[Tensor, "*#batch 3"]  # the deferred picture, exposed [W/(m² sr)]
    background_depth: Float[Tensor, "*#batch"]  # of it, infinite where it is the sky [m]
    to_eye: Float[Tensor, "*#batch 3"]
    lights: Lights


# Elevation of the eye [degrees]; depth of the background; of four layers depth, angle of the normal from the eye
# [degrees] and dust.
_EXAMPLES: tuple[tuple[float, float, tuple[tuple[float, float, float], ...]], ...] = (
    (30.0, 9.0, ()),
    (30.0, 9.0, ((2.0, 0.0, 0.0),)),  # straight on
    (30.0, torch.inf, ((2.0, 40.0, 0.0),)),  # before the sky
    (50.0, 9.0, ((2.0, 84.0, 0.0),)),  # grazing
    (-20.0, 9.0, ((2.0, 56.7, 0.2),)),  # seen from below, at Brewster's angle
    (20.0, 9.0, ((2.0, 20.0, 0.9), (4.0, 35.0, 0.1))),
    (20.0, 9.0, ((4.0, 35.0, 0.1), (2.0, 20.0, 0.9))),  # the same the other way round
    (20.0, 9.0, ((2.0, 20.0, 0.1), (4.0, 35.0, 0.9))),  # the dust behind
    (40.0, 3.0, ((4.0, 20.0, 0.5), (2.0, 60.0, 0.5), (5.0, 10.0, 1.0))),  # two behind what is opaque
    (35.0, 30.0, ((6.0, 10.0, 0.3), (3.0, 150.0, 0.8), (8.0, 70.0, 0.5), (1.0, 120.0, 0.0))),  # two from the back
    (35.0, 30.0, ((3.0, 10.0, 1.0), (3.0, 50.0, 0.0))),  # of equal depth
    (10.0, 90.0, ((40.0, 15.0, 0.6), (0.3, 45.0, 0.3), (12.0, 75.0, 0.2))),
    (89.9, 9.0, ((5.0, 0.1, 0.4), (2.0, 30.0, 0.7))),  # straight down
    (25.0, 0.5, ((2.0, 20.0, 0.9), (4.0, 35.0, 0.1))),  # all of it hidden
)
_LAYERS = 4


def example_inputs(dtype: torch.dtype) -> TransparentView:
    """None to four panes, from both sides, grazing, in and out of order, dusty and clean, hidden and before the sky."""
    none = (torch.inf, 0.0, 0.0)
    elevation = torch.tensor([seen for seen, _, _ in _EXAMPLES], dtype=torch.float64).deg2rad()
    layers = [panes + (none,) * (_LAYERS - len(panes)) for _, _, panes in _EXAMPLES]
    depth, tilt, dust = torch.tensor(layers, dtype=torch.float64).unbind(-1)
    count = torch.arange(len(_EXAMPLES), dtype=torch.float64)[:, None]
    azimuth = torch.full_like(elevation, 0.4)
    to_eye, aside = from_angles(elevation, azimuth), from_angles(elevation + 0.5 * torch.pi, azimuth)
    around = from_angles(torch.zeros_like(elevation), azimuth + 0.5 * torch.pi)
    turn = 0.9 * count + 0.4 * torch.arange(_LAYERS)  # of the normals round the eye
    across = torch.cos(turn)[..., None] * aside[:, None] + torch.sin(turn)[..., None] * around[:, None]
    tilted = tilt.deg2rad()[..., None]
    background = torch.tensor([0.9, 0.7, 0.5], dtype=torch.float64) * (0.2 + 0.8 * torch.sin(count).square())
    view = TransparentView(
        depth=depth,
        normal=torch.cos(tilted) * to_eye[:, None] + torch.sin(tilted) * across,
        dust=dust,
        background=background,
        background_depth=torch.tensor([behind for _, behind, _ in _EXAMPLES], dtype=torch.float64),
        to_eye=to_eye,
        lights=_lights(),
    )
    return cast(view, dtype)


def _lights() -> Lights:
    """A sun, and a dim light on the other side."""
    elevation, azimuth = torch.tensor([[42.0, 15.0], [40.0, 200.0]], dtype=torch.float64).deg2rad().unbind(0)
    single = torch.tensor([[0.5, 0.55, 0.65], [0.25, 0.25, 0.2]], dtype=torch.float64)
    irradiance = torch.tensor([[3.0, 2.8, 2.5], [0.4, 0.5, 0.7]], dtype=torch.float64)
    return Lights(from_angles(elevation, azimuth), irradiance, EvenSky(*single))


def cast(view: TransparentView, dtype: torch.dtype) -> TransparentView:
    """The same view in another precision."""
    leaves = {name: value.to(dtype) for name, value in vars(view).items() if isinstance(value, Tensor)}
    lights = view.lights
    sky = EvenSky(*(value.to(dtype) for value in vars(lights.sky).values()))
    return TransparentView(**leaves, lights=Lights(lights.to_light.to(dtype), lights.irradiance.to(dtype), sky))
