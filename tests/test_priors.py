import math

import numpy as np
import pytest
import torch

from diffrender.scene import weather_names
from fit import priors, sky


def test_all_that_is_searched_unasked_has_a_prior():
    assert set(priors.PRIORS) == {*sky.SEARCHED, *sky.POOL}


@pytest.mark.parametrize("name", priors.PRIORS)
def test_a_centre_is_inside_the_bounds_and_its_spread_narrower(name):
    prior = priors.in_unit_cube([name])
    assert 0.0 < prior.centre[0] < 1.0
    assert 0.0 < prior.spread[0] < math.sqrt(1.0 / 12.0)


@pytest.mark.parametrize(("name", "further"), [("SKY_OZONE", 1.0 + 0.15), ("SKY_MIE_SCALE", 12.0 * 2.2)])
def test_a_spread_is_a_difference_or_for_log_parameters_a_factor(name, further):
    prior, known = priors.in_unit_cube([name]), weather_names()[name]
    assert float(known.from_unit(torch.from_numpy(prior.centre + prior.spread))) == pytest.approx(further)


def test_without_a_prior_a_parameter_is_anywhere_between_its_bounds():
    drawn = np.random.default_rng(0).uniform(size=10_000)
    found = priors.in_unit_cube(["SUN_ELEVATION"])
    assert found.centre[0] == pytest.approx(drawn.mean(), abs=0.01)
    assert found.spread[0] == pytest.approx(drawn.std(), abs=0.01)
