"""Solution: what a fit found, how well each parameter is determined, and how it got there."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64

from diffrender.rays import Camera
from diffrender.scene import Scene
from fit.minimum import Minimum


@dataclass(frozen=True)
class Fitted:
    """One parameter of a solution, in the unit of weather files."""

    value: float
    unit: str
    bounds: tuple[float, float]
    # None where the photo does not determine the parameter. Of a log parameter, over the value, that of its logarithm:
    # the interval is the value times and over exp(error / value). Intervals end at the bounds.
    standard_error: float | None
    determined: bool
    why: str  # "searched", "closed form", "given", "default", "not determined by the photo", "at its lower bound" ...


@dataclass(frozen=True)
class SunPlace:
    """Where the sun stands, in degrees, azimuth to the right of the picture's centre, and how that is known."""

    elevation: float
    azimuth: float
    how: str
    visible: bool
    elevation_standard_error: float | None = None  # None where it was not searched or is not determined
    azimuth_standard_error: float | None = None


@dataclass(frozen=True)
class Solution:
    """A fitted scene and the account of the fit."""

    effect: str  # "sky", "fog" or "sharpening"
    photo: str  # file name of the photo, as given
    camera: Camera
    notes: tuple[str, ...]  # what was recognised, assumed or left aside, one sentence each
    scene: Scene
    parameters: Mapping[str, Fitted]  # weather-file name -> value; also what was not searched
    correlated: tuple[str, ...]  # names of the determined searched parameters, in the order of `correlation`
    correlation: Float64[np.ndarray, "n n"]
    sun: SunPlace | None  # None where a fit does not ask for it
    gains: tuple[float, float, float]  # per channel, in closed form
    used: Bool[np.ndarray, "height width"]  # pixels of the photo that the fit may look at
    pixels: Mapping[str, int]  # used, masked, nonfinite, negative
    left_out: Mapping[str, str]  # effect or parameter -> why
    # Mean square of the difference in the measure; E3 of a sky: of log radiance, solid-angle weighted, over the mask.
    error: float
    minimum: Minimum
    solver: str
    seed: int
    seconds: Mapping[str, float]  # read, solve, write
    versions: Mapping[str, str]
    measure: str = "log radiance"  # what pictures are compared in
    # Method -> name of a score -> its value, where a fit compares methods.
    scores: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
