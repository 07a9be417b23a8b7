import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic_sky import HAZY_MORNING, photo, radiance

from fit import hidden_sun, keyframes, png
from fit.input_error import InputError
from fit.search_space import SearchSpace
from fit.sky import Options, fit
from fit.solution import Fitted, SunPlace

SPACE = SearchSpace(keyframes.scene(HAZY_MORNING, torch.float64), ("SKY_HAZINESS", *hidden_sun.NAMES))
DETERMINED = dict.fromkeys(SPACE.free, "")
BEGUN = SunPlace(20.0, 30.0, "no disc seen; brightest part of the sky taken", visible=False)


def at(elevation, azimuth):
    return SPACE.point(keyframes.scene({**HAZY_MORNING, "SUN_ELEVATION": elevation, "SUN_AZIMUTH": azimuth}))


def fitted(value, error, why):
    return Fitted(value, "degrees", (-90.0, 90.0), error, error is not None, why)


def test_a_sun_may_move_thirty_degrees_and_no_farther():
    assert hidden_sun.why_not(SPACE, at(49.5, 30.0), DETERMINED) == ""
    assert "far from the brightest part" in hidden_sun.why_not(SPACE, at(50.5, 30.0), DETERMINED)
    # Near the zenith a large angle of azimuth is a small one.
    high = replace(SPACE, start=keyframes.scene({**HAZY_MORNING, "SUN_ELEVATION": 85.0}, torch.float64))
    assert hidden_sun.why_not(high, at(85.0, -150.0), DETERMINED) == ""


@pytest.mark.parametrize("why", [("", "at its lower bound", ""), ("", "", "not determined by the photo")])
def test_a_sun_whose_place_is_not_determined_stays(why):
    assert "not determined" in hidden_sun.why_not(SPACE, at(21.0, 31.0), dict(zip(SPACE.free, why, strict=True)))


def test_other_parameters_may_stay_open():
    assert hidden_sun.why_not(SPACE, at(21.0, 31.0), DETERMINED | {SPACE.free[0]: "at its upper bound"}) == ""


def test_a_sun_that_moved_says_whence_and_how_well():
    parameters = {
        "SUN_ELEVATION": fitted(11.0, 0.5, "searched"),
        "SUN_AZIMUTH": fitted(33.0, 0.7, "searched"),
    }
    found = hidden_sun.place(BEGUN, parameters, hidden_sun.NAMES)
    assert (found.elevation, found.azimuth, found.visible) == (11.0, 33.0, False)
    assert (found.elevation_standard_error, found.azimuth_standard_error) == (0.5, 0.7)
    assert found.how == "elevation and azimuth searched; before, no disc seen; brightest part of the sky taken"


def test_a_sun_that_stayed_says_why():
    why = "no disc seen, and not determined by the photo; a place near the brightest part of the sky is kept"
    parameters = dict(zip(hidden_sun.NAMES, (fitted(15.0, None, why), fitted(30.0, None, why)), strict=True))
    found = hidden_sun.place(BEGUN, parameters, ("SKY_HAZINESS",))
    assert found == replace(BEGUN, elevation=15.0, how=why)


@pytest.mark.slow
def test_a_sun_that_no_disc_shows_is_recovered_with_its_error():
    solution = fit(photo(radiance({**HAZY_MORNING, "SUN_ELEVATION": 6.0, "SUN_AZIMUTH": -100.0})))
    found = solution.sun
    assert not found.visible
    assert found.how.startswith("elevation and azimuth searched")
    for value, error, truth in (
        (found.elevation, found.elevation_standard_error, 6.0),
        (found.azimuth, found.azimuth_standard_error, -100.0),
    ):
        assert 0.0 < error < 0.5  # degrees; the brightest part is 2 degrees off
        assert abs(value - truth) < 4.0 * error
    assert math.sqrt(solution.error) == pytest.approx(0.01, rel=0.1)  # the noise
    assert len(solution.correlated) <= 11  # nine, and the sun's two


@pytest.mark.slow
def test_a_night_is_fitted_where_both_mask_and_sun_are_given(tmp_path):
    seen = radiance()
    seen[4:28:3, 2:126:4] *= 1.5
    mask = np.zeros((*seen.shape[:2], 1), np.uint8)
    mask[5:28:3] = 255
    (tmp_path / "mask.png").write_bytes(png.encoded(mask))
    moon = SunPlace(20.0, 30.0, "given by a test", visible=False)
    with pytest.raises(InputError, match="shows a night"):
        fit(photo(seen), Options(sun=moon))
    assert fit(photo(seen), Options(sun=moon, mask=tmp_path / "mask.png")).error < 1e-3
