"""nlopt's algorithms, global and local, behind the signature of every solver.

nlopt mangles what an objective raises and takes a loss that is not finite for a result, so the objective it is given
never does either: it keeps the exception, stops the run, and states a penalty in place of infinity.
"""

import difflib
import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import nlopt
import numpy as np

from fit.input_error import InputError
from fit.minimum import Budget, Ending, Minimum, Objective, Point, Watch, watched

# Without constraints AUGLAG only passes on to another algorithm; NOCEDAL is not in the library; NEWUOA_BOUND, which
# BOBYQA replaces, can fall into a loop of its own where neither the budget nor an interruption reaches it.
LEFT_OUT = ("AUGLAG", "NOCEDAL", "NEWUOA_BOUND")
RESTARTS = 3  # of a local algorithm that failed, or was misled by a penalty
ENDINGS = {
    nlopt.MAXEVAL_REACHED: "evaluations used up",
    nlopt.SUCCESS: "the search is complete",
    nlopt.FTOL_REACHED: "the loss no longer falls",
    nlopt.XTOL_REACHED: "the point no longer moves",
    nlopt.ROUNDOFF_LIMITED: "rounding errors hide any further gain",
}


def names() -> list[str]:
    """Names of nlopt's algorithms that are of use here."""
    prefixes = ("GN_", "GD_", "G_", "LN_", "LD_")
    return [name for name in vars(nlopt) if name.startswith(prefixes) and not any(part in name for part in LEFT_OUT)]


def check_name(algorithm: str) -> None:
    """Refuse what is not the name of an algorithm.

    Raises:
        InputError: with the nearest names there are.
    """
    known = names()
    if algorithm not in known:
        near = difflib.get_close_matches(algorithm.upper(), known, n=3, cutoff=0.4) or ["LD_SLSQP", "LN_BOBYQA"]
        raise InputError(f"the solver nlopt:{algorithm} does not exist; use one of nlopt's, such as {', '.join(near)}")


def minimise(objective: Objective, start: Point, budget: Budget, *, algorithm: str) -> Minimum:
    """Minimum by one of nlopt's algorithms.

    Global ones (G...) use up the budget as a rule; local ones end at the nearest minimum. MLSL sends LD_LBFGS or
    LN_BOBYQA from its points, by whether it follows gradients. Random choices follow the budget's seed.

    Raises:
        InputError: when the algorithm does not exist, or does not take this number of parameters.
    """
    check_name(algorithm)
    return watched(partial(_search, algorithm=algorithm), objective, start, budget)


def _search(watch: Watch, start: Point, *, algorithm: str) -> Ending:
    nlopt.srand(watch.budget.seed)
    told = _Told(watch, scale=watch.loss or 1.0)
    result = _run(told, start, algorithm)
    for _ in range(RESTARTS):
        if algorithm.startswith("G") or not (told.penalties or result == nlopt.FAILURE):
            break
        # BOBYQA's model of the loss, for one, never recovers from a penalty; a new run from the best point does.
        told.penalties = 0
        result = _run(told, watch.best_point, algorithm)
    return Ending(ENDINGS.get(result, f"{algorithm} failed"), watch.is_settled())


@dataclass
class _Told:
    """What nlopt is told of the loss: relative to the start's, finite, and nothing after a failure."""

    watch: Watch
    scale: float
    penalties: int = 0
    failure: BaseException | None = None
    optimiser: Any = None

    def __call__(self, memory: Point, gradient: Point) -> float:
        if self.failure is None:
            try:
                return self._value(np.clip(memory, 0.0, 1.0), gradient)
            except BaseException as failure:  # KeyboardInterrupt too; raised again once nlopt has returned
                self.failure = failure
        # Some algorithms call on after this, hence the answer.
        self.optimiser.force_stop()
        gradient[:] = 0.0
        return self.watch.penalty / self.scale

    def _value(self, point: Point, gradient: Point) -> float:
        if gradient.size == 0:
            loss = self.watch.evaluate(point)
        else:
            model = self.watch.model(point)
            loss = model.loss
            gradient[:] = model.gradient / self.scale
        self.watch.iterations += 1
        if math.isfinite(loss):
            return loss / self.scale
        self.penalties += 1
        return self.watch.penalty / self.scale


def _run(told: _Told, start: Point, algorithm: str) -> int:
    optimiser = _optimiser(algorithm, start.size, told.watch.budget)
    optimiser.set_min_objective(told)
    told.optimiser = optimiser
    try:
        optimiser.optimize(start)
    except nlopt.RoundoffLimited:
        return int(nlopt.ROUNDOFF_LIMITED)
    except (nlopt.ForcedStop, nlopt.runtime_error):
        if told.failure is None:
            return int(nlopt.FAILURE)
    except nlopt.invalid_argument as error:  # it does not say which
        raise InputError(
            f"the solver nlopt:{algorithm} does not take {start.size} free parameters in bounds; use nlopt:LD_SLSQP"
        ) from error
    if told.failure is not None:
        raise told.failure
    return int(optimiser.last_optimize_result())


def _optimiser(algorithm: str, size: int, budget: Budget) -> Any:  # nlopt has no types
    optimiser = nlopt.opt(getattr(nlopt, algorithm), size)
    optimiser.set_lower_bounds(np.zeros(size))
    optimiser.set_upper_bounds(np.ones(size))
    optimiser.set_maxeval(10 * budget.evaluations)  # for STOGO, which does not hear force_stop
    optimiser.set_ftol_rel(budget.tolerance)
    optimiser.set_xtol_abs(budget.tolerance)
    if "MLSL" in algorithm:
        local = nlopt.opt(nlopt.LN_BOBYQA if algorithm.startswith("GN_") else nlopt.LD_LBFGS, size)
        local.set_ftol_rel(budget.tolerance)
        local.set_xtol_abs(budget.tolerance)
        optimiser.set_local_optimizer(local)
    return optimiser
