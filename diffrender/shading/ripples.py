"""Rings that raindrops make on puddles: four layers of them, each with one drop after another in every cell [1].

A drop's ring leaves its centre, widens to the drop's reach and fades; then the next one falls at the same place. Cells
repeat after a tile; a drop reaches no further than its cell's border, so that a place has to look at one cell alone.
Where [1] reads a texture, this is a formula over a small tensor of drops, which a seed makes.

Gradient: of amounts exact, 0 where one stands still at its bound; of places and times exact but at a ring's fronts.

[1] S. Lagarde, "Water drop 2b - Dynamic rain and its effects", seblagarde.wordpress.com, 2013.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

CELL = 0.25  # side of a cell [m]
DROPS_PER_SECOND = 1.6  # in a cell of a layer [1]
_RATES, _LATER = (1.0, 0.85, 0.93, 1.13), (0.0, 0.2, 0.45, 0.7)  # of the layers [1]
_STEEPEST = 0.35  # slope of a ring at its steepest, at a strength of 1 [1]
_ASIDE = ((0.0, 0.0), (0.53, 0.29), (0.17, 0.71), (0.79, 0.41))  # of the layers' cells [cells]


def drops(cells: int, generator: torch.Generator) -> Float[Tensor, "4 {cells} {cells} 4"]:
    """A tile of drops for `slope`: of each layer and cell, where in it a drop falls, how far it reaches, and when.

    The place and the reach are in cells, the moment is a share of the time between two drops.
    """
    uneven = torch.rand(4, cells, cells, 4, generator=generator, dtype=torch.float64)
    reach = 0.25 + 0.25 * uneven[..., 2]
    place = reach[..., None] + uneven[..., :2] * (1.0 - 2.0 * reach[..., None])
    return torch.stack([place[..., 0], place[..., 1], reach, uneven[..., 3]], -1)


def slope(
    tile: Float[Tensor, "4 rows columns 4"],
    place: Float[Tensor, "*batch 2"],
    time: Float[Tensor, "*#batch"],
    amount: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch 2"]:
    """How far the water's normal leans along x and y, by an amount of rain from 0 to 1.

    With more rain one layer after the other sets in, and rings live longer. Times are good to a hundredth of a ring's
    life: in float32 up to a day.
    """
    total = torch.zeros_like(place)
    for layer, drops_of in enumerate(tile):
        strength = (4.0 * (amount - 0.25 * layer)).clamp(0.0, 1.0)
        when = DROPS_PER_SECOND * (_RATES[layer] * time + _LATER[layer])
        total = total + strength[..., None] * _layer(drops_of, place / CELL + place.new_tensor(_ASIDE[layer]),
                                                     when, strength)  # fmt: skip
    return _STEEPEST * total


def _layer(drops_of: Tensor, cell: Tensor, when: Tensor, strength: Tensor) -> Tensor:
    """Slope of one layer's rings at places in cells."""
    corner = cell.detach().floor()
    rows, columns = drops_of.shape[:2]
    index = corner.long()
    found = drops_of.to(cell).flatten(0, 1)[index[..., 1].remainder(rows) * columns + index[..., 0].remainder(columns)]
    reach = found[..., 2]
    aside = (cell - corner - found[..., :2]) / reach[..., None]
    square = aside.square().sum(-1)
    is_centre = square == 0.0
    far = torch.where(is_centre, square, torch.where(is_centre, torch.ones_like(square), square).sqrt())
    near = (1.0 - far).clamp(min=0.0)  # 1 at the drop, 0 where its ring ends
    age = (found[..., 3] + when).remainder(1.0)
    fading = (0.2 + 0.8 * strength - age).clamp(0.0, 1.0)
    rings = torch.sin(math.pi * (9.0 * (age - 1.0 + near)).clamp(0.0, 3.0))
    # Towards the centre the direction has none; a slope that ends there keeps the water smooth.
    return (fading * near * rings * (2.0 - far).clamp(min=0.0))[..., None] * aside
