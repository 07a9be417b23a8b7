"""The names by which the command line knows the solvers."""

from collections.abc import Callable, Mapping
from functools import partial

from fit import least_squares, nlopt_solver, torch_solver
from fit.input_error import InputError
from fit.minimum import Budget, Minimum, Objective, Point

Minimise = Callable[[Objective, Point, Budget], Minimum]

SOLVERS: Mapping[str, Minimise] = {
    "least-squares": least_squares.minimise,
    "adam": torch_solver.adam,
    "lbfgs": torch_solver.lbfgs,
}


def solver(name: str) -> Minimise:
    """Solver of a name: least-squares, adam, lbfgs, or nlopt: and the name of one of nlopt's algorithms.

    Raises:
        InputError: when there is none of that name.
    """
    if name in SOLVERS:
        return SOLVERS[name]
    algorithm = name.removeprefix("nlopt:")
    if algorithm == name:
        raise InputError(
            f"the solver {name!r} does not exist; use {', '.join(SOLVERS)} or nlopt:NAME, as nlopt:LD_SLSQP"
        )
    nlopt_solver.check_name(algorithm)
    return partial(nlopt_solver.minimise, algorithm=algorithm)
