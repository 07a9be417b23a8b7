import numpy as np
import pytest
import torch
from exr_files import save
from foggy_picture import CAMERA, EYE, photo

from diffrender.rays import Equirectangular, pixel_centres
from fit import distance
from fit.input_error import InputError

GREY = np.ones((CAMERA.height, CAMERA.width, 3), np.float32)


def test_a_wall_of_one_depth_is_farther_along_rays_to_its_edges():
    depth = np.full(GREY.shape[:2], 100.0, np.float32)
    found = distance.of(photo(GREY, depth), None, "depth", EYE)
    direction = CAMERA.direction(*pixel_centres(CAMERA, slice(0, CAMERA.height), torch.zeros(()))).numpy()
    met = direction * found[..., None]
    ahead = np.array([np.cos(CAMERA.pitch), 0.0, np.sin(CAMERA.pitch)])
    np.testing.assert_allclose(met @ ahead, 100.0, rtol=1e-5)
    assert np.linalg.norm(met[20, 0] - met[20, -1]) == pytest.approx(
        200.0 * np.tan(np.radians(30.0)) * 63 / 64, rel=1e-5
    )


def test_distances_along_rays_stay_as_they_are():
    given = np.random.default_rng(0).uniform(1.0, 1e6, GREY.shape[:2]).astype(np.float32)
    assert np.array_equal(distance.of(photo(GREY, given), None, "euclidean", EYE), given)


@pytest.mark.parametrize("kind", distance.KINDS)
def test_the_sky_is_infinitely_far_whatever_it_is_written_as(kind):
    given = np.full(GREY.shape[:2], 50.0, np.float32)
    given[0, :4] = 1e8, 1e9, 1e10, np.inf
    given[1, :4] = 0.0, -1.0, np.nan, -np.inf
    found = distance.of(photo(GREY, given), None, kind, EYE)
    assert np.isposinf(found[0, :4]).all()
    assert np.isnan(found[1, :4]).all()
    assert np.isfinite(found).sum() == found.size - 8


def test_the_given_distances_are_left_unchanged():
    given = np.full(GREY.shape[:2], 50.0, np.float32)
    given[0, 0] = 1e9
    before = given.copy()
    distance.of(photo(GREY, given), None, "depth", EYE)
    assert np.array_equal(given, before)


@pytest.mark.parametrize("name", ["Z", "Y", "R"])
def test_a_file_goes_before_the_photo_s_own_channel(tmp_path, name):
    own, given = (np.full(GREY.shape[:2], value, np.float32) for value in (1.0, 2.0))
    path = save(tmp_path / "distance.exr", {name: given})
    assert np.array_equal(distance.of(photo(GREY, own), path, "euclidean", EYE), given)


def test_a_picture_in_grey_is_read_and_one_in_colour_refused(tmp_path):
    given = np.full(GREY.shape[:2], 2.0, np.float32)
    grey = save(tmp_path / "grey.exr", dict.fromkeys("RGB", given))
    assert np.array_equal(distance.of(photo(GREY), grey, "euclidean", EYE), given)
    colour = save(tmp_path / "colour.exr", {"R": given, "G": given + 1.0, "B": given})
    with pytest.raises(InputError, match=r"colour\.exr is a picture in colour; give an OpenEXR of distances"):
        distance.of(photo(GREY), colour, "euclidean", EYE)


def test_without_a_file_or_channel_no_distance_is_known():
    assert distance.of(photo(GREY), None, "euclidean", EYE) is None


def test_only_perspective_pictures_have_a_depth():
    camera = Equirectangular(8, 4)
    with pytest.raises(InputError, match="--distance-kind euclidean"):
        distance.of(photo(GREY[:4, :8], GREY[:4, :8, 0], camera), None, "depth", EYE)


def test_a_file_without_distances_is_refused(tmp_path):
    path = save(tmp_path / "distance.exr", {"G": GREY[..., 0]})
    with pytest.raises(InputError, match="none of the channels Z, Y, R"):
        distance.of(photo(GREY), path, "euclidean", EYE)


def test_level_ground_is_as_far_as_a_round_earth_lets_it_be():
    camera = Equirectangular(8, 1800)
    looked = photo(np.ones((1800, 8, 3), np.float32), None, camera)
    found = distance.of(looked, distance.LEVEL, "euclidean", 716.0)
    assert found[-1, 0] == pytest.approx(716.0, rel=1e-5)
    # The horizon is 0.86 degrees down.
    assert np.isposinf(found[:908]).all()
    assert np.isfinite(found[909:]).all()
    up = np.sin(np.radians(90.0 - (np.arange(909, 1800) + 0.5) * 0.1))
    radius = np.hypot(6360716.0 + found[909:, 0] * up, found[909:, 0] * np.sqrt(1.0 - up * up))
    np.testing.assert_allclose(radius, 6360e3, atol=0.1)


@pytest.mark.parametrize("eye", [0.0, -2.0])
def test_level_ground_cannot_be_seen_from_below(eye):
    with pytest.raises(InputError, match="--distance level looks down on the ground; give an --eye-height above 0"):
        distance.of(photo(GREY), distance.LEVEL, "euclidean", eye)
