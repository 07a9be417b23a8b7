"""torch's optimisers behind the signature of every solver; both follow the exact gradient of the loss."""

from itertools import count

import numpy as np
import torch

from fit.minimum import Budget, Ending, Minimum, Objective, Point, Watch, watched

STEPS = 200  # of Adam
LENGTH = 0.1  # of Adam's first steps, in the unit cube; falls to 0 along half a cosine
MEMORY = (0.9, 0.9)  # of gradients and their squares; 200 steps cannot forget steep early ones at torch's 0.999
LINE_SEARCH = 25  # evaluations of one line search of L-BFGS
INSET = 1e-3  # nearer a bound, the angle's gradient is too small to leave it


def adam(objective: Objective, start: Point, budget: Budget) -> Minimum:
    """Minimum by Adam, each step projected onto the cube. Of the budget, tolerance and seed are not used."""
    return watched(_adam, objective, start, budget)


def lbfgs(objective: Objective, start: Point, budget: Budget) -> Minimum:
    """Minimum by L-BFGS with strong Wolfe line search, in angles whose squared sines are the point.

    The angles have no bounds and reach those of the point at ordinary values. Of the budget, the seed is not used.
    """
    return watched(_lbfgs, objective, start, budget)


def _adam(watch: Watch, start: Point) -> Ending:
    steps = min(STEPS, watch.budget.evaluations)
    point = torch.tensor(start)
    optimiser = torch.optim.Adam([point], lr=LENGTH, betas=MEMORY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, T_max=steps)
    for _ in range(steps):
        model = watch.model(point.numpy())
        if model.is_finite:
            point.grad = torch.tensor(model.gradient)
        else:
            # Back to firm ground, without the moments that led away from it, and more carefully.
            optimiser.state.clear()
            optimiser.param_groups[0]["lr"] *= 0.5
            point.copy_(torch.tensor(watch.best_point))
            point.grad = torch.tensor(watch.model(point.numpy()).gradient)
        optimiser.step()
        schedule.step()
        point.clamp_(0.0, 1.0)
        watch.iterations += 1
    return Ending("all steps are done", watch.is_settled())


def _lbfgs(watch: Watch, start: Point) -> Ending:
    scale = watch.loss or 1.0
    angle = torch.asin(torch.tensor(np.clip(start, INSET, 1.0 - INSET)).sqrt())
    # One iteration a step: the optimiser's own tests are absolute, and blind to the budget's tolerance.
    optimiser = torch.optim.LBFGS(
        [angle],
        max_iter=1,
        max_eval=LINE_SEARCH,
        tolerance_grad=0.0,
        tolerance_change=0.0,
        line_search_fn="strong_wolfe",
    )

    def closure() -> float:
        model = watch.model((angle.sin() ** 2).numpy())
        angle.grad = torch.tensor(model.gradient) / scale * torch.sin(2.0 * angle)
        return (model.loss if model.is_finite else watch.penalty) / scale

    idle = 0
    before = watch.loss
    for watch.iterations in count(1):
        optimiser.step(closure)  # type: ignore[no-untyped-call]
        idle = idle + 1 if before - watch.loss <= watch.budget.tolerance * watch.loss else 0
        before = watch.loss
        if idle == 2:
            break
    return Ending("the loss no longer falls", watch.is_settled())
