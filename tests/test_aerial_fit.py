from dataclasses import replace

import numpy as np
import pytest
import torch
from exr_files import save
from foggy_picture import photo

from diffrender.atmosphere import aerial_perspective, sky
from diffrender.atmosphere.celestial import to_sun
from diffrender.parameters import defaults
from diffrender.rays import Perspective, pixel_centres
from fit import aerial, fog_models, keyframes, weather_file
from fit.foggy_photo import Options
from fit.input_error import InputError
from fit.solution import SunPlace

pytest_plugins = ["command_fixtures"]

CAMERA = Perspective(48, 24, np.radians(60.0), np.radians(-1.0))
EYE = 150.0
SUN = SunPlace(20.0, 40.0, "given by --sun", visible=False)
TRUTH = {"AERIAL_PERSPECTIVE_DISTANCE_SCALE": 3.0, "AERIAL_PERSPECTIVE_HAZINESS": 0.6}
IRRADIANCE = (1.2, 1.1, 0.9)
GIVEN = Options(sun=SUN, eye_height=EYE)
WEATHER = {**TRUTH, "SUN_ELEVATION": SUN.elevation, "SUN_AZIMUTH": SUN.azimuth} | {
    f"SUN_IRRADIANCE_{channel}": value for channel, value in zip("RGB", IRRADIANCE, strict=True)
}


def landscape(noise=0.01, **changed):
    """Radiance of hills by chance under a sky of one colour, that without air, and distances."""
    scene = keyframes.scene({**WEATHER, **changed}, torch.float64)
    direction = CAMERA.direction(*pixel_centres(CAMERA, slice(None), torch.zeros((), dtype=torch.float64)))
    random = np.random.default_rng(0)
    away = np.kron(np.geomspace(2e4, 300.0, 6)[:, None] * random.uniform(0.6, 1.6, (6, 12)), np.ones((3, 4)))
    distance = np.concatenate([np.full((6, 48), np.inf), away])
    clear = np.kron(random.uniform(0.02, 0.3, (8, 12, 3)), np.ones((3, 4, 1)))
    view = sky.SkyView(direction, to_sun(scene.sun), scene.sun.irradiance, torch.tensor(EYE, dtype=torch.float64))
    air = sky.medium(defaults(sky.Sky, torch.float64))
    seen = aerial_perspective.through(air, view, torch.from_numpy(distance), torch.from_numpy(clear))
    drawn = aerial_perspective.EFFECT.rungs["three tables"](scene.aerial_perspective, seen).numpy()
    drawn = drawn * random.lognormal(0.0, noise, drawn.shape)
    drawn[np.isinf(distance)] = clear[np.isinf(distance)] = 0.5
    return tuple(one.astype(np.float32) for one in (drawn, clear, distance))


def write(path, radiance):
    save(path, {name: np.ascontiguousarray(radiance[..., index]) for index, name in enumerate("RGB")})


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("landscape")
    seen, clear, distance = landscape()
    write(folder / "seen.exr", seen)
    write(folder / "clear.exr", clear)
    save(folder / "distance.exr", {"Z": distance})
    return folder


@pytest.fixture(scope="module")
def found(files):
    """Fit of known air with all that helps but the sun's strength."""
    seen, _, distance = landscape()
    return aerial.solve(photo(seen, distance, CAMERA), replace(GIVEN, clear=files / "clear.exr"))


def near(solution, name):
    one = solution.parameters[name]
    assert one.standard_error is not None, one.why
    assert abs(one.value - TRUTH[name]) < 4.0 * one.standard_error + 0.01 * TRUTH[name]
    assert one.standard_error < 0.1 * TRUTH[name]


@pytest.mark.slow
def test_known_air_is_recovered_with_the_strength_of_its_sun(found):
    assert found.solution.minimum.converged
    for name in TRUTH:
        near(found.solution, name)
    scene = found.solution.scene
    np.testing.assert_allclose(scene.exposure.exposure * scene.sun.irradiance, IRRADIANCE, rtol=0.05)
    assert found.solution.parameters["SUN_IRRADIANCE_G"].why == "closed form"
    assert not found.solution.used[:6].any()  # the sky


@pytest.mark.slow
def test_pictures_are_the_photo_and_the_view_without_air(found):
    drawn = aerial.draw(found, found.solution.scene)
    seen, clear, distance = landscape(noise=0.0)
    far = np.isinf(distance)
    assert np.isnan(drawn["fog"][far]).all()
    assert np.abs(drawn["fog"] / seen - 1.0)[~far].max() < 0.03
    told = np.isfinite(drawn["without fog"]).all(-1)
    assert told[~far].mean() > 0.5
    assert np.median(np.abs(drawn["without fog"] / clear - 1.0)[told]) < 0.05


@pytest.mark.slow
def test_of_a_known_sun_the_tint_is_found(files):
    tint = {"AERIAL_PERSPECTIVE_TINT_R": 1.5, "AERIAL_PERSPECTIVE_TINT_B": 0.7}
    seen, _, distance = landscape(**tint)
    start = keyframes.scene({name: value for name, value in WEATHER.items() if name.startswith("SUN")})
    solution = aerial.solve(
        photo(seen, distance, CAMERA), replace(GIVEN, clear=files / "clear.exr", start=start)
    ).solution
    near(solution, "AERIAL_PERSPECTIVE_DISTANCE_SCALE")
    np.testing.assert_allclose(solution.scene.aerial_perspective.tint, (1.5, 1.0, 0.7), rtol=0.05)
    assert solution.parameters["AERIAL_PERSPECTIVE_TINT_G"].why == "closed form"
    assert solution.parameters["SUN_IRRADIANCE_R"].why == "kept"


@pytest.mark.slow
def test_where_surfaces_of_all_shades_hide_the_air_it_is_told_that_they_do():
    seen, _, distance = landscape()
    alone = aerial.solve(photo(seen, distance, CAMERA), GIVEN)
    scale = alone.solution.parameters["AERIAL_PERSPECTIVE_DISTANCE_SCALE"]
    assert (scale.standard_error, scale.why) == (None, "not determined by the photo")
    assert 1.5 < scale.value < 6.0
    near_ones = np.isfinite(distance) & (distance < 2e3)
    assert np.isfinite(aerial.draw(alone, alone.solution.scene)["fog"][near_ones]).all()


@pytest.mark.slow
def test_the_command_writes_a_weather_file_of_the_air(run, files, tmp_path):
    given = ["fog", files / "seen.exr", "--model", "aerial", "--distance", files / "distance.exr"]
    given += ["--clear", files / "clear.exr", "--sun", "20,40", "--fov", "60", "--pitch", "-1", "--eye-height", "150"]
    status, out, _ = run(*given, "--out", tmp_path)
    assert status == 0, out
    values = keyframes.at(weather_file.read(tmp_path / "weather.csv"), 12.0)
    assert values["AERIAL_PERSPECTIVE_DISTANCE_SCALE"] == pytest.approx(3.0, rel=0.1)
    assert not any(name.startswith("HEIGHT_FOG") for name in values)


def test_the_slopes_of_the_residuals_match_differences(found):
    point = torch.from_numpy(found.solution.minimum.point)
    _, slopes = found.objective.jacobian(point)
    for index, step in enumerate(1e-5 * torch.eye(len(point), dtype=torch.float64)):
        both = [found.objective.residuals(point + sign * step) for sign in (1.0, -1.0)]
        torch.testing.assert_close(slopes[:, index], (both[0] - both[1]) / 2e-5, rtol=1e-4, atol=1e-8)


# Refused


def test_without_distances_it_is_refused():
    with pytest.raises(InputError, match="has no distances, which --model aerial needs; give --distance EXR"):
        aerial.solve(photo(landscape()[0], None, CAMERA), GIVEN)


def test_a_photo_of_sky_alone_is_refused():
    seen, _, distance = landscape()
    distance[:-1] = np.inf
    with pytest.raises(InputError, match="only 48 usable pixels have a distance, of at least 100"):
        aerial.solve(photo(seen, distance, CAMERA), GIVEN)


@pytest.mark.parametrize("name", ["AERIAL_PERSPECTIVE_TINT_R", "HEIGHT_FOG_EXTINCTION", "SUN_AZIMUTH"])
def test_what_it_does_not_search_is_refused(name):
    seen, _, distance = landscape()
    with pytest.raises(InputError, match=f"{name} is not for --model aerial's --fix and --free"):
        aerial.solve(photo(seen, distance, CAMERA), replace(GIVEN, fixed={name: 0.5}))


def test_an_eye_below_the_ground_of_the_air_is_refused():
    seen, _, distance = landscape()
    with pytest.raises(InputError, match=r"--eye-height -5; with --model aerial give 0 to 20,000 m"):
        aerial.solve(photo(seen, distance, CAMERA), replace(GIVEN, eye_height=-5.0))


def test_nothing_to_search_is_refused():
    seen, _, distance = landscape()
    with pytest.raises(InputError, match="nothing is left to search"):
        aerial.solve(photo(seen, distance, CAMERA), replace(GIVEN, fixed=TRUTH))


def test_an_unknown_model_is_refused():
    with pytest.raises(InputError, match="the model 'dust' does not exist; use height or aerial"):
        fog_models.model("dust")
