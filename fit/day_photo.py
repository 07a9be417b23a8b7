"""One photo of a day: what its sky says, as a normal distribution over the searched parameters, small and plain.

Directions, and what leans towards one, are turned to the compass: +x is where the day's pictures will look, not where
this one did. What leaves here is text, so that a photo fitted in another process, on another machine or yesterday gives
the same bits.
"""

import base64
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, Float64

from diffrender.scene import Scene, weather_names
from fit import keyframes, night, sky, sun
from fit.asked import Options
from fit.day_sun import Turned, View, seen, sky_pixels
from fit.input_error import InputError
from fit.objective import Sample
from fit.pixels import stratified
from fit.selection import NO_LAYER, OF_OVERCAST
from fit.uncertainty import NEAR_BOUND, NO_INFLUENCE, covariances, reasons

LOWEST_SUN = -6.0  # degrees: below it the sun's light in the sky is less than a town's
LEANS = ("SKY_OVERCAST_AHEAD", "SKY_OVERCAST_LEFT")
UNSEEN = 0.02  # share of clouds that a photo need not show
THREADS = 1
SEED_OF_SAMPLE = 2  # after those of the fit itself


@dataclass(frozen=True)
class Asked:
    """What is asked of every photo of a day.

    Attributes:
        latitude: degrees north.
        longitude: degrees east.
        turned: what is known of how the camera was turned.
        mask: of all photos, white where sky is; None finds it.
        bearing: compass bearing that +x of the results has, degrees.
        solver: as on the command line.
        seed: of the sample of pixels.
        start: values in files' units to begin at and to keep where the photo says nothing; none for a hazy day.
    """

    latitude: float
    longitude: float
    turned: Turned
    mask: Path | None = None
    bearing: float = 0.0
    solver: str = "least-squares"
    seed: int = 0
    start: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Estimate:
    """What one photo says; arrays are in the unit cube of `names`.

    Attributes:
        photo: file name.
        refused: why it is not used; empty where it is, else nothing below but the sun's place is known.
        elevation: of the sun by place and time, degrees.
        bearing: of the sun, on the compass.
        names: searched parameters that have an influence on the photo, determined or not.
        noise: covariance of what differs from photo to photo.
        held: covariance of what all photos have in common.
        determined: names among them that are determined.
        error: mean square of log radiance over `sample` at the photo's own values.
        heading_error: degrees; None where the heading was given or cannot be told.
        off: degrees between the sun's disc and where it should be; None where none is seen.
        is_doubtful: whether that is more than it may be.
    """

    photo: str
    refused: str
    elevation: float
    bearing: float
    names: tuple[str, ...] = ()
    point: Float64[np.ndarray, " k"] | None = None
    noise: Float64[np.ndarray, "k k"] | None = None
    held: Float64[np.ndarray, "k k"] | None = None
    determined: tuple[str, ...] = ()
    error: float = math.nan
    converged: bool = False
    heading: float = math.nan
    heading_error: float | None = None
    how: str = ""
    pitch: float | None = None
    pitch_error: float | None = None
    off: float | None = None
    tolerance: float = math.nan
    direction: Float32[np.ndarray, "n 3"] | None = None
    log_radiance: Float32[np.ndarray, "n 3"] | None = None
    floor: float = math.nan

    @property
    def is_doubtful(self) -> bool:
        """Whether the sun's disc is so far from where place and time put it that one of them may be wrong."""
        return self.off is not None and self.off > self.tolerance

    def sample(self) -> Sample:
        """Pixels by which a scene is compared with the photo."""
        assert self.direction is not None
        assert self.log_radiance is not None
        return Sample(
            torch.from_numpy(self.direction).double(), torch.from_numpy(self.log_radiance).double(), self.floor
        )


def fitted(path: Path, time: datetime, asked: Asked) -> str:
    """Estimate of one photo, as text; also where the photo is refused, which is said then."""
    torch.set_num_threads(THREADS)
    computed = sun.from_place(asked.latitude, asked.longitude, time, 0.0)
    nothing = Estimate(path.name, "", computed.elevation, computed.azimuth % 360.0)
    if computed.elevation < LOWEST_SUN:
        deep = f"a night: the sun stands {-computed.elevation:.1f} degrees below the horizon"
        return _text(replace(nothing, refused=deep))
    start = None if asked.start is None else keyframes.scene(asked.start, torch.float64)
    options = Options(mask=asked.mask, solver=asked.solver, seed=asked.seed, start=start)
    try:
        view = seen(path, computed, asked.turned, options)
        if asked.mask is None:
            night.refuse(view.photo, view.place)
        return _text(_estimate(view, nothing, options, asked.bearing))
    except (InputError, FloatingPointError) as refused:  # the second where no sky is drawn that is finite
        return _text(replace(nothing, refused=str(refused)))


def _estimate(view: View, nothing: Estimate, options: Options, bearing: float) -> Estimate:
    pixels = sky_pixels(view.photo, view.place, options)
    free = ("SUN_AZIMUTH",) if view.is_searched else ()
    found = sky.solve(pixels, view.place, replace(options, sun=view.place, free=free))
    azimuth = found.parameters["SUN_AZIMUTH"]
    view = replace(view, place=replace(view.place, azimuth=azimuth.value))
    turn = math.radians(view.heading - bearing)
    few = sky.sample(pixels, stratified(pixels, sky.FINE_PIXELS, options.seed + SEED_OF_SAMPLE))
    _, error = sky.compared(_under_one(found.scene), few)
    said = _said(found, turn)
    return replace(
        nothing,
        names=said.names,
        point=said.point,
        noise=said.noise,
        held=said.held,
        determined=tuple(name for name, why in zip(found.space.free, found.known.why, strict=True) if not why),
        error=error,
        converged=found.minimum.converged,
        heading=view.heading,
        heading_error=azimuth.standard_error if view.is_searched else view.heading_error,
        how=_how(view, azimuth.standard_error),
        pitch=view.pitch,
        pitch_error=view.pitch_error,
        off=view.off,
        tolerance=view.tolerance,
        direction=_turned(few, turn),
        log_radiance=few.log_radiance.numpy().astype(np.float32),
        floor=few.floor,
    )


@dataclass(frozen=True)
class _Said:
    names: tuple[str, ...]
    point: Float64[np.ndarray, " k"]
    noise: Float64[np.ndarray, "k k"]
    held: Float64[np.ndarray, "k k"]


def _said(found: sky.Solved, turn: float) -> _Said:
    """What a fit says of its parameters, leans turned by an angle, with the errors that differ from photo to photo.

    What a photo leaves open is among them: its error is wide, but where it ends decides where the others do. Without
    it the curves would be off by three times the photos' own errors. What the fit holds still is alike in all photos
    of a day: it blurs where a curve lies, not how it runs.
    """
    names, point, parts = found.space.free, found.minimum.point, covariances(found.evidence)
    why = reasons(found.evidence.slopes.reshape(-1, point.size), point, NEAR_BOUND)
    is_cut = sum(name in names for name in LEANS) == 1 and math.sin(turn) != 0.0
    kept = [
        index
        for index, name in enumerate(names)
        if why[index] != NO_INFLUENCE and not name.startswith("SUN_") and not (is_cut and name in LEANS)
    ]
    chosen = np.ix_(kept, kept)
    spoken = tuple(names[index] for index in kept)
    rotation = _turning(spoken, turn)
    middle = np.full(len(kept), 0.5)  # of the unit cube, where a lean is none
    said = _Said(
        spoken,
        np.clip(middle + rotation @ (point[kept] - middle), 0.0, 1.0),
        rotation @ parts.noise[chosen] @ rotation.T,
        rotation @ parts.held[chosen] @ rotation.T,
    )
    return _without_clouds(said) if found.pinned.get(OF_OVERCAST) == NO_LAYER else said


def _without_clouds(said: _Said) -> _Said:
    """The same with a cloud layer of 0, which a search has come to and left: that too is something a photo says."""
    count = len(said.names)
    noise, held = np.zeros((count + 1, count + 1)), np.zeros((count + 1, count + 1))
    noise[:count, :count], held[:count, :count] = said.noise, said.held
    noise[count, count] = UNSEEN**2
    return _Said((*said.names, OF_OVERCAST), np.append(said.point, 0.0), noise, held)


def _how(view: View, searched_error: float | None) -> str:
    if view.is_searched:
        return "the sky's shape" if searched_error is not None else "a guess: the sky does not determine it"
    if view.heading_error is None:
        return "given"
    return "the sun's disc"


def _turning(names: tuple[str, ...], turn: float) -> Float64[np.ndarray, "k k"]:
    """Matrix that turns what leans towards a direction from the picture's axes to those of the day; else the identity.

    Both leans have the same bounds, symmetric round 0, so that the unit cube turns as they do.
    """
    matrix = np.eye(len(names))
    if all(name in names for name in LEANS):
        ahead, left = (names.index(name) for name in LEANS)
        matrix[[ahead, ahead, left, left], [ahead, left, ahead, left]] = (
            math.cos(turn), math.sin(turn), -math.sin(turn), math.cos(turn),
        )  # fmt: skip
    return matrix


def _turned(few: Sample, turn: float) -> Float32[np.ndarray, "n 3"]:
    """Directions by the day's axes, seen clockwise from the picture's by an angle."""
    ahead, left, up = few.direction.numpy().T
    cos, sin = math.cos(turn), math.sin(turn)
    return np.stack([ahead * cos + left * sin, left * cos - ahead * sin, up], -1).astype(np.float32)


def _under_one(scene: Scene) -> Scene:
    """Scene under an irradiance of 1, at which gains are the exposed sun's."""
    ones = {name: 1.0 for name in weather_names() if name.startswith(("EXPOSURE", "SUN_IRRADIANCE"))}
    return keyframes.scene(keyframes.values(scene) | ones, torch.float64)


# Text


def _text(estimate: Estimate) -> str:
    plain = {
        name: _plain(value) if isinstance(value, np.ndarray) else value for name, value in asdict(estimate).items()
    }
    # NaN, which alone differs from itself, is a default.
    return json.dumps({name: None if value != value else value for name, value in plain.items()}, allow_nan=False)


def _plain(array: np.ndarray) -> dict[str, object]:
    coded = base64.b64encode(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()).decode()
    return {"shape": list(array.shape), "type": array.dtype.str[1:], "base64": coded}


def of_text(text: str) -> Estimate:
    """Estimate of its text.

    Raises:
        ValueError, LookupError, TypeError: when it is none.
    """
    plain = json.loads(text)
    known: dict[str, object] = {}
    for name, value in plain.items():
        if isinstance(value, dict):
            array = np.frombuffer(base64.b64decode(value["base64"]), "<" + value["type"]).reshape(value["shape"])
            known[name] = array.astype(value["type"])
        elif isinstance(value, list):
            known[name] = tuple(value)
        elif value is not None:
            known[name] = value
    return Estimate(**known)  # type: ignore[arg-type]
