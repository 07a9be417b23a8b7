"""What every solver is given and gives back: an objective over the unit cube, a budget, a minimum."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Float64
from torch import Tensor

Point = Float64[np.ndarray, " n"]


class Objective(Protocol):
    """Half a sum of squares over the unit cube; robustness and priors are already in the residuals."""

    def residuals(self, point: Tensor) -> Tensor:
        """Residuals at a point; differentiable in reverse and in forward mode."""

    def jacobian(self, point: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals, and their derivative by each coordinate in columns."""


@dataclass(frozen=True)
class Budget:
    """When a solver gives up."""

    evaluations: int = 400
    seconds: float | None = None
    tolerance: float = 1e-6  # relative change of the point or of the loss
    seed: int = 0


@dataclass(frozen=True)
class Minimum:
    """Where a solver ended."""

    point: Point
    loss: float  # half the sum of squares
    history: tuple[float, ...]  # loss of each evaluation, in order
    converged: bool
    reason: str
    iterations: int
    evaluations: int


class OutOfBudget(Exception):  # noqa: N818 - a signal between `Watch` and the solver around it, never seen outside
    """Evaluations or seconds are used up."""


@dataclass
class Watch:
    """Remembers the best point of a run, however the solver around it ends."""

    budget: Budget
    best: Point | None = None
    loss: float = np.inf
    history: list[float] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)
    clock: Callable[[], float] = time.monotonic

    def saw(self, point: Point, loss: float) -> None:
        """Note one evaluation.

        Raises:
            OutOfBudget: when the budget allows no further one.
        """
        self.history.append(loss)
        if loss < self.loss:
            self.best, self.loss = point.copy(), loss
        if len(self.history) >= self.budget.evaluations:
            raise OutOfBudget("evaluations used up")
        if self.budget.seconds is not None and self.clock() - self.began > self.budget.seconds:
            raise OutOfBudget("seconds used up")

    def minimum(self, reason: str, iterations: int, *, converged: bool) -> Minimum:
        """Best point seen.

        Raises:
            FloatingPointError: when no evaluation was finite.
        """
        if self.best is None:
            raise FloatingPointError("the loss was not finite anywhere")
        return Minimum(self.best, self.loss, tuple(self.history), converged, reason, iterations, len(self.history))
