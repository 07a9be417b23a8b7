"""A sun whose disc is not seen: it is searched from the brightest part of the sky, and kept there where that fails.

It is searched when all else is found, so that it explains what is left over and does not take the place of clouds.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import torch

from diffrender.atmosphere import celestial
from diffrender.scene import Scene
from fit.minimum import Point
from fit.search_space import SearchSpace
from fit.solution import Fitted, SunPlace

NAMES = ("SUN_ELEVATION", "SUN_AZIMUTH")
_WORDS = {"SUN_ELEVATION": "elevation", "SUN_AZIMUTH": "azimuth"}
UNSETTLED = "no disc seen, and its search did not settle; a place near the brightest part of the sky is kept"
# From the brightest part of the sky. The sun of an overcast photo, searched freely, ends 40 degrees from it and below
# the horizon, where it stands for the shape of the clouds.
FARTHEST = math.radians(30.0)
# Clouds shine from above the sun that lights them, and from one place of the sun a search may end in a poor minimum.
BELOW = (0.0, math.radians(5.0), math.radians(10.0))


def starts(home: Scene) -> list[Scene]:
    """Scenes with the sun where it is and somewhat below, from the best of which a search goes on."""
    return [replace(home, sun=replace(home.sun, elevation=home.sun.elevation - below)) for below in BELOW]


def why_not(space: SearchSpace, point: Point, why: Mapping[str, str]) -> str:
    """Why the sun stays where the space begins, not at a point that a search has come to; nothing where it may move.

    Args:
        space: in which it was searched.
        point: where the search has ended.
        why: of each name, the reason why it is not determined; empty where it is.
    """
    if any(why[name] for name in NAMES):
        return "no disc seen, and not determined by the photo; a place near the brightest part of the sky is kept"
    towards = celestial.to_sun(space.scene(torch.from_numpy(point)).sun)
    if float(towards @ celestial.to_sun(space.start.sun)) < math.cos(FARTHEST):
        return "no disc seen, and a search leads far from the brightest part of the sky; a place near that is kept"
    return ""


def place(begun: SunPlace, parameters: Mapping[str, Fitted], free: tuple[str, ...]) -> SunPlace:
    """Sun's place as it was known before, or where the fit has moved it, with its standard errors."""
    elevation, azimuth = (parameters[name] for name in NAMES)
    if not any(name in free for name in NAMES):
        if begun.visible or elevation.why == "given":
            return begun
        return replace(begun, elevation=elevation.value, azimuth=azimuth.value, how=elevation.why)
    return replace(
        begun,
        elevation=elevation.value,
        azimuth=azimuth.value,
        how=f"{' and '.join(_WORDS[name] for name in NAMES if name in free)} searched; before, {begun.how}",
        elevation_standard_error=elevation.standard_error,
        azimuth_standard_error=azimuth.standard_error,
    )
