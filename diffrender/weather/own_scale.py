"""A parameter's own scale, in which values are mixed: its logarithm, the shorter way round a circle, or as it is."""

from collections.abc import Sequence

import torch
from torch import Tensor

from diffrender.parameters import Specification


def difference(start: Tensor, end: Tensor, known: Specification) -> Tensor:
    """How far an end lies from a start: the logarithm of their ratio, the shorter turn, else end - start.

    Gradient: across half a circle, where the turn changes its sign, that of the turn taken.
    """
    if known.scale == "log":
        return torch.log(end / start)
    apart = end - start
    if known.turn is None:
        return apart
    return apart - known.turn * torch.round(apart / known.turn)


def mean(values: Sequence[Tensor], shares: Sequence[Tensor], known: Specification) -> Tensor:
    """Mean of values, weighted by shares from 0 to 1 whose sum is 1; values and shares broadcast.

    Measured from the value with the largest share: a share of 1 gives its value bit for bit, equal values give
    themselves, and no mean of two lies outside of them. Directions are turned the shorter way from that value, so the
    mean of three that lie all round a circle jumps where another share becomes the largest.

    Gradient: exact for shares that move without changing their sum.
    """
    spread: tuple[Tensor, ...] = torch.broadcast_tensors(*values, *shares)  # type: ignore[no-untyped-call]
    every, share = torch.stack(spread[: len(values)]), torch.stack(spread[len(values) :])
    largest = torch.gather(every, 0, share.argmax(0, keepdim=True))[0]
    step = (share * difference(largest, every, known)).sum(0)
    if known.scale == "log":
        return largest * torch.exp(step)
    there = largest + step
    if known.turn is None:
        return there
    low, high = known.bounds
    inside = (there >= low) & (there <= high)
    return torch.where(inside, there, low + torch.remainder(there - low, known.turn))
