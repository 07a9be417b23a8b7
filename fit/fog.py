"""`fit fog`: height fog fitted to one HDR photo whose distances are known.

The strengths of all lights are solved in closed form: that of the sun in the fog, that of the even sky in it, and where
the picture without fog is not known that of surfaces and of the sky behind, alike in all of the picture. Searched are
density, colour and height of the fog, its phase function, and how the light on surfaces changes.

Without distances only the sky is looked at, near the horizon, and only the fog's whole column can be told.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.celestial import Sun
from diffrender.atmosphere.height_fog import HeightFog
from diffrender.parameters import defaults, specifications
from diffrender.scene import Exposure, Scene, places, skylight, weather_names
from fit import account, foggy_photo, hidden_sun, keyframes, residual_covariance, selection, sun
from fit import photo as photos
from fit.fog_objective import FogObjective, FogPixels, Lights
from fit.foggy_photo import FoggyPhoto, Options
from fit.gauss_newton import half_square
from fit.input_error import InputError
from fit.minimum import INTERRUPTED, Budget, Minimum, Point
from fit.photo import Photo
from fit.search_space import SearchSpace
from fit.shot import Shot
from fit.solution import Solution, SunPlace
from fit.solvers import solver
from fit.uncertainty import Evidence, Uncertainty, uncertainty
from fit.weather_file import check

__all__ = ["Fogged", "Options", "fit", "solve", "sun_of"]

COARSE_PIXELS = 500  # at which starts are compared
PIXELS = 4000  # of a search
# At its end: in four of five path-traced scenes densities are off by 0.7 % at most, where 4000 left 1.7 %.
FINE_PIXELS = 16_000
STARTS = tuple(product((1e-4, 1e-3, 1e-2), (15.0, 60.0, 240.0)))  # extinction [1/m] and scale height [m]
# Variance of what is wider than a pixel, over what the residuals show of it. It is light scattered twice and shadows in
# the fog, which the model does not have and its parameters hide: five path-traced scenes ask for it.
MISFIT = 50.0
BY_CHANCE = 4.0  # standard deviations of noise that residuals may be alike by, beyond which the model is off
DIMMEST_SUN = 0.2  # irradiance of a sun that is not seen, over the sky's radiance or the picture's

# The tints' common factor is the extinction's, and with the base height exactly so; both stay where they are.
SEARCHED = (
    "HEIGHT_FOG_EXTINCTION",
    "HEIGHT_FOG_SCALE_HEIGHT",
    "HEIGHT_FOG_EXTINCTION_TINT_R",
    "HEIGHT_FOG_EXTINCTION_TINT_B",
    "HEIGHT_FOG_ASYMMETRY",
    "HEIGHT_FOG_RAYLEIGH_SHARE_R",
    "HEIGHT_FOG_RAYLEIGH_SHARE_G",
    "HEIGHT_FOG_RAYLEIGH_SHARE_B",
)
DENSITY = "HEIGHT_FOG_EXTINCTION"  # searched even where it is not determined: without it there is no fog
SEARCHED_IN_THE_SKY = (DENSITY,)
IN_CLOSED_FORM = ("HEIGHT_FOG_SUN_TINT", "HEIGHT_FOG_AMBIENT_TINT")
SURFACES = "light on surfaces"  # the one coordinate of a search that is no parameter


def fit(photo: Photo | Path, options: Options | None = None) -> Solution:
    """Scene whose fog looks like the photo's, and the account of the fit.

    Raises:
        InputError: when the photo, a file beside it or an option cannot be used; the message says what to do.
    """
    return solve(photo if isinstance(photo, Photo) else photos.read(photo), options or Options()).solution


@dataclass(frozen=True, eq=False)
class Fogged:
    """A solution, with what it takes to draw it."""

    solution: Solution
    seen: FoggyPhoto
    objective: FogObjective


def under(own: Solution, sky: Solution) -> Solution:
    """A solution with the account of the sky that was fitted to the photo first."""
    minimum = sky.minimum
    ended = f"mean square error of log radiance {sky.error:.4g}, {'converged' if minimum.converged else minimum.reason}"
    of_sky = {"kept", place.how} if (place := sky.sun) else {"kept"}
    parameters = {
        name: sky.parameters[name] if name in sky.parameters and found.why in of_sky else found
        for name, found in own.parameters.items()
    }
    return replace(own, parameters=parameters, notes=(*own.notes, f"the sky was fitted first: {ended}"))


def solve(photo: Photo, options: Options) -> Fogged:
    """Solution of a fit, and what it takes to draw it.

    Raises:
        InputError: as `fit` does.
    """
    began = time.monotonic()
    minimise = solver(options.solver)
    place, guessed = sun_of(photo, options.sun)
    home = _home(options, place)
    seen = foggy_photo.seen(photo, options, home)
    read = time.monotonic()
    space = _space(options, home, (*(SEARCHED if seen.distance is not None else SEARCHED_IN_THE_SKY), *guessed))
    objective = seen.objective(space, PIXELS, options.seed)
    start = _start(seen.objective(space, COARSE_PIXELS, options.seed), options)

    def search(objective: FogObjective, start: Point) -> Minimum:
        left = None if options.seconds is None else max(options.seconds - (time.monotonic() - read), 0.0)
        return minimise(objective, start, Budget(seconds=left, seed=options.seed))

    minimum = search(objective, start)
    known = known_of(objective, minimum.point)
    open_ones = selection.undetermined(dict(zip(space.free, known.why, strict=False)), overcast=None)
    pinned = {name: why for name, why in open_ones.items() if name not in (*options.free, DENSITY)}
    if pinned and len(pinned) < len(minimum.point) and minimum.reason != INTERRUPTED:
        # What the photo leaves open goes to where it was at home, and the rest, if there is one, is searched again.
        kept = [index for index, name in enumerate(space.free) if name not in pinned]
        kept += list(range(len(space.free), len(minimum.point)))
        space = SearchSpace(home, tuple(name for name in space.free if name not in pinned))
        objective = replace(objective, space=space)
        minimum = search(objective, minimum.point[kept])
    else:
        pinned = {}
    if minimum.reason != INTERRUPTED:
        objective = seen.objective(space, FINE_PIXELS, options.seed)
        minimum = search(objective, minimum.point)
    known = known_of(objective, minimum.point)
    point = torch.from_numpy(minimum.point)
    lights = objective.lights(point)
    scene = _lit(home, space.scene(point[: len(space.free)]), lights)
    solved = time.monotonic()
    left_out = pinned | {name: why for name, why in zip((*space.free, SURFACES), known.why, strict=False) if why}
    held = partial(_unsearched, options=options, left_out=left_out, place=place)
    parameters = account.parameters(scene, space, known, held)
    ended = account.Ended(scene, parameters, space.free, known, minimum)
    solution = Solution(
        **account.of_any(photo, seen.used, options, ended),
        effect="fog",
        notes=(*photo.notes, *seen.notes, *_degeneracies(options)),
        sun=hidden_sun.place(place, parameters, space.free),
        gains=account.gains(scene),
        left_out=left_out,
        error=account.log_error(lights.picture(), objective.pixels.radiance),
        seconds={"read": read - began, "solve": solved - read},
        versions=account.versions(),
    )
    return Fogged(solution, seen, objective)


# What is searched


def sun_of(photo: Photo, given: SunPlace | None) -> tuple[SunPlace, tuple[str, ...]]:
    """Where the sun of a photo stands, and which names of that are a guess and to be searched.

    A photo's header may tell its height by place and time, but not where the picture looks.
    """
    if given is not None:
        return sun.checked(photo, given), ()
    found = sun.find(photo)
    if found.visible:
        return found, ()
    computed = Shot(heading=0.0).sun_by(photo.header)
    if computed is None:
        return found, hidden_sun.NAMES
    how = "no disc seen; as high as at the header's place and time, towards the brightest part of the sky"
    return replace(found, elevation=computed.elevation, how=how), ("SUN_AZIMUTH",)


def _home(options: Options, place: SunPlace) -> Scene:
    """Scene of what is not searched: given values, those of the weather file to start at, defaults."""
    known = weather_names()
    for name in (*options.fixed, *options.free):
        if name not in known:
            check(name, 0.0)
        if name.startswith(IN_CLOSED_FORM) or not name.startswith(("HEIGHT_FOG_", "SUN_ELEVATION", "SUN_AZIMUTH")):
            raise InputError(f"{name} is not for a fog fit's --fix and --free; give one of HEIGHT_FOG_, but no tint")
        if name.startswith("SUN_") and name in options.fixed:
            raise InputError(f"--fix {name}; give the sun's place by --sun ELEVATION,AZIMUTH")
    plain = Scene(defaults(Exposure), defaults(Sun), sky=None, height_fog=defaults(HeightFog))
    given = {} if options.start is None else keyframes.values(options.start)
    sun_now = {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    return keyframes.scene({**keyframes.values(plain), **given, **sun_now, **options.fixed}, torch.float64)


def _space(options: Options, home: Scene, searched: tuple[str, ...]) -> SearchSpace:
    names = tuple(name for name in dict.fromkeys((*searched, *options.free)) if name not in options.fixed)
    if not names:
        raise InputError("nothing is left to search; give --distance, --free NAME or less of --fix")
    return SearchSpace(home, names)


def _start(objective: FogObjective, options: Options) -> Point:
    """Of densities and heights of fog, the best; or where the weather file to start at has it."""
    space = objective.space
    begun = np.append(space.point(space.start), [0.5] * objective.extra)
    if options.start is not None and options.start.height_fog is not None:
        return begun
    known = places()
    tried = []
    for extinction, scale_height in STARTS:
        point = begun.copy()
        for name, number in (("HEIGHT_FOG_EXTINCTION", extinction), ("HEIGHT_FOG_SCALE_HEIGHT", scale_height)):
            if name in space.free:
                unit = known[name].specification.to_unit(torch.tensor(number, dtype=torch.float64))
                point[space.free.index(name)] = float(unit)
        tried.append(point)
    best: Point = min(tried, key=lambda point: half_square(objective.residuals(torch.from_numpy(point))))
    return best


# What was found


class Compared(Protocol):
    """An objective whose first residuals are differences of some pixels."""

    @property
    def pixels(self) -> FogPixels:
        """Those that are compared."""

    def jacobian(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, " m"], Float[Tensor, "m n"]]:
        """Residuals and their derivatives by each coordinate."""


def known_of(objective: Compared, point: Point) -> Uncertainty:
    """How well each coordinate of a point is known."""
    residuals, slopes = objective.jacobian(torch.from_numpy(point))
    shape = tuple(objective.pixels.radiance.shape)
    count = objective.pixels.radiance.numel()
    direction, left = objective.pixels.rays.direction.numpy(), residuals[:count].reshape(shape).numpy()
    # Surfaces of one brightness are never the truth.
    is_off = objective.pixels.clear is None or residual_covariance.excess(direction, left) > BY_CHANCE
    return uncertainty(
        Evidence(
            direction=direction,
            residuals=left,
            slopes=slopes[:count].reshape(*shape, point.size).numpy(),
            changes=np.zeros((0, *shape)),
            spread=np.ones(point.size),
            wide_weight=MISFIT if is_off else 1.0,
        ),
        point,
    )


def _lit(home: Scene, scene: Scene, lights: Lights) -> Scene:
    """Scene whose sun and sky light the fog as strongly as was found.

    Where no weather file tells how bright the sun is, the sun takes its strength; else the fog's tints do.

    Raises:
        InputError: when no tint makes the given sky so bright.
    """
    assert scene.height_fog is not None
    fog = scene.height_fog
    of_sun, of_sky = lights.strength[0] / fog.albedo, lights.ambient() / fog.albedo
    if home.sky is None:
        # Behind thick fog no sun is seen; then a dim one stands for it.
        brightest = torch.maximum(of_sky.max(), lights.picture().mean())
        irradiance = torch.maximum(of_sun, DIMMEST_SUN * brightest * torch.ones_like(of_sun))
        scene = account.exposed(scene, irradiance)
        fog = replace(fog, sun_tint=of_sun / irradiance)
    else:
        fog = replace(fog, sun_tint=of_sun / (scene.exposure.exposure * scene.sun.irradiance))
    fog = replace(fog, ambient_tint=of_sky / skylight(scene))
    needed = float(torch.cat([fog.sun_tint, fog.ambient_tint]).max())
    most = specifications(HeightFog)["sun_tint"].bounds[1]
    if needed > most:
        raise InputError(
            f"the photo's fog is lit {needed:.3g} times as strongly as the given sky lights it, of {most:g} allowed; "
            "the weather file's EXPOSURE may be another photo's: give --with-sky, or no sky at all"
        )
    return replace(scene, height_fog=fog)


def _unsearched(name: str, options: Options, left_out: Mapping[str, str], place: SunPlace) -> str:
    if name in left_out:
        return left_out[name]
    if name in options.fixed:
        return "given"
    if name.startswith(IN_CLOSED_FORM):
        return "closed form"
    if name.startswith(("EXPOSURE", "SUN_IRRADIANCE")):
        return "closed form" if options.start is None else "kept"
    if name.startswith("SUN_"):
        return place.how
    return "kept" if options.start is not None else "default"


def _degeneracies(options: Options) -> list[str]:
    notes = ["albedo and light are seen as their product: the albedo stays, the lights take the rest"]
    if "HEIGHT_FOG_BASE_HEIGHT" not in options.free:
        notes.append("base height and extinction are seen as one density: the base height stays")
    return notes
