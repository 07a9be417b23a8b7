"""Levenberg-Marquardt in the unit cube: the local solver of every fit [1, 2].

Each step goes to the lowest point in the whole cube of the damped Gauss-Newton model, so it meets bounds exactly and
leaves them in one step. scipy.optimize.least_squares was measured first, on 31 problems of 2 to 8 parameters, most with
solutions on bounds: `trf` takes 18 evaluations and 17 Jacobians where this takes 12 and 10 for the same minima, and
decomposes the whole Jacobian at each step, on threads, which took up to 60 ms; `dogbox` often stops far from a minimum.

[1] K. Levenberg, "A method for the solution of certain non-linear problems in least squares", 1944.
[2] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05: the rule by which the damping changes.
"""

from fit.minimum import Budget, Ending, Minimum, Objective, Point, Watch, watched

FIRST_DAMPING = 1e-2  # of the greatest curvature; 1 costs two evaluations more and finds no better minima


def minimise(objective: Objective, start: Point, budget: Budget) -> Minimum:
    """Nearest minimum downhill from a start.

    A trial point with residuals that are not finite is a failed step, and so is one without finite derivatives.
    Of the budget, the seed is not used.
    """
    return watched(_search, objective, start, budget)


def _search(watch: Watch, start: Point) -> Ending:
    model = watch.model(start)
    tolerance = watch.budget.tolerance
    damping, growth = FIRST_DAMPING, 2.0
    while True:
        trial = model.lowest(damping)
        promised = model.decrease(trial)
        loss = watch.evaluate(trial)
        gained = model.loss - loss
        # Under strong damping a small gain says only that the step was short.
        if damping <= 1.0 and max(promised, abs(gained)) <= tolerance * model.loss:
            return Ending("the loss no longer falls", converged=True)
        if abs(trial - model.point).max() <= tolerance:
            # Or could not: a kink, or a border of what is finite, also makes the damping grow.
            return Ending("the point no longer moves", watch.is_settled())
        reached = watch.model(trial) if gained > 0.0 else model
        if reached is not model and reached.is_finite:
            watch.iterations += 1
            kept = min(gained / promised, 1.0) if promised > 0.0 else 1.0
            damping *= max(0.1, 1.0 - (2.0 * kept - 1.0) ** 3)
            model, growth = reached, 2.0
        else:
            damping *= growth
            growth *= 2.0
