"""What a solver is given and gives back: objective, budget, minimum; and the watch over its search of the unit cube."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from fit.gauss_newton import QuadraticModel, half_square

Point = Float64[np.ndarray, " n"]

INTERRUPTED = "interrupted"  # the reason by which a caller knows to go no further
STUCK = "the point no longer moves"  # settled or not

# With some thousand residuals this share of the loss is half a standard error of one parameter.
NEGLIGIBLE = 1e-4
TRUSTED_DAMPING = 1e-3  # of the step that is asked; without any, the model promises what no loss keeps
AT_BOUND = 1e-6  # so near a face of the cube a coordinate is tried on it


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
    tolerance: float = 1e-6  # relative change of the loss, or change of the point
    seed: int = 0


@dataclass(frozen=True)
class Minimum:
    """Where a solver ended."""

    point: Point
    loss: float  # half the sum of squares
    history: tuple[float, ...]  # loss of each evaluation, in order; infinite where it was not finite
    converged: bool
    reason: str
    iterations: int
    evaluations: int  # points at which the loss was asked for; a derivative at the same point is not another
    model: QuadraticModel | None = None  # at the point, where the search ended with one

    def derivatives(self, objective: Objective) -> tuple[Tensor, Tensor]:
        """Residuals and their derivatives at the point; of the search itself where it ended with them."""
        if self.model is None:
            return objective.jacobian(torch.from_numpy(self.point))
        return self.model.residuals, self.model.jacobian


@dataclass(frozen=True)
class Ending:
    """How a search ended of itself."""

    reason: str
    converged: bool


class OutOfBudget(Exception):  # noqa: N818 - a signal between `Watch` and `watched`, never seen outside
    """Evaluations or seconds are used up."""


@dataclass
class Watch:
    """Evaluates an objective for a search and remembers the best point, however the search ends."""

    objective: Objective
    budget: Budget
    best: Point | None = None
    loss: float = math.inf  # of the best
    worst: float = 0.0  # greatest finite loss
    iterations: int = 0
    history: list[float] = field(default_factory=list)
    clock: Callable[[], float] = time.monotonic
    began: float = field(init=False)
    latest: Point | None = None
    latest_model: QuadraticModel | None = None

    def __post_init__(self) -> None:
        """Start the clock."""
        self.began = self.clock()

    def evaluate(self, point: Point) -> float:
        """Loss at a point, infinite where it is not finite; not another evaluation at the point evaluated last.

        Raises:
            OutOfBudget: when the budget allows no further evaluation.
        """
        if _same(point, self.latest):
            return self.history[-1]
        loss = half_square(self.objective.residuals(torch.tensor(point)))
        self._saw(point, loss)
        return loss

    def model(self, point: Point) -> QuadraticModel:
        """Loss, gradient and curvature at a point; not another evaluation at the point evaluated last or at the best.

        Raises:
            OutOfBudget: when the budget allows no further evaluation.
        """
        if self.latest_model is not None and _same(point, self.latest_model.point):
            return self.latest_model
        model = QuadraticModel(point.copy(), *self.objective.jacobian(torch.tensor(point)))
        self.latest_model = model
        if not (_same(point, self.latest) or _same(point, self.best)):
            self._saw(point, model.loss)
        return model

    def finite_start(self, start: Point) -> Point:
        """The start, or where the loss is not finite there, the first finite point on the way to the cube's middle.

        Raises:
            FloatingPointError: when there is none.
            OutOfBudget: when the budget allows no further evaluation.
        """
        for share in (0.0, 0.5, 1.0):
            point = start + share * (0.5 - start)
            if self.model(point).is_finite:
                return point
        raise FloatingPointError("the loss is finite neither at the start nor on the way to the middle of the bounds")

    @property
    def penalty(self) -> float:
        """What a search that cannot take infinity is told instead: finite, and worse than all it has seen."""
        return 10.0 * self.worst + 1.0

    @property
    def best_point(self) -> Point:
        """Best point so far, which a search has from its finite start on."""
        assert self.best is not None
        return self.best

    def is_settled(self) -> bool:
        """Whether a Gauss-Newton step from the best point promises no gain worth having."""
        if self.best is None:
            return False
        model = self.model(self.best)
        # Where residuals can vanish, a step promises all that is left; the loss at the start is the scale there.
        first = next(loss for loss in self.history if math.isfinite(loss))
        worth = max(NEGLIGIBLE * self.loss, self.budget.tolerance * first)
        return model.is_finite and model.decrease(model.lowest(TRUSTED_DAMPING)) <= worth

    def settle_on_bounds(self) -> None:
        """Move coordinates that nearly touch their bound onto it, where the loss does not grow."""
        for axis in range(self.best_point.size):
            coordinate = float(self.best_point[axis])
            if 0.0 < abs(coordinate - round(coordinate)) <= AT_BOUND:
                moved = self.best_point.copy()
                moved[axis] = round(coordinate)
                self.evaluate(moved)

    def minimum(self, ending: Ending) -> Minimum:
        """Best point seen.

        Raises:
            FloatingPointError: when no evaluation was finite.
        """
        if self.best is None:
            raise FloatingPointError("the loss was not finite anywhere")
        return Minimum(
            point=self.best,
            loss=self.loss,
            history=tuple(self.history),
            converged=ending.converged,
            reason=ending.reason,
            iterations=self.iterations,
            evaluations=len(self.history),
            model=self.latest_model if self.latest_model and _same(self.latest_model.point, self.best) else None,
        )

    def _saw(self, point: Point, loss: float) -> None:
        self.latest = point.copy()
        self.history.append(loss)
        if math.isfinite(loss):
            self.worst = max(self.worst, loss)
            if loss <= self.loss:
                self.best, self.loss = self.latest, loss
        if len(self.history) >= self.budget.evaluations:
            raise OutOfBudget("evaluations used up")
        if self.budget.seconds is not None and self.clock() - self.began > self.budget.seconds:
            raise OutOfBudget("seconds used up")


def _same(point: Point, other: Point | None) -> bool:
    return other is not None and np.array_equal(point, other)


Search = Callable[[Watch, Point], Ending]


def watched(search: Search, objective: Objective, start: Point, budget: Budget) -> Minimum:
    """Minimum that a search comes to from a start, however it ends.

    The first KeyboardInterrupt ends the search; the best point so far is returned as not converged, with the reason
    INTERRUPTED. It is passed on where nothing was evaluated yet.

    Raises:
        FloatingPointError: when the loss was not finite at the start, nor on the way to the middle of the cube.
    """
    watch = Watch(objective, budget)
    try:
        ending = _ending(search, watch, np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0))
    except KeyboardInterrupt:
        if watch.best is None:
            raise
        ending = Ending(INTERRUPTED, converged=False)
    return watch.minimum(ending)


def _ending(search: Search, watch: Watch, start: Point) -> Ending:
    try:
        if start.size == 0:
            with suppress(OutOfBudget):  # one evaluation is what there is to do, and it is done
                watch.evaluate(start)
            return Ending("nothing to search", converged=True)
        ending = search(watch, watch.finite_start(start))
    except OutOfBudget as stop:
        return Ending(str(stop), watch.is_settled())
    with suppress(OutOfBudget):  # the search has ended; what remains of the budget only polishes
        watch.settle_on_bounds()
    return ending
