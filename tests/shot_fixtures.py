"""One photo with its mask and its row in a table of peers, for the tests of experiments."""

import csv
import math
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from experiments import harmonics_floor, log_error, shots

PHOTOS = Path(__file__).parents[1] / "experiments" / "photos"
NAME, SUN = "rooitou_park", (10.54, 35.99)  # where it is seen, in degrees


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Folder with one photo, a mask of its sky above the trees and away from the sun, and a table of peers."""
    folder = tmp_path_factory.mktemp("photos")
    (folder / f"{NAME}.exr").symlink_to(PHOTOS / f"{NAME}.exr")
    (folder / "masks").mkdir()
    picture = log_error.read_picture(PHOTOS / f"{NAME}.exr")
    seen = harmonics_floor.directions(np.ones(picture.shape[:2], dtype=bool))
    elevation, to_right = np.radians(SUN)
    to_sun = [math.cos(elevation) * math.cos(to_right), -math.cos(elevation) * math.sin(to_right), math.sin(elevation)]
    is_sky = (seen[:, 2] > math.sin(math.radians(15.0))) & (seen @ to_sun < math.cos(math.radians(8.0)))
    write_mask(folder / "masks" / f"{NAME}.png", is_sky.reshape(picture.shape[:2]))
    row = {
        "file": f"{NAME}.exr",
        "sun_visible": "True",
        "sun_elevation": SUN[0],
        "sun_azimuth_right_of_centre": SUN[1],
        "eps": 2e-4,
        "mitsuba_fixed_E3": 0.03,
        "lm_fixed_E3": 0.02,
    }
    with (folder / "PEERS.csv").open("w", newline="") as lines:
        table = csv.DictWriter(lines, row)
        table.writeheader()
        table.writerows([row, row | {"file": "not_there.exr"}])
    return folder


@pytest.fixture(scope="module")
def shot(photos):
    return shots.read_shots(photos, photos / "masks", photos / "PEERS.csv")[0]


@pytest.fixture(scope="module")
def sky(shot):
    return log_error.sky_under(log_error.read_mask(shot.mask), log_error.read_picture(shot.photo), shot.eps)


def write_mask(path, mask):
    output = OpenImageIO.ImageBuf(np.where(mask, 255, 0).astype(np.uint8)[..., None].copy())
    assert output.write(str(path))


def picture_of(sky, radiance):
    picture = np.zeros((*sky.mask.shape, 3))
    picture[sky.mask] = radiance
    return picture
