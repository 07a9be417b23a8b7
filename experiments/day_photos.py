"""Small panoramas of a day by our own renderer, for experiments that ask how `fit day` works, not how well it fits."""

import math
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from diffrender.rays import Equirectangular
from fit import exr, keyframes, picture, sun

LATITUDE, LONGITUDE, DATE, HEADING = 48.0, 11.0, "2020-06-21", 100.0
FIRST, LAST = 6.0, 20.5  # hours of the day, in a zone two hours ahead
PLACE = ("--latitude", str(LATITUDE), "--longitude", str(LONGITUDE), "--heading", str(HEADING))
NOISE = 0.02


def write(folder: Path, count: int, width: int) -> list[Path]:
    """Write so many panoramas; their names tell their times."""
    folder.mkdir(parents=True, exist_ok=True)
    midnight = datetime.fromisoformat(f"{DATE}T00:00").replace(tzinfo=UTC) - timedelta(hours=2)
    paths = []
    for number, hour in enumerate(np.linspace(FIRST, LAST, count)):
        time = midnight + timedelta(seconds=round(3600.0 * hour))
        place = sun.from_place(LATITUDE, LONGITUDE, time, HEADING)
        turn = 2.0 * math.pi * hour / 24.0
        values = {
            "SUN_ELEVATION": place.elevation,
            "SUN_AZIMUTH": place.azimuth,
            "SKY_HAZINESS": 0.6 + 0.1 * math.sin(turn),
            "SKY_MIE_SCALE": 5.0 * math.exp(0.5 * math.cos(turn)),
            "SKY_RAYLEIGH_SCALE": 0.8,
        }
        drawn = picture.draw(keyframes.scene(values), Equirectangular(width, width // 2))["sky"]
        noise = np.random.default_rng(number).lognormal(0.0, NOISE, drawn.shape)
        local = time + timedelta(hours=2)
        paths.append(folder / f"roof_{local:%Y%m%dT%H%M%S}+0200.exr")
        exr.write(paths[-1], {"": {"RGB": (drawn * noise).astype(np.float32)}}, {})
    return paths
