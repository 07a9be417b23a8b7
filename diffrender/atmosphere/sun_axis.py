"""The axis of stored tables over the sun's elevation: where its cells lie, and values between them.

Between cells the logarithm is linear, because in twilight light falls by a factor of ten within a few degrees, and
thicker air dims it by a factor for each amount.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import lookup

CELLS = 64
LOWEST = math.radians(-21.0)  # below it a sky is fainter than starlight, and counts as black
HIGHEST = math.pi / 2.0
_SCALE = math.radians(5.0)  # elevation over which the cells are dense round the horizon
_FIRST, _LAST = math.asinh(LOWEST / _SCALE), math.asinh(HIGHEST / _SCALE)
_DARK = 1e-12  # value far below those of the deepest twilight, by which 0 keeps a logarithm


def elevations(index: Float[Tensor, " n"], count: int) -> Float[Tensor, " n"]:
    """Elevations of the sun [rad] at whole indices among a number of cells, evenly spaced in asinh.

    The first is the nadir's: the night, into which the light of the second fades.
    """
    # The clamp keeps the zenith from being missed by rounding.
    spaced = torch.clamp(_SCALE * torch.sinh(_FIRST + (_LAST - _FIRST) / (count - 1) * index), max=HIGHEST)
    return torch.where(index < 0.5, -math.pi / 2.0, spaced)


def place(elevation: Float[Tensor, ""], count: int) -> Float[Tensor, ""]:
    """Fractional index of an elevation [rad] among a number of cells; that of the nearer end beyond them."""
    return torch.clamp((torch.asinh(elevation / _SCALE) - _FIRST) / (_LAST - _FIRST), 0.0, 1.0) * (count - 1)


def between(table: Float[Tensor, " cells *shape"], index: Float[Tensor, ""]) -> Float[Tensor, "*shape"]:
    """Values of a table of nothing negative at a fractional index of its first axis, by their logarithms.

    Whole indices give its own entries up to rounding; where both neighbours are 0 it is exactly 0.
    """
    # One place, not none: a whole number without an axis cannot be taken from a tensor without numbers.
    found: Tensor = lookup(torch.log1p(table / _DARK)[:, None], index[None], torch.zeros_like(index)[None])
    return _DARK * torch.expm1(found[0])
