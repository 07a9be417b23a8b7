import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import torch
from exr_files import save
from foggy_picture import CAMERA, EYE, FOG, SUN, TRUTH, drawn, photo

from diffrender.parameters import defaults
from diffrender.scene import Exposure, Scene, skylight
from fit import fog, fog_picture, foggy_photo, keyframes, weather_file
from fit.__main__ import BAD_INPUT
from fit.fitting_command import FITTED, NOT_CONVERGED
from fit.foggy_photo import Options
from fit.input_error import InputError
from fit.search_space import SearchSpace

pytest_plugins = ["command_fixtures"]

# Whose truth is the default; one test searches them.
SHARES = {f"HEIGHT_FOG_RAYLEIGH_SHARE_{channel}": 0.2 for channel in "RGB"}
GIVEN = Options(sun=SUN, eye_height=EYE, fixed=SHARES)
DENSITY_ALONE = replace(GIVEN, fixed=SHARES | {name: TRUTH[name] for name in TRUTH if name != "HEIGHT_FOG_EXTINCTION"})


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files of one foggy view."""
    folder = tmp_path_factory.mktemp("foggy")
    seen, clear, distance = drawn()
    write(folder / "fog.exr", seen)
    write(folder / "clear.exr", clear)
    write(folder / "small.exr", clear[:20])
    save(folder / "distance.exr", {"Z": distance})
    save(folder / "far.exr", {"Z": np.full_like(distance, 1e9)})
    save(folder / "short.exr", {"Z": distance[:20]})
    return folder


def write(path, radiance):
    save(path, {name: np.ascontiguousarray(radiance[..., index]) for index, name in enumerate("RGB")})


@pytest.fixture(scope="module")
def fogged(files):
    """Fit of the known fog with all that helps."""
    seen, _, distance = drawn()
    return fog.solve(photo(seen, distance), replace(GIVEN, clear=files / "clear.exr"))


@pytest.fixture(scope="module")
def alone():
    """Fit of the same without the view without fog."""
    seen, _, distance = drawn()
    return fog.solve(photo(seen, distance), GIVEN)


def apart(solution):
    """Distances of what is determined from the truth, in standard errors."""
    found = {name: solution.parameters[name] for name in TRUTH}
    return {
        name: abs(one.value - TRUTH[name]) / one.standard_error
        for name, one in found.items()
        if one.standard_error is not None
    }


@pytest.mark.slow
def test_a_known_fog_is_recovered(fogged):
    solution = fogged.solution
    assert solution.minimum.converged
    for name in ("HEIGHT_FOG_EXTINCTION", "HEIGHT_FOG_SCALE_HEIGHT"):
        assert solution.parameters[name].value == pytest.approx(TRUTH[name], rel=0.01)
        assert solution.parameters[name].standard_error < 0.02 * TRUTH[name]
    assert len(apart(solution)) == len(TRUTH)
    assert max(apart(solution).values()) < 4.0, apart(solution)


@pytest.mark.slow
def test_what_ends_at_a_bound_stays_there_and_is_not_taken_for_open(tmp_path):
    seen, clear, distance = drawn(fog=replace(FOG, rayleigh_share=torch.zeros(3, dtype=torch.float64)))
    write(tmp_path / "clear.exr", clear)
    given = {name: TRUTH[name] for name in TRUTH if "EXTINCTION" not in name}
    solution = fog.fit(photo(seen, distance), replace(GIVEN, clear=tmp_path / "clear.exr", fixed=given))
    found = [solution.parameters[f"HEIGHT_FOG_RAYLEIGH_SHARE_{channel}"] for channel in "RGB"]
    assert max(one.value for one in found) < 0.05
    assert "at its lower bound" in {one.why for one in found}


@pytest.mark.slow
def test_without_the_view_without_fog_the_intervals_are_wider_and_hold_the_truth(fogged, alone):
    assert max(apart(alone.solution).values()) < 4.0, apart(alone.solution)
    told = "HEIGHT_FOG_EXTINCTION"
    wide, narrow = (one.solution.parameters[told].standard_error for one in (alone, fogged))
    assert wide > 2.0 * narrow


@pytest.mark.slow
def test_the_fitted_picture_is_the_photo_but_for_its_noise(fogged):
    pictures = fog_picture.draw(fogged, fogged.solution.scene)
    seen, clear, _ = drawn(noise=0.0)
    assert np.abs(pictures["fog"] / seen - 1.0).max() < 0.02
    told = np.isfinite(pictures["without fog"]).all(-1)
    assert told.mean() > 0.5
    # Of a tenth of the light, 1 % of noise makes 10 %.
    assert np.median(np.abs(pictures["without fog"] / clear - 1.0)[told]) < 0.03


@pytest.mark.slow
def test_a_picture_of_a_weather_file_that_was_written_is_the_fitted_one(fogged, tmp_path):
    weather_file.write(
        tmp_path / "weather.csv", weather_file.of_photo(keyframes.values(fogged.solution.scene), 12.0, {})
    )
    read = keyframes.scene(keyframes.at(weather_file.read(tmp_path / "weather.csv"), 12.0))
    pictures = [fog_picture.draw(fogged, scene)["fog"] for scene in (fogged.solution.scene, read)]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-5)


@pytest.mark.slow
def test_light_above_the_fog_is_found_with_its_colour(fogged):
    scene = fogged.solution.scene
    found = (scene.exposure.exposure * scene.sun.irradiance * scene.height_fog.sun_tint).numpy()
    np.testing.assert_allclose(found, [3.0, 2.6, 2.0], rtol=0.1)


def objective_of(options, **changed):
    seen, _, distance = drawn(**changed)
    home = Scene(defaults(Exposure, torch.float64), keyframes.scene({}, torch.float64).sun, None, FOG)
    names = {"SUN_ELEVATION": SUN.elevation, "SUN_AZIMUTH": SUN.azimuth}
    home = keyframes.scene({**keyframes.values(home), **names}, torch.float64)
    known = foggy_photo.seen(photo(seen, distance), options, home)
    return known.objective(SearchSpace(home, (*fog.SEARCHED, "SUN_ELEVATION")), 300, seed=0)


@pytest.mark.parametrize("clear", [None, "clear.exr"])
def test_derivatives_are_those_of_differences(files, clear):
    objective = objective_of(replace(GIVEN, clear=clear and files / clear))
    count = len(objective.space.free) + objective.extra
    point = torch.linspace(0.35, 0.65, count, dtype=torch.float64)
    residuals, slopes = objective.jacobian(point)
    torch.testing.assert_close(residuals, objective.residuals(point))
    for index, step in enumerate(1e-6 * torch.eye(count, dtype=torch.float64)):
        difference = (objective.residuals(point + step) - objective.residuals(point - step)) / 2e-6
        torch.testing.assert_close(slopes[:, index], difference, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("clear", [None, "clear.exr"])
def test_no_light_is_darker_than_none(files, clear):
    # Of fog far too dense, too low or lit from elsewhere some light would have to be taken away to explain the photo.
    objective = objective_of(replace(GIVEN, clear=clear and files / clear))
    random = torch.Generator().manual_seed(0)
    dark = 0
    for _ in range(30):
        point = torch.rand(len(objective.space.free) + objective.extra, generator=random, dtype=torch.float64)
        strength = objective.lights(point).strength
        assert (strength >= 0.0).all()
        dark += int((strength == 0.0).any())
    assert dark > 0


def test_lights_are_those_that_explain_the_photo_best(files):
    objective = objective_of(replace(GIVEN, clear=files / "clear.exr"))
    lights = objective.lights(torch.full((len(objective.space.free) + 1,), 0.5, dtype=torch.float64))

    def misfit(strength):
        picture = replace(lights, strength=strength).picture()
        return float(((picture - objective.pixels.radiance) / objective.scale).square().sum())

    for change in torch.eye(3, dtype=torch.float64):
        for sign in (-1e-3, 1e-3):
            moved = (lights.strength + sign * change[:, None] * lights.strength.max()).clamp(min=0.0)
            assert misfit(moved) >= misfit(lights.strength) * (1.0 - 1e-9)


# What is kept


@pytest.mark.slow
def test_the_base_height_stays_and_the_fit_says_so(alone):
    base = alone.solution.parameters["HEIGHT_FOG_BASE_HEIGHT"]
    assert (base.value, base.standard_error) == (0.0, None)
    assert any("base height" in note for note in alone.solution.notes)


@pytest.mark.slow
def test_another_base_height_is_the_same_fog(fogged, files):
    seen, _, distance = drawn()
    raised = replace(GIVEN, clear=files / "clear.exr", fixed=SHARES | {"HEIGHT_FOG_BASE_HEIGHT": 60.0})
    found = fog.fit(photo(seen, distance), raised)
    one, other = (solution.parameters["HEIGHT_FOG_EXTINCTION"].value for solution in (fogged.solution, found))
    scale = found.parameters["HEIGHT_FOG_SCALE_HEIGHT"].value
    assert other == pytest.approx(one * np.exp(-60.0 / scale), rel=0.01)


@pytest.mark.slow
def test_a_start_keeps_what_is_not_searched(files):
    seen, _, distance = drawn()
    begun = keyframes.scene({**TRUTH, "HEIGHT_FOG_ALBEDO_R": 0.8}, torch.float64)
    found = fog.fit(photo(seen, distance), replace(GIVEN, clear=files / "clear.exr", start=begun, seconds=1e-3))
    kept = found.parameters["HEIGHT_FOG_ALBEDO_R"]
    assert (kept.value, kept.why) == (pytest.approx(0.8), "kept")
    assert found.parameters["HEIGHT_FOG_SCALE_HEIGHT"].value == pytest.approx(TRUTH["HEIGHT_FOG_SCALE_HEIGHT"])


UNDER_A_SKY = {"SKY_HAZINESS": 0.7, "SKY_MIE_SCALE": 2.0, "EXPOSURE": 1.0}


@pytest.mark.slow
def test_fog_under_a_known_sky_takes_its_light(files):
    seen, _, distance = drawn()
    begun = keyframes.scene(UNDER_A_SKY | {"EXPOSURE": 4.0}, torch.float64)
    found = fog.solve(photo(seen, distance), replace(DENSITY_ALONE, clear=files / "clear.exr", start=begun))
    scene = found.solution.scene
    given = scene.height_fog.ambient_tint * skylight(scene)
    wanted = found.objective.lights(torch.from_numpy(found.solution.minimum.point)).ambient() / scene.height_fog.albedo
    torch.testing.assert_close(given, wanted)
    assert found.solution.parameters["SKY_HAZINESS"].value == pytest.approx(0.7)
    assert found.solution.parameters["HEIGHT_FOG_EXTINCTION"].value == pytest.approx(2e-3, rel=0.05)


@pytest.mark.slow
def test_a_sky_that_is_far_too_dark_is_refused(files):
    seen, _, distance = drawn()
    begun = keyframes.scene(UNDER_A_SKY | {"EXPOSURE": 0.01}, torch.float64)
    with pytest.raises(InputError, match="times as strongly as the given sky lights it, of 16 allowed; the weather"):
        fog.solve(photo(seen, distance), replace(DENSITY_ALONE, clear=files / "clear.exr", start=begun, seconds=1.0))


@pytest.mark.slow
def test_light_stronger_than_a_known_sky_s_tints_allow_is_held_against_a_fit():
    # Without distances its light and its density are seen as one.
    seen, _, _ = drawn()
    begun = keyframes.scene(UNDER_A_SKY | {"EXPOSURE": 1.2}, torch.float64)
    found = fog.solve(photo(seen), replace(GIVEN, start=begun))
    fitted = found.solution.scene.height_fog
    brightest = float(torch.cat([fitted.sun_tint, fitted.ambient_tint]).max())
    assert 8.0 < brightest < 13.0  # 13.4 by the photo alone
    point = torch.from_numpy(found.solution.minimum.point)
    bare = replace(found.objective, greatest=None).residuals(point)
    beyond = found.objective.residuals(point)[bare.numel() :]
    # Half of what may be written is free; beyond, each time it counts once.
    assert float(beyond.max()) == pytest.approx(brightest / 8.0 - 1.0, rel=1e-3)


@pytest.mark.slow
def test_the_sky_of_a_photo_whose_header_tells_its_place_has_that_sun_s_height():
    header = {"time": datetime(2002, 6, 23, 23, tzinfo=UTC), "latitude": 37.9, "longitude": -122.6, "altitude": None}
    place, searched = fog.sun_of(replace(photo(drawn()[0]), header=header), None)
    assert searched == ("SUN_AZIMUTH",)
    assert place.elevation == pytest.approx(52.0, abs=2.0)
    assert fog.sun_of(photo(drawn()[0]), SUN) == (SUN, ())


@pytest.mark.slow
def test_without_distances_only_the_fog_s_column_is_searched():
    seen, _, _ = drawn()
    found = fog.fit(photo(seen), GIVEN)
    searched = {name for name, one in found.parameters.items() if one.why == "searched"}
    assert searched <= {"HEIGHT_FOG_EXTINCTION"}
    assert any("no distances" in note for note in found.notes)
    rows = np.nonzero(found.used)[0]
    horizon = CAMERA.height / 2 - CAMERA.width / 2 / np.tan(np.radians(30.0)) * np.tan(np.radians(3.0))
    assert rows.max() < horizon


# Where the sun is


@pytest.mark.slow
def test_a_header_s_place_and_time_tell_how_high_the_sun_is():
    seen, _, distance = drawn()
    header = {"time": datetime(2020, 6, 21, 12, tzinfo=UTC), "latitude": 0.0, "longitude": 0.0}
    found = fog.fit(photo(seen, distance, **header), Options(eye_height=EYE, seconds=1e-3))
    assert found.sun.elevation == pytest.approx(66.6, abs=0.2)
    assert found.parameters["SUN_ELEVATION"].standard_error is None


# The command


@pytest.mark.slow
def test_the_command_writes_a_report_and_both_pictures(run, files, tmp_path):
    status, out, err = run(
        "fog", files / "fog.exr", *["--fov", "60", "--pitch", "-3", "--eye-height", "25", "--sun", "20,40"],
        "--distance", files / "distance.exr", "--clear", files / "clear.exr", "--seconds", "0.001", "--out", tmp_path,
    )  # fmt: skip
    assert (status, err) == (NOT_CONVERGED, "")
    assert "HEIGHT_FOG_EXTINCTION" in out
    page = (tmp_path / "report.html").read_text()
    assert "HEIGHT_FOG_SCALE_HEIGHT" in page
    assert "base height and extinction are seen as one density" in page


@pytest.mark.slow
def test_fog_under_a_fitted_sky_tells_of_both(run, tmp_path):
    photo = Path(__file__).parent.parent / "experiments" / "photos" / "spruit_sunrise.exr"
    status, out, err = run("fog", photo, "--with-sky", "--seconds", "20", "--out", tmp_path)
    assert (status, err) == (FITTED, "")
    assert "the sky was fitted first: mean square error of log radiance 0.005" in out
    parameters = json.loads((tmp_path / "fit.json").read_text())["parameters"]
    assert parameters["SKY_HAZINESS"]["why"] == "searched"
    assert parameters["SKY_HAZINESS"]["standard_error"] > 0.0


@pytest.fixture
def inside(files, monkeypatch):
    """The same folder, as the one the command runs in."""
    monkeypatch.chdir(files)
    return files


AT = ("--fov", "60", "--sun", "20,40")
BAD = {
    "eye too high": (("--distance", "distance.exr", "--eye-height", "inf"), "--eye-height inf; give metres"),
    "distances missing": (("--distance", "missing.exr"), "missing.exr", "No such file"),
    "distances of another size": (("--distance", "short.exr"), "64 x 20", "64 x 40", "one for each pixel"),
    "no distance in the file": (("--distance", "far.exr"), "no distance between 0 and"),
    "unknown kind": (("--distance", "distance.exr", "--distance-kind", "log"), "log", "euclidean, depth"),
    "picture in place of distances": (("--distance", "missing.csv"), "missing.csv"),
    "clear of another size": (("--distance", "distance.exr", "--clear", "small.exr"), "64 x 20", "the same view"),
    "tint": (("--distance", "distance.exr", "--fix", "HEIGHT_FOG_SUN_TINT_R=1"), "but no tint"),
    "free sky": (("--distance", "distance.exr", "--free", "SKY_OZONE"), "SKY_OZONE is not for a fog fit"),
    "unknown name": (("--distance", "distance.exr", "--free", "HEIGHT_FOG_HAZE"), "nearest known one"),
    "sun by name": (("--distance", "distance.exr", "--fix", "SUN_ELEVATION=5"), "give the sun's place by --sun"),
}


@pytest.mark.parametrize(("words", "said"), [(w, s) for w, *s in BAD.values()], ids=BAD)
def test_bad_input_is_one_line_and_leaves_nothing(run, inside, tmp_path, words, said):
    before = sorted(inside.iterdir())
    status, out, err = run("fog", "fog.exr", *AT, *words, "--out", tmp_path / "out")
    assert (status, out, err.count("\n")) == (BAD_INPUT, "", 1)
    assert [text for text in said if text not in err] == []
    assert not any(tmp_path.iterdir())
    assert sorted(inside.iterdir()) == before


def test_too_few_pixels_are_refused():
    seen, _, distance = drawn()
    distance[:, 2:] = np.nan
    with pytest.raises(InputError, match="usable pixels are left"):
        fog.fit(photo(seen, distance), GIVEN)


def test_a_black_photo_is_refused():
    seen, _, distance = drawn()
    with pytest.raises(InputError, match="black where it is used"):
        fog.fit(photo(np.zeros_like(seen), distance), GIVEN)
