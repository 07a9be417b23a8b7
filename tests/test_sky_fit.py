import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic_sky import CAMERA, HAZY_MORNING, SUN, photo, radiance

from fit import keyframes, picture, png, sky
from fit.input_error import InputError
from fit.minimum import INTERRUPTED
from fit.objective import SkyObjective
from fit.sky import Options, fit
from fit.solution import SunPlace

PHOTOS = Path(__file__).parents[1] / "experiments" / "photos"
GIVEN = Options(sun=SUN)
SEEN = radiance()

pytestmark = pytest.mark.slow  # a fit takes about a second


@pytest.fixture(scope="module")
def solution():
    return fit(photo(SEEN), GIVEN)


def values(solution):
    return {name: fitted.value for name, fitted in solution.parameters.items()}


def distance(one, other, names):
    """Greatest distance of two solutions, in standard errors of the first."""
    return max(
        abs(one.parameters[name].value - other.parameters[name].value) / one.parameters[name].standard_error
        for name in names
    )


def determined(solution):
    return [name for name, fitted in solution.parameters.items() if fitted.standard_error is not None]


def test_a_known_sky_is_recovered(solution):
    assert solution.minimum.converged
    truth = keyframes.values(keyframes.scene(HAZY_MORNING, torch.float64))
    found = determined(solution)
    assert {"SKY_HAZINESS", "SKY_MIE_SCALE", "SKY_RAYLEIGH_SCALE"} <= set(found)
    apart = {n: abs(solution.parameters[n].value - truth[n]) / solution.parameters[n].standard_error for n in found}
    assert max(apart.values()) < 4.0, apart
    assert np.median(list(apart.values())) < 1.5, apart


def test_what_is_left_over_is_the_noise(solution):
    assert math.sqrt(solution.error) == pytest.approx(0.01, rel=0.1)


def test_the_fitted_scene_draws_the_photo(solution):
    drawn = picture.draw(keyframes.scene(keyframes.values(solution.scene)), CAMERA)["sky"]
    apart = np.log(drawn[solution.used] / SEEN[solution.used])
    assert np.abs(apart.mean(0)).max() < 1e-3  # the gains
    assert np.sqrt((apart**2).mean()) == pytest.approx(0.01, rel=0.1)


def test_a_brighter_photo_has_the_same_sky_and_more_exposure(solution):
    brighter = fit(photo(np.float32(1000.0) * SEEN), GIVEN)
    assert brighter.parameters["EXPOSURE"].value == pytest.approx(
        1000.0 * solution.parameters["EXPOSURE"].value, rel=1e-3
    )
    assert np.divide(brighter.gains, solution.gains) == pytest.approx([1000.0] * 3, rel=1e-3)
    assert distance(solution, brighter, determined(solution)) < 0.05


def test_a_tinted_photo_has_the_same_sky_under_a_tinted_sun(solution):
    tint = np.array([1.5, 1.0, 0.5], np.float32)
    tinted = fit(photo(tint * SEEN), GIVEN)
    gain = np.divide(tinted.gains, solution.gains)
    # The floor under the logarithm is of one colour, and weighs more on a darker channel.
    assert gain / gain[1] == pytest.approx(tint, rel=0.05)
    assert distance(solution, tinted, determined(solution)) < 3.0


def test_turning_the_panorama_turns_the_sun_and_nothing_else(solution):
    columns = 32  # a quarter of a turn to the right
    turned = fit(photo(np.roll(SEEN, columns, 1)), Options(sun=SunPlace(20.0, 120.0, "known", visible=False)))
    level = [name for name in determined(solution) if not name.startswith("SKY_OVERCAST")]
    # Another sample of the same pixels, so not the same bits.
    assert distance(solution, turned, level) < 2.0
    assert np.divide(turned.gains, solution.gains) == pytest.approx([1.0] * 3, rel=0.1)
    assert turned.parameters["SUN_AZIMUTH"].value == pytest.approx(120.0)


def test_the_same_photo_and_seed_give_the_same_bits(solution):
    again = fit(photo(SEEN), GIVEN)
    assert values(again) == values(solution)
    assert again.minimum.history == solution.minimum.history


def test_another_seed_agrees_within_the_errors(solution):
    other = fit(photo(SEEN), Options(sun=SUN, seed=5))
    assert distance(solution, other, [n for n in determined(solution) if n in determined(other)]) < 3.0


# Masks


def test_what_the_mask_leaves_out_has_no_say(tmp_path):
    mask = np.zeros((CAMERA.height, CAMERA.width, 1), np.uint8)
    mask[3:24] = 255
    (tmp_path / "mask.png").write_bytes(png.encoded(mask))
    options = Options(sun=SUN, mask=tmp_path / "mask.png")
    spoiled = SEEN.copy()
    spoiled[mask[..., 0] == 0] = 7.0
    clean, other = fit(photo(SEEN), options), fit(photo(spoiled), options)
    assert values(clean) == values(other)
    assert clean.pixels == {"used": 21 * 128, "masked": 43 * 128, "nonfinite": 0, "negative": 0}
    assert np.array_equal(clean.used, mask[..., 0] > 0)


def test_pixels_that_show_nothing_are_counted_and_not_used():
    spoiled = SEEN.copy()
    spoiled[10, 5], spoiled[11, 6], spoiled[12, 7] = np.nan, np.inf, -1.0
    found = fit(photo(spoiled), GIVEN)
    assert (found.pixels["nonfinite"], found.pixels["negative"]) == (2, 1)
    assert not found.used[[10, 11, 12], [5, 6, 7]].any()
    assert found.pixels["used"] + found.pixels["masked"] == found.used.size


# Options


def test_what_is_fixed_stays_where_it_is(solution):
    found = fit(photo(SEEN), Options(sun=SUN, fixed={"SKY_HAZINESS": 0.4}))
    assert found.parameters["SKY_HAZINESS"].value == 0.4
    assert found.parameters["SKY_HAZINESS"].why == "given"
    assert found.parameters["SKY_HAZINESS"].standard_error is None
    assert found.error > solution.error  # what is left fits no better without the true haziness


def test_a_start_keeps_what_is_not_searched():
    start = keyframes.scene({**HAZY_MORNING, "SKY_GROUND_ALBEDO": 0.2, "SKY_OZONE": 1.5}, torch.float64)
    fixed = dict.fromkeys(("SKY_OVERCAST", "SKY_OVERCAST_AHEAD", "SKY_OVERCAST_LEFT"), 0.0)
    found = fit(photo(SEEN), Options(sun=SUN, start=start, fixed=fixed))
    kept = [name for name, fitted in found.parameters.items() if fitted.why == "kept"]
    truth = keyframes.values(start)
    assert all(found.parameters[name].value == truth[name] for name in kept)


@pytest.mark.parametrize("name", ["EXPOSURE", "SUN_IRRADIANCE_G"])
@pytest.mark.parametrize("option", ["fixed", "free"])
def test_gains_are_neither_fixed_nor_searched(name, option):
    options = Options(sun=SUN, **{option: {name: 1.0} if option == "fixed" else (name,)})
    with pytest.raises(InputError, match=f"{name} is the photo's gain"):
        fit(photo(SEEN), options)


@pytest.mark.parametrize("option", ["fixed", "free"])
def test_unknown_names_are_refused_with_the_nearest(option):
    options = Options(sun=SUN, **{option: {"SKY_OZOME": 1.0} if option == "fixed" else ("SKY_OZOME",)})
    with pytest.raises(InputError, match="nearest known one is SKY_OZONE"):
        fit(photo(SEEN), options)


@pytest.mark.parametrize("solver", ["nlopt:LD_SLSQP", "lbfgs"])
def test_solvers_meet_in_the_same_sky(solution, solver):
    other = fit(photo(SEEN), Options(sun=SUN, solver=solver))
    assert other.error == pytest.approx(solution.error, rel=0.05)


def test_little_time_gives_the_best_so_far():
    found = fit(photo(SEEN), Options(sun=SUN, seconds=1e-3))
    assert not found.minimum.converged
    assert math.isfinite(found.error)


def test_an_interrupt_gives_the_best_so_far(monkeypatch):
    jacobian = SkyObjective.jacobian
    calls = []

    def interrupted(self, point):
        calls.append(point)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return jacobian(self, point)

    monkeypatch.setattr(SkyObjective, "jacobian", interrupted)
    found = fit(photo(SEEN), GIVEN)
    assert found.minimum.reason == INTERRUPTED
    assert not found.minimum.converged
    assert math.isfinite(found.error)


def test_an_interrupt_between_two_searches_gives_the_best_so_far(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(sky, "_reselected", interrupted)
    found = fit(photo(SEEN), GIVEN)
    assert found.minimum.reason == INTERRUPTED
    assert not found.minimum.converged
    assert math.isfinite(found.error)
    assert found.minimum.evaluations == len(found.minimum.history)


def test_a_searched_sun_is_recorded_where_the_fit_has_put_it():
    off = replace(SUN, elevation=SUN.elevation + 2.0)
    found = fit(photo(SEEN), Options(sun=off, free=("SUN_ELEVATION",)))
    assert found.sun.elevation == found.parameters["SUN_ELEVATION"].value
    assert found.sun.elevation == pytest.approx(SUN.elevation, abs=0.5)


# Refusals


def test_the_sun_s_place_is_not_fixed_by_name():
    with pytest.raises(InputError, match="--sun ELEVATION,AZIMUTH"):
        fit(photo(SEEN), Options(fixed={"SUN_AZIMUTH": 10.0}))


def test_a_black_photo_is_refused():
    with pytest.raises(InputError, match=r"black where the sky is|no light above the horizon|no sky found"):
        fit(photo(np.zeros_like(SEEN)), GIVEN)


def test_a_photo_without_a_usable_pixel_is_refused():
    with pytest.raises(InputError, match=r"no light above the horizon|usable pixels|no sky found"):
        fit(photo(np.full_like(SEEN, np.nan)), GIVEN)


def test_too_few_pixels_are_refused(tmp_path):
    mask = np.zeros((CAMERA.height, CAMERA.width, 1), np.uint8)
    mask[10, 10:20] = 255
    (tmp_path / "mask.png").write_bytes(png.encoded(mask))
    with pytest.raises(InputError, match="only 10 usable pixels"):
        fit(photo(SEEN), Options(sun=SUN, mask=tmp_path / "mask.png"))


# A real photo, as README shows it


def test_a_real_photo_is_fitted_by_its_path():
    found = sky.fit(PHOTOS / "spruit_sunrise.exr")
    low, high = found.parameters["SKY_HAZINESS"].bounds
    assert low < found.parameters["SKY_HAZINESS"].value < high
    assert found.parameters["SKY_HAZINESS"].determined
    assert found.error < 0.01
    assert found.sun.visible
    for fitted in found.parameters.values():
        assert fitted.bounds[0] <= fitted.value <= fitted.bounds[1]
        assert fitted.standard_error is None or fitted.standard_error > 0.0
        assert fitted.standard_error is None or fitted.determined
