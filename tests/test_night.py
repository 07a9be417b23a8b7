from pathlib import Path

import numpy as np
import pytest
import torch

from diffrender import rays
from fit import night, sun
from fit import photo as photos
from fit.input_error import InputError
from fit.photo import Photo
from fit.solution import SunPlace

PHOTOS = Path(__file__).parent.parent / "experiments" / "photos"
CAMERA = rays.Equirectangular(256, 128)
SUN = SunPlace(30.0, 40.0, "given by a test", visible=True)
HIDDEN = SunPlace(30.0, 40.0, "given by a test", visible=False)


def photo(points: np.ndarray, noise: float = 0.01) -> Photo:
    """A sky that brightens towards the horizon, times `points` and a little noise, over dark ground."""
    x, y = rays.pixel_centres(CAMERA, slice(None), torch.zeros(1))
    height = CAMERA.direction(x, y)[..., 2]
    grey = torch.where(height > 0.0, 2.0 - height, 0.1).numpy() * points
    grey = grey * np.random.default_rng(1).lognormal(0.0, noise, grey.shape)
    return Photo(Path("drawn.exr"), grey.astype(np.float32)[..., None].repeat(3, -1), CAMERA, {}, (), None)


def scattered(count: int, factor: float) -> np.ndarray:
    """Ones, but for a number of single cells of the sky."""
    points = np.ones((CAMERA.height, CAMERA.width))
    places = np.random.default_rng(0).choice(20 * 60, count, replace=False)
    points[10 + 2 * (places // 60), 4 * (places % 60) + 4] = factor
    return points


def lights(lamps: int, share: float) -> np.ndarray:
    """Ones, but for the sun's cell and lamps with a share of its light."""
    points = np.ones((CAMERA.height, CAMERA.width))
    column, row = (int(value) for value in CAMERA.place(sun.to_sun(SUN)))
    points[row, column] = 1e4
    for index in range(lamps):
        points[row + 10, (column + 40 + 20 * index) % CAMERA.width] = 1e4 * share
    return points


@pytest.mark.parametrize("place", [SUN, HIDDEN], ids=["moon", "no disc"])
@pytest.mark.parametrize("exposure", [1e-6, 1.0, 1e3])
def test_stars_are_a_night_however_it_is_exposed(place: SunPlace, exposure: float) -> None:
    with pytest.raises(
        InputError, match=r"drawn\.exr shows a night: [0-9]+ points like stars .* both --sun"
    ) as refused:
        night.refuse(photo(exposure * scattered(150, 1.5)), place)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "points",
    [
        scattered(20, 1.5),
        scattered(150, 0.5),
        scattered(75, 1.5) * scattered(150, 0.5)[:, ::-1],
        np.random.default_rng(2).lognormal(0.0, 0.3, (CAMERA.height, CAMERA.width)),
    ],
    ids=["few bright points", "dark points", "points of both kinds", "noise"],
)
def test_what_a_day_shows_is_no_star(points: np.ndarray) -> None:
    night.refuse(photo(points), HIDDEN)


def test_stars_below_the_horizon_are_none() -> None:
    night.refuse(photo(scattered(150, 1.5)[::-1]), HIDDEN)


def test_stars_are_seen_in_no_rough_part() -> None:
    assert not night.points(sun.reduced(photo(scattered(150, 1.2), noise=0.2))).are_stars


def test_lamps_alike_are_no_sun() -> None:
    with pytest.raises(InputError, match="shows a night: 5 lights alike where a day has one sun"):
        night.refuse(photo(lights(4, 0.8)), SUN)


@pytest.mark.parametrize(("lamps", "share"), [(0, 1.0), (2, 0.8), (6, 0.04)], ids=["sun", "two mirrors", "glitter"])
def test_a_sun_may_have_reflections(lamps: int, share: float) -> None:
    night.refuse(photo(lights(lamps, share)), SUN)


def test_lights_through_leaves_are_no_lamps_where_no_sun_is_seen() -> None:
    night.refuse(photo(lights(6, 0.8)), HIDDEN)


def test_a_real_night_is_refused() -> None:
    shown = photos.read(PHOTOS / "dikhololo_night.exr")
    with pytest.raises(InputError, match="points like stars"):
        night.refuse(shown, sun.find(shown))


@pytest.mark.parametrize(
    "name", ["kiara_1_dawn", "venice_dawn", "potsdamer_platz", "kloofendal_48d_partly_cloudy_puresky", "blender_forest"]
)
def test_dawn_clouds_and_leaves_are_no_night(name: str) -> None:
    shown = photos.read(PHOTOS / f"{name}.exr")
    night.refuse(shown, sun.find(shown))
    assert night.points(sun.reduced(shown)).bright < night.STARS / 3
