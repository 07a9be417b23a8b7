"""`fit sky`: the air, haze and clouds of a scene fitted to the sky of one HDR photo."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import celestial, sky
from diffrender.scene import Scene, places, sky_view, weather_names
from fit import account, hidden_sun, keyframes, night, sky_mask, sun
from fit import photo as photos
from fit.asked import Options
from fit.input_error import InputError
from fit.minimum import INTERRUPTED, STUCK, Budget, Minimum, Point
from fit.objective import Sample, SkyObjective
from fit.photo import Photo
from fit.pixels import Pixels, averaged, stratified, usable
from fit.search_space import SearchSpace, value
from fit.selection import begin, left_open, pinned_scene, undetermined, widened
from fit.solution import Fitted, Solution, SunPlace
from fit.solvers import solver
from fit.uncertainty import Evidence, Uncertainty, evidence, uncertainty
from fit.weather_file import check

__all__ = ["POOL", "SEARCHED", "Options", "Solved", "check_sky", "compared", "fit", "sample", "solve"]

SEARCHED = (
    "SKY_HAZINESS",
    "SKY_MIE_SCALE",
    "SKY_MIE_COLOUR_EXPONENT",
    "SKY_COARSE_SCALE",
    "SKY_RAYLEIGH_SCALE",
    "SKY_RAYLEIGH_COLOUR_EXPONENT",
    "SKY_OVERCAST",
    "SKY_OVERCAST_AHEAD",
    "SKY_OVERCAST_LEFT",
)
# Where a search begins if no weather file says otherwise: a hazy day, from which every parameter has a slope.
HAZY = {
    "SKY_HAZINESS": 0.55,
    "SKY_MIE_SCALE": 10.0,
    "SKY_COARSE_SCALE": 0.5,
    "SKY_RAYLEIGH_SCALE": 0.6,
    "SKY_OVERCAST": 0.3,
}
# What may take the place of searched parameters that a photo leaves open.
POOL = (
    "SKY_COARSE_HAZINESS",
    "SKY_OZONE",
    "SKY_GROUND_ALBEDO",
    "SKY_OVERCAST_TRANSMITTANCE_R",
    "SKY_OVERCAST_TRANSMITTANCE_B",
)
LEAN = 3.2  # towards the sun, of the clouds where a search begins
SIZE = sky.Size(rows=16, columns=5, steps=24, heights=6, suns=8, steps_around=6)  # of the search's tables
# Twice these pixels, tables of twice the cells and tighter tolerances change the error by less than 1 %.
COARSE_PIXELS, FINE_PIXELS = 400, 1200
GAIN_PIXELS = 10_000  # a log gain's standard error is then a hundredth of the residuals' spread
ROUGH_BUDGET, FINE_BUDGET = Budget(tolerance=3e-3), Budget(tolerance=1e-3)
LATE_BUDGET = Budget(tolerance=3e-4, evaluations=60)  # of what is searched on top of what was found


def fit(photo: Photo | Path, options: Options | None = None) -> Solution:
    """Scene whose sky looks like the photo's, with the sun where the photo has it, and the account of the fit.

    Raises:
        InputError: when the photo, the mask or an option cannot be used; the message says what to do.
    """
    options = options or Options()
    began = time.monotonic()
    solver(options.solver)  # whose name is asked for before the photo is read
    photo = photo if isinstance(photo, Photo) else photos.read(photo)
    place = sun.checked(photo, options.sun) if options.sun else sun.find(photo)
    if options.sun is None or options.mask is None:
        night.refuse(photo, place)
    mask = sky_mask.read(options.mask, photo) if options.mask else sky_mask.find(photo, place)
    used = usable(photo, mask.used)
    pixels = averaged(photo, used)
    check_sky(pixels)
    read = time.monotonic()
    found = solve(pixels, place, options)
    space, known = found.space, found.known
    ended = account.Ended(found.scene, found.parameters, space.free, known, found.minimum)
    return Solution(
        **account.of_any(photo, used, options, ended),
        effect="sky",
        notes=(*photo.notes, mask.how),
        sun=hidden_sun.place(place, found.parameters, space.free),
        gains=account.gains(found.scene),
        left_out={**found.pinned, **_left_out(space, known)},
        error=found.error,
        seconds={"read": read - began, **found.seconds},
        versions=account.versions(),
    )


@dataclass(frozen=True)
class Solved:
    """What the pixels of a photo give, the files and the camera aside."""

    space: SearchSpace
    minimum: Minimum
    pinned: Mapping[str, str]  # names that were searched in vain, and why
    scene: Scene
    error: float  # mean square of the difference of log radiance
    evidence: Evidence
    known: Uncertainty
    parameters: Mapping[str, Fitted]
    seconds: Mapping[str, float]  # to find the scene; then its error and those of its parameters


def solve(pixels: Pixels, place: SunPlace, options: Options) -> Solved:
    """Scene whose sky looks like some pixels, under a sun, which is searched too where its place is but a guess.

    Raises:
        InputError: when an option cannot be used.
    """
    began = time.monotonic()
    is_guess = options.sun is None and not place.visible
    late = tuple(name for name in hidden_sun.NAMES if is_guess and name not in options.free)
    found = _search(_home(options, place), pixels, options, late)
    space, point = found.objective.space, torch.from_numpy(found.minimum.point)
    # The tables from which a picture is drawn: gains of coarser ones would be off by a percent.
    drawn = replace(found.objective, geometry=_geometry(space, sky.Size()))
    gains = _closed_form_gains(drawn, sample(pixels, stratified(pixels, GAIN_PIXELS, options.seed)), point)
    scene = account.exposed(space.scene(point), gains)
    solved = time.monotonic()
    proof = _evidence(found, options)
    known = uncertainty(proof, found.minimum.point)
    error = _error(drawn, pixels, point, gains)
    parameters = account.parameters(scene, space, known, lambda n: found.pinned.get(n) or _unsearched(n, options))
    seconds = {"solve": solved - began, "errors": time.monotonic() - solved}
    return Solved(space, found.minimum, found.pinned, scene, error, proof, known, parameters, seconds)


def check_sky(pixels: Pixels) -> None:
    """Do nothing where a fit has pixels to look at.

    Raises:
        InputError: when they are too few, or black.
    """
    count = int(pixels.used.sum())
    if count < 30:
        raise InputError(f"only {count} usable pixels of sky are left; give --mask with white where the sky is")
    if not float(pixels.radiance[pixels.used].median()) > 0.0:
        raise InputError("the photo is black where the sky is; give an exposed photo or another --mask")


def _home(options: Options, place: SunPlace) -> Scene:
    """Scene of what is not searched: given values, those of the weather file to start at, defaults."""
    known = weather_names()
    for name in (*options.fixed, *options.free):
        if name not in known:
            check(name, 0.0)
        if name.startswith(("EXPOSURE", "SUN_IRRADIANCE")):
            raise InputError(f"{name} is the photo's gain and found in closed form; leave it out of --fix and --free")
        if name.startswith("SUN_") and name in options.fixed:
            raise InputError(f"--fix {name}; give the sun's place by --sun ELEVATION,AZIMUTH")
    given = keyframes.values(options.start) if options.start is not None else {"SKY_OVERCAST": 0.0}
    # An irradiance of 1: the gains found later are the exposed sun's.
    ones = {name: 1.0 for name in known if name.startswith(("EXPOSURE", "SUN_IRRADIANCE"))}
    sun_now = {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    return keyframes.scene({**given, **ones, **sun_now, **options.fixed}, torch.float64)


def _space(options: Options, home: Scene) -> SearchSpace:
    """What is searched first, from a hazy day with clouds on the sun's side, or from the weather file given."""
    free = tuple(name for name in dict.fromkeys((*SEARCHED, *options.free)) if name not in options.fixed)
    if options.start is not None:
        return SearchSpace(home, free)
    sunward = celestial.to_sun(home.sun)
    lean = LEAN * sunward[:2] / torch.clamp(torch.linalg.vector_norm(sunward[:2]), min=1e-9)
    begin = {**HAZY, "SKY_OVERCAST_AHEAD": float(lean[0]), "SKY_OVERCAST_LEFT": float(lean[1])}
    values = keyframes.values(home) | {name: number for name, number in begin.items() if name in free}
    return SearchSpace(keyframes.scene(values, torch.float64), free)


@dataclass(frozen=True)
class _Found:
    objective: SkyObjective
    minimum: Minimum
    pinned: Mapping[str, str]  # names that were searched in vain, and why


def _search(home: Scene, pixels: Pixels, options: Options, late: tuple[str, ...]) -> _Found:
    """Where the last stage of a search ended, with the account of all of them; what Ctrl-C leaves is said so."""
    found: list[_Found] = []
    try:
        for stage in _stages(home, pixels, options, late):
            found.append(stage)
            if stage.minimum.reason == INTERRUPTED:
                break
    except KeyboardInterrupt:
        if not found:
            raise
        ended = replace(found[-1].minimum, reason=INTERRUPTED, converged=False, history=(), iterations=0, evaluations=0)
        found.append(replace(found[-1], minimum=ended))
    minima = [stage.minimum for stage in found]
    whole = replace(
        minima[-1],
        history=tuple(loss for minimum in minima for loss in minimum.history),
        iterations=sum(minimum.iterations for minimum in minima),
        evaluations=sum(minimum.evaluations for minimum in minima),
    )
    return replace(found[-1], minimum=whole)


def _stages(home: Scene, pixels: Pixels, options: Options, late: tuple[str, ...]) -> Iterator[_Found]:
    """Minimum on few pixels; again without what the photo leaves open; polished on more of them.

    What is searched late comes on top, from there.
    """
    began = time.monotonic()
    minimise = solver(options.solver)

    def search(objective: SkyObjective, start: Point, budget: Budget) -> Minimum:
        left = None if options.seconds is None else max(options.seconds - (time.monotonic() - began), 0.0)
        return minimise(objective, start, replace(budget, seconds=left, seed=options.seed))

    few = sample(pixels, stratified(pixels, COARSE_PIXELS, options.seed))
    many = sample(pixels, stratified(pixels, FINE_PIXELS, options.seed + 1))
    tried = []
    for start in hidden_sun.starts(home) if late else [home]:
        space = _space(options, start)
        rough = SkyObjective(space, few, _geometry(space, SIZE))
        tried.append((search(rough, begin(space), ROUGH_BUDGET), rough, start))
        yield _Found(rough, tried[-1][0], {})
    first, rough, home = min(tried, key=lambda one: one[0].loss)
    last = first
    wider, pinned = _reselected(rough, first, home, options)
    if pinned:
        rough = replace(rough, space=wider)
        last = search(rough, begin(wider), ROUGH_BUDGET)
        yield _Found(rough, last, pinned)
    fine = replace(rough, sample=many)
    last = search(fine, last.point, FINE_BUDGET)
    yield _Found(fine, last, pinned)
    if late:
        space = fine.space
        wider = SearchSpace(space.scene(torch.from_numpy(last.point)), (*space.free, *late))
        with_late = replace(fine, space=wider, geometry=_geometry(wider, SIZE))
        moved = search(with_late, wider.point(wider.start), LATE_BUDGET)
        why = hidden_sun.why_not(wider, moved.point, left_open(with_late, moved))
        if moved.reason == STUCK and not moved.converged:
            why = hidden_sun.UNSETTLED
        if why:
            stays = replace(last, history=moved.history, iterations=moved.iterations, evaluations=moved.evaluations)
            yield _Found(fine, stays, {**pinned, **dict.fromkeys(late, why)})
        else:
            yield _Found(with_late, moved, pinned)


def _reselected(
    objective: SkyObjective, minimum: Minimum, home: Scene, options: Options
) -> tuple[SearchSpace, dict[str, str]]:
    """Space in which others take the place of what the photo leaves open, and why that was left out."""
    space, point = objective.space, minimum.point
    overcast = float(value(space.scene(torch.from_numpy(point)), places()["SKY_OVERCAST"]))
    pinned = undetermined(left_open(objective, minimum), overcast)
    pinned = {name: why for name, why in pinned.items() if name not in options.free}
    if not pinned:
        return space, {}
    start = pinned_scene(space, point, list(pinned), home)
    kept = SearchSpace(start, tuple(name for name in space.free if name not in pinned))
    pool = [name for name in POOL if name not in options.fixed and name not in pinned]
    return widened(replace(objective, space=kept), pool, len(space.free)), pinned


def _evidence(found: _Found, options: Options) -> Evidence:
    """What the photo says, whatever is held without being known; all is where a scene was given."""
    unknown = (*SEARCHED, *POOL) if options.start is None else ()
    held = [name for name in unknown if name not in found.objective.space.free and name not in options.fixed]
    return evidence(found.objective, found.minimum, held)


def sample(pixels: Pixels, chosen: Tensor) -> Sample:
    """Some of the used pixels, by their indices among them."""
    radiance = pixels.radiance[pixels.used][chosen].double()
    direction = pixels.direction[pixels.used][chosen].double()
    return Sample(direction, torch.log(radiance + pixels.floor), pixels.floor)


def _geometry(space: SearchSpace, size: sky.Size) -> Callable[[Scene], sky.Geometry]:
    """Rays of the tables of a scene; worked out once where the sun is not searched."""

    def rays(scene: Scene) -> sky.Geometry:
        return sky.geometry(sky_view(scene, torch.zeros(1, 3, dtype=torch.float64)), size)

    if any(name.startswith("SUN_") for name in space.free):
        return rays
    kept = rays(space.start)
    return lambda _: kept


def compared(scene: Scene, some: Sample) -> tuple[Float[Tensor, "3"], float]:
    """Gain of each channel at which a scene is most like some pixels, and the error E3 over them then."""
    space = SearchSpace(scene, ())
    drawn, nowhere = SkyObjective(space, some, _geometry(space, sky.Size())), torch.zeros(0, dtype=torch.float64)
    gains = _closed_form_gains(drawn, some, nowhere)
    difference = torch.log(gains * drawn.radiance(nowhere) + some.floor) - some.log_radiance
    return gains, float(difference.square().mean())


def _closed_form_gains(drawn: SkyObjective, some: Sample, point: Float[Tensor, " n"]) -> Float[Tensor, "3"]:
    """Gain of each channel that makes the mean square of log differences least over some pixels."""
    model = replace(drawn, sample=some).radiance(point)
    log_gain = (some.log_radiance - torch.log(model)).mean(0)
    for _ in range(2):
        # Newton: the floor alone keeps the first guess from being exact.
        lit = torch.exp(log_gain) * model
        slope = lit / (lit + some.floor)
        difference = torch.log(lit + some.floor) - some.log_radiance
        log_gain = log_gain - (difference * slope).sum(0) / slope.square().sum(0)
    return torch.exp(log_gain)


def _error(drawn: SkyObjective, pixels: Pixels, point: Float[Tensor, " n"], gains: Float[Tensor, "3"]) -> float:
    """Mean square of the difference of log radiance over all used pixels."""
    whole = sample(pixels, torch.arange(int(pixels.used.sum())))
    weight = pixels.solid_angle[pixels.used].double()
    difference = torch.log(gains * replace(drawn, sample=whole).radiance(point) + whole.floor) - whole.log_radiance
    return float((weight[:, None] * difference.square()).sum() / (3.0 * weight.sum()))


def _unsearched(name: str, options: Options) -> str:
    if name in options.fixed:
        return "given"
    if name.startswith(("EXPOSURE", "SUN_IRRADIANCE")):
        return "closed form"
    if name.startswith("SUN_"):
        return "given" if options.sun else "taken from the photo"
    return "kept" if options.start is not None else "default"


def _left_out(space: SearchSpace, known: Uncertainty) -> dict[str, str]:
    return {name: reason for name, reason in zip(space.free, known.why, strict=True) if reason}
