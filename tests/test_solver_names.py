import pytest

from fit.input_error import InputError
from fit.solvers import solver


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("newton", "least-squares"),
        ("Adam", "adam"),
        ("nlopt", "nlopt:LD_SLSQP"),
        ("nlopt:LD_LFBGS", "LD_LBFGS"),
        ("nlopt:ln_bobyqa", "LN_BOBYQA"),
        ("nlopt:LD_AUGLAG", "LD_"),
        ("nlopt:srand", "nlopt"),
        ("nlopt:", "LD_SLSQP"),
        ("scipy:LD_SLSQP", "nlopt:NAME"),
    ],
)
def test_unknown_solver_is_refused_with_near_names(name: str, hint: str) -> None:
    with pytest.raises(InputError) as refusal:
        solver(name)
    message = str(refusal.value)
    assert name in message
    assert hint in message
    assert "\n" not in message
