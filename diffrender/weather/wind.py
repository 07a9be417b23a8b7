"""Wind: waves that a designer draws and that travel over the land, and how far they carry what drifts in them.

A wave is a drawn curve of wind over one period [1]: drawn calm with one peak it is a gust, drawn as one keyframe it is
a steady wind. It travels in the direction it blows, a wavelength in every period; several add up to a wind that
differs from place to place. Because the curve's integral has a closed form, the wind's displacement at any time is
known without a step before it: froxel noise and clouds that are moved by it start at any hour, on any frame rate.

Gradient: exact in keyframes, strengths, wavelengths and periods, and continuous in position and time.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Wind": wave functions
    "drawn" by designers; what they are drawn over, the talk does not say.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import record
from diffrender.weather import drawn_curve
from diffrender.weather.drawn_curve import DrawnCurve


@record
class Wave:
    """One wave of wind; it passes a wavelength in a period, so its speed of travel is their quotient."""

    curve: DrawnCurve  # over the time of a period; over space it lies the other way round
    towards: Float[Tensor, "3"]  # unit direction that it blows and travels in
    strength: Float[Tensor, ""]  # wind where the curve is 1 [m/s]
    wavelength: Float[Tensor, ""]  # infinite for a wave that is everywhere at once [m]
    period: Float[Tensor, ""]  # [s]


def velocity(
    waves: Sequence[Wave], position: Float[Tensor, "*batch 3"], time: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3"]:
    """Wind at places and times [m/s]: the sum of all waves; none is no wind.

    >>> gust = DrawnCurve(torch.tensor([0.0, 0.5]), torch.tensor([0.0, 1.0]))
    >>> wave = Wave(gust, torch.tensor([1.0, 0.0, 0.0]), *torch.tensor([6.0, 40.0, 10.0]))
    >>> velocity([wave], torch.tensor([[0.0, 0.0, 0.0], [20.0, 7.0, 0.0]]), torch.tensor(5.0))[:, 0]
    tensor([6., 0.])
    """
    total = torch.zeros_like(position)
    for wave in waves:
        blown = wave.strength * drawn_curve.value(wave.curve, _phase(wave, position, time))
        total = total + blown[..., None] * wave.towards
    return total


def displacement(
    waves: Sequence[Wave], position: Float[Tensor, "*batch 3"], time: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3"]:
    """Integral of the wind at a place from time 0 on [m]: how far it has carried what it has blown past there.

    The time's integral of `velocity` where it is, not the path of one particle, which meets other winds on its way.
    """
    total = torch.zeros_like(position)
    for wave in waves:
        begin, end = (_phase(wave, position, moment) for moment in (torch.zeros_like(time), time))
        passed = drawn_curve.integral(wave.curve, end) - drawn_curve.integral(wave.curve, begin)
        total = total + (wave.strength * wave.period * passed)[..., None] * wave.towards
    return total


def _phase(wave: Wave, position: Tensor, time: Tensor) -> Tensor:
    return time / wave.period - (position * wave.towards).sum(-1) / wave.wavelength
