"""The local solver of every fit: scipy's trust region inside the cube, then Gauss-Newton steps that reach its faces.

scipy's `trf` [1] keeps off bounds, where a share of 0 would hide the slopes of all that it multiplies; steps that go
onto bounds at once were measured to end in worse minima of skies. It pays for that by creeping up to a bound that
holds the solution, so it stops early here, and steps to the lowest point of the model in the whole cube do the rest.
It is given n + 1 residuals that make the same model, because it decomposes the whole Jacobian at every step, which for
10 000 residuals took 2 to 60 ms, by threads, beside 20 ms for the Jacobian.

[1] M. A. Branch, T. F. Coleman, Y. Li, "A subspace, interior, and conjugate gradient method for large-scale
    bound-constrained minimization problems", 1999.
"""

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

from fit.minimum import Budget, Ending, Minimum, Objective, Point, Watch, watched

COARSE = (
    1e-3  # relative change of loss or point at which Gauss-Newton takes over; 1e-2 lost minima, 1e-4 two evaluations
)


class NoDerivative(Exception):  # noqa: N818 - a signal, never seen outside
    """At a point that scipy has gone to."""


def minimise(objective: Objective, start: Point, budget: Budget) -> Minimum:
    """Nearest minimum downhill from a start.

    A trial point with residuals that are not finite is a failed step; derivatives that are not finite end the search.
    Of the budget, the seed is not used.
    """
    return watched(_search, objective, start, budget)


def _search(watch: Watch, start: Point) -> Ending:
    try:
        _approach(watch, start, max(COARSE, watch.budget.tolerance))
        ending = _finish(watch)
        if not ending.converged:
            _approach(watch, watch.best_point, watch.budget.tolerance)
            ending = _finish(watch)
    except NoDerivative:
        return Ending("the residuals have no derivative at the best point", converged=False)
    return ending


def _approach(watch: Watch, start: Point, tolerance: float) -> None:
    scale = watch.model(start).loss ** 0.5 or 1.0

    def residuals(point: Point) -> Point:
        along = np.zeros(point.size + 1)
        along[0] = (2.0 * watch.evaluate(point)) ** 0.5 / scale
        return along

    def jacobian(point: Point) -> Float64[np.ndarray, "m n"]:
        model = watch.model(point)
        if not model.is_finite:
            raise NoDerivative
        watch.iterations += 1
        return model.turned_jacobian / scale

    least_squares(
        residuals,
        start,
        jac=jacobian,
        bounds=(0.0, 1.0),
        ftol=tolerance,
        xtol=tolerance,
        gtol=1e-15,
        max_nfev=watch.budget.evaluations,
    )


def _finish(watch: Watch) -> Ending:
    model = watch.model(watch.best_point)
    tolerance = watch.budget.tolerance
    while model.is_finite:
        trial = model.lowest(damping=0.0)
        gained = model.loss - watch.evaluate(trial)
        if abs(trial - model.point).max() <= tolerance:
            return Ending("the point no longer moves", converged=True)
        if gained <= tolerance * model.loss:
            return Ending("the loss no longer falls", watch.is_worthless(model.decrease(trial)))
        watch.iterations += 1
        model = watch.model(trial)
    raise NoDerivative
