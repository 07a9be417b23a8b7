"""Timelines: the value of a parameter at any hour, from keyframes over a day that begins again at midnight.

Between keyframes runs a cubic whose slopes are weighted harmonic means of the rises to both sides [1, 2]: it is
monotone from one keyframe to the next, smooth across them, and flat where it turns.

[1] F. N. Fritsch, J. Butland, "A method for constructing local monotone piecewise cubic interpolants", SIAM Journal on
    Scientific and Statistical Computing 5(2), 1984: the slopes, eq. 5 with unequal lengths.
[2] F. N. Fritsch, R. E. Carlson, "Monotone piecewise cubic interpolation", SIAM Journal on Numerical Analysis 17(2),
    1980: why slopes of up to three times the rise keep a cubic monotone.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import Specification
from diffrender.weather.own_scale import difference, mean

DAY = 24.0  # hours


def between(
    hours: Float[Tensor, " keyframes"],
    values: Float[Tensor, " keyframes *channels"],
    hour: Float[Tensor, "*batch"],
    known: Specification,
) -> Float[Tensor, "..."]:
    """Value at an hour, of shape (*batch, *channels), in the unit and the own scale of the parameter.

    Hours of keyframes rise, in [0, 24); the day is cyclic, so hour 25 is 1. At a keyframe's hour it is the keyframe,
    between two of them it never leaves their span, and a single one holds all day. A circle is gone round the shorter
    way, keyframe by keyframe.

    Gradient: exact in keyframes and hour. By a keyframe it jumps where a rise beside it becomes a fall; where both are
    equal it is that of the turning side, which is finite and not 0.

    >>> from diffrender.parameters import Specification
    >>> density = Specification(1.0, bounds=(0.01, 100.0), unit="1/m", about="of fog", scale="log")
    >>> between(torch.tensor([6.0, 18.0]), torch.tensor([0.1, 10.0]), torch.tensor([6.0, 12.0, 24.0]), density)
    tensor([0.1000, 1.0000, 1.0000])
    """
    per_channel = (1,) * (values.ndim - 1)
    next_hours = torch.roll(hours, -1)
    lengths = _over_midnight(next_hours - hours)
    lengths = torch.where(hours == next_hours, DAY, lengths)  # of a single keyframe
    behind, ahead = controls(difference(values, torch.roll(values, -1, 0), known), lengths.reshape((-1, *per_channel)))

    # Twice, because the remainder of -1e-20 rounds to 24.
    time = torch.remainder(torch.remainder(hour, DAY), DAY)
    start = torch.remainder((hours <= time[..., None]).sum(-1) - 1, len(hours))
    place = (_over_midnight(time - hours[start]) / lengths[start]).reshape((*time.shape, *per_channel))
    left = 1.0 - place
    early, late = 3.0 * place * left**2, 3.0 * place**2 * left
    gone = early * behind[0][start] + late * behind[1][start] + place**3
    to_go = left**3 + early * ahead[0][start] + late * ahead[1][start]
    end = torch.remainder(start + 1, len(hours))
    return mean((values[start], values[end]), (to_go, gone), known)


def _over_midnight(hours: Tensor) -> Tensor:
    """Hours that have passed between two hours of the day."""
    return torch.where(hours < 0.0, hours + DAY, hours)


Pair = tuple[Tensor, Tensor]


def controls(rises: Tensor, lengths: Tensor) -> tuple[Pair, Pair]:
    """Shares of each interval's rise that lie behind and ahead of the inner two of its cubic's four control points."""
    slopes = rises / lengths
    first, not_first = _end_share(slopes, torch.roll(slopes, 1, 0), lengths, torch.roll(lengths, 1, 0))
    last, not_last = _end_share(slopes, torch.roll(slopes, -1, 0), lengths, torch.roll(lengths, -1, 0))
    return (first, not_last), (not_first, last)


def _end_share(own: Tensor, beside: Tensor, length: Tensor, length_beside: Tensor) -> Pair:
    """Share of its rise that an interval has between an end and the control point next to it, and the rest.

    A third of the mean slope at that end [1] over its own; 0 where the curve turns. Both are sums of what is not
    negative: no rounding takes the cubic out of the span of its keyframes.
    """
    # Below the root of the smallest number squares vanish, and with them the gradient of the quotient.
    least = torch.finfo(own.dtype).tiny ** 0.5
    rises = (own > least) & (beside > least)
    falls = (own < -least) & (beside < -least)
    is_flat = ~(rises | falls)
    own, beside = (torch.where(is_flat, torch.ones_like(own), slope) for slope in (own, beside))
    whole = (2.0 * length + length_beside) * own + (length + 2.0 * length_beside) * beside
    share = (length + length_beside) * beside / whole
    rest = ((2.0 * length + length_beside) * own + length_beside * beside) / whole
    return torch.where(is_flat, torch.zeros_like(share), share), torch.where(is_flat, torch.ones_like(rest), rest)
