"""DESIGN section 3: each convention pinned by one number."""

import math

import pytest
import torch

from diffrender import colour
from diffrender.atmosphere.celestial import Sun
from diffrender.parameters import Specification, specifications
from diffrender.rays import Equirectangular, Perspective, angles, from_angles, pixel_centres
from diffrender.scene import RECORDS, weather_names

WHOLE = Equirectangular(width=360, height=180)  # a degree to the pixel


def seen_at(camera, x, y):
    return camera.direction(*torch.tensor([x, y], dtype=torch.float64))


def assert_points(direction, x, y, z):
    torch.testing.assert_close(direction, torch.tensor([x, y, z], dtype=direction.dtype), atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("camera", [WHOLE, Perspective(width=360, height=180, field_of_view=1.0)])
def test_x_axis_lies_under_the_centre_of_the_picture(camera):
    assert_points(seen_at(camera, 180.0, 90.0), 1.0, 0.0, 0.0)


def test_y_axis_lies_to_the_left_of_the_picture():
    assert_points(seen_at(WHOLE, 90.0, 90.0), 0.0, 1.0, 0.0)


def test_z_axis_points_up():
    assert_points(seen_at(WHOLE, 180.0, 0.0), 0.0, 0.0, 1.0)


def test_axes_are_right_handed():
    ahead, left, up = seen_at(WHOLE, 180.0, 90.0), seen_at(WHOLE, 90.0, 90.0), seen_at(WHOLE, 180.0, 0.0)
    assert torch.dot(torch.linalg.cross(ahead, left), up) == pytest.approx(1.0)


def test_row_zero_is_on_top_and_column_zero_on_the_left():
    x, y = pixel_centres(WHOLE, slice(0, 1), torch.zeros((), dtype=torch.float64))
    elevation, azimuth = angles(WHOLE.direction(x, y))
    assert math.degrees(elevation[0, 0]) == pytest.approx(89.5)
    assert math.degrees(azimuth[0, 0]) == pytest.approx(179.5)


def test_pixel_centres_lie_at_one_half():
    x, y = pixel_centres(Equirectangular(width=4, height=2), slice(0, 2), torch.zeros(()))
    assert (x[1, 3], y[1, 3]) == (3.5, 1.5)


def test_images_are_height_by_width_by_channels():
    x, y = pixel_centres(Equirectangular(width=4, height=2), slice(0, 2), torch.zeros(()))
    picture = Equirectangular(width=4, height=2).direction(x, y)
    assert picture.shape == (2, 4, 3)
    assert colour.luminance(picture).shape == (2, 4)


def test_angles_are_radians_and_azimuth_counts_from_x_towards_y():
    elevation, azimuth = torch.tensor([math.pi / 6, math.pi / 2], dtype=torch.float64)
    assert_points(from_angles(elevation, azimuth), 0.0, math.cos(math.pi / 6), 0.5)


def test_primaries_are_those_of_rec_709_under_d65():
    assert colour.luminance(torch.tensor([0.0, 1.0, 0.0])) == pytest.approx(0.7152)
    assert colour.REC709[-2:] == (0.3127, 0.3290)


def test_azimuth_in_files_counts_degrees_to_the_right_of_the_pictures_centre():
    specification = specifications(Sun)["azimuth"]
    _, azimuth = angles(seen_at(WHOLE, 190.0, 90.0))  # ten degrees right of the centre column
    assert float(azimuth) * specification.file_factor == pytest.approx(10.0)
    assert specification.file_unit == "degrees to the right"


def test_elevation_in_files_counts_degrees_up():
    specification = specifications(Sun)["elevation"]
    elevation, _ = angles(seen_at(WHOLE, 180.0, 80.0))
    assert float(elevation) * specification.file_factor == pytest.approx(10.0)
    assert specification.file_unit == "degrees"


ALL = [
    pytest.param(specification, id=f"{kind.__name__}.{name}")
    for kind in RECORDS.values()
    for name, specification in specifications(kind).items()
]


@pytest.mark.parametrize("specification", ALL)
def test_units_inside_are_metres_radians_and_seconds(specification: Specification):
    allowed = {"1", "m", "rad", "s", "W", "sr", "radiance"}  # radiance: W/(m^2 sr) up to the photo's scale
    factors = specification.unit.translate(str.maketrans("/() ^-0123456789", " " * 16)).split()
    assert specification.unit == "1" or (factors and set(factors) <= allowed)


def test_names_in_files_are_prefix_and_field_with_the_channel_last():
    names = weather_names()
    assert {"EXPOSURE", "SUN_ELEVATION", "SUN_AZIMUTH", "SUN_IRRADIANCE_R", "SUN_IRRADIANCE_B"} <= names.keys()
