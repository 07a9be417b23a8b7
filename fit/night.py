"""What tells a night from a day: stars, or several lamps where there is one sun.

How bright a photo is says nothing, because its exposure is not known, and a moon lights a sky as a sun does. Stars are
points brighter than all that is round them, in a part of the sky that is smooth; noise has dark points as well. In
thirty panoramas two nights have 200 to 500 of them, days and dawns at most 13.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter, minimum_filter

from fit.input_error import InputError
from fit.photo import Photo
from fit.sky_mask import LEAST_KNOWN, LOWEST
from fit.solution import SunPlace
from fit.sun import Reduced, reduced, to_sun

NEIGHBOURS = np.ones((3, 3), bool)
NEIGHBOURS[1, 1] = False
RING = np.ones((5, 5), bool)
RING[1:4, 1:4] = False
SMOOTH = 0.3  # largest range of log luminance in the ring round a point: leaves and the edges of clouds have more
LEAST_STEP = 0.03  # of log luminance between a point and the ring; at least the ring's range as well
STARS = 50  # a clear day with birds, pollen and hot pixels has fewer
MORE_BRIGHT = 5  # times as many bright points as dark ones
PER_STERADIAN = 5.0

RIVAL = 0.1  # of the brightest cell's luminance; glass and water give back less of a sun
COMPACT = 10.0  # times the luminance of its surroundings, and of the sky
OF_THE_SUN = math.radians(10.0)  # round it, where clouds may let through more than one bright spot
RIVALS = 3


class Points(NamedTuple):
    """How many compact points a sky shows."""

    bright: int
    dark: int
    per_steradian: float

    @property
    def are_stars(self) -> bool:
        """Whether they can be nothing but stars."""
        return self.bright >= STARS and self.bright > MORE_BRIGHT * self.dark and self.per_steradian > PER_STERADIAN


def refuse(photo: Photo, sun: SunPlace) -> None:
    """Do nothing for a photo that has, or may have, a sun.

    Raises:
        InputError: when it shows stars, or what was taken for the sun is one of several lamps.
    """
    cells = reduced(photo)
    stars = points(cells)
    if stars.are_stars:
        raise _refused(photo, f"{stars.bright} points like stars in a dark sky, so the light is a moon's or lamps'")
    if sun.visible and (lamps := rivals(cells, sun)) >= RIVALS:
        raise _refused(photo, f"{lamps + 1} lights alike where a day has one sun, so they are lamps")


def _refused(photo: Photo, seen: str) -> InputError:
    return InputError(
        f"{photo.path} shows a night: {seen}; a sky is fitted to a sun: give another photo, or both --sun "
        "ELEVATION,AZIMUTH of the light and --mask PNG to fit it all the same"
    )


def points(cells: Reduced) -> Points:
    """Points brighter, and darker, than their eight neighbours and the smooth ring beyond; none along the borders."""
    known = ((cells.usable > LEAST_KNOWN) & (cells.luminance > 0.0)).numpy()
    is_sky = known & (cells.direction[..., 2] > math.sin(LOWEST)).numpy()
    bright = np.log(np.where(known, cells.luminance.numpy(), 1.0))
    # What lies at the border of a picture is left out.
    whole = minimum_filter(is_sky.astype(np.uint8), size=5, mode="constant") > 0
    highest, lowest = maximum_filter(bright, footprint=RING), minimum_filter(bright, footprint=RING)
    smooth = whole & (highest - lowest < SMOOTH)
    step = np.maximum(LEAST_STEP, highest - lowest)
    above = smooth & (bright > maximum_filter(bright, footprint=NEIGHBOURS)) & (bright - highest > step)
    below = smooth & (bright < minimum_filter(bright, footprint=NEIGHBOURS)) & (lowest - bright > step)
    seen = float(cells.solid_angle.numpy()[smooth].sum())
    return Points(int(above.sum()), int(below.sum()), float(above.sum()) / seen if seen > 0.0 else 0.0)


def rivals(cells: Reduced, sun: SunPlace) -> int:
    """Number of lights far from the sun that are nearly as bright and as compact."""
    known = (cells.usable > 0.0) & (cells.luminance > 0.0)
    bright = torch.where(known, cells.luminance, 0.0).numpy()
    least = max(RIVAL * float(bright.max()), COMPACT * float(np.median(bright[known.numpy()])))
    from_sun = torch.linalg.vector_norm(cells.direction - to_sun(sun), dim=-1).numpy()
    is_far = from_sun > 2.0 * math.sin(OF_THE_SUN / 2.0)
    peaks = is_far & (bright >= least) & (bright == maximum_filter(bright, size=3))
    return sum(_is_compact(bright, int(row), int(column)) for row, column in np.argwhere(peaks))


def _is_compact(bright: Float[np.ndarray, "rows columns"], row: int, column: int) -> bool:
    """Whether a cell is far brighter than nearly all that is three cells away."""
    window = bright[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4].copy()
    inner: Bool[np.ndarray, "a b"] = np.zeros(window.shape, bool)
    top, left = min(row, 3), min(column, 3)
    inner[max(top - 2, 0) : top + 3, max(left - 2, 0) : left + 3] = True
    return bool(bright[row, column] > COMPACT * np.quantile(window[~inner], 0.9))
