import itertools

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from diffrender.parameters import Specification
from diffrender.weather.drawn_curve import DrawnCurve, integral, value
from diffrender.weather.timeline import DAY, between

FLOAT = torch.float64
GUST = DrawnCurve(
    torch.tensor([0.05, 0.2, 0.35, 0.5, 0.9], dtype=FLOAT), torch.tensor([0.0, 0.3, 1.0, 0.25, -0.1], dtype=FLOAT)
)
STEADY = DrawnCurve(torch.tensor([0.3], dtype=FLOAT), torch.tensor([0.7], dtype=FLOAT))
PHASES = torch.linspace(-2.3, 3.1, 137, dtype=FLOAT)


def test_the_curve_is_that_of_a_timeline_of_the_same_keyframes():
    known = Specification(0.0, bounds=(-1e6, 1e6), unit="1", about="")
    found = between(DAY * GUST.places, GUST.values, DAY * PHASES, known)
    torch.testing.assert_close(value(GUST, PHASES), found, rtol=0.0, atol=1e-13)


def test_keyframes_are_met_in_every_period_and_never_passed():
    for turns in (-2.0, 0.0, 5.0):
        torch.testing.assert_close(value(GUST, GUST.places + turns), GUST.values, rtol=0.0, atol=1e-14)
    many = value(GUST, torch.linspace(0.0, 1.0, 10_001, dtype=FLOAT))
    assert (float(many.min()), float(many.max())) == pytest.approx((-0.1, 1.0), abs=1e-12)


@pytest.mark.parametrize("curve", [GUST, STEADY])
def test_the_integral_is_that_of_the_curve(curve):
    def wanted(phase):
        borders = np.unique([0.0, phase, *(place + turn for place in curve.places.tolist() for turn in range(-3, 4))])
        inside = [b for b in borders if min(0.0, phase) <= b <= max(0.0, phase)]
        pieces = [
            quad(lambda x: float(value(curve, torch.tensor(x, dtype=FLOAT))), a, b)[0]
            for a, b in itertools.pairwise(inside)
        ]
        return np.sign(phase) * sum(pieces)

    start = integral(curve, torch.zeros((), dtype=FLOAT))
    for phase in (-1.7, 0.04, 0.42, 0.97, 2.6):
        found = integral(curve, torch.tensor(phase, dtype=FLOAT)) - start
        assert float(found) == pytest.approx(wanted(phase), abs=1e-11)


def test_the_integral_grows_by_the_curve():
    found = torch.func.vmap(torch.func.grad(lambda phase: integral(GUST, phase)))(PHASES)
    torch.testing.assert_close(found, value(GUST, PHASES), rtol=0.0, atol=1e-13)


def test_curve_and_slope_have_no_seam():
    borders = torch.cat([GUST.places, GUST.places[:1] + 1.0])
    slope = torch.func.vmap(torch.func.grad(lambda phase: value(GUST, phase)))
    torch.testing.assert_close(slope(borders - 1e-9), slope(borders + 1e-9), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(integral(GUST, borders - 1e-9), integral(GUST, borders + 1e-9), rtol=0.0, atol=1e-8)


def test_one_keyframe_is_a_constant():
    torch.testing.assert_close(value(STEADY, PHASES), torch.full_like(PHASES, 0.7), rtol=0.0, atol=0.0)


@pytest.mark.parametrize("function", [value, integral])
def test_gradients_match_finite_differences(function):
    given = [GUST.places, GUST.values, torch.tensor([-0.61, 0.27, 1.44], dtype=FLOAT)]

    def draw(places, values, phase):
        return function(DrawnCurve(places, values), phase)

    leaves = [one.clone().requires_grad_() for one in given]
    assert torch.autograd.gradcheck(draw, leaves, check_forward_ad=True, check_batched_grad=True)


def test_the_smallest_phase_below_a_keyframe_is_in_the_period_before():
    found = (
        value(GUST, GUST.places[0] - 1e-20),
        value(DrawnCurve(GUST.places - 0.05, GUST.values), torch.tensor(-1e-20, dtype=FLOAT)),
    )
    for one in found:
        assert float(one) == pytest.approx(0.0, abs=1e-14)
