"""The local solver of every fit: scipy's trust region inside the cube, then Levenberg-Marquardt onto its faces.

scipy's `trf` [1] keeps off bounds, where a share of 0 would hide the slopes of all that it multiplies; steps that go
onto bounds at once were measured to end in worse minima of skies. It pays for that by creeping up to a bound that
holds the solution, so it stops early here, and damped steps [2] to the lowest point of the model in the whole cube do
the rest. scipy's `dogbox`, made for bounds, often stopped far from any minimum.

`trf` is given n + 1 residuals that make the same model, because it decomposes the whole Jacobian at every step, which
for 10 000 residuals took 2 to 60 ms, by threads, beside 20 ms for the Jacobian.

Derivatives are taken at every trial: most are kept, and then residuals alone would have been in vain.

[1] M. A. Branch, T. F. Coleman, Y. Li, "A subspace, interior, and conjugate gradient method for large-scale
    bound-constrained minimization problems", 1999.
[2] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05: how the damping changes.
"""

from contextlib import suppress

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

from fit.gauss_newton import half_square
from fit.minimum import STUCK, Budget, Ending, Minimum, Objective, Point, Watch, watched

COARSE_LOSS, COARSE_POINT = 1e-2, 1e-3  # changes, relative and of the point, below which `trf` has done its part
FIRST_DAMPING = 1e-3


class NoDerivative(Exception):  # noqa: N818 - a signal, never seen outside
    """At a point that scipy has gone to."""


class Near(Exception):  # noqa: N818 - a signal, never seen outside
    """The minimum, at a point that scipy has gone to."""


def minimise(objective: Objective, start: Point, budget: Budget) -> Minimum:
    """Nearest minimum downhill from a start.

    A trial point with residuals that are not finite is a failed step; derivatives that are not finite end the search.
    Of the budget, the seed is not used.
    """
    return watched(_search, objective, start, budget)


def _search(watch: Watch, start: Point) -> Ending:
    try:
        _approach(watch, start)
        return _finish(watch)
    except NoDerivative:
        return Ending("the residuals have no derivative at a point of the search", converged=False)


def _approach(watch: Watch, start: Point) -> None:
    tolerance = watch.budget.tolerance
    tolerance = watch.budget.tolerance
    scale = watch.model(start).loss ** 0.5 or 1.0

    def residuals(point: Point) -> Point:
        along = np.zeros(point.size + 1)
        along[0] = (2.0 * half_square(watch.model(point).residuals)) ** 0.5 / scale
        return along

    def jacobian(point: Point) -> Float64[np.ndarray, "m n"]:
        model = watch.model(point)
        if not model.is_finite:
            raise NoDerivative
        watch.iterations += 1
        if model.decrease(model.lowest(FIRST_DAMPING)) <= tolerance * model.loss:
            raise Near
        return model.turned_jacobian / scale

    with suppress(Near):
        least_squares(
            residuals,
            start,
            jac=jacobian,
            bounds=(0.0, 1.0),
            ftol=max(COARSE_LOSS, tolerance),
            xtol=max(COARSE_POINT, tolerance),
            gtol=1e-15,
            max_nfev=watch.budget.evaluations,
        )


def _finish(watch: Watch) -> Ending:
    model = watch.model(watch.best_point)
    tolerance = watch.budget.tolerance
    damping, growth = FIRST_DAMPING, 2.0
    while True:
        trial = model.lowest(damping)
        promised = model.decrease(trial)
        # Under strong damping a small promise says only that the step is short.
        if damping <= 1.0 and promised <= tolerance * model.loss:
            return Ending("the loss no longer falls", converged=True)
        if abs(trial - model.point).max() <= tolerance:
            # Or could not: a kink, or a border of what is finite, also makes the damping grow.
            return Ending(STUCK, watch.is_settled())
        tried = watch.model(trial)
        gained = model.loss - tried.loss
        if gained > 0.0:
            watch.iterations += 1
            kept = min(gained / promised, 1.0) if promised > 0.0 else 1.0
            damping *= max(0.1, 1.0 - (2.0 * kept - 1.0) ** 3)
            model, growth = tried, 2.0
        else:
            damping *= growth
            growth *= 2.0
