"""Things that wind moves, for pictures and measurements: a meadow, plants, a banner and a head of hair.

The meadow's wind is one drawn gust and a ripple across it; banner and hair hang in a calm that a gust ends, with
short waves that stand for its eddies. All in float64.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.weather import bending, bones, wind
from diffrender.weather.bones import Bones, Chain
from diffrender.weather.drawn_curve import DrawnCurve
from diffrender.weather.wind import Wave

GUST = ((0.0, 0.05), (0.42, 0.1), (0.55, 1.0), (0.68, 0.45), (0.85, 0.15))  # a quick rise and a slow fall
RIPPLE = ((0.0, 0.0), (0.5, 1.0))
ONSET = ((0.0, 0.02), (0.05, 0.05), (0.2, 1.0), (0.35, 0.6), (0.5, 0.85), (0.8, 0.1))
EDDY = ((0.0, -1.0), (0.45, 1.0))
SWAY = 0.12  # share of a lean that flutters
SWAY_RATE = 9.0  # [rad/s]
CLOTH = (0.8, 0.6)  # width across the wind per mass per length: a heavy cloth of 0.75 kg/m²
LOCKS = 40
STRAND = (0.004, 0.003)  # of a lock that its neighbours shelter [m], [kg/m]


def wave(curve: Sequence[tuple[float, float]], azimuth: float, *numbers: float) -> Wave:
    """A wave of keyframes (place, value) towards an azimuth [rad], with strength, wavelength and period."""
    places, values = torch.tensor(curve, dtype=torch.float64).unbind(-1)
    towards = torch.tensor([math.cos(azimuth), math.sin(azimuth), 0.0], dtype=torch.float64)
    strength, wavelength, period = torch.tensor(numbers, dtype=torch.float64)
    return Wave(DrawnCurve(places, values), towards, strength, wavelength, period)


def meadow_wind() -> list[Wave]:
    """A gust that travels to the right and a little away at 9 m/s, and a ripple of it."""
    return [wave(GUST, 0.2, 10.0, 36.0, 4.0), wave(RIPPLE, -0.35, 1.6, 3.1, 0.6)]


def close_wind() -> list[Wave]:
    """Wind from which banner and hair are blown: calm, a gust within the first second, and eddies of a metre or two."""
    return [
        wave(ONSET, 0.0, 4.0, 60.0, 6.0),
        wave(EDDY, 0.9, 0.7, 1.7, 0.6),
        wave(EDDY, -0.7, 0.5, 0.9, 0.37),
    ]


@record
class Meadow:
    """Blades of grass, each a narrow ribbon round a stem."""

    root: Float[Tensor, "blades 3"]  # [m]
    length: Float[Tensor, " blades"]  # [m]
    width: Float[Tensor, " blades"]  # at the root [m]
    facing: Float[Tensor, " blades"]  # azimuth of the ribbon's width [rad]
    grown: Float[Tensor, "blades 2"]  # lean without wind [rad]
    flexibility: Float[Tensor, " blades"]  # [rad s²/m²]
    phase: Float[Tensor, " blades"]  # of its flutter [rad]


def meadow(blades: int, near: float, far: float) -> Meadow:
    """A meadow before an eye at the origin that looks along y; farther blades are fewer, and wider for it."""
    drawn = torch.rand(9, blades, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    distance = near * (far / near) ** drawn[0]
    across = (2.0 * drawn[1] - 1.0) * (0.8 * distance + 1.0)
    grown = 0.3 * torch.stack([drawn[2] + drawn[3] - 1.0, drawn[4] + drawn[5] - 1.0], -1)
    return Meadow(
        root=torch.stack([across, distance, torch.zeros_like(across)], -1),
        length=0.45 + 0.5 * drawn[6],
        width=0.0022 * distance * (0.6 + 0.8 * drawn[2]),
        facing=math.pi * drawn[7],
        grown=grown,
        flexibility=0.012 * (0.6 + 1.2 * drawn[8]),
        phase=100.0 * drawn[5],
    )


def leans(land: Meadow, velocity: Float[Tensor, "blades 3"], seconds: float) -> Float[Tensor, "blades 2"]:
    """Leans of the blades' tips [rad] in a wind: the wind's, fluttering, and what they have grown with."""
    sway = bending.flutter(land.phase + SWAY_RATE * seconds)
    return land.grown + bending.lean(velocity, land.flexibility) * (1.0 + SWAY * sway.sum(-1, keepdim=True))


def blown(land: Meadow, waves: Sequence[Wave], seconds: float) -> Float[Tensor, "blades 2"]:
    """Leans in the wind at a time."""
    return leans(land, wind.velocity(waves, land.root, land.root.new_tensor(seconds)), seconds)


def ribbons(land: Meadow, lean: Float[Tensor, "blades 2"], pieces: int) -> Float[Tensor, "blades heights 2 3"]:
    """Left and right edge of every blade, from the root to a pointed tip [m]."""
    share = torch.linspace(0.0, 1.0, pieces + 1).to(lean)
    height = land.length[:, None] * share
    half = 0.5 * land.width[:, None] * (1.0 - share**2)
    sides = torch.stack([-half, half], -1)
    turned = torch.stack([torch.cos(land.facing), torch.sin(land.facing)], -1)
    upright = torch.cat(
        [sides[..., None] * turned[:, None, None, :], height[..., None, None].expand(*sides.shape, 1)], -1
    )
    bent = bending.bent(upright, lean[:, None, None, :], land.length[:, None, None])
    return land.root[:, None, None, :] + bent


@record
class Hung:
    """Chains with the places where they are held."""

    bones: Bones
    root: Float[Tensor, "chains 3"]  # [m]


def banner(chains: int, joints: int) -> Hung:
    """A cloth of 1.2 m by 1.7 m that hangs from a bar along y."""
    down = torch.linspace(0.0, 1.7, joints, dtype=torch.float64)
    rest = torch.stack([torch.zeros_like(down), torch.zeros_like(down), -down], -1)
    across = torch.linspace(-0.6, 0.6, chains, dtype=torch.float64)
    root = torch.stack([torch.zeros_like(across), across, torch.full_like(across, 2.6)], -1)
    return Hung(Bones(rest, bones.drag_of(*_numbers(CLOTH)), *_numbers((9.0,)), *_numbers((1.2,))), root)


def hair(strands: int, joints: int) -> Hung:
    """Hair that falls from the top and the sides of a head of 0.1 m in radius at the origin, which looks along -x.

    Strands follow the head to its back, then hang; wind towards x blows them away from it. They go in locks, within
    which wind finds nearly the same drag.
    """
    generator = torch.Generator().manual_seed(5)
    drawn = torch.rand(4, strands, generator=generator, dtype=torch.float64)
    locks = torch.rand(2, LOCKS, generator=generator, dtype=torch.float64)[:, torch.arange(strands) % LOCKS]
    side = 1.5 * locks[0] - 1.1 + 0.25 * (drawn[0] - 0.5)  # angle of the strand's circle from the middle
    radius = 0.1 * (1.0 + 0.1 * drawn[1])
    level = radius * torch.cos(side)
    begin = -0.6 + 1.9 * drawn[2]  # angle of the root from the top towards the back
    along = torch.linspace(0.0, 1.0, joints, dtype=torch.float64) * (0.27 + 0.1 * locks[1] + 0.04 * drawn[3])[:, None]
    angle = begin[:, None] + along / level[:, None]
    hanging = (angle - math.pi / 2.0).clamp(min=0.0) * level[:, None]  # below the place where the head is deepest
    round_it = angle.clamp(max=math.pi / 2.0)
    across = (radius * torch.sin(side))[:, None].expand_as(angle)
    upright = level[:, None] * torch.cos(round_it) - hanging
    rest = torch.stack([level[:, None] * torch.sin(round_it) + 0.1 * hanging, across, upright], -1)
    root = rest[:, 0]
    drag = bones.drag_of(*_numbers(STRAND)) * (0.7 + 0.5 * locks[1] + 0.15 * drawn[3])[:, None]
    # Near the root hair is held by what lies on it; its tip moves freely.
    stiffness = 25.0 + 400.0 * torch.exp(-along / 0.05)
    return Hung(Bones(rest - root[:, None, :], drag, stiffness, torch.full_like(drag, 8.0)), root)


def _numbers(values: Sequence[float]) -> list[Tensor]:
    return [torch.tensor([value], dtype=torch.float64) for value in values]


def swung(hung: Hung, waves: Sequence[Wave], seconds: float, rate: int) -> list[Chain]:
    """Chains from rest on, at every step of `rate` in a second."""
    found = [bones.at_rest(hung.bones, hung.root)]
    for number in range(round(seconds * rate)):
        chain = found[-1]
        blowing = wind.velocity(waves, chain.joint, chain.joint.new_tensor(number / rate))
        found.append(bones.step(hung.bones, chain, hung.root, blowing, 1.0 / rate))
    return found
