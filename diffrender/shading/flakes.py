"""Metal flakes in varnish: how many of them face a direction, one by one or all together, and the sky in them.

Flakes lie about the surface, their slopes spread as Gauss has it [1]. Each is a mirror that is not quite flat: its own
slopes are spread by `WAVY` about its mean, which is drawn so that all flakes together have the spread that is given,
exactly. So flakes that are counted have the mean brightness of even ones.

A sheet of flakes is a grid of cells of the flakes' size, each with one flake that a hash of the cell's numbers turns,
the same in every frame. Where a pixel covers more than one, cells are taken that are 2, 4, 8... times as wide, so that
a cell is about a pixel and glints neither crawl nor flicker as it moves; such a cell of n flakes differs from the even
sheet by 1 / sqrt(n) of what one does, as the mean of n does [2, 3]. Two sizes are blended, so that none pops; half-way
between them glints are fainter by 1 / sqrt(2) than they should be. Flakes are square when seen from near.

Inside varnish no direction is more than 42 degrees from the normal, so flakes hide each other nowhere.

Gradient: exact in the spread, slopes and the footprint, in which it has kinks at 1, 2, 4... flakes; none of which flake
it is that is seen.

[1] S. Ershov, K. Kolchin, K. Myszkowski, "Rendering Pearlescent Appearance Based On Paint-Composition Modelling",
    Eurographics 2001.
[2] W. Jakob et al., "Discrete Stochastic Microfacet Models", SIGGRAPH 2014.
[3] T. Deliot, L. Belcour, "Real-Time Rendering of Glinty Appearances using Distributed Binomial Laws on Anisotropic
    Grids", High-Performance Graphics 2023. Its grids by a pixel's size; counts there are binomial.
"""

import math
from functools import cache

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from diffrender.numerics import lookup
from diffrender.shading.microfacet import LEAST_COSINE, fresnel_exact

WAVY = 0.05  # spread of one flake's slopes
WIDEST = 0.5  # spread of all flakes' slopes that the table goes to
_TURN = 2.4  # of the grid from one size of cells to the next, so that their borders do not coincide [rad]
_MIX = 0x45D9F3B  # odd and below 2^27: products with 32 bits stay below 2^63
_BITS = 0xFFFFFFFF
_COSINES, _SPREADS = 65, 33  # of the table of the sky
_SHARES, _TURNS = 64, 48  # nodes of its quadrature


def even(slope: Float[Tensor, "*batch 2"], spread: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Share of all flakes per unit of slope, about one slope."""
    square = spread * spread
    return torch.exp(-slope.square().sum(-1) / square) / (math.pi * square)


def counted(
    slope: Float[Tensor, "*batch 2"],
    spread: Float[Tensor, "*#batch"],
    place: Float[Tensor, "*batch 2"],
    footprint: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch"]:
    """The same of the flakes that a pixel sees; place and the pixel's width on the sheet are in flakes."""
    level = torch.log2(footprint.clamp(min=1.0))
    lower = level.detach().floor()
    whole, upper_share = even(slope, spread), level - lower
    found = whole
    for above, share in ((0.0, 1.0 - upper_share), (1.0, upper_share)):
        size = torch.exp2(lower + above)
        own = (slope - drawn(spread, cell(place, lower + above), lower + above)).square().sum(-1)
        one = torch.exp(-own / WAVY**2) / (math.pi * WAVY**2)
        found = found + share / size * (one - whole)
    return found


def cell(place: Float[Tensor, "*batch 2"], level: Float[Tensor, "*#batch"]) -> Int64[Tensor, "*batch 2"]:
    """Numbers of the cell of a place, in cells of 2 to the power of the level flakes."""
    turn, size = _TURN * level, torch.exp2(level)
    x, y = place.detach().unbind(-1)
    across, along = torch.cos(turn) * x - torch.sin(turn) * y, torch.sin(turn) * x + torch.cos(turn) * y
    return torch.stack([across / size, along / size], -1).floor().long()


def drawn(
    spread: Float[Tensor, "*#batch"], cell: Int64[Tensor, "*batch 2"], level: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 2"]:
    """Mean slope of a cell's flake: Gaussian, and with its own waviness as wide as the spread of all."""
    column, row = cell.unbind(-1)
    # One after the other: mixed all at once, sixths of the cells would have the same flake as another.
    here = _mixed(_mixed(_mixed(level.long() + 1) + column) + row)
    there = _mixed(here + 1)
    # Twenty-three bits and a half, which float32 holds, and never 0.
    share, turn = (((bits >> 9).to(spread) + 0.5) / 2.0**23 for bits in (here, there))
    far = torch.sqrt((spread * spread - WAVY**2) * -torch.log(share))
    return far[..., None] * torch.stack([torch.cos(2.0 * math.pi * turn), torch.sin(2.0 * math.pi * turn)], -1)


def _mixed(seed: Tensor) -> Tensor:
    """Thirty-two bits, each of which hangs on all of the seed's."""
    bits = seed & _BITS
    for _ in range(2):
        bits = ((bits ^ (bits >> 16)) * _MIX) & _BITS
    return bits ^ (bits >> 16)


def moments(
    index: float, spread: Float[Tensor, "*#batch"], cos_eye: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3"]:
    """What gets out to an even sky of the light that an eye's ray meets white flakes with: as `clear_coat.moments`.

    The ray has crossed the varnish's surface, of that index, by all of it; on the way out it is dimmed as a smooth
    surface does. What meets it from within at more than 42 degrees is lost.
    """
    row = cos_eye.clamp(LEAST_COSINE, 1.0).sqrt() * (_COSINES - 1.0)
    column = spread * ((_SPREADS - 1.0) / WIDEST)
    row, column = row + 0.0 * column, column + 0.0 * row
    return lookup(_moments(index).to(cos_eye), row, column)


@cache
def _moments(index: float) -> Float64[Tensor, "65 33 3"]:
    """Table of `moments` over the root of the cosine and the spread. Made once."""
    cosine = torch.linspace(0.0, 1.0, _COSINES, dtype=torch.float64).square()
    spread = torch.linspace(0.0, WIDEST, _SPREADS, dtype=torch.float64)
    return torch.stack([_column(index, one, cosine) for one in spread], 1)


def _column(index: float, spread: Tensor, cosine: Tensor) -> Tensor:
    """Of one spread; nodes are even in cube roots of flakes' shares, finest in the tail, and in angles."""
    left = ((torch.arange(_SHARES, dtype=torch.float64) + 0.5) / _SHARES)[:, None]
    turn = (torch.arange(_TURNS, dtype=torch.float64) + 0.5) * (math.pi / _TURNS)
    far = spread * (-3.0 * torch.log(left)).sqrt()
    towards, across = far * torch.cos(turn), far * torch.sin(turn)
    # Not straight down, where the sine is 0 and the plane of the mirror none.
    cos_eye = cosine.clamp(LEAST_COSINE, 1.0 - 2e-3)[:, None, None]
    sin_eye = (1.0 - cos_eye * cos_eye).sqrt()
    flat = sin_eye / index
    within = (1.0 - flat * flat).sqrt()
    # Flakes as the eye sees them, over their number: those that face it look larger.
    facing = (1.0 + towards * flat / within).clamp(min=0.0)
    twice = 2.0 * facing * within / (1.0 + towards.square() + across.square())
    level, height = twice * towards - flat, twice - within
    cos_square = 1.0 - index * index * (1.0 - height.square())
    leaves = (cos_square > 0.0) & (height > 0.0)
    cos_light = torch.where(leaves, cos_square, torch.zeros_like(cos_square)).sqrt()
    weight = 3.0 * left.square() * facing * (1.0 - fresnel_exact(index, cos_light))
    weight = torch.where(leaves, weight, torch.zeros_like(weight))
    aside = -index * level / sin_eye
    return torch.stack([(weight * part).mean((1, 2)) for part in (torch.ones_like(aside), cos_light, aside)], -1)
