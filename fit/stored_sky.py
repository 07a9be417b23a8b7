"""`fit tables`: what is asked for, the tables that are made for it, and what is told of them."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import sky, stored_tables, sun_axis
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.atmosphere.stored_tables import StoredTables
from diffrender.parameters import defaults
from diffrender.rays import from_angles
from diffrender.scene import EYE_ALTITUDE
from fit import keyframes, options, photo_tables, table_fits, weather_file
from fit.input_error import InputError
from fit.picture import scene_sky
from fit.tables import Tables

FORMS = ("two-tables", "in-scatter")
TOLD = (60.0, 30.0, 10.0, 5.0, 1.0, -1.0, -4.0, -8.0)  # elevations of the sun whose errors are told, in degrees


@dataclass(frozen=True)
class Asked:
    """What tables are made of.

    Attributes:
        form: one of FORMS.
        photos: to fit; where there is none, a sky is marched.
        mask_folder: of masks named as the photos; None finds the sky.
        weather: file of the marched sky; None is the default sky.
        hour: of the day in it.
    """

    form: str
    photos: tuple[Path, ...] = ()
    mask_folder: Path | None = None
    weather: Path | None = None
    hour: float = 12.0


@dataclass(frozen=True, eq=False)
class Made:
    """Tables, a line on what they were made from, and what is told of them."""

    tables: Tables
    origin: str
    summary: str


def made(asked: Asked) -> Made:
    """Tables as asked for.

    Raises:
        InputError: when the options do not suit each other, or a file cannot be used.
    """
    if asked.form not in FORMS:
        raise InputError(f"--form {asked.form} is unknown; allowed are {' and '.join(FORMS)}")
    if asked.photos:
        return _of_photos(asked)
    if asked.mask_folder is not None:
        raise InputError("--mask-folder without photos; name the photos, or leave it out")
    of = defaults(Sky, torch.float64)
    if asked.weather is not None:
        values = keyframes.at(weather_file.read(asked.weather), asked.hour)
        of = scene_sky(options.with_sky(keyframes.scene(values, torch.float64), asked.weather))
    origin = f"weather {asked.weather.name}, hour {asked.hour:g}" if asked.weather else "the default sky"
    return _two(of, origin) if asked.form == "two-tables" else _in_scatter(of, origin)


def _of_photos(asked: Asked) -> Made:
    if asked.form != "two-tables" or asked.weather is not None:
        raise InputError("photos make --form two-tables, and need no --weather; leave the photos or the option out")
    found = photo_tables.from_photos([photo_tables.sample(path, asked.mask_folder) for path in asked.photos])
    lines = [f"draw these tables with SKY_HAZINESS {found.haziness:g}; relative error of radiance, by photo:"]
    lines += [f"  {name:<40} {error:.3f}" for name, error in found.errors.items()]
    return Made(found.tables, "photos " + ", ".join(found.errors), "\n".join(lines))


def _two(of: Sky, origin: str) -> Made:
    elevations = _elevations()
    found = table_fits.from_march(of, elevations)
    lines = ["relative error of radiance against the march, by the sun's elevation in degrees:"]
    for degrees in TOLD:
        nearest = (elevations - math.radians(degrees)).abs().argmin()
        lines.append(f"  {math.degrees(elevations[nearest]):6.1f}  {float(found.error[nearest]):.3f}")
    return Made(found.tables, origin, "\n".join(lines))


def _in_scatter(of: Sky, origin: str) -> Made:
    found = stored(of, _elevations(), sky.Size())
    suns, rows, columns = found.in_scatter.shape[:3]
    return Made(found, origin, f"in-scatter of {rows} x {columns} directions, sunlight and skylight for {suns} suns")


def stored(of: Sky, elevations: Float[Tensor, " suns"], size: sky.Size) -> StoredTables:
    """Decima's tables of a sky for elevations of the sun [rad]."""
    each = []
    for to_sun in from_angles(elevations, torch.zeros_like(elevations)):
        view = SkyView(to_sun[None], to_sun, torch.ones_like(to_sun), to_sun.new_tensor(EYE_ALTITUDE))
        each.append(sky.daylight(of, view, sky.geometry(view, size)))
    return stored_tables.stored(each)


def _elevations() -> Float[Tensor, " suns"]:
    return sun_axis.elevations(torch.arange(sun_axis.CELLS, dtype=torch.float64), sun_axis.CELLS)
