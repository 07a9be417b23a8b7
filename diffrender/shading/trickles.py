"""Water that trickles down walls: rivulets whose normals move with it.

The thickness of the film is that of some waves, each much longer down the slope than across, that run downwards at
their own speeds; where they add up to less than nothing there is no water, else it is their square, so that rivulets
have round edges. It is looked up across the two walls of the axes, and walls between are a mixture of both by their
direction, so that none of it needs coordinates of the surface.

A seed makes the waves. Nothing of it is from the talk or a measurement: it is to be looked at.

Gradient: exact; the second derivative jumps at the edges of rivulets.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record

ACROSS, DOWN = (0.04, 0.2), (0.8, 4.0)  # shortest and longest waves across and down the slope [m]
SPEED = (0.1, 0.4)  # slowest and fastest [m/s]
_STEEPEST = 0.6  # about the slope of a rivulet's edge at a strength of 1


def waves(count: int, generator: torch.Generator) -> Float[Tensor, "{count} 4"]:
    """Waves for `lean`: of each how fast it turns across and down the slope [rad/m], its speed [m/s] and its start."""
    uneven = torch.rand(count, 5, generator=generator, dtype=torch.float64)
    across, down = (_between(limits, uneven[:, axis]) for axis, limits in enumerate((ACROSS, DOWN)))
    turn = 2.0 * math.pi * torch.where(uneven[:, 4] < 0.5, -1.0, 1.0)
    return torch.stack([turn / across, turn.abs() / down, _between(SPEED, uneven[:, 2]), turn * uneven[:, 3]], -1)


@record
class Rivulets:
    """What they add to a unit normal at a strength of 1, along the surface, and how thick their film is, about 1.

    Both are 0 where a surface is level.
    """

    lean: Float[Tensor, "*batch 3"]
    film: Float[Tensor, "*batch"]


def rivulets(
    waves: Float[Tensor, "waves 4"],
    position: Float[Tensor, "*batch 3"],
    normal: Float[Tensor, "*batch 3"],
    time: Float[Tensor, "*#batch"],
) -> Rivulets:
    """Rivulets on surfaces of a unit normal; in float32 good to a hundredth for an hour."""
    x, y, z = position.unbind(-1)
    of_x, of_y = (_film(waves.to(position), across, -z, time) for across in (x, y))
    facing_x, facing_y = normal[..., 0] ** 2, normal[..., 1] ** 2
    # A wall that faces x is crossed along y. Down is -z.
    added = torch.stack([facing_y * of_x[0], facing_x * of_y[0], -(facing_y * of_x[1] + facing_x * of_y[1])], -1)
    lean = -_STEEPEST * (added - normal * (added * normal).sum(-1, keepdim=True))
    return Rivulets(lean, facing_y * of_x[2] + facing_x * of_y[2])


def _film(waves: Tensor, across: Tensor, down: Tensor, time: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Slope of the film across and down the wall, and its thickness; each about 1 at most."""
    turn_across, turn_down, speed, start = waves.unbind(-1)
    wave = turn_across * across[..., None] + turn_down * (down[..., None] - speed * time[..., None]) + start
    level, rise = torch.sin(wave).sum(-1).clamp(min=0.0), torch.cos(wave)
    # Over the root mean squares of the sums of waves and of their slopes.
    weight = level / (0.5 * math.sqrt(waves.shape[0]) * torch.linalg.vector_norm(turn_across))
    slopes = [weight * (rise * turn).sum(-1) for turn in (turn_across, turn_down)]
    return slopes[0], slopes[1], level * level / waves.shape[0]


def _between(limits: tuple[float, float], share: Tensor) -> Tensor:
    low, high = limits
    return low * (high / low) ** share
