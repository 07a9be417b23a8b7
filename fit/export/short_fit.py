"""A short fit of an engine's own formula to our radiance, by least squares of its logarithm."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import least_squares
from torch import Tensor

from fit.export.account import Difference, difference
from fit.export.analytic_sky import Dial

_EVALUATIONS = 25
_DIMMEST = 1e-9  # radiance below which an engine's counts as that
_BLACK = 1e-30  # and ours, as at night


@dataclass(frozen=True, eq=False)
class Match:
    """Dials for which a formula comes nearest to our radiance.

    Attributes:
        dials: value by name.
        gain: what the formula's radiance is to be multiplied with.
        difference: of the formula's radiance, times the gain, from ours.
    """

    dials: Mapping[str, float]
    gain: float
    difference: Difference


def fitted(
    formula: Callable[[Float[Tensor, " dials"]], Float[Tensor, "n 3"]],
    dials: Sequence[Dial],
    ours: Float[Tensor, "n 3"],
) -> Match:
    """Best dials of a formula and one gain for all channels, which is solved in closed form: the mean log ratio."""
    aim = ours.double().clamp(min=_BLACK).log()
    low, high = (np.array([getattr(dial, end) for dial in dials]) for end in ("low", "high"))

    def residual(point: Tensor) -> Tensor:
        found = formula(point).clamp(min=_DIMMEST).log() - aim
        return (found - found.mean()).flatten()

    def numbers(point: np.ndarray) -> np.ndarray:
        return residual(torch.from_numpy(point)).numpy()

    def slopes(point: np.ndarray) -> np.ndarray:
        return np.asarray(torch.func.jacfwd(residual)(torch.from_numpy(point)).numpy())

    start = np.array([dial.start for dial in dials])
    found = least_squares(
        numbers, start, slopes, bounds=(low, high), x_scale=high - low, max_nfev=_EVALUATIONS, loss="soft_l1"
    )
    values = dict(zip((dial.name for dial in dials), found.x.tolist(), strict=True))
    return match(values, formula(torch.from_numpy(found.x)), ours)


def match(dials: Mapping[str, float], theirs: Float[Tensor, "n 3"], ours: Float[Tensor, "n 3"]) -> Match:
    """How near a formula's radiance with some dials comes to ours, with its best gain."""
    seen, aim = theirs.clamp(min=_DIMMEST), ours.double().clamp(min=_BLACK)
    gain = float(torch.exp((aim.log() - seen.log()).mean()))
    return Match(dials, gain, difference(ours.double(), gain * seen))
