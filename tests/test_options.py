import math
from datetime import UTC, datetime

import pytest
import torch

from diffrender import rays
from fit import options
from fit.input_error import InputError
from fit.shot import Shot


def test_values_are_taken_by_name():
    assert options.assignments(["SKY_OZONE=1", " SKY_HAZINESS = 0.5 ", "SKY_MIE_SCALE=1e1"]) == {
        "SKY_OZONE": 1.0,
        "SKY_HAZINESS": 0.5,
        "SKY_MIE_SCALE": 10.0,
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("SKY_OZONE", "give NAME=VALUE"),
        ("SKY_OZONE=", "give NAME=VALUE"),
        ("SKY_OZONE=much", "give NAME=VALUE"),
        ("SKY_OZONE=nan", "give NAME=VALUE"),
        ("SKY_OZONE=inf", "give NAME=VALUE"),
        ("", "give NAME=VALUE"),
        ("=1", "unknown name"),
        ("SKY_OZOME=1", "nearest known one is SKY_OZONE"),
        ("SKY_HAZINESS=1.5", "SKY_HAZINESS is 1.5; allowed 0 to 0.99"),
    ],
)
def test_other_texts_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        options.assignments([text])


def test_a_name_is_fixed_once():
    with pytest.raises(InputError, match="SKY_OZONE twice"):
        options.assignments(["SKY_OZONE=1", "SKY_OZONE=2"])


# Start


def weather(path, *rows):
    path.write_text("\n".join(["# weather 1", "TIME_OF_DAY,6,18", *rows]) + "\n")
    return path


def test_a_start_is_the_first_hour_in_double_precision(tmp_path):
    scene = options.start(weather(tmp_path / "day.csv", "SKY_HAZINESS,0.3,0.9"))
    assert scene.sky.haziness.dtype == torch.float64
    assert float(scene.sky.haziness) == 0.3


def test_a_start_without_sky_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no sky"):
        options.start(weather(tmp_path / "day.csv", "EXPOSURE,1,2"))


def test_a_broken_start_is_refused_with_its_place(tmp_path):
    with pytest.raises(InputError, match=r"day\.csv, row 3, column 3"):
        options.start(weather(tmp_path / "day.csv", "SKY_HAZINESS,0.3,much"))


def test_the_hour_is_that_given_else_that_of_the_time_else_noon():
    at = datetime(2020, 6, 1, 6, 30, tzinfo=UTC)
    assert [options.hour_of(given, Shot(time=at)) for given in (9.0, 0.0, None)] == [9.0, 0.0, 6.5]
    assert options.hour_of(None, Shot()) == 12.0


# Camera


@pytest.mark.parametrize(
    ("given", "camera"),
    [
        (("1024x512", None, None, 0.0), rays.Equirectangular(1024, 512)),
        (("1000x400", "equirectangular", None, 0.0), rays.Equirectangular(1000, 400)),
        (("1024x256", None, None, 0.0), rays.Equirectangular(1024, 256, lowest=0.0)),
        (("1024x256", "equirectangular", None, 0.0), rays.Equirectangular(1024, 256, lowest=0.0)),
        (("1024x256", "hemisphere", None, 0.0), rays.Equirectangular(1024, 256, lowest=0.0)),
        (("600x100", None, None, 0.0), rays.Cubemap(100, rays.STRIP_LYING)),
        (("100x600", None, None, 0.0), rays.Cubemap(100, rays.STRIP_STANDING)),
        (("400x300", "cubemap", None, 0.0), rays.Cubemap(100, rays.CROSS_LYING)),
        (("300x400", "cubemap", None, 0.0), rays.Cubemap(100, rays.CROSS_STANDING)),
        (("640x480", None, 60.0, 10.0), rays.Perspective(640, 480, math.radians(60.0), math.radians(10.0))),
        (("1024x512", "perspective", 60.0, 0.0), rays.Perspective(1024, 512, math.radians(60.0))),
        (("1x1", "perspective", 1.0, 0.0), rays.Perspective(1, 1, math.radians(1.0))),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)
def test_a_camera_follows_from_size_and_projection(given, camera):
    assert options.camera(*given) == camera


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("1024", None, None, 0.0), "--size 1024; give WIDTHxHEIGHT"),
        (("0x512", None, None, 0.0), "give WIDTHxHEIGHT"),
        (("-4x2", None, None, 0.0), "give WIDTHxHEIGHT"),
        (("\uff11\uff10x\uff15", None, None, 0.0), "give WIDTHxHEIGHT"),
        (("99999x99999", None, None, 0.0), "at most 64,000,000 pixels"),
        (("640x480", None, None, 0.0), "no shape of a panorama"),
        (("640x480", "fisheye", None, 0.0), "--projection fisheye is unknown; allowed are equirectangular"),
        (("640x400", "cubemap", None, 0.0), "wrong shape for cubemap"),
        (("641x481", "cubemap", None, 0.0), "wrong shape for cubemap"),
        (("1024x512", "hemisphere", None, 0.0), "wrong shape for hemisphere"),
        (("640x480", "perspective", None, 0.0), "needs --fov"),
        (("640x480", None, 0.0, 0.0), "needs --fov"),
        (("640x480", None, 180.0, 0.0), "needs --fov"),
        (("640x480", None, math.nan, 0.0), "needs --fov"),
        (("640x480", None, 60.0, 91.0), "--pitch 91"),
        (("640x480", None, 60.0, math.nan), "--pitch nan"),
        (("1024x512", "equirectangular", 60.0, 0.0), "leave them out"),
        (("1024x512", None, None, 5.0), "leave them out"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)
def test_other_cameras_are_refused(given, message):
    with pytest.raises(InputError, match=message):
        options.camera(*given)
