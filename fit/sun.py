"""Where the sun stands: found in the picture, given in degrees, or computed from place and time.

It is looked for above the horizon only, in three steps: the cell of a coarse picture with the most light round it, the
pixels near that cell, their centre of brightness. All of it happens on the sphere, so a sun at the zenith, on the seam
of a panorama or on the edge of a cube's face is like any other.
"""

import math
from dataclasses import dataclass, replace
from datetime import datetime
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender import rays
from diffrender.atmosphere.celestial import Sun
from diffrender.colour import LUMINANCE
from diffrender.parameters import specifications
from fit.input_error import InputError
from fit.photo import Photo
from fit.solution import SunPlace

COLUMNS = 512  # of the coarse picture, at most: 0.7 degrees each in a panorama
BAND = 64  # rows of pixels read at a time

OVERFLOWED = 65_504.0  # taken for an infinite pixel: the largest half float, which a sun goes beyond
BRIGHTEST = 1e30  # no brighter pixel is believed, so that sums stay finite

CANDIDATES = 400  # brightest cells, among which the one with the most light round it is the start
LIGHT_ROUND = math.radians(0.6)  # a little more than the disc's diameter
DISC = math.radians(2.0)  # radius that holds the disc and its blur
DISC_PIXELS = 3.0  # the same in small pictures, in pixels
GLOW = math.radians(8.0)  # the same where no disc is seen
GLARE = 0.02  # share of the peak below which light is glare, which a low sun has more of above it than below
STEPS = 5  # of the centre towards the centre of brightness round it

# In thirty panoramas the faintest discs have 48 and 0.029; what shines through leaves has 27, a lamp at night 0.006.
LEAST_CONTRAST = 36.0  # of the peak to the brightest tenth of what surrounds it
LEAST_SHARE = 0.01  # of the light above the horizon that comes from the disc

YEARS = (1700, 2200)  # pandas counts nanoseconds in 64 bits

_ELEVATION, _AZIMUTH = (specifications(Sun)[name] for name in ("elevation", "azimuth"))


# In degrees


def given(text: str) -> SunPlace:
    """Sun of the option --sun: elevation and azimuth to the right of the picture's centre, in degrees.

    Raises:
        InputError: when the text is not two such numbers.

    >>> given("35.5,270").azimuth
    -90.0
    """
    try:
        elevation, azimuth = (float(word) for word in text.split(","))
    except ValueError:
        elevation = azimuth = math.nan
    low, high = _ELEVATION.file_bounds
    if not (low <= elevation <= high and abs(azimuth) <= 360.0):
        raise InputError(
            f"--sun {text!r}; give ELEVATION,AZIMUTH in degrees such as 35.5,-20: {low:g} to {high:g} above the "
            "horizon and -360 to 360 to the right of the picture's centre"
        )
    return SunPlace(elevation, _wrapped(azimuth), "given by --sun", visible=False)


def parse_time(text: str) -> datetime:
    """Time of the option --time; whether it has a zone is for `from_place` to ask.

    Raises:
        InputError: when the text is no date and time.
    """
    try:
        return datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"--time {text!r}; give date, time and zone such as 2016-08-14T06:30+02:00") from error


def from_place(latitude: float, longitude: float, time: datetime, heading: float) -> SunPlace:
    """Sun seen from a place at a time, lifted by the air's refraction.

    Args:
        latitude: degrees, north positive.
        longitude: degrees, east positive.
        time: with its zone.
        heading: compass bearing of the picture's centre column, in degrees.

    Raises:
        InputError: for a time without a zone, or a value out of range.
    """
    ranges = {
        "latitude": (latitude, -90.0, 90.0),
        "longitude": (longitude, -180.0, 180.0),
        "heading": (heading, 0.0, 360.0),
    }
    for name, (value, low, high) in ranges.items():
        if not low <= value <= high:
            raise InputError(f"--{name} {value:g}; allowed is a number of degrees from {low:g} to {high:g}")
    if time.tzinfo is None:
        raise InputError(f"--time {time.isoformat()} has no zone; add it, as in {time.isoformat()}+02:00")
    if not YEARS[0] <= time.year < YEARS[1]:
        raise InputError(f"--time {time.isoformat()}; allowed are the years from {YEARS[0]} to {YEARS[1] - 1}")
    import pandas as pd
    from pvlib import solarposition

    seen = solarposition.get_solarposition(pd.DatetimeIndex([time]), latitude, longitude).iloc[0]
    how = f"computed for {latitude:g}, {longitude:g} at {time.isoformat()}, heading {heading:g}"
    return SunPlace(float(seen["apparent_elevation"]), _wrapped(float(seen["azimuth"]) - heading), how, visible=False)


def to_sun(sun: SunPlace) -> Float[Tensor, "3"]:
    """Unit direction towards the sun."""
    in_files = (sun.elevation, _ELEVATION), (sun.azimuth, _AZIMUTH)
    return rays.from_angles(*(torch.tensor(degrees / known.file_factor) for degrees, known in in_files))


def _place(towards: Float[Tensor, "3"], how: str, *, visible: bool) -> SunPlace:
    elevation, azimuth = (float(angle) for angle in rays.angles(towards))
    return SunPlace(elevation * _ELEVATION.file_factor, _wrapped(azimuth * _AZIMUTH.file_factor), how, visible)


def _wrapped(degrees: float) -> float:
    # What needs no turn keeps its last digit.
    return degrees if -180.0 <= degrees < 180.0 else (degrees + 180.0) % 360.0 - 180.0


# In the picture


def find(photo: Photo) -> SunPlace:
    """Centre of the sun's disc or, where none is seen, of the brightest part of the sky.

    A disc is seen where light is bright and compact: far brighter than what lies a few degrees away, and a fair share
    of all light above the horizon, which a lamp is not.

    Raises:
        InputError: when the picture shows no light above the horizon.
    """
    cells = reduced(photo)
    start = _brightest(photo, cells)
    centre, visible = _disc(photo, cells, start)
    if visible:
        return _place(centre, "found in the picture", visible=True)
    nearby, _ = cells.light().round(start, 3.0 * GLOW)
    glow = _centre(nearby, start, GLOW)
    return _place(glow, "no disc seen; brightest part of the sky taken", visible=False)


def checked(photo: Photo, sun: SunPlace) -> SunPlace:
    """Sun that was given or computed, with `visible` set by whether the picture shows a disc there."""
    centre, visible = _disc(photo, reduced(photo), to_sun(sun))
    return replace(sun, visible=visible and bool(_distance(centre, to_sun(sun)) < DISC))


class Light(NamedTuple):
    """What comes from some directions."""

    direction: Float[Tensor, "n 3"]
    luminance: Float[Tensor, " n"]
    solid_angle: Float[Tensor, " n"]

    def at(self, chosen: Bool[Tensor, " n"]) -> "Light":
        """What comes from some of them."""
        return Light(*(values[chosen] for values in self))

    def round(self, centre: Float[Tensor, "3"], radius: float) -> tuple["Light", "Light"]:
        """What comes from within a radius of a direction, and from what surrounds that up to twice as far."""
        distance = _distance(self.direction, centre)
        return self.at(distance < radius), self.at((distance >= radius) & (distance < 2.0 * radius))


@dataclass(frozen=True, eq=False)
class Reduced:
    """A photo averaged over square cells; those of the last row and column may be cut off.

    Attributes:
        side: of a cell, in pixels.
        direction: towards its middle.
        solid_angle: 0 where the picture shows nothing.
        luminance: mean over its usable pixels; 0 at and below the horizon.
        usable: share of pixels that are not NaN; 0 at and below the horizon.
    """

    side: int
    direction: Float[Tensor, "rows columns 3"]
    solid_angle: Float[Tensor, "rows columns"]
    luminance: Float[Tensor, "rows columns"]
    usable: Float[Tensor, "rows columns"]

    @property
    def width(self) -> float:
        """Angle across the largest cell [rad]."""
        return float(self.solid_angle.max().sqrt())

    def light(self) -> Light:
        """What comes from above the horizon."""
        known = self.usable > 0.0
        return Light(self.direction[known], self.luminance[known], self.solid_angle[known])


def reduced(photo: Photo) -> Reduced:
    """Coarse picture of the sky."""
    camera = photo.camera
    side = cell_side(camera)
    x, columns = _middles(camera.width, side)
    y, rows = _middles(camera.height, side)
    places = torch.meshgrid(x, y, indexing="xy")
    towards = camera.direction(*places)
    solid_angle = camera.solid_angle(*places) * columns * rows[:, None]
    is_sky = (towards[..., 2] > 0.0) & (solid_angle > 0.0)
    light, usable = torch.zeros(2, len(y), len(x))
    step = max(1, BAND // side)
    for top in range(0, len(y), step):
        lines = slice(top, top + step)
        if is_sky[lines].any():
            bright, counts = _brightness(photo.band(slice(top * side, (top + step) * side)))
            pooled = torch.nn.functional.avg_pool2d(torch.stack([bright, counts.to(bright)]), side, ceil_mode=True)
            light[lines], usable[lines] = pooled * is_sky[lines]
    return Reduced(side, towards, solid_angle, light / usable.clamp(min=torch.finfo(usable.dtype).tiny), usable)


def cell_side(camera: rays.Camera) -> int:
    """Pixels across a cell of the coarse picture."""
    if isinstance(camera, rays.Cubemap):
        side = math.ceil(4 * camera.side / COLUMNS)  # four faces go round the horizon
        # A cell should not lie on two faces.
        return next((fitting for fitting in range(side, 2 * side + 1) if camera.side % fitting == 0), side)
    return math.ceil(camera.width / COLUMNS)


def _middles(length: int, side: int) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Middle and number of pixels of each cell along one axis."""
    first = torch.arange(0, length, side)
    last = (first + side).clamp(max=length)
    return (first + last) / 2.0, (last - first).float()


def _brightness(radiance: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch"], Bool[Tensor, "*batch"]]:
    """Luminance of pixels, and which of them are known; 0 for the others. An infinite one is a bright one.

    Lossy compression leaves negative values round a sun, and in single channels of the sun itself; they count as 0.
    """
    # As a product of matrices, and cleaned afterwards, it takes a quarter of the time of colour.luminance.
    bright = radiance.clamp(min=0.0) @ radiance.new_tensor(LUMINANCE)
    usable = ~bright.isnan()
    return torch.nan_to_num(bright, nan=0.0, posinf=OVERFLOWED).clamp(max=BRIGHTEST), usable


def _brightest(photo: Photo, cells: Reduced) -> Float[Tensor, "3"]:
    """Direction of the cell with the most light round it."""
    light = cells.light()
    if not light.luminance.any():
        raise InputError(
            f"{photo.path} shows no light above the horizon; give a picture with sky, or the right --pitch"
        )
    top = torch.topk(light.luminance, min(CANDIDATES, len(light.luminance))).indices
    towards, bright, solid_angle = (values[top] for values in light)
    near = _distance(towards[:, None], towards) < max(LIGHT_ROUND, 1.5 * cells.width)
    brightest: Tensor = towards[(near * (bright * solid_angle)).sum(-1).argmax()]
    return brightest


def _disc(photo: Photo, cells: Reduced, start: Float[Tensor, "3"]) -> tuple[Float[Tensor, "3"], bool]:
    """Centre of brightness at full resolution near a direction, and whether it is a disc."""
    radius = max(DISC, DISC_PIXELS * cells.width / cells.side)
    light = _pixels(photo, cells, start, 3.0 * radius)
    centre = _centre(light, start, radius)
    near, ring = light.round(centre, radius)
    if not (len(near.luminance) and len(ring.luminance)):
        return centre, False
    stands_out = near.luminance.amax() > LEAST_CONTRAST * torch.quantile(ring.luminance, 0.9)
    excess = ((near.luminance - ring.luminance.median()).clamp(min=0.0) * near.solid_angle).sum()
    whole = (cells.luminance * cells.solid_angle).sum()
    return centre, bool(stands_out & (excess > LEAST_SHARE * whole))


def _pixels(photo: Photo, cells: Reduced, centre: Float[Tensor, "3"], radius: float) -> Light:
    """What comes from above the horizon near a direction, pixel by pixel."""
    camera = photo.camera
    line, column = ((_distance(cells.direction, centre) < radius) & (cells.usable > 0.0)).nonzero().T
    inside = torch.arange(cells.side)
    y = (line[:, None, None] * cells.side + inside[:, None]).expand(-1, -1, cells.side).flatten()
    x = (column[:, None, None] * cells.side + inside).expand(-1, cells.side, -1).flatten()
    in_picture = (x < camera.width) & (y < camera.height)
    x, y = x[in_picture], y[in_picture]
    with np.errstate(invalid="ignore"):  # a half may be a signalling NaN
        radiance = torch.from_numpy(photo.radiance[y.numpy(), x.numpy()].astype(np.float32))
    bright, usable = _brightness(radiance)
    towards = camera.direction(x + 0.5, y + 0.5)
    every = Light(towards, bright, camera.solid_angle(x + 0.5, y + 0.5))
    return every.at(usable & (towards[:, 2] > 0.0))


def _centre(light: Light, start: Float[Tensor, "3"], radius: float) -> Float[Tensor, "3"]:
    """Centre of brightness round a direction, glare left aside; the direction itself where all is equally bright."""
    centre = start
    for _ in range(STEPS):
        near, ring = light.round(centre, radius)
        if not len(near.luminance):
            return start
        surroundings = ring.luminance.median() if len(ring.luminance) else near.luminance.amin()
        floor = torch.lerp(surroundings, near.luminance.amax(), GLARE)
        weight = (near.luminance - floor).clamp(min=0.0) * near.solid_angle
        total = (weight[:, None] * near.direction).sum(0)
        length = torch.linalg.vector_norm(total)
        if not length > 0.0:
            return centre
        centre = total / length
    return centre


def _distance(directions: Float[Tensor, "*batch 3"], centre: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch"]:
    """Angle between directions [rad]; from the chord, because the cosine of a small angle has few digits."""
    chord = torch.linalg.vector_norm(directions - centre, dim=-1)
    return 2.0 * torch.asin((chord / 2.0).clamp(max=1.0))
