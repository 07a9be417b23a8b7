"""Shadows of lamps: for each a square of one atlas of depths, which holds all directions into which the lamp shines.

Directions lie on a square as on an octahedron that is unfolded [1], whose tip is the lamp's axis: a point needs all of
it, a spot the middle, so that one map and one formula do for both. A margin round the square holds what comes next on
the octahedron, so that no look-up has to fold. Texels hold minus the way from the lamp to what first catches its light
[m]: as on maps of the sun, more is nearer to the light.

Places are lifted off their surface by some widths of a texel, so that it does not shade itself; what stands lower than
that casts no shadow.

Gradient: exact, of the depths, places, lamps and softness; of the place in the square its slope within a cell.

[1] T. Engelhardt, C. Dachsbacher, "Octahedron Environment Maps", VMV 2008.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.images import share_above
from diffrender.numerics import safe_sqrt
from diffrender.parameters import record
from diffrender.rays import unit

MARGIN = 2  # texels of a square at each side beyond what it shows: comparisons reach so far
LIFT = 1.5  # of places off their surface [widths of a texel]


@record
class Squares:
    """Where the maps of lamps are in their atlas."""

    corner: Int[Tensor, "*lamps 2"]  # row and column of the first texel
    size: Int[Tensor, "*lamps"]  # texels along a side, the margins included
    span: Float[Tensor, "*lamps"]  # half of the side, of which the unfolded octahedron's is 1


@record
class Shadows:
    """Maps of lamps, all of which have one."""

    squares: Squares
    atlas: Float[Tensor, "rows columns"]  # [m], all of it finite: where nothing is caught, minus more than any reach
    softness: Float[Tensor, ""]  # of the comparison, above 0 [widths of a texel]: turned up, edges are softer


def on_octahedron(along: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Place in the square from -1 to 1 of a direction, given by its parts across, aside and along the axis.

    It need not be of unit length; none at all is in the middle, as the axis is.

    >>> on_octahedron(torch.tensor([[0.0, 0.0, 2.0], [1.0, 0.0, 0.0], [1.0, 1.0, -2.0]]))
    tensor([[0.0000, 0.0000],
            [1.0000, 0.0000],
            [0.7500, 0.7500]])
    """
    total = along.abs().sum(-1, keepdim=True)
    place = along / torch.where(total > 0.0, total, torch.ones_like(total))
    flat = place[..., :2]
    side = torch.where(flat < 0.0, -torch.ones_like(flat), torch.ones_like(flat))
    return torch.where(place[..., 2:] < 0.0, (1.0 - flat.abs().flip(-1)) * side, flat)


def from_octahedron(place: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
    """Unit direction of a place; up to 1 beyond the square's sides that of where the octahedron goes on.

    >>> from_octahedron(torch.tensor([[1.1, 0.3], [0.9, -0.3]]))
    tensor([[ 0.9526, -0.1361, -0.2722],
            [ 0.9526, -0.1361, -0.2722]])
    """
    right, down = place.unbind(-1)
    for _ in range(2):
        # Over the first side, then over the other: half a turn round the middle of that side.
        is_over = right.abs() > 1.0
        right, down = torch.where(is_over, 2.0 * right.sign() - right, right), torch.where(is_over, -down, down)
        right, down = down, right
    ahead = 1.0 - right.abs() - down.abs()
    behind = torch.relu(-ahead)
    # On the half behind, |own| + |other| is 1 more than that: 1 - |other|, as it is folded, is |own| less how far.
    parts = [one - one.sign() * behind for one in (right, down)]
    return unit(torch.stack([*parts, ahead], -1))


def span(cos_outer: Float[Tensor, "*lamps"], size: Int[Tensor, "*lamps"]) -> Float[Tensor, "*lamps"]:
    """Half of the side of squares of so many texels that hold cones of an outer cosine, and their margins.

    >>> span(torch.tensor([-2.0, 0.8]), torch.tensor([20, 20]))
    tensor([1.2500, 0.5357])
    """
    cosine = cos_outer.clamp(0.0, 1.0)
    sine = safe_sqrt(1.0 - cosine * cosine)
    reached = torch.where(cos_outer > 0.0, sine / (sine + cosine), torch.ones_like(sine))
    return reached * size / (size - 2 * MARGIN)


def texel_directions(size: int, span: Float[Tensor, ""]) -> Float[Tensor, "{size} {size} 3"]:
    """Directions of the middles of a square's texels, by their parts across, aside and along the lamp's axis.

    A map is minus the length of rays from the lamp along them to what they first meet.
    """
    middle = (2.0 * (torch.arange(size).to(span) + 0.5) / size - 1.0) * span
    return from_octahedron(torch.stack(torch.meshgrid(middle, middle, indexing="ij"), -1))


def share(
    shadows: Shadows, place: Float[Tensor, "*batch 3"], normal: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch"]:
    """Share of lamps' light that reaches places past what their maps hold: soft comparisons with 3 × 3 texels.

    Place from the lamp [m] and unit normal are given by their parts across, aside and along the lamp's axis; the last
    axis but that is of lamps. A place in the lamp is lit.
    """
    squares = shadows.squares
    up = lifted(shadows, place, normal)
    last = squares.size - 1

    def texel(row: Tensor, column: Tensor) -> Tensor:
        # Held within the square: beside it lies another lamp's.
        down, across = (torch.minimum(one.clamp(min=0), last) for one in (row, column))
        return shadows.atlas[squares.corner[..., 0] + down, squares.corner[..., 1] + across]

    softness = shadows.softness * _width(squares, place)
    return share_above(-safe_sqrt(up.square().sum(-1)), softness, in_square(squares, up), texel)


def lifted(
    shadows: Shadows, place: Float[Tensor, "*batch 3"], normal: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Place off its surface from which it is compared [m], as places are given to `share`."""
    return place + (LIFT * _width(shadows.squares, place))[..., None] * normal


def in_square(
    squares: Squares, along: Float[Tensor, "*batch 3"]
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Row and column of directions in lamps' squares [texels], whole numbers at texels' middles."""
    place = (on_octahedron(along) / squares.span[..., None] + 1.0) * (0.5 * squares.size[..., None]) - 0.5
    return place[..., 0], place[..., 1]


def _width(squares: Squares, place: Tensor) -> Tensor:
    """Of a texel at a place at most [m]: amid the octahedron's faces they are thrice as wide as at its corners."""
    way = safe_sqrt(place.square().sum(-1))
    is_none = way == 0.0
    along = place.abs().sum(-1)
    widening = along * along / torch.where(is_none, torch.ones_like(way), way)
    return 2.0 * squares.span / squares.size * torch.where(is_none, torch.ones_like(way), widening)
