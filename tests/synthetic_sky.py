"""Photos of a known sky: drawn, with a little noise, as if a camera had seen it."""

from pathlib import Path

import numpy as np
import OpenEXR

from diffrender.rays import Equirectangular
from fit import keyframes, picture
from fit.photo import Photo
from fit.solution import SunPlace

# A hazy morning; what is not named stands at its default.
HAZY_MORNING = {
    "EXPOSURE": 0.5,
    "SUN_ELEVATION": 20.0,
    "SUN_AZIMUTH": 30.0,
    "SUN_IRRADIANCE_R": 1.2,
    "SUN_IRRADIANCE_G": 1.0,
    "SUN_IRRADIANCE_B": 0.9,
    "SKY_HAZINESS": 0.7,
    "SKY_MIE_SCALE": 5.0,
    "SKY_MIE_COLOUR_EXPONENT": 1.0,
    "SKY_COARSE_SCALE": 1.0,
    "SKY_RAYLEIGH_SCALE": 0.8,
}
SUN = SunPlace(HAZY_MORNING["SUN_ELEVATION"], HAZY_MORNING["SUN_AZIMUTH"], "known", visible=False)
CAMERA = Equirectangular(128, 64)


def radiance(values=HAZY_MORNING, camera=CAMERA, noise=0.01):
    drawn = picture.draw(keyframes.scene(values), camera)["sky"]
    return drawn * np.random.default_rng(0).lognormal(0.0, noise, drawn.shape).astype(np.float32)


def photo(seen, camera=CAMERA):
    """Photo in memory that shows a radiance."""
    header = {"time": None, "latitude": None, "longitude": None, "altitude": None}
    return Photo(Path("synthetic.exr"), seen, camera, header, ("synthetic",), None)


def save(path, picture=None, **channels):
    """Write a picture, or other channels, as OpenEXR."""
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels or {"RGB": picture}) as file:
        file.write(str(path))
