"""Where a photo of a known place and time looks: its heading, and a perspective camera's pitch, from the sun.

Astronomy gives the sun's elevation and compass bearing. Where the picture shows the disc, the two angles by which it
stands elsewhere in the picture are pitch and heading. Where it does not, the sky itself is fitted with the sun at
several bearings, and pitches, and the likeliest is kept.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from scipy.optimize import brentq

from diffrender.rays import Perspective
from fit import photo as photos
from fit import sky, sky_mask, sun
from fit.asked import Options
from fit.input_error import InputError
from fit.photo import Photo
from fit.pixels import Pixels, averaged, usable
from fit.selection import PATCHES
from fit.solution import SunPlace

LEAST_TOLERANCE = 2.0  # degrees between seen and computed sun from which a photo is doubtful
SIGMAS = 3.0
LEAST_ERROR = 0.1  # degrees: a panorama's seam and level are not known better
FINEST = 5.0  # degrees between the last pitches that are tried
MOST_OF_SKY = 0.9  # of the sky that shows at the pitch where most of it does
SKYLINE = math.radians(30.0)  # that a landscape's sky comes down to at least, be it somewhere between houses
PITCHES = range(-20, 61, 10)  # degrees, of the search without a disc
AZIMUTHS = (0.0, 90.0, -180.0, -90.0)  # of the sun to the right of the middle, from which it is searched


@dataclass(frozen=True)
class View:
    """A photo, how it was turned, and whether its sun stands where place and time put it.

    Attributes:
        photo: with its camera at the pitch that was given or found.
        place: the sun by astronomy, in the picture; its azimuth is where a search begins if it `is_searched`.
        bearing: compass bearing of the sun, degrees.
        tolerance: degrees that its disc may be off.
        is_searched: whether the sun's azimuth in the picture, and so the heading, is left to the fit of the sky.
        heading_error: standard error in degrees; None where the heading was given, or is left to the fit.
        pitch: in degrees; None for panoramas.
        pitch_error: None where it was given or has no error.
        off: degrees between the sun's disc and where it should be; None where no disc is seen.
    """

    photo: Photo
    place: SunPlace
    bearing: float
    tolerance: float
    is_searched: bool = False
    heading_error: float | None = None
    pitch: float | None = None
    pitch_error: float | None = None
    off: float | None = None

    @property
    def heading(self) -> float:
        """Compass bearing of the picture's middle column, degrees."""
        return (self.bearing - self.place.azimuth) % 360.0


@dataclass(frozen=True)
class Turned:
    """What is known beforehand of how a camera was turned, and of its picture.

    Attributes:
        heading: degrees; None where it is not known.
        pitch: of a perspective camera, degrees; None where it is not known.
        projection: as on the command line; None to recognise it.
        field_of_view: across the width of a perspective picture, degrees.
    """

    heading: float | None = None
    pitch: float | None = None
    projection: str | None = None
    field_of_view: float | None = None


def seen(path: Path, computed: SunPlace, turned: Turned, options: Options) -> View:
    """How a photo was turned under a computed sun, whose azimuth is a compass bearing.

    Raises:
        InputError: when the photo cannot be read, or shows no sky.
    """
    photo = photos.read(path, turned.projection, turned.field_of_view, turned.pitch or 0.0)
    is_level = not isinstance(photo.camera, Perspective)
    if is_level or turned.pitch is not None:
        pitch = None if is_level else turned.pitch
        return _headed(photo, computed, turned, pitch)
    at_pitches = [_tilted(photo, float(pitch)) for pitch in PITCHES]
    with_disc = [(one, found) for one in at_pitches if (found := _disc(one)) is not None]
    if with_disc:
        return _by_disc(*with_disc[0], computed, turned)
    return _by_sky(photo, computed, turned, options)


def _headed(photo: Photo, computed: SunPlace, turned: Turned, pitch: float | None) -> View:
    """View of a camera whose pitch is known."""
    found, error = _disc(photo), _error(photo)
    tolerance = max(LEAST_TOLERANCE, SIGMAS * error)
    if turned.heading is not None:
        place = _in_picture(computed, turned.heading)
        off = None if found is None else _apart(found, place)
        place = replace(place, visible=off is not None and off < tolerance)
        return View(photo, place, computed.azimuth, tolerance, pitch=pitch, off=off)
    if found is None:
        glow = sun.find(photo)
        place = replace(computed, azimuth=glow.azimuth)
        return View(photo, place, computed.azimuth, tolerance, is_searched=True, pitch=pitch)
    off = abs(found.elevation - computed.elevation)
    heading_error = math.hypot(error, off) / max(math.cos(math.radians(computed.elevation)), 1e-3)
    place = replace(computed, azimuth=found.azimuth, visible=True)
    heading_error = min(heading_error, 180.0)
    return View(photo, place, computed.azimuth, tolerance, heading_error=heading_error, pitch=pitch, off=off)


def _by_disc(photo: Photo, found: SunPlace, computed: SunPlace, turned: Turned) -> View:
    """View of a camera whose pitch lifts the disc that it sees to where it should stand."""
    assert isinstance(photo.camera, Perspective)
    towards, now = sun.to_sun(found).double(), photo.camera.pitch

    def lifted(pitch: float) -> torch.Tensor:
        turn = pitch - now
        ahead, left, up = towards
        return torch.stack(
            [ahead * math.cos(turn) - up * math.sin(turn), left, up * math.cos(turn) + ahead * math.sin(turn)]
        )

    def gap(pitch: float) -> float:
        return math.degrees(math.asin(float(lifted(pitch)[2]))) - computed.elevation

    steps = [now + math.radians(step) for step in range(-90, 91)]
    brackets = [(a, b) for a, b in itertools.pairwise(steps) if gap(a) * gap(b) <= 0.0]
    if not brackets:
        raise InputError(f"{photo.path} shows a sun that no --pitch lifts to {computed.elevation:.3g} degrees")
    nearest = min(brackets, key=lambda ends: abs(ends[0] - now))
    pitch = math.degrees(float(brentq(gap, *nearest)))
    view = _headed(_tilted(photo, pitch), computed, turned, pitch)
    return replace(view, pitch_error=_error(photo))


def _by_sky(photo: Photo, computed: SunPlace, turned: Turned, options: Options) -> View:
    """View of a camera whose pitch, and heading, make the fitted sky most like the photo's."""
    options = replace(options, free=() if turned.heading is not None else ("SUN_AZIMUTH",))
    every = list(_tried(photo, computed, turned, options))
    if not every:
        raise InputError(f"{photo.path} shows no sky at any pitch; give --pitch and --mask")
    # Sky is not below the horizon: a pitch that puts some of it there fits the rest the better, and is wrong.
    most = max(one.pixels for one in every)
    tried = [one for one in every if one.pixels >= MOST_OF_SKY * most]
    best = min(tried, key=lambda one: one.error)
    fine = [trial for step in (-FINEST, FINEST) for trial in _trial(photo, best.pitch + step, (best.place,), options)]
    fine = [one for one in fine if one.pixels >= MOST_OF_SKY * most]
    best, *others = sorted([*tried, *fine], key=lambda one: one.error)
    # A parabola from the best pitch to the likeliest beside it: its curvature is the pitch's information.
    pitch, error = best.pitch, FINEST
    beside = [one for one in others if 0.0 < abs(one.pitch - best.pitch) <= 10.0]
    if beside:
        rise = max(beside[0].error / best.error - 1.0, 1e-6)
        error = min(abs(beside[0].pitch - pitch) / math.sqrt(rise * PATCHES), 90.0)
    place = replace(best.place, visible=False)
    return View(
        _tilted(photo, pitch),
        place,
        computed.azimuth,
        max(LEAST_TOLERANCE, SIGMAS * _error(photo)),
        is_searched=turned.heading is None,
        pitch=pitch,
        pitch_error=math.hypot(error, FINEST / math.sqrt(12.0)),
    )


@dataclass(frozen=True)
class _Trial:
    pitch: float
    place: SunPlace
    error: float
    pixels: int  # of sky above the horizon


def _tried(photo: Photo, computed: SunPlace, turned: Turned, options: Options) -> Iterator[_Trial]:
    """Skies at every pitch, at the first under suns all around, then from the likeliest of them."""
    if turned.heading is not None:
        starts: Sequence[SunPlace] = (_in_picture(computed, turned.heading),)
    else:
        starts = [replace(computed, azimuth=azimuth) for azimuth in AZIMUTHS]
    for pitch in sorted(PITCHES, key=abs):
        some = list(_trial(photo, float(pitch), starts, options))
        yield from some
        if some:
            starts = (min(some, key=lambda one: one.error).place,)


def _trial(photo: Photo, pitch: float, starts: Sequence[SunPlace], options: Options) -> Iterator[_Trial]:
    """Fits at a pitch; none where the picture then shows no sky, or a landscape high up in it."""
    tilted = _tilted(photo, pitch)
    try:
        pixels = sky_pixels(tilted, starts[0], options)
        if _is_landscape_in_the_sky(pixels):
            return
        for start in starts:
            found = sky.solve(pixels, start, replace(options, sun=start))
            azimuth = found.parameters["SUN_AZIMUTH"].value
            yield _Trial(pitch, replace(start, azimuth=azimuth), found.error, int(pixels.used.sum()))
    except InputError:
        return


def _is_landscape_in_the_sky(pixels: Pixels) -> bool:
    """Whether something stands below all of the sky, even where the sky comes lowest, and that is high up.

    The model's sky is smoother up there, and fits many a sky better that it cannot draw down to the horizon.
    """
    return not pixels.used[-1].any() and float(pixels.direction[pixels.used][:, 2].min()) > math.sin(SKYLINE)


def sky_pixels(photo: Photo, place: SunPlace, options: Options) -> Pixels:
    """Pixels of a photo's sky.

    Raises:
        InputError: when there is none.
    """
    mask = sky_mask.read(options.mask, photo) if options.mask else sky_mask.find(photo, place)
    pixels = averaged(photo, usable(photo, mask.used))
    sky.check_sky(pixels)
    return pixels


def _tilted(photo: Photo, pitch: float) -> Photo:
    assert isinstance(photo.camera, Perspective)
    return replace(photo, camera=replace(photo.camera, pitch=math.radians(pitch)))


def _disc(photo: Photo) -> SunPlace | None:
    """Sun's disc in a picture; None where it shows none."""
    try:
        found = sun.find(photo)
    except InputError:  # no light above the horizon
        return None
    return found if found.visible else None


def _error(photo: Photo) -> float:
    """Standard error of a disc's place, degrees: a pixel's width."""
    cells = sun.reduced(photo)
    return max(math.degrees(cells.width) / cells.side, LEAST_ERROR)


def _in_picture(computed: SunPlace, heading: float) -> SunPlace:
    azimuth = (computed.azimuth - heading + 180.0) % 360.0 - 180.0
    return replace(computed, azimuth=azimuth)


def _apart(one: SunPlace, other: SunPlace) -> float:
    """Angle between two places, degrees."""
    chord = float(torch.linalg.vector_norm(sun.to_sun(one) - sun.to_sun(other)))
    return math.degrees(2.0 * math.asin(min(chord / 2.0, 1.0)))
