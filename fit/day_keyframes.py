"""As few keyframes of a curve as its photos support.

A curve begins with a keyframe at every node. The one whose loss changes the curve least is taken away, and so on, while
the misfit, by the curve's own covariance, rises by less than the logarithm of the number of photos for each: Schwarz's
criterion [1]. A curve that is as well a constant is one keyframe.

[1] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6(2), 1978.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from diffrender.parameters import Specification
from diffrender.weather.timeline import between
from fit.day_curves import Curves

Values = Float64[np.ndarray, " t"]

_CUBE = Specification(0.5, bounds=(0.0, 1.0), unit="1", about="place between its bounds, in its own scale")


@dataclass(frozen=True)
class Keyframes:
    """Hours and values of one parameter, in the unit cube."""

    hours: tuple[float, ...]
    values: tuple[float, ...]

    def at(self, hours: Sequence[float]) -> Values:
        """Values at some hours, as a weather file has them: monotone between keyframes of the cyclic day."""
        known, values, asked = (torch.tensor(one, dtype=torch.float64) for one in (self.hours, self.values, hours))
        drawn: Values = between(known, values, asked, _CUBE).numpy()
        return drawn


def fewest(curves: Curves, photos: int) -> dict[str, Keyframes]:
    """Keyframes of each name."""
    count = len(curves.hours)
    found = {}
    for index, name in enumerate(curves.names):
        own = slice(index * count, (index + 1) * count)
        information = np.linalg.inv(curves.covariance[own, own])
        found[name] = _fewest(curves.hours, curves.values[index], information, math.log(max(photos, 2)))
    return found


def _fewest(hours: Sequence[float], values: Values, information: Float64[np.ndarray, "t t"], price: float) -> Keyframes:
    def misfit(keyframes: Keyframes) -> float:
        away = keyframes.at(hours) - values
        return float(away @ information @ away)

    def some(kept: Sequence[int]) -> Keyframes:
        return Keyframes(tuple(hours[index] for index in kept), tuple(float(values[index]) for index in kept))

    kept, now = list(range(len(hours))), 0.0
    while len(kept) > 2:
        rises = {index: misfit(some([other for other in kept if other != index])) for index in kept}
        cheapest = min(kept, key=lambda index: rises[index])
        if rises[cheapest] - now >= price:
            break
        now = rises[cheapest]
        kept.remove(cheapest)
    mean = float(np.clip(information.sum(0) @ values / information.sum(), values.min(), values.max()))
    constant = Keyframes((hours[int(np.abs(values - mean).argmin())],), (mean,))
    return constant if misfit(constant) + price <= now + price * len(kept) else some(kept)
