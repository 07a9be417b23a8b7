"""Volumes: values on the cells of a box, and what lies between them."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.images import Address, wrapped

_OCTAVES = 3


def trilinear(
    volume: Float[Tensor, "depth rows columns channels"], place: Float[Tensor, "*batch 3"], address: Address
) -> Float[Tensor, "*batch channels"]:
    """Value at places, counted in cells by depth, row and column; a cell's centre is at +0.5, and its value is there.

    Gradient: of the volume, exact; of the place, the slope within the eight centres round it.
    By gather and lerp, because grid_sample has no forward-mode derivative.
    """
    corner = place - 0.5
    first = corner.detach().floor()
    nearest = first.long()
    # Both neighbours along each axis, each pair along an axis of its own, so that all eight are gathered at once.
    layer, row, column = (
        address(torch.stack([nearest[..., axis], nearest[..., axis] + 1]), volume.shape[axis]) for axis in range(3)
    )
    index = (layer[:, None, None] * volume.shape[1] + row[:, None]) * volume.shape[2] + column
    found = volume.flatten(0, 2)[index]
    for share in (corner - first).unbind(-1):
        found = torch.lerp(found[0], found[1], share[..., None])
    return found


def repeated(volume: Float[Tensor, "depth rows columns"], place: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Value at places of a volume that repeats without end, counted in its sizes; flat at every cell's centre.

    Between centres it rises by 3x² - 2x³, so that its gradient by the place has no jumps.
    """
    cells = place * place.new_tensor(volume.shape) - 0.5
    first = cells.detach().floor()
    share = cells - first
    eased = first + share * share * (3.0 - 2.0 * share)
    return trilinear(volume[..., None], eased + 0.5, wrapped)[..., 0]


def repeating_noise(size: int, generator: torch.Generator) -> Float[Tensor, "{size} {size} {size}"]:
    """Smooth noise from -1 to 1 that repeats without a seam: three octaves of random values, in float64.

    The finest has a value for each cell, the others for two and four of them: sizes are multiples of 4. Sums of random
    values seldom come near their bounds, so they are spread towards them: else fog has few holes at full strength.
    """
    total = torch.zeros(size, size, size, dtype=torch.float64)
    steps = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    place = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1)
    for octave in range(_OCTAVES):
        cells = size >> octave
        lattice = 2.0 * torch.rand(cells, cells, cells, generator=generator, dtype=torch.float64) - 1.0
        total = total + 2.0**octave * repeated(lattice, place)
    spread = torch.tanh(total / total.std())
    return spread / spread.abs().max()
