"""What carries a weather: areas and sequences, and the transition from one weather to the next.

Each has a share from 0 to 1 that says how much of its weather there is. All of them begin and end smoothly; a fade of 0
is a cut.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import safe_sqrt, smooth_rise
from diffrender.parameters import record


@record
class Area:
    """A box along the axes, whose weather fades with the distance from it.

    Attributes:
        lowest: corner with the smallest coordinates [m].
        highest: corner with the largest ones [m].
        fade: distance at which nothing of its weather is left [m].
    """

    lowest: Float[Tensor, "3"]
    highest: Float[Tensor, "3"]
    fade: Float[Tensor, ""]


@record
class Sequence:
    """A stretch of time, such as a cutscene, whose fades lie inside: before and after it nothing is changed.

    Attributes:
        start: when its weather begins to come [s].
        end: when it has gone [s].
        fade_in: how long it comes [s].
        fade_out: how long it goes [s].
    """

    start: Float[Tensor, ""]
    end: Float[Tensor, ""]
    fade_in: Float[Tensor, ""]
    fade_out: Float[Tensor, ""]


@record
class Transition:
    """The time in which a weather becomes another.

    Attributes:
        start: when it begins [s].
        length: how long it takes [s].
    """

    start: Float[Tensor, ""]
    length: Float[Tensor, ""]


def share_at(area: Area, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Share of an area's weather: 1 in the box and on its faces, 0 from its fade on, round its corners.

    Gradient: 0 in the box and on its faces.

    >>> box = Area(torch.zeros(3), torch.ones(3), torch.tensor(4.0))
    >>> share_at(box, torch.tensor([[0.5, 1.0, 0.0], [3.0, 0.5, 0.5], [0.5, 9.0, 0.5]]))
    tensor([1.0000, 0.5000, 0.0000])
    """
    outside = torch.maximum(area.lowest - position, position - area.highest).clamp(min=0.0)
    return smooth_rise(area.fade - safe_sqrt((outside * outside).sum(-1)), area.fade)


def share_during(sequence: Sequence, time: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of a sequence's weather; where its fades overlap, their product. At its end it is over."""
    come = smooth_rise(time - sequence.start, sequence.fade_in)
    gone = smooth_rise(time - (sequence.end - sequence.fade_out), sequence.fade_out)
    return come * (1.0 - gone)


def share_after(transition: Transition, time: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of the weather that a transition leads to."""
    return smooth_rise(time - transition.start, transition.length)
