import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from diffrender import rays
from fit.objective import PRIOR_WEIGHT
from fit.uncertainty import FEW_CLOUDS, Evidence, uncertainty

PIXELS = 300
MIDDLE = np.full(2, 0.5)
NOTHING_HELD = np.zeros((0, PIXELS, 3))


def line(noise=0.05, seed=0):
    """Evidence of a plane fitted to noise that is alike in no two pixels."""
    generator = torch.Generator().manual_seed(seed)
    height, turn = torch.rand(2, PIXELS, generator=generator, dtype=torch.float64)
    direction = rays.from_angles(torch.asin(height), 2.0 * math.pi * turn)
    slopes = direction[:, None, [0, 2]].repeat(1, 3, 1)
    slopes = (slopes - slopes.mean(0)).numpy()
    measured = noise * torch.randn(PIXELS, 3, generator=generator, dtype=torch.float64).numpy()
    measured -= measured.mean(0)
    estimate = np.linalg.lstsq(slopes.reshape(-1, 2), measured.ravel(), rcond=None)[0]
    return Evidence(direction.numpy(), slopes @ estimate - measured, slopes, NOTHING_HELD, np.full(2, 0.2))


EVIDENCE = line()


def sloped(factors, evidence=EVIDENCE):
    """Evidence in which coordinates change the picture more or less."""
    return replace(evidence, slopes=evidence.slopes * np.array(factors))


def test_independent_residuals_have_the_errors_of_ordinary_least_squares():
    found = uncertainty(EVIDENCE, MIDDLE)
    flat = EVIDENCE.slopes.reshape(-1, 2)
    variance = float((EVIDENCE.residuals**2).sum()) / (3 * PIXELS - 5)
    ordinary = np.sqrt(np.linalg.inv(flat.T @ flat).diagonal() * variance * FEW_CLOUDS)
    # Wider fields, where there are none, are found at random and never below nothing.
    assert found.standard_error == pytest.approx(ordinary, rel=0.5)
    assert (found.standard_error > 0.9 * ordinary).all()
    assert found.why == ("", "")


def test_half_the_noise_is_half_the_error():
    whole, half = (uncertainty(line(noise), MIDDLE).standard_error for noise in (0.04, 0.02))
    assert half == pytest.approx(whole / 2.0, rel=1e-3)


def test_what_is_held_adds_its_own_spread_to_the_error():
    # What is held does the same as the first coordinate, by 0.1 of it to either side.
    change = 0.1 * EVIDENCE.slopes[..., 0]
    held = replace(EVIDENCE, changes=np.stack([-change, change]))
    alone, both = (uncertainty(evidence, MIDDLE).standard_error for evidence in (EVIDENCE, held))
    assert both**2 - alone**2 == pytest.approx([0.01, 0.0], abs=1e-5)


def test_what_is_held_away_from_its_centre_adds_that_too():
    change = 0.1 * EVIDENCE.slopes[..., 1]
    beside = replace(EVIDENCE, changes=np.stack([0.0 * change, 2.0 * change]))
    alone, both = (uncertainty(evidence, MIDDLE).standard_error for evidence in (EVIDENCE, beside))
    assert both[1] ** 2 - alone[1] ** 2 == pytest.approx(0.01 + 0.01, abs=1e-5)  # centre and spread of 0.1 each


def test_correlation_is_that_of_the_estimates():
    leaning = EVIDENCE.slopes @ np.array([[1.0, 0.9], [0.0, 0.436]])  # the second leans on the first
    found = uncertainty(replace(EVIDENCE, slopes=leaning), MIDDLE).correlation
    assert found.diagonal() == pytest.approx([1.0, 1.0])
    assert found[0, 1] == pytest.approx(found[1, 0])
    assert -1.0 <= found[0, 1] < -0.5


def test_what_changes_nothing_is_not_determined():
    found = uncertainty(sloped([0.0, 1.0]), MIDDLE)
    assert found.why == ("without influence on this photo", "")
    assert np.isnan(found.standard_error[0])
    assert found.standard_error[1] > 0.0
    assert found.correlation[0].tolist() == [1.0, 0.0]


def test_what_changes_too_little_is_not_determined():
    found = uncertainty(sloped([1.0, 1e-3], line(noise=2.0)), MIDDLE)
    assert found.why[1] == "not determined by the photo"
    assert np.isnan(found.standard_error[1])


def test_a_prior_is_no_determination():
    quiet = line(noise=1e-9)
    # Half of what a slope says is the prior's where the two weigh the same.
    level = PRIOR_WEIGHT / 0.2 / np.linalg.norm(quiet.slopes[..., 1])
    assert uncertainty(sloped([1.0, 0.5 * level], quiet), MIDDLE).why == ("", "not determined by the photo")
    assert uncertainty(sloped([1.0, 2.0 * level], quiet), MIDDLE).why == ("", "")


def test_the_less_the_photo_says_the_more_an_error_is_the_prior_s():
    quiet = line(noise=1e-9)
    level = PRIOR_WEIGHT / 0.2 / np.linalg.norm(quiet.slopes[..., 1])
    errors = [uncertainty(sloped([1.0, factor * level], quiet), MIDDLE).standard_error[1] for factor in (100.0, 1.2)]
    assert errors[0] < 1e-3
    # The share of the prior, 1 / (1 + 1.2^2), of its spread of 0.2; the other coordinate knows a little of it.
    assert errors[1] == pytest.approx(0.2 / 2.44, rel=0.05)


@pytest.mark.parametrize(("place", "why"), [(0.0, "at its lower bound"), (1.0, "at its upper bound")])
def test_what_lies_on_a_bound_has_no_error(place, why):
    found = uncertainty(EVIDENCE, np.array([place, 0.5]))
    assert found.why == (why, "")
    assert np.isnan(found.standard_error[0])


def test_a_bound_does_not_make_the_others_surer():
    leaning = replace(EVIDENCE, slopes=EVIDENCE.slopes @ np.array([[1.0, 0.9], [0.0, 0.436]]))
    inside, outside = (uncertainty(leaning, np.array([place, 0.5])).standard_error[1] for place in (0.5, 0.0))
    assert inside == outside


def test_where_nothing_is_determined_there_is_no_number():
    found = uncertainty(sloped([0.0, 0.0]), MIDDLE)
    assert np.isnan(found.standard_error).all()
    assert np.array_equal(found.correlation, np.eye(2))


def test_two_parameters_that_do_the_same_are_not_both_determined():
    found = uncertainty(replace(EVIDENCE, slopes=EVIDENCE.slopes[..., [0, 0]]), MIDDLE)
    assert "not told apart from others by the photo" in found.why


def test_where_nothing_is_left_over_only_the_prior_s_share_is_the_error():
    exact = replace(EVIDENCE, residuals=np.zeros((PIXELS, 3)))
    assert uncertainty(exact, MIDDLE).standard_error.max() < 1e-6
