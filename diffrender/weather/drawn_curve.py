"""Drawn curves: a periodic function through a few keyframes that a designer draws, and its integral in closed form.

Between keyframes runs the monotone cubic of `timeline`: what is drawn as a rise rises, nothing overshoots, and a gust
that is drawn calm for half its length is calm there.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.weather.timeline import controls


@record
class DrawnCurve:
    """Keyframes of one period, which is 1 long; its end meets its begin."""

    places: Float[Tensor, " keyframes"]  # rising, in [0, 1)
    values: Float[Tensor, " keyframes"]


def value(curve: DrawnCurve, phase: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Value at a phase in periods, which may be any number; at a keyframe's place its value.

    Gradient: exact in keyframes and phase, and continuous in the phase.

    >>> value(DrawnCurve(torch.tensor([0.0, 0.5]), torch.tensor([0.0, 2.0])), torch.tensor([0.0, 0.25, -0.5, 3.0]))
    tensor([0., 1., 2., 0.])
    """
    pieces = _pieces(curve)
    start, _, place = _found(curve, phase, pieces.lengths)
    linear, square, cube = (_entry(rate, start) for rate in pieces.rates)
    return _entry(curve.values, start) + _entry(pieces.rises, start) * place * (
        linear + place * (square + place * cube)
    )


def integral(curve: DrawnCurve, phase: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Integral from the first keyframe to a phase; it grows by the mean of the curve with every period.

    Gradient: by the phase the value, exact by the keyframes.

    >>> integral(DrawnCurve(torch.tensor([0.0, 0.5]), torch.tensor([0.0, 2.0])), torch.tensor([0.0, 0.5, 10.0]))
    tensor([ 0.0000,  0.5000, 10.0000])
    """
    pieces = _pieces(curve)
    start, turns, place = _found(curve, phase, pieces.lengths)
    square, cube, fourth = (
        _entry(rate, start) / power for rate, power in zip(pieces.rates, (2.0, 3.0, 4.0), strict=True)
    )
    above = _entry(pieces.rises, start) * place * place * (square + place * (cube + place * fourth))
    within = _entry(pieces.lengths, start) * (_entry(curve.values, start) * place + above)
    linear, bent, steep = pieces.rates
    whole = pieces.lengths * (curve.values + pieces.rises * (linear / 2.0 + bent / 3.0 + steep / 4.0))
    before = torch.cumsum(whole, 0) - whole
    return turns * whole.sum() + _entry(before, start) + within


@record
class _Pieces:
    """The cubics between keyframes: start + rise × (a u + b u² + c u³), for u from 0 to 1."""

    lengths: Float[Tensor, " keyframes"]
    rises: Float[Tensor, " keyframes"]
    rates: tuple[Tensor, Tensor, Tensor]


def _pieces(curve: DrawnCurve) -> _Pieces:
    apart = torch.roll(curve.places, -1) - curve.places
    lengths = torch.where(apart <= 0.0, apart + 1.0, apart)  # over the period's end; all of it for a single keyframe
    rises = torch.roll(curve.values, -1) - curve.values
    (first, second), _ = controls(rises, lengths)
    rates = (3.0 * first, 3.0 * second - 6.0 * first, 1.0 + 3.0 * first - 3.0 * second)
    return _Pieces(lengths, rises, rates)


def _found(curve: DrawnCurve, phase: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The keyframe before a phase, whole periods since the first keyframe, and the share of the way to the next."""
    offsets = curve.places - curve.places[0]
    since = phase - curve.places[0]
    turns = since.detach().floor()
    gone = since - turns
    start = (offsets <= gone[..., None]).sum(-1) - 1
    return start, turns, (gone - _entry(offsets, start)) / _entry(lengths, start)


def _entry(keyframes: Tensor, start: Tensor) -> Tensor:
    """Entries of keyframes; of one alone too, which vmap would not take as an index."""
    return keyframes[start.reshape(-1)].reshape(start.shape)
