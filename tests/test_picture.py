import math

import numpy as np
import OpenEXR
import pytest
import torch
from synthetic_sky import CAMERA, HAZY_MORNING

from diffrender import rays
from diffrender.atmosphere import sky
from diffrender.scene import sky_view
from fit import keyframes, picture
from fit.input_error import InputError

SCENE = keyframes.scene(HAZY_MORNING)
DRAWN = picture.draw(SCENE, CAMERA)


def scene(**changes):
    return keyframes.scene({**HAZY_MORNING, **changes})


def directions(camera):
    return camera.direction(*rays.pixel_centres(camera, slice(None), torch.zeros(())))


def test_a_picture_is_the_sky_of_the_last_table_rung():
    view = sky_view(SCENE, directions(CAMERA))
    whole = sky.render_tables(SCENE.sky, sky.prepare(SCENE.sky, view)).numpy()
    assert np.allclose(DRAWN["sky"], whole, rtol=1e-5, atol=0.0)


def test_the_sky_is_lit_above_the_horizon_and_black_below():
    up = directions(CAMERA)[..., 2].numpy() > 0.0
    assert (DRAWN["sky"][up] > 0.0).all()
    assert not DRAWN["sky"][~up].any()


def test_the_disc_is_where_the_sun_stands_and_nowhere_else():
    camera = rays.Equirectangular(720, 360)
    # In the middle of a pixel, which is as wide as the disc.
    drawn = picture.draw(scene(SUN_ELEVATION=20.25, SUN_AZIMUTH=30.25), camera)
    towards = rays.from_angles(torch.tensor(math.radians(20.25)), torch.tensor(math.radians(-30.25)))
    near = (directions(camera) @ towards).numpy() > math.cos(math.radians(0.3))
    assert near.any()
    assert np.array_equal(drawn["sun"].any(-1), near)


def test_pictures_do_not_depend_on_how_many_rows_are_drawn_at_once(monkeypatch):
    monkeypatch.setattr(picture, "PIXELS_AT_ONCE", 5 * CAMERA.width)
    again = picture.draw(SCENE, CAMERA)
    assert np.allclose(again["sky"], DRAWN["sky"], rtol=1e-5, atol=0.0)
    assert np.array_equal(again["sun"], DRAWN["sun"])


def test_drawing_twice_gives_the_same_bits():
    again = picture.draw(SCENE, CAMERA)
    assert np.array_equal(again["sky"], DRAWN["sky"])


def test_exposure_scales_sky_and_disc_alike():
    camera = rays.Perspective(40, 40, 0.03, pitch=math.radians(20.0))
    one, four = (picture.draw(scene(EXPOSURE=value, SUN_AZIMUTH=0.0), camera) for value in (0.5, 2.0))
    assert one["sun"].any()
    assert np.allclose(four["sky"], 4.0 * one["sky"], rtol=1e-5)
    assert np.allclose(four["sun"], 4.0 * one["sun"], rtol=1e-5)


@pytest.mark.parametrize(
    "camera",
    [
        rays.Equirectangular(64, 16, lowest=0.0),
        rays.Cubemap(16, rays.CROSS_LYING),
        rays.Cubemap(16, rays.STRIP_STANDING),
        rays.Perspective(48, 32, 1.2, pitch=0.4),
    ],
    ids=["hemisphere", "cross", "strip", "perspective"],
)
def test_every_camera_sees_the_same_sky(camera):
    drawn = picture.draw(SCENE, camera)
    assert drawn["sky"].shape == (camera.height, camera.width, 3)
    view = sky_view(SCENE, directions(camera))
    whole = sky.render_tables(SCENE.sky, sky.prepare(SCENE.sky, view)).numpy()
    shown = camera.solid_angle(*rays.pixel_centres(camera, slice(None), torch.zeros(()))).numpy() > 0.0
    assert np.allclose(drawn["sky"][shown], whole[shown], rtol=1e-5, atol=0.0)


def test_cells_of_a_cross_that_show_nothing_are_black():
    drawn = picture.draw(SCENE, rays.Cubemap(16, rays.CROSS_LYING))
    assert not drawn["sky"][:16, :16].any()
    assert not drawn["sky"][:16, 32:].any()
    assert (drawn["sky"][:16, 16:32] > 0.0).all()


@pytest.mark.parametrize("changes", [{"SUN_ELEVATION": -3.0}, {"SKY_OVERCAST": 1.0}])
def test_behind_the_earth_or_clouds_there_is_no_disc(changes):
    dark = scene(**changes)
    assert not picture.draw(dark, rays.Equirectangular(360, 180))["sun"].any()


# Files


def test_a_file_has_the_sky_and_then_the_sun(tmp_path):
    path = tmp_path / "drawn.exr"
    picture.write(path, DRAWN, {"weather": "day.csv"})
    with OpenEXR.File(str(path)) as file:
        assert [part.name() for part in file.parts] == ["sky", "sun"]
        assert np.array_equal(file.parts[0].channels["RGB"].pixels, DRAWN["sky"])
        assert np.array_equal(file.parts[1].channels["RGB"].pixels, DRAWN["sun"])


def test_a_picture_that_cannot_be_written_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        picture.write(tmp_path / "missing" / "drawn.exr", DRAWN, {})
    assert not any(tmp_path.iterdir())
