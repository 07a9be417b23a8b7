import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from synthetic_sky import save

from diffrender.antialiasing.settings import AntiAliasing
from diffrender.parameters import defaults
from diffrender.rays import Equirectangular, Perspective
from fit import keyframes, options, png, sampled_photo, sharpening, sharpening_pictures, weather_file
from fit.input_error import InputError
from fit.photo import Photo
from fit.sampled_photo import MARGIN, TILE, Sampling, inner, scenery, tiles
from fit.sharpening_objective import JUMPING, UNSMOOTHED, SharpeningObjective, drawn

pytest_plugins = ["command_fixtures"]

FACTOR = 4
SIDE = TILE * FACTOR
STRENGTH_ALONE = {
    "AA_EDGE_THRESHOLD": 0.2,
    "AA_EDGE_THRESHOLD_MINIMUM": 0.2,
    "AA_SUBPIXEL": 0.5,
    "AA_CONTRAST_RESPONSE": 1.0,
}


def textured(width=SIDE, height=SIDE, seed=0):
    """Radiance of a surface with detail at every scale, and a few clear edges."""
    random = np.random.default_rng(seed)
    grey = np.zeros((height, width))
    for scale in (1, 2, 4, 8, 16):
        coarse = random.standard_normal((height // scale + 1, width // scale + 1))
        grey += scale**0.5 * 0.15 * coarse.repeat(scale, 0).repeat(scale, 1)[:height, :width]
    grey[height // 3 : height // 2] += 0.8
    return np.exp(grey)[..., None].astype(np.float32) * np.array([1.0, 0.8, 0.6], np.float32)


def photo(radiance, camera=None):
    height, width = radiance.shape[:2]
    seen = camera or Perspective(width, height, math.radians(60.0), 0.0)
    header = {"time": None, "latitude": None, "longitude": None, "altitude": None}
    return Photo(Path("synthetic.exr"), radiance, seen, header, (), None)


def one_view(footprint, radiance=None, dtype=torch.float64):
    scene = scenery(photo(textured() if radiance is None else radiance), Sampling(FACTOR, footprint), None)
    return scene.views([(0, 0)], (TILE, TILE), dtype)


# Sampling


def test_samples_without_footprint_are_pixels_of_the_photo():
    radiance = textured()
    scene = scenery(photo(radiance), Sampling(FACTOR, 0.0), None)
    shown = scene.shown((0, 0), (TILE, TILE), torch.float64)
    even, odd = scene.views([(0, 0)], (TILE, TILE), torch.float64).frames[0]
    middle = FACTOR // 2
    torch.testing.assert_close(odd[:, :-1], shown[middle::FACTOR, FACTOR::FACTOR])
    torch.testing.assert_close(even[:-1], shown[FACTOR::FACTOR, middle::FACTOR])


def test_samples_as_wide_as_a_pixel_are_the_truth_in_its_centre():
    views = one_view(1.0)
    torch.testing.assert_close(views.centres, views.truth)
    assert not torch.allclose(one_view(0.5).centres, views.truth, atol=1e-2)


@pytest.mark.parametrize("white", [0, 255])
def test_a_mask_mixes_points_and_footprints(white):
    is_texture = np.full((SIDE, SIDE), white == 255)
    mixed = scenery(photo(textured()), Sampling(FACTOR, 1.0), is_texture).views([(0, 0)], (TILE, TILE), torch.float64)
    torch.testing.assert_close(mixed.frames, one_view(1.0 if white else 0.0).frames)


def test_exposure_does_not_matter():
    radiance = textured()
    torch.testing.assert_close(one_view(0.5, 16.0 * radiance).frames, one_view(0.5, radiance).frames)


def test_tiles_are_whole_parts_with_detail():
    radiance = np.full((3 * SIDE, 3 * SIDE, 3), 0.5, np.float32)
    radiance[: SIDE // 2, : SIDE // 2] = textured(SIDE // 2, SIDE // 2)
    radiance[-SIDE:, -SIDE:] = textured()
    radiance[-SIDE // 2, -SIDE // 2] = np.nan
    scene = scenery(photo(radiance), Sampling(FACTOR), None)
    (found,) = tiles(scene, 100)
    assert found[0] < SIDE // 2 // FACTOR > found[1]
    used = sampled_photo.pixels(scene, [found])
    assert used.sum() == ((TILE - 2 * MARGIN) * FACTOR) ** 2


def test_the_poles_of_a_panorama_are_left_out():
    camera = Equirectangular(2 * 512, 512)
    scene = scenery(photo(textured(1024, 512), camera), Sampling(FACTOR), None)
    used = sampled_photo.pixels(scene, tiles(scene, 100))
    assert used.any()
    rows = np.nonzero(used.any(1))[0]
    up, down = (90.0 - 180.0 * (row + 0.5) / 512 for row in (rows[0], rows[-1]))
    assert up < 60.0
    assert down > -60.0


# Fitting


def by_hand(footprint, radiance, lobe):
    """Mean of two frames sharpened without FXAA, and the truth, by sums over the photo's pixels in numpy."""
    shown = scenery(photo(radiance), Sampling(FACTOR), None).shown((0, 0), (TILE, TILE), torch.float64).numpy()
    side = max(footprint * FACTOR, 1.0)

    def mean(place_y, place_x, width):
        def shares(place):
            cells = np.arange(shown.shape[0])
            return np.clip(
                np.minimum(cells + 1, place + 0.5 + width / 2) - np.maximum(cells, place + 0.5 - width / 2), 0, None
            )

        return np.einsum("i,j,ijc->c", shares(place_y), shares(place_x), shown) / width**2

    found, truth = [], []
    for row in range(MARGIN, TILE - MARGIN, 4):
        for column in range(MARGIN, TILE - MARGIN, 4):
            y, x = FACTOR * row + FACTOR / 2, FACTOR * column + FACTOR / 2
            taps = [FACTOR * step for step in (-1.5, -0.5, 0.5, 1.5)]
            weights = [-lobe, 0.5 + lobe, 0.5 + lobe, -lobe]
            down = sum(w * mean(y + t, x, side) for w, t in zip(weights, taps, strict=True))
            right = sum(w * mean(y, x + t, side) for w, t in zip(weights, taps, strict=True))
            found.append((down + right) / 2)
            truth.append(mean(y, x, FACTOR))
    return np.array(found), np.array(truth)


@pytest.mark.parametrize("footprint", [0.0, 0.5, 1.0])
def test_pictures_without_fxaa_are_those_by_hand(footprint):
    settings = replace(
        defaults(AntiAliasing, torch.float64),
        sharpening=torch.tensor(0.1, dtype=torch.float64),
        contrast_response=torch.tensor(0.0, dtype=torch.float64),
    )
    views = one_view(footprint)
    found = sharpening_pictures.methods(settings, views)["without fxaa"][0]
    wanted, truth = by_hand(footprint, textured(), 0.1)
    inside = slice(MARGIN, TILE - MARGIN, 4)
    np.testing.assert_allclose(found[inside, inside].reshape(-1, 3).numpy(), wanted, atol=1e-12)
    np.testing.assert_allclose(views.truth[0, inside, inside].reshape(-1, 3).numpy(), truth, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("footprint", [0.0, 0.5, 1.0])
def test_the_strength_found_is_that_of_a_grid_search(footprint):
    asked = sharpening.Options(sampling=Sampling(FACTOR, footprint), fixed=STRENGTH_ALONE)
    found = sharpening.solve(photo(textured()), asked)
    settings = found.solution.scene.antialiasing
    lobes = np.linspace(0.0, 0.25, 26)
    errors = []
    for lobe in lobes:
        tried = replace(settings, sharpening=torch.tensor(lobe, dtype=torch.float64))
        errors.append(float(inner(drawn(tried, found.views) - found.views.truth).square().mean()))
    assert found.solution.minimum.converged
    assert found.solution.error <= min(errors) * (1.0 + 1e-9)
    assert float(settings.sharpening) == pytest.approx(lobes[np.argmin(errors)], abs=0.0051)


@pytest.mark.slow
def test_points_are_best_not_sharpened_and_wide_samples_are(monkeypatch):
    monkeypatch.setattr(sharpening, "THRESHOLDS", sharpening.THRESHOLDS[1::3])
    found = {
        footprint: sharpening.fit(photo(textured()), sharpening.Options(sampling=Sampling(FACTOR, footprint)))
        for footprint in (0.0, 1.0)
    }
    assert found[0.0].parameters["AA_SHARPENING"].value < 0.02
    wide = found[1.0].parameters["AA_SHARPENING"]
    assert wide.determined
    assert wide.value > 1.0 / 16.0
    for solution in found.values():
        scores = {name: score["psnr"] for name, score in solution.scores.items()}
        assert scores["fitted"] >= max(scores["average"], scores["catmull-rom"], scores["default"]) - 0.01
        assert solution.error == pytest.approx(10.0 ** (-scores["fitted"] / 10.0))


def test_derivatives_are_those_of_differences():
    views = one_view(0.5)
    space = sharpening.search_space(sharpening.Options())
    objective = SharpeningObjective(space, views)
    point = torch.from_numpy(space.point(space.start))
    residuals, slopes = objective.jacobian(point)
    assert torch.equal(residuals, objective.residuals(point))
    for index, name in enumerate(space.free):
        step = torch.zeros_like(point)
        step[index] = 0.025 if name in JUMPING else 1e-6
        wanted = (objective.residuals(point + step) - objective.residuals(point - step)) / (2.0 * step[index])
        torch.testing.assert_close(slopes[:, index], wanted, rtol=1e-4, atol=1e-6)
        assert float(wanted.abs().max()) > 0.0


@pytest.mark.parametrize("motion", [(0.0, 0.0), (-7.75, 6.25)])
def test_a_picture_in_bands_is_the_picture_whole(monkeypatch, motion):
    scene = scenery(photo(textured(64, 400)), Sampling(FACTOR, 0.5, motion=motion), None)
    settings = defaults(AntiAliasing)
    whole = sharpening_pictures.draw(scene, settings)
    monkeypatch.setattr(sharpening_pictures, "ROWS", 23)
    for name, picture in sharpening_pictures.draw(scene, settings).items():
        # torch's powers round by where in a vector a number lies.
        np.testing.assert_allclose(picture, whole[name], rtol=1e-6)


# Motion


MOTION = (2.0, -1.0)


def moving(motion, footprint=0.5):
    radiance = textured(SIDE + 64, SIDE + 64)
    scene = scenery(photo(radiance), Sampling(FACTOR, footprint, motion=motion), None)
    return scene, scene.tiles([(4, 4)], torch.float64)


def test_what_is_behind_the_disc_was_where_its_motion_says():
    scene, views = moving(MOTION)
    still = scene.views([(4, 4)], (TILE, TILE), torch.float64)
    right, down = (int(way) for way in MOTION)
    even, before = views.frames[0, 0], scenery(scene.photo, Sampling(FACTOR, 0.5), None)
    wanted = before.views([(4 + down, 4 + right)], (TILE, TILE), torch.float64).frames[0, 0]
    middle = slice(TILE // 2 - 5, TILE // 2 + 5)
    assert torch.equal(even[:8], wanted[:8])
    assert not torch.isclose(even[middle, middle], wanted[middle, middle]).all()
    assert torch.equal(views.motion[0, 0, 0], torch.tensor([-2.0, 1.0], dtype=torch.float64))
    assert torch.equal(views.motion[0, middle, middle], torch.zeros(10, 10, 2, dtype=torch.float64))
    assert torch.equal(still.truth[0, :8], views.truth[0, :8])


def test_a_third_of_a_pixel_may_be_given_with_a_few_digits():
    assert Sampling(6, motion=(0.3333, -1.66667)).motion == (0.3333, -1.66667)
    with pytest.raises(InputError, match="multiples of 1/6"):
        Sampling(6, motion=(0.33, 0.0))


def test_history_that_moves_along_is_as_good_as_that_of_a_scene_at_rest():
    scene, views = moving(MOTION)
    settings = defaults(AntiAliasing, torch.float64)
    rest = scenery(scene.photo, Sampling(FACTOR, 0.5), None).views([(4, 4)], (TILE, TILE), torch.float64)
    # Motion by whole pixels blurs nothing; rows away from the disc and the border, as far as the filter's taps see.
    pictures = [drawn(settings, one, UNSMOOTHED)[0, 4:7, 4:-4] for one in (views, rest)]
    torch.testing.assert_close(*pictures)
    forgotten = replace(views, motion=torch.zeros_like(views.motion))
    errors = [float(inner(drawn(settings, one) - one.truth).square().mean()) for one in (views, forgotten)]
    assert errors[0] < 0.9 * errors[1]


def test_the_tolerance_of_history_is_searched_where_the_scene_moves():
    seen = photo(textured(SIDE + 64, SIDE + 64))
    asked = sharpening.Options(sampling=Sampling(FACTOR, 0.5, motion=(1.25, -0.5)), fixed=STRENGTH_ALONE)
    found = sharpening.solve(seen, asked)
    assert found.solution.parameters["AA_HISTORY_TOLERANCE"].why != "default"
    assert any("moves 1.25,-0.5 pixels a frame" in note for note in found.solution.notes)
    usual = sharpening.search_space(sharpening.Options(fixed=STRENGTH_ALONE)).start.antialiasing
    begun = float(inner(drawn(usual, found.views) - found.views.truth).square().mean())
    assert found.solution.error < begun


# The command


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    folder = tmp_path_factory.mktemp("given")
    save(folder / "photo.exr", textured(SIDE + 32, SIDE))
    save(folder / "small.exr", textured(64, 64))
    save(folder / "smooth.exr", np.full((SIDE, SIDE, 3), 0.5, np.float32))
    save(folder / "black.exr", np.zeros((SIDE, SIDE, 3), np.float32))
    (folder / "small.png").write_bytes(png.encoded(np.full((8, 8, 1), 255, np.uint8)))
    return folder


@pytest.fixture
def inside(given, monkeypatch):
    monkeypatch.chdir(given)


@pytest.mark.slow
def test_the_weather_file_draws_the_same_picture(run, given, tmp_path):
    fixed = [word for name, value in STRENGTH_ALONE.items() for word in ("--fix", f"{name}={value}")]
    words = ("--fov", "60", "--screen", "pq", *fixed, "--out", tmp_path)
    status, told, err = run("sharpening", given / "photo.exr", *words)
    assert (status, err) == (0, "")
    assert "AA_SHARPENING" in told
    assert "catmull-rom" in told
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["fit.json", "fitted.exr", "mask.png", "report.html", "weather.csv"]
    account = json.loads((tmp_path / "fit.json").read_text())
    rows = weather_file.read(tmp_path / "weather.csv").values
    assert {name for name in account["parameters"] if name.startswith("AA_")} <= set(rows)
    assert rows["AA_CONTRAST_RESPONSE"] == (1.0,)
    assert (account["effect"], account["sun"]) == ("sharpening", None)
    scene = options.first_scene(tmp_path / "weather.csv")
    again = keyframes.scene(keyframes.values(scene)).antialiasing
    seen = sharpening.photos.read(given / "photo.exr", field_of_view=60.0)
    wanted = sharpening_pictures.draw(scenery(seen, Sampling(screen="pq"), None), again)
    with OpenEXR.File(str(tmp_path / "fitted.exr")) as file:
        parts = {part.name(): part.channels["RGB"].pixels for part in file.parts}
    assert next(iter(parts)) == "fitted"
    assert sorted(parts) == sorted(sharpening_pictures.SHOWN)
    for name, picture in parts.items():
        assert picture.shape == (SIDE // FACTOR, (SIDE + 32) // FACTOR, 3)
        np.testing.assert_array_equal(picture, wanted[name])
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png") == len(sharpening_pictures.SHOWN)
    assert "E3 =" not in page


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("photo.exr", "--factor", "5"), "--factor 5; give an even number from 4 to 16"),
        (("photo.exr", "--footprint", "1.5"), "--footprint 1.5; give pixels from 0"),
        (("photo.exr", "--footprint", "nan"), "--footprint nan; give pixels from 0"),
        (("photo.exr", "--motion", "1.1,0"), "--motion 1.1,0.0; give pixels to the right and down, whole pixels"),
        (("photo.exr", "--motion", "9,0"), "up to 8"),
        (("photo.exr", "--motion", "0,1"), "at --motion 0,1; give a larger photo or a smaller --motion"),
        (("photo.exr", "--fix", "AA_SUBPIXEL=1", "--free", "AA_SUBPIXEL"), "--fix and --free both name AA_SUBPIXEL"),
        (("photo.exr", "--motion", "fast"), "--motion fast; give RIGHT,DOWN"),
        (("photo.exr", "--screen", "film"), "allowed are srgb and pq"),
        (("photo.exr", "--fix", "SKY_OZONE=1"), "give one of AA_"),
        (("photo.exr", "--solver", "magic"), "does not exist"),
        (("photo.exr", "--textures", "small.png"), "give a mask of the photo's size"),
        (("small.exr",), "give a larger photo or a smaller --factor"),
        (("smooth.exr",), "smooth everywhere"),
        (("black.exr",), "black everywhere"),
        (("absent.exr",), "absent.exr"),
    ],
)
@pytest.mark.usefixtures("inside")
def test_bad_input_is_one_line_and_leaves_nothing(run, tmp_path, words, said):
    status, out, err = run("sharpening", *words, "--fov", "60", "--out", tmp_path / "out")
    assert (status, out) == (2, "")
    assert said in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
