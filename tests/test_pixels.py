import math

import numpy as np
import pytest
import torch
from synthetic_sky import photo

from diffrender.rays import STRIP_LYING, Cubemap, Equirectangular, Perspective
from fit import pixels
from fit.pixels import averaged, stratified, usable

SMALL = Equirectangular(64, 32)
LARGE = Equirectangular(2048, 1024)  # four pixels a box
EVERYWHERE = np.ones((32, 64), bool)


def plain(camera, value=2.0):
    return np.full((camera.height, camera.width, 3), value, np.float32)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1e-3])
def test_pixels_that_show_nothing_are_not_usable(bad):
    seen = plain(SMALL)
    seen[3, 5, 1] = bad
    used = usable(photo(seen, SMALL), EVERYWHERE)
    assert not used[3, 5]
    assert used.sum() == used.size - 1


def test_what_the_mask_leaves_out_is_not_usable():
    mask = EVERYWHERE.copy()
    mask[10:] = False
    assert np.array_equal(usable(photo(plain(SMALL), SMALL), mask), mask)


def test_small_photos_are_taken_as_they_are():
    seen = np.random.default_rng(0).random((32, 64, 3), np.float32)
    found = averaged(photo(seen, SMALL), EVERYWHERE)
    assert np.array_equal(found.radiance.numpy(), seen)
    assert found.used.all()


def test_the_number_of_boxes_does_not_grow_with_the_photo():
    for scale in (1, 2, 3):
        camera = Equirectangular(1024 * scale, 512 * scale)
        found = averaged(photo(plain(camera), camera), np.ones((camera.height, camera.width), bool))
        assert found.used.shape == (256, 512)


def test_a_box_has_the_mean_of_its_pixels():
    seen = np.random.default_rng(0).random((1024, 2048, 3), np.float32)
    found = averaged(photo(seen, LARGE), np.ones((1024, 2048), bool))
    assert found.radiance[7, 9].numpy() == pytest.approx(seen[28:32, 36:40].mean((0, 1)), rel=1e-6)
    assert float(found.radiance.mean()) == pytest.approx(float(seen.mean()), rel=1e-5)


def test_a_box_is_used_only_when_all_of_its_pixels_are():
    used = np.ones((1024, 2048), bool)
    used[29, 38] = False
    found = averaged(photo(plain(LARGE), LARGE), used)
    assert not found.used[7, 9]
    assert found.used.sum() == found.used.numel() - 1


@pytest.mark.parametrize("camera", [SMALL, LARGE, Cubemap(256, STRIP_LYING)])
def test_boxes_share_out_the_whole_sphere(camera):
    found = averaged(photo(plain(camera), camera), np.ones((camera.height, camera.width), bool))
    assert float(found.solid_angle.sum()) == pytest.approx(4.0 * math.pi, rel=1e-3)


@pytest.mark.parametrize("camera", [SMALL, LARGE, Perspective(1536, 1024, 1.0, pitch=0.3)])
def test_a_box_lies_where_its_pixels_do(camera):
    found = averaged(photo(plain(camera), camera), np.ones((camera.height, camera.width), bool))
    side = camera.width // found.used.shape[1]
    place = camera.place(found.direction[5, 11])
    assert place.tolist() == pytest.approx([11.5 * side, 5.5 * side], abs=1e-6)


def test_pixels_that_fill_no_box_are_left_out():
    camera = Perspective(1023, 511, 1.0)
    found = averaged(photo(plain(camera), camera), np.ones((511, 1023), bool))
    assert found.used.shape == (255, 511)
    assert torch.equal(found.radiance, torch.full((255, 511, 3), 2.0))


def test_the_floor_follows_the_photo_s_scale():
    seen = np.random.default_rng(0).random((32, 64, 3), np.float32)
    one, thousand = (averaged(photo(k * seen, SMALL), EVERYWHERE).floor for k in (np.float32(1.0), np.float32(1000.0)))
    assert thousand == pytest.approx(1000.0 * one)
    assert one == pytest.approx(pixels.FLOOR * 0.5, rel=0.05)


def test_pixels_that_are_not_used_have_no_say_in_the_floor():
    mask = EVERYWHERE.copy()
    mask[16:] = False
    dark, bright = plain(SMALL), plain(SMALL)
    bright[16:] = 1e6
    assert averaged(photo(dark, SMALL), mask).floor == averaged(photo(bright, SMALL), mask).floor


def test_a_sample_stands_for_equal_solid_angles():
    found = averaged(photo(plain(SMALL), SMALL), EVERYWHERE)
    chosen = stratified(found, 400, seed=0)
    height = found.direction[found.used][chosen, 2]
    # A zone's share of the sphere is its height (Archimedes), to one stratum at each of its borders.
    for low, high in ((-1.0, -0.5), (0.0, 0.5), (0.5, 1.0)):
        share = float(((height > low) & (height <= high)).double().mean())
        assert share == pytest.approx((high - low) / 2.0, abs=0.03)


def test_a_sample_is_of_used_pixels_in_order():
    mask = EVERYWHERE.copy()
    mask[16:] = False
    chosen = stratified(averaged(photo(plain(SMALL), SMALL), mask), 100, seed=0)
    assert chosen.shape == (100,)
    assert bool((chosen.diff() >= 0).all())
    assert 0 <= int(chosen.min()) <= int(chosen.max()) < 16 * 64


def test_a_seed_gives_one_sample_and_another_seed_another():
    found = averaged(photo(plain(SMALL), SMALL), EVERYWHERE)
    assert torch.equal(stratified(found, 100, seed=1), stratified(found, 100, seed=1))
    assert not torch.equal(stratified(found, 100, seed=1), stratified(found, 100, seed=2))


def test_a_sample_does_not_touch_the_global_generator():
    state = torch.random.get_rng_state()
    stratified(averaged(photo(plain(SMALL), SMALL), EVERYWHERE), 100, seed=1)
    assert torch.equal(torch.random.get_rng_state(), state)


@pytest.mark.parametrize("count", [64 * 32, 10**6])
def test_of_few_pixels_all_are_taken_once(count):
    chosen = stratified(averaged(photo(plain(SMALL), SMALL), EVERYWHERE), count, seed=0)
    assert torch.equal(chosen, torch.arange(64 * 32))
