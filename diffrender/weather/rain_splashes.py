"""Splashes: a crown of small drops that leap from where a drop landed, and fall again.

The talk [1] emits particles from the surface and says no more. Here each drop that lands throws `DROPLETS`, upwards
and apart at speeds that differ from drop to drop; they fly without drag for `SPLASH` seconds, and shrink meanwhile.
What they land on again is not asked, but they last about as long as they take to fall back at the talk's gravity.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Rain".
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.weather.rain_drops import Drops

DROPLETS = 4
SPLASH = 0.2  # how long a crown lasts [s]
UPWARDS = 1.1  # speed at which droplets leap, at most [m/s]
APART = 0.7  # speed at which they part, at most [m/s]
_LEAST = 0.5  # of either speed, of the weakest crown


def sides(drops: Drops) -> Float[Tensor, "drops droplets 3"]:
    """Level unit vectors to the sides to which droplets part, evenly round each drop."""
    number = torch.arange(DROPLETS, device=drops.chance.device).to(drops.chance)
    turn = (number + drops.chance[:, 1, None]) * (2.0 * math.pi / DROPLETS)
    return torch.stack([torch.cos(turn), torch.sin(turn), torch.zeros_like(turn)], -1)


def leaps(drops: Drops) -> Float[Tensor, "drops droplets 3"]:
    """Velocities at which droplets leave the drop's rim [m/s]."""
    strength = _LEAST + (1.0 - _LEAST) * drops.chance[:, 0]
    return strength[:, None, None] * (APART * sides(drops) + drops.chance.new_tensor([0.0, 0.0, UPWARDS]))


def shrunk(since: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Size of a droplet over that of its drop, by the time since that landed [s]: from 2/3 to nothing."""
    return (2.0 / 3.0) * torch.clamp(1.0 - since / SPLASH, 0.0, 1.0)
