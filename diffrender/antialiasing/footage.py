"""Footage: scenes with so many samples in each pixel that their mean is the truth that anti-aliasing is held to.

The mean is taken of what the screen is sent, as the filters do, not of radiance.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.antialiasing.display import shown_srgb
from diffrender.images import places, sampled
from diffrender.parameters import record

FINENESS = 16  # samples along each side of a pixel: 256 in it


@record
class Footage:
    """Sequences as screens show them, FINENESS times as fine as the picture, and the motion of its pixels."""

    fine: Float[Tensor, "*batch time fine_height fine_width 3"]
    motion: Float[Tensor, "*batch time height width 2"]


def truth(fine: Float[Tensor, "*batch fine_height fine_width 3"]) -> Float[Tensor, "*batch height width 3"]:
    """Mean over each pixel."""
    return sampled(fine, FINENESS, (0.0, 0.0), 1.0)


def points(
    fine: Float[Tensor, "*batch fine_height fine_width 3"], offset: tuple[float, float]
) -> Float[Tensor, "*batch height width 3"]:
    """One sample in each pixel, an offset [pixels] off its centre."""
    return sampled(fine, FINENESS, offset, 0.0)


def spread(fine: Float[Tensor, "*batch height width 3"]) -> Float[Tensor, ""]:
    """Largest difference of two values: a mean of samples differs from another by no more."""
    return fine.amax() - fine.amin()


def example_pictures(dtype: torch.dtype) -> Float[Tensor, "pictures fine_height fine_width 3"]:
    """A slanted edge and a bright disc, thin lines, a checker of one pixel, and black, each 16 x 12 pixels."""
    place = places(16 * FINENESS, 12 * FINENESS, torch.zeros(2, dtype=torch.float64)) / FINENESS
    x, y = place.unbind(-1)
    edge = 0.2 + 0.5 * (y > 4.3 + x / 16.0)
    disc = torch.hypot(x - 10.2, y - 8.1) < 2.7
    lines = 0.1 + 2.0 * (((x * math.cos(1.2) + y * math.sin(1.2)) % 3.7) < 0.45)
    checker = 0.3 + 0.9 * ((x.floor() + y.floor()) % 2)
    grey = torch.stack([torch.where(disc, 9.0, edge), lines, checker, torch.zeros_like(x)])
    return shown_srgb(grey[..., None] * grey.new_tensor([1.0, 0.8, 0.6])).to(dtype)


def example_footage(dtype: torch.dtype) -> Footage:
    """Thin shapes at rest and a disc that passes a striped wall at 1.3 and 0.4 pixels a frame; 3 frames, 12 x 8."""
    time = torch.arange(3, dtype=torch.float64)[:, None, None]
    x, y = (places(12 * FINENESS, 8 * FINENESS, torch.zeros(2, dtype=torch.float64)) / FINENESS).unbind(-1)
    still = 0.1 + 0.8 * (torch.hypot(x - 6.2, y - 4.1) < 2.4) + 2.0 * (((x + 1.7 * y) % 4.3) < 0.3)
    wall = 0.2 + 0.6 * ((y + 0.3 * x) % 3.1 < 1.2)
    moving = torch.where(torch.hypot(x - 3.1 - 1.3 * time, y - 3.2 - 0.4 * time) < 2.1, 4.0, wall)
    grey = torch.stack([still.expand(3, -1, -1), moving])
    x, y = places(12, 8, torch.zeros(2, dtype=torch.float64)).unbind(-1)
    on_disc = torch.hypot(x - 3.1 - 1.3 * time, y - 3.2 - 0.4 * time) < 2.1
    motion = torch.where(on_disc[..., None], grey.new_tensor([-1.3, -0.4]), grey.new_zeros(2))
    fine = shown_srgb(grey[..., None] * grey.new_tensor([0.7, 1.0, 0.9]))
    return Footage(fine.to(dtype), torch.stack([torch.zeros_like(motion), motion]).to(dtype))
