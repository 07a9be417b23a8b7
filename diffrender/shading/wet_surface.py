"""What wetness is drawn from: the weather's parameters, a view of a surface, and the published model's constants [1].

[1] S. Lagarde, "Water drop 3b - Physically based wet surfaces", seblagarde.wordpress.com, 2013.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.shading import ripples, trickles
from diffrender.shading.drying import DryBoxes
from diffrender.surfaces import EvenSky

WATER = 0.02  # share that water reflects at normal incidence: refraction 1.33
POROUS_FROM, POROUS_OVER = 0.5, 0.4  # roughness where ground begins to be porous, and over which it gets wholly so
SHORE = 0.4  # rise of the terrain over which a puddle ends
STEEP, LEVEL = 0.77, 0.94  # height of normals from which on water stays, and at which all of it does: 40 and 20 degrees


@record
class Wetness:
    """Water on the surfaces of a whole scene."""

    amount: Float[Tensor, ""] = parameter(
        0.6, bounds=(0.0, 1.0), unit="1", about="how wet what the rain reaches gets: turned up, darker and smoother"
    )
    soaked_albedo: Float[Tensor, ""] = parameter(
        0.2, bounds=(0.02, 1.0), unit="1",
        about="share of its colour that the most porous ground keeps when soaked: turned up, less dark",
    )  # fmt: skip
    hole_flood: Float[Tensor, ""] = parameter(
        0.3, bounds=(0.0, 1.0), unit="1", about="level of water in holes of the height map: turned up, joints fill"
    )
    puddle_flood: Float[Tensor, ""] = parameter(
        0.3, bounds=(0.0, 1.4), unit="1", about="level of water in dips of the terrain: turned up, puddles spread"
    )
    rain: Float[Tensor, ""] = parameter(
        0.5, bounds=(0.0, 1.0), unit="1", about="how much rain falls on puddles: turned up, more rings"
    )
    ripple_strength: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 2.0), unit="1", about="how steep the rings of raindrops are: turned up, mirrors break"
    )
    trickle_strength: Float[Tensor, ""] = parameter(
        0.5, bounds=(0.0, 2.0), unit="1", about="how steep rivulets on walls are: turned up, more glitter"
    )
    soaking_time: Float[Tensor, ""] = parameter(
        20.0, bounds=(1.0, 3600.0), unit="s", about="in which rain wets to two thirds: turned up, slower", scale="log"
    )
    drying_time: Float[Tensor, ""] = parameter(
        120.0, bounds=(1.0, 36000.0), unit="s", about="in which a third of the water is left under a roof: turned up, "
        "things stay wet", scale="log",
    )  # fmt: skip


@record
class WetView:
    """A view of a surface that is dry, its light, exposed already, and the water's places and times.

    The height map is 1 on top of cobbles and 0 in the joints; the terrain is 0 where puddles are deepest. `open` is the
    share of the rain that roofs let through, as from a depth map from above; `held` is the share of its water that a
    place held `elapsed` seconds ago, of which what has been in the rain for long may give any and a day.
    """

    position: Float[Tensor, "*#batch 3"]  # [m]
    normal: Float[Tensor, "*#batch 3"]
    to_eye: Float[Tensor, "*#batch 3"]
    base: Float[Tensor, "*#batch 3"]
    roughness: Float[Tensor, "*#batch"]
    metallic: Float[Tensor, "*#batch"]
    height: Float[Tensor, "*#batch"]
    terrain: Float[Tensor, "*#batch"]
    to_light: Float[Tensor, "*#batch 3"]
    irradiance: Float[Tensor, "*#batch 3"]  # where it faces the light, times what shadows leave of it [W/m²]
    sky: EvenSky
    open: Float[Tensor, "*#batch"]
    held: Float[Tensor, "*#batch"]
    elapsed: Float[Tensor, ""]  # [s]
    time: Float[Tensor, ""]  # of rings and rivulets [s]
    boxes: DryBoxes
    drops: Float[Tensor, "4 rows columns 4"]  # of `ripples.drops`
    waves: Float[Tensor, "waves 4"]  # of `trickles.waves`


# Base colour's brightness, roughness, metallic, height, terrain, what is held and open; elevations of normal and eye
# [degrees], eye's azimuth.
_EXAMPLES = (
    (0.30, 0.90, 0.0, 0.8, 0.6, 0.5, 1.0, 90.0, 40.0, 180.0),
    (0.30, 0.80, 0.0, 0.1, 0.5, 0.9, 1.0, 90.0, 25.0, 170.0),
    (0.50, 0.70, 0.0, 0.9, 0.03, 0.9, 1.0, 88.0, 35.0, 200.0),  # in a puddle
    (0.50, 0.65, 0.0, 0.2, 0.0, 0.95, 0.9, 84.0, 60.0, 30.0),
    (0.80, 0.45, 0.0, 0.7, 0.1, 0.8, 1.0, 64.0, 20.0, 150.0),  # where water begins to run off
    (0.10, 0.00, 0.0, 0.9, 0.8, 0.4, 1.0, 90.0, 50.0, 90.0),  # a mirror
    (0.70, 0.00, 1.0, 0.9, 0.9, 0.6, 1.0, 90.0, 20.0, 220.0),
    (0.60, 1.00, 1.0, 0.6, 0.9, 0.6, 0.7, 80.0, 45.0, 180.0),
    (0.40, 0.60, 0.0, 0.8, 0.05, 0.9, 1.0, 90.0, 4.0, 160.0),  # grazing
    (0.40, 0.20, 0.0, 0.8, 0.7, 0.7, 1.0, 90.0, 89.9, 0.0),  # straight down
    (0.25, 0.85, 0.0, 0.5, 0.5, 0.8, 1.0, 0.0, 10.0, 180.0),  # a wall
    (0.25, 0.75, 0.0, 0.5, 0.5, 0.8, 1.0, 35.0, 15.0, 190.0),
    (0.35, 0.90, 0.0, 0.3, 0.3, 0.9, 0.0, 90.0, 30.0, 120.0),  # under a roof
    (0.35, 0.90, 0.0, 0.3, 0.3, 0.0, 0.0, 90.0, 30.0, 120.0),  # and long dry
)


def example_inputs(dtype: torch.dtype) -> WetView:
    """Grounds, walls, metals and mirrors; flooded, grazing, under a roof, on the border of a dry box."""
    double = torch.tensor(_EXAMPLES, dtype=torch.float64)
    bright, roughness, metallic, height, terrain, held, is_open, steep, seen_at, turn = double.unbind(-1)
    count = torch.arange(len(_EXAMPLES), dtype=torch.float64)
    position = torch.stack([0.37 * count, 1.13 * count - 3.0, 0.2 * count], -1)

    def single(*numbers: float) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64)

    view = WetView(
        position=position,
        normal=from_angles(steep.deg2rad(), torch.full_like(steep, 2.9)),
        to_eye=from_angles(seen_at.deg2rad(), turn.deg2rad()),
        base=bright[:, None] * single(1.0, 0.9, 0.75),
        roughness=roughness,
        metallic=metallic,
        height=height,
        terrain=terrain,
        to_light=from_angles(single(35.0).deg2rad(), single(20.0).deg2rad())[0],
        irradiance=single(3.0, 2.8, 2.5),
        sky=EvenSky(single(0.5, 0.55, 0.65), single(0.25, 0.25, 0.2)),
        open=is_open,
        held=held,
        elapsed=torch.tensor(30.0, dtype=torch.float64),
        time=torch.tensor(10.2, dtype=torch.float64),
        boxes=DryBoxes(single(1.6, 0.0, 1.0)[None], single(1.5, 2.0, 2.0)[None], single(0.8)),
        drops=ripples.drops(5, torch.Generator().manual_seed(1)),
        waves=trickles.waves(8, torch.Generator().manual_seed(2)),
    )
    return cast(view, dtype)


def cast(view: WetView, dtype: torch.dtype) -> WetView:
    """The same view in another precision."""
    leaves = {name: value.to(dtype) for name, value in vars(view).items() if isinstance(value, Tensor)}
    sky = EvenSky(*(value.to(dtype) for value in vars(view.sky).values()))
    boxes = DryBoxes(*(value.to(dtype) for value in vars(view.boxes).values()))
    return WetView(**leaves, sky=sky, boxes=boxes)
