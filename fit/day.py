"""`fit day`: photos of a day, each fitted for itself, then all of them together, as one weather file of few keyframes.

A photo that is far from what the others foretell is fitted once more from there: its loss has several minima.

What is common to a day is air, haze and clouds, which change slowly: their curves follow all photos, through clouds and
gaps. What each photo has of its own is its exposure and white balance: these are found at the curves' values, and their
curves follow them as far as they follow each other.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch

from diffrender.scene import Scene, weather_names
from fit import account, day_parts, day_times, keyframes, priors, sky
from fit.day_curves import Curves, Observation, curves, spoken_of
from fit.day_keyframes import Keyframes, fewest
from fit.day_photo import LEANS, THREADS, Asked, Estimate, fitted, of_text
from fit.input_error import InputError
from fit.search_space import SearchSpace
from fit.selection import PATCHES
from fit.solvers import solver

GAINS = ("EXPOSURE", "SUN_IRRADIANCE_R", "SUN_IRRADIANCE_G", "SUN_IRRADIANCE_B")
STOP = math.log(2.0)  # deviation of the prior of a gain's logarithm

FEWEST = 4  # photos of a day, from which on each is compared with what the others foretell
# A photo fitted again from there takes the place of the first fit up to this ratio of errors: of 60 patches of sky as
# if independent, two standard deviations.
AS_WELL = math.exp(4.0 / PATCHES)

Tell = Callable[[int, int], None]
Task = tuple[Path, datetime, Asked]


def quietly(done: int, whole: int) -> None:
    """Tell nobody how many photos of how many are fitted."""


@dataclass(frozen=True)
class Options:
    """What may be asked of a day.

    Attributes:
        asked: of each photo.
        times: of photos by their file names, before what they say themselves.
        parts: folder where fitted photos are kept.
        resume: whether photos that an earlier run has kept there are not fitted again.
        jobs: photos at a time; -1 for as many as there are processors.
    """

    asked: Asked
    parts: Path
    times: Mapping[str, datetime]
    resume: bool = False
    jobs: int = -1


@dataclass(frozen=True)
class Judged:
    """A photo against the day's curves: gains under an irradiance of 1, and mean square error of log radiance."""

    gains: tuple[float, float, float]
    error: float


@dataclass(frozen=True)
class Day:
    """What a day's photos say.

    Attributes:
        times: of the photos, in the order of the hour.
        estimates: of each photo.
        judged: each photo at the curves' values; None where it was refused.
        air: curves of air, haze and clouds.
        gains: curves of exposure and the sun's colour.
        keyframes: of every name that has a curve, in the unit cube.
        held: variance of each name of `air` that all photos have in common, in the unit cube.
        home: scene of what has no curve.
    """

    asked: Asked
    times: tuple[datetime, ...]
    estimates: tuple[Estimate, ...]
    judged: tuple[Judged | None, ...]
    air: Curves
    gains: Curves
    keyframes: Mapping[str, Keyframes]
    held: Mapping[str, float]
    home: Scene

    def used(self) -> list[int]:
        """Indices of the photos that were not refused."""
        return [index for index, one in enumerate(self.estimates) if not one.refused]


def fit(photos: Sequence[Path], options: Options, tell: Tell = quietly) -> Day:
    """Day of some photos.

    Raises:
        InputError: when a photo cannot be read, has no time, or none can be used.
    """
    torch.set_num_threads(THREADS)
    solver(options.asked.solver)  # whose name is asked for before any photo is read
    _check_names(photos)
    times = day_times.of_photos(photos, options.times)
    zone = times[0].tzinfo
    order = sorted(range(len(photos)), key=lambda index: (hour(times[index].astimezone(zone)), photos[index].name))
    photos, times = [photos[i].absolute() for i in order], [times[i].astimezone(zone) for i in order]
    if not options.resume:
        day_parts.clear(options.parts, [])
    tasks = [(photo, time, options.asked) for photo, time in zip(photos, times, strict=True)]
    first = _estimates(tasks, options, tell)
    again = _again(tasks, list(first.values()))
    second = _estimates(list(again.values()), options, tell)
    day_parts.clear(options.parts, [*first, *second])
    chosen = _likelier(list(first.values()), dict(zip(again, second.values(), strict=True)))
    return together(chosen, times, options)


def hour(time: datetime) -> float:
    """Hour of a local day."""
    return time.hour + time.minute / 60.0 + time.second / 3600.0


def _check_names(photos: Sequence[Path]) -> None:
    names = [path.name for path in photos]
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise InputError(f"two photos are named {doubled}; rename one of them, or give it once")


def _estimates(tasks: Sequence[Task], options: Options, tell: Tell) -> dict[Path, Estimate]:
    """What each photo says, by the file where it is kept as soon as it is known."""
    places = [day_parts.place(options.parts, *task) for task in tasks]
    texts = {place: text for place in places if (text := day_parts.found(place)) is not None}
    missing = [(str(place), *task) for place, task in zip(places, tasks, strict=True) if place not in texts]
    tell(len(texts), len(places))
    for name, text in _each(_one, missing, options.jobs):
        day_parts.keep(Path(name), text)
        texts[Path(name)] = text
        tell(len(texts), len(places))
    return {place: of_text(texts[place]) for place in places}


def _again(tasks: Sequence[Task], estimates: Sequence[Estimate]) -> dict[int, Task]:
    """Photos, by their index, that are far from what the others foretell, to be fitted again from there.

    A photo's loss has several minima that are nearly as low: it may have ended in one where no other photo did.
    """
    spoken = _spoken(estimates, [time for _, time, _ in tasks])
    heard = [place for place in range(len(spoken.used)) if place not in spoken.doubtful]
    if len(heard) < FEWEST:
        return {}
    air, home = _air(spoken), _home()
    keys = fewest(air, len(spoken.used))
    found = {}
    for place in heard:
        index = spoken.used[place]
        if not air.distances[place] > 1.0:
            continue
        here = keys | {name: Keyframes((0.0,), (there,)) for name, there in air.foretold[place].items()}
        values = values_at(home, here, spoken.hours[place])
        start = {name: at for name, at in values.items() if name.startswith("SKY_") and name not in LEANS}
        photo, time, asked = tasks[index]
        found[index] = photo, time, replace(asked, start=start)
    return found


def _likelier(first: Sequence[Estimate], second: Mapping[int, Estimate]) -> list[Estimate]:
    """Estimates, of which those fitted again take the place of the first where the photo is as well told by them."""
    found = list(first)
    for index, again in second.items():
        if not again.refused and again.error <= AS_WELL * first[index].error:
            # What a fit holds at given values is not known to it to be uncertain.
            found[index] = replace(again, held=None)
    return found


def _one(name: str, photo: Path, time: datetime, asked: Asked) -> tuple[str, str]:
    return name, fitted(photo, time, asked)


def _each(work: Callable[..., Any], tasks: Sequence[Sequence[Any]], jobs: int) -> Any:
    """Results in the order in which they come; on the backend that joblib is set to."""
    parallel = joblib.Parallel(n_jobs=min(jobs, len(tasks)) or 1, return_as="generator_unordered", batch_size=1)
    try:
        yield from parallel(joblib.delayed(work)(*task) for task in tasks)
    except BrokenExecutor as error:
        raise InputError(
            "a process that fitted a photo was ended from outside, perhaps for want of memory; run again with --resume "
            "and fewer --jobs"
        ) from error


# Together


def together(estimates: Sequence[Estimate], times: Sequence[datetime], options: Options) -> Day:
    """Joint fit of photos in the order of the hour.

    Raises:
        InputError: when none of them can be used.
    """
    spoken = _spoken(estimates, times)
    used, hours = spoken.used, spoken.hours
    if not used:
        raise InputError(f"none of {len(estimates)} photos can be used; of the first: {estimates[0].refused}")
    if len(spoken.doubtful) == len(used):
        one = estimates[used[0]]
        raise InputError(
            f"the sun of {one.photo} stands {one.off:.3g} degrees from where place and time put it, and so in every "
            "photo; check --latitude, --longitude, --heading and the times with their zones"
        )
    air, home = _air(spoken), _home()
    keys = fewest(air, len(used))
    tasks = [
        (place, values_at(home, keys, at) | _sun(estimates[index], options.asked.bearing), estimates[index])
        for place, (index, at) in enumerate(zip(used, hours, strict=True))
    ]
    found = dict(_each(_judged, tasks, options.jobs))
    judged = [found[place] for place in range(len(used))]
    gains = curves(
        [_gained(one, at) for one, at in zip(judged, hours, strict=True)],
        {name: STOP / _span(name) for name in GAINS},
        spoken.doubtful,
    )
    every: list[Judged | None] = [None] * len(estimates)
    for place, index in enumerate(used):
        every[index] = judged[place]
    return Day(
        asked=options.asked,
        times=tuple(times),
        estimates=tuple(estimates),
        judged=tuple(every),
        air=air,
        gains=gains,
        keyframes=keys | fewest(gains, len(used)),
        held={name: _held(name, [estimates[index] for index in used]) for name in air.names},
        home=home,
    )


@dataclass(frozen=True)
class _Spoken:
    """What those photos say that are not refused.

    Attributes:
        used: their indices.
        hours: of the day, one for each of them.
        said: by each of them.
        doubtful: places among them of photos whose sun is elsewhere.
    """

    used: list[int]
    hours: list[float]
    said: list[Observation]
    doubtful: list[int]


def _spoken(estimates: Sequence[Estimate], times: Sequence[datetime]) -> _Spoken:
    used = [index for index, one in enumerate(estimates) if not one.refused]
    hours = [hour(times[index]) for index in used]
    said = [_observation(estimates[index], at) for index, at in zip(used, hours, strict=True)]
    return _Spoken(used, hours, said, [place for place, index in enumerate(used) if estimates[index].is_doubtful])


def _air(spoken: _Spoken) -> Curves:
    names = _with_curves([one for place, one in enumerate(spoken.said) if place not in spoken.doubtful])
    spread = dict(zip(names, map(float, priors.in_unit_cube(names).spread), strict=True))
    return curves(spoken.said, spread, spoken.doubtful)


def _home() -> Scene:
    return keyframes.scene({"SKY_OVERCAST": 0.0}, torch.float64)


def _with_curves(spoken: Sequence[Observation]) -> list[str]:
    """Names that have curves: those that every photo was asked for, and of the others what most photos speak of.

    The rest of the photos were fitted with the default of the others.
    """
    most = spoken_of(spoken, len(spoken) // 2 + 1)
    return [name for name in spoken_of(spoken, 1) if name in sky.SEARCHED or name in most]


def _observation(one: Estimate, at: float) -> Observation:
    assert one.point is not None
    assert one.noise is not None
    return Observation(at, one.names, one.point, one.noise)


def values_at(home: Scene, keys: Mapping[str, Keyframes], at: float) -> dict[str, float]:
    """Values of a scene at an hour, in files' units: of curves by their keyframes, of all else as at home."""
    point = torch.tensor([float(np.clip(keys[name].at([at])[0], 0.0, 1.0)) for name in keys], dtype=torch.float64)
    return keyframes.values(SearchSpace(home, tuple(keys)).scene(point))


def _sun(one: Estimate, middle: float) -> dict[str, float]:
    """Sun by place and time, in a picture whose middle column has a bearing."""
    return {"SUN_ELEVATION": one.elevation, "SUN_AZIMUTH": (one.bearing - middle + 180.0) % 360.0 - 180.0}


def _judged(place: int, values: Mapping[str, float], one: Estimate) -> tuple[int, Judged]:
    torch.set_num_threads(THREADS)
    ones = dict.fromkeys(GAINS, 1.0)
    gains, error = sky.compared(keyframes.scene({**values, **ones}, torch.float64), one.sample())
    red, green, blue = map(float, gains)
    return place, Judged((red, green, blue), error)


def _gained(one: Judged, at: float) -> Observation:
    """What a photo's gains say of exposure and sun; the mean of so many patches of sky has its error."""
    exposed = account.exposed(keyframes.scene({}, torch.float64), torch.tensor(one.gains, dtype=torch.float64))
    spans = np.array([_span(name) for name in GAINS])
    point = SearchSpace(exposed, GAINS).point(exposed)
    return Observation(at, GAINS, point, np.diag(one.error / PATCHES / spans**2))


def _span(name: str) -> float:
    """Of a log parameter's bounds."""
    low, high = weather_names()[name].bounds
    return math.log(high / low)


def _held(name: str, estimates: Sequence[Estimate]) -> float:
    """Median over the photos that speak of a name of the variance that they have in common."""
    found = [
        float(one.held[one.names.index(name), one.names.index(name)])
        for one in estimates
        if name in one.names and one.held is not None
    ]
    return float(np.median(found)) if found else 0.0
