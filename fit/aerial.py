"""`fit fog --model aerial`: the air of a whole landscape, as aerial perspective instead of a layer of fog.

The air is that of the weather file's sky, or a clear day's. Searched are by how much more distances count than in it
and the haziness; solved in closed form is its light by channel: of a known sun the tint of the middle ground, else the
sun's own strength. Where the picture without air is not known, so is that of surfaces, alike in all of the picture.

The sky is not looked at, for it has its air already; so distances have to be known. The sun stays where it is given or
guessed to be.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jvp, vmap

from diffrender.atmosphere import aerial_perspective, sky
from diffrender.atmosphere.aerial_perspective import AerialPerspective, AerialView, TabledView, Tables
from diffrender.atmosphere.celestial import Sun, to_sun
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.parameters import defaults, specifications
from diffrender.scene import Exposure, Scene, places, weather_names
from fit import account, fog, foggy_photo, hidden_sun, keyframes, selection
from fit.exr import bands
from fit.fog_objective import PRIOR_WEIGHT, FogPixels, robust, strengths
from fit.fog_picture import LEAST_SEEN, Radiance
from fit.foggy_photo import LEAST_PIXELS, FoggyPhoto, Options
from fit.gauss_newton import half_square
from fit.input_error import InputError
from fit.minimum import INTERRUPTED, Budget, Minimum, Point
from fit.photo import Photo
from fit.search_space import SearchSpace
from fit.solution import Solution, SunPlace
from fit.solvers import solver
from fit.uncertainty import Uncertainty
from fit.weather_file import check

PREFIX = "AERIAL_PERSPECTIVE_"
DISTANCE = PREFIX + "DISTANCE_SCALE"  # searched even where it is not determined: without it there is no air
SEARCHED = (DISTANCE, PREFIX + "HAZINESS")
TINT = PREFIX + "TINT"
STARTS = (0.1, 0.5, 2.0, 8.0, 30.0)  # distance scales
HIGHEST_EYE = 2e4  # of the tables' air [m]


@dataclass(frozen=True)
class AerialObjective:
    """Residuals over a sample of pixels; a point is that of the search space.

    Attributes:
        scale: what differences are relative to.
        seen: black objects in the air, under the irradiance that the strength of its light is relative to.
        tables: of that air.
        horizon: irradiance that lights the background's part of the tables, which no tint changes; 0 where the sun is
            not known and all light has one strength.
    """

    space: SearchSpace
    pixels: FogPixels
    scale: Float[Tensor, "n 3"]
    seen: AerialView
    tables: Tables
    horizon: Float[Tensor, "3"]

    def residuals(self, point: Float[Tensor, " n"]) -> Float[Tensor, " m"]:
        """Robust relative differences, three for each pixel, then distances from the start."""
        begun = torch.from_numpy(self.space.point(self.space.start)).to(point)
        difference = (self.picture(point)[0] - self.pixels.radiance) / self.scale
        return torch.cat([robust(difference), PRIOR_WEIGHT * (point - begun)])

    def jacobian(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, " m"], Float[Tensor, "m n"]]:
        """Residuals and their exact derivatives by each coordinate, in forward mode."""
        slopes = vmap(lambda along: jvp(self.residuals, (point,), (along,))[1])(torch.eye(point.numel()).to(point))
        return self.residuals(point), slopes.T

    def picture(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "lights 3"]]:
        """Radiance of objects through the air of a point, and in closed form the strengths of air and surfaces."""
        perspective = self.space.scene(point).aerial_perspective
        assert perspective is not None  # a search space of the air has one
        plain = replace(perspective, tint=torch.ones_like(perspective.tint))
        bare = replace(perspective, tint=torch.zeros_like(perspective.tint))
        black, white, dark = torch.zeros_like(self.scale), torch.ones_like(self.scale), torch.zeros_like(self.horizon)
        passed = self._drawn(bare, white, dark)
        of_horizon = self._drawn(bare, black, self.horizon)
        added = self._drawn(plain, black, self.seen.view.irradiance) - of_horizon
        known = of_horizon if self.pixels.clear is None else of_horizon + passed * self.pixels.clear
        columns = torch.stack([added, passed] if self.pixels.clear is None else [added], -2)
        strength = strengths(columns / self.scale[:, None], (self.pixels.radiance - known) / self.scale)
        return known + (columns * strength).sum(-2), strength

    def _drawn(self, perspective: AerialPerspective, background: Tensor, irradiance: Tensor) -> Float[Tensor, "n 3"]:
        seen = replace(self.seen, view=replace(self.seen.view, irradiance=irradiance), background=background)
        return aerial_perspective.render_tables(perspective, TabledView(seen, self.tables))


@dataclass(frozen=True, eq=False)
class Aerial:
    """A solution, with what it takes to draw it."""

    solution: Solution
    photo: FoggyPhoto
    objective: AerialObjective


def solve(photo: Photo, options: Options) -> Aerial:
    """Scene whose aerial perspective looks like the photo's, the account of the fit, and what it takes to draw it.

    Raises:
        InputError: when the photo, a file beside it or an option cannot be used; the message says what to do.
    """
    began = time.monotonic()
    place, _ = fog.sun_of(photo, options.sun)
    home = _home(options, place)
    seen = _with_distances(foggy_photo.seen(photo, options, home))
    read = time.monotonic()
    found = _searched(seen, home, options)
    objective, minimum, names = found.objective, found.minimum, found.objective.space.free
    drawn, strength = objective.picture(torch.from_numpy(minimum.point))
    scene = _lit(objective.space.scene(torch.from_numpy(minimum.point)), strength[0], options)
    solved = time.monotonic()
    left_out = found.pinned | {name: why for name, why in zip(names, found.known.why, strict=True) if why}
    held = partial(_unsearched, options=options, left_out=left_out, place=place)
    parameters = account.parameters(scene, objective.space, found.known, held)
    ended = account.Ended(scene, parameters, names, found.known, minimum)
    solution = Solution(
        **account.of_any(photo, seen.used, options, ended),
        effect="fog",
        notes=(*photo.notes, *seen.notes, *_notes(options)),
        sun=hidden_sun.place(place, parameters, names),
        gains=account.gains(scene),
        left_out=left_out,
        error=account.log_error(drawn, objective.pixels.radiance),
        seconds={"read": read - began, "solve": solved - read},
        versions=account.versions(),
    )
    return Aerial(solution, seen, objective)


def _notes(options: Options) -> list[str]:
    notes = ["aerial perspective is fitted to what has a distance alone, not to the sky"]
    if options.clear is None:
        notes.append("without --clear the air is hardly told from surfaces that grow paler with distance")
    return notes


@dataclass(frozen=True, eq=False)
class _Found:
    """Where a search has ended, and why of each name that it left at home."""

    objective: AerialObjective
    minimum: Minimum
    known: Uncertainty
    pinned: dict[str, str]


def _searched(seen: FoggyPhoto, home: Scene, options: Options) -> _Found:
    """The best point; what the photo leaves open goes to where it was at home, and the rest is searched again."""
    names = tuple(name for name in dict.fromkeys((*SEARCHED, *options.free)) if name not in options.fixed)
    if not names:
        raise InputError("nothing is left to search; give --free NAME or less of --fix")
    minimise, begun = solver(options.solver), time.monotonic()
    objective = _objective(seen, SearchSpace(home, names), options)

    def search(objective: AerialObjective, start: Point) -> Minimum:
        left = None if options.seconds is None else max(options.seconds - (time.monotonic() - begun), 0.0)
        return minimise(objective, start, Budget(seconds=left, seed=options.seed))

    minimum = search(objective, _start(objective, options))
    known = fog.known_of(objective, minimum.point)
    open_ones = selection.undetermined(dict(zip(names, known.why, strict=True)), overcast=None)
    pinned = {name: why for name, why in open_ones.items() if name not in (*options.free, DISTANCE)}
    if not pinned or len(pinned) == len(names) or minimum.reason == INTERRUPTED:
        return _Found(objective, minimum, known, {})
    kept = [index for index, name in enumerate(names) if name not in pinned]
    objective = replace(objective, space=SearchSpace(home, tuple(names[index] for index in kept)))
    minimum = search(objective, minimum.point[kept])
    return _Found(objective, minimum, fog.known_of(objective, minimum.point), pinned)


def draw(found: Aerial, scene: Scene) -> dict[str, Radiance]:
    """A photo as a scene's air explains it, and as it would be without that air; in float32, band by band.

    Without air it is NaN where less than 10 % come through; both are NaN for the sky and where no distance is known.
    """
    shape = found.photo.photo.radiance.shape
    fitted, bare = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    _, strength = found.objective.picture(torch.from_numpy(found.solution.minimum.point))
    perspective = scene.aerial_perspective
    assert perspective is not None  # such a fit's scene has one
    irradiance = (scene.exposure.exposure * scene.sun.irradiance).double()
    given = AerialPerspective(*(value.double() for value in vars(perspective).values()))
    distance = found.photo.distance
    assert distance is not None  # such a fit's photo has some
    for rows in bands(shape[0]):
        line, column = np.nonzero(np.isfinite(distance[rows]))
        if line.size:
            line = line + rows.start
            pixels = found.photo.at(line, column)
            seen = _seen(pixels, found.objective.space.start, irradiance, found.objective.seen.around)
            added = aerial_perspective.render_tables(given, TabledView(seen, found.objective.tables))
            white = replace(seen, background=torch.ones_like(added))
            through = aerial_perspective.render_tables(given, TabledView(white, found.objective.tables)) - added
            behind = strength[-1] if pixels.clear is None else pixels.clear
            fitted[line, column] = (added + through * behind).numpy()
            without = (pixels.radiance - added).clamp(min=0.0) / through
            bare[line, column] = torch.where(through > LEAST_SEEN, without, torch.nan).numpy()
    return {"fog": fitted, "without fog": bare}


def _home(options: Options, place: SunPlace) -> Scene:
    """Scene of what is not searched: given values, those of the weather file to start at, a clear day's air."""
    known = weather_names()
    for name in (*options.fixed, *options.free):
        if name not in known:
            check(name, 0.0)
        if name.startswith(TINT) or not name.startswith(PREFIX):
            raise InputError(f"{name} is not for --model aerial's --fix and --free; give one of {PREFIX}, but no tint")
    if not 0.0 <= options.eye_height <= HIGHEST_EYE:
        raise InputError(f"--eye-height {options.eye_height:g}; with --model aerial give 0 to {HIGHEST_EYE:,.0f} m")
    plain = Scene(defaults(Exposure), defaults(Sun), defaults(Sky), aerial_perspective=defaults(AerialPerspective))
    given = {} if options.start is None else keyframes.values(options.start)
    sun_now = {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    return keyframes.scene({**keyframes.values(plain), **given, **sun_now, **options.fixed}, torch.float64)


def _with_distances(seen: FoggyPhoto) -> FoggyPhoto:
    """A photo of which only what has a distance is used."""
    if seen.distance is None:
        raise InputError(f"{seen.photo.path} has no distances, which --model aerial needs; give --distance EXR")
    used = seen.used & np.isfinite(seen.distance)
    if (count := int(used.sum())) < LEAST_PIXELS:
        raise InputError(f"only {count} usable pixels have a distance, of at least {LEAST_PIXELS}; give another --mask")
    return replace(seen, used=used)


def _objective(seen: FoggyPhoto, space: SearchSpace, options: Options) -> AerialObjective:
    pixels, scale = seen.sample(fog.PIXELS, options.seed)
    given = space.start.exposure.exposure * space.start.sun.irradiance
    irradiance, horizon = (given, given) if options.start is not None else (torch.ones_like(given), 0.0 * given)
    bare = _seen(pixels, space.start, irradiance, torch.zeros(0, 0, 3, dtype=torch.float64))
    known = aerial_perspective.through(bare.air, bare.view, bare.length, bare.background)
    tables = aerial_perspective.prepare(defaults(AerialPerspective, torch.float64), known).tables
    return AerialObjective(space, pixels, scale, known, tables, horizon)


def _seen(pixels: FogPixels, home: Scene, irradiance: Tensor, around: Tensor) -> AerialView:
    """Black objects in the air of a scene at home."""
    assert home.sky is not None  # `_home` gives one
    direction = pixels.rays.direction
    view = SkyView(direction, to_sun(home.sun), irradiance, pixels.rays.origin[0, 2])
    return AerialView(view, pixels.rays.length, torch.zeros_like(direction), sky.medium(home.sky), around)


def _start(objective: AerialObjective, options: Options) -> Point:
    """The best of some distance scales; or where the weather file to start at has it."""
    space = objective.space
    begun = space.point(space.start)
    if DISTANCE not in space.free or (options.start is not None and options.start.aerial_perspective is not None):
        return begun
    specification, tried = places()[DISTANCE].specification, []
    for number in STARTS:
        point = begun.copy()
        point[space.free.index(DISTANCE)] = float(specification.to_unit(torch.tensor(number, dtype=torch.float64)))
        tried.append(point)
    best: Point = min(tried, key=lambda point: half_square(objective.residuals(torch.from_numpy(point))))
    return best


def _lit(scene: Scene, strength: Float[Tensor, "3"], options: Options) -> Scene:
    """Scene whose air is as bright as was found: by the middle ground's tint, or by the sun where it is open.

    Raises:
        InputError: when no tint makes the air of the given sun so bright.
    """
    perspective = scene.aerial_perspective
    assert perspective is not None  # a search space of the air has one
    if options.start is None:
        least = 1e-6 * strength.max().clamp(min=1e-6)  # of a channel that shows no air
        scene = account.exposed(scene, torch.maximum(strength, least))
        return replace(scene, aerial_perspective=replace(perspective, tint=torch.ones_like(strength)))
    most = specifications(AerialPerspective)["tint"].bounds[1]
    if float(strength.max()) > most:
        raise InputError(
            f"the photo's air is {float(strength.max()):.3g} times as bright as the given sun lights it, of {most:g} "
            "allowed; the weather file's EXPOSURE may be another photo's: give --with-sky, or no weather file"
        )
    return replace(scene, aerial_perspective=replace(perspective, tint=strength))


def _unsearched(name: str, options: Options, left_out: Mapping[str, str], place: SunPlace) -> str:
    if name in left_out:
        return left_out[name]
    if name in options.fixed:
        return "given"
    if name.startswith(TINT):
        return "default" if options.start is None else "closed form"
    if name.startswith(("EXPOSURE", "SUN_IRRADIANCE")):
        return "closed form" if options.start is None else "kept"
    if name.startswith("SUN_"):
        return place.how
    return "kept" if options.start is not None else "default"
