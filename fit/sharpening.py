"""`fit sharpening`: FXAA's thresholds and the sharpening of two-frame anti-aliasing, fitted to one HDR photo.

The photo stands for a scene several times as fine as the pictures; what is right is its mean over pixels. How much
sharpening that takes hangs on how the scene was sampled: points alias, and sharpening makes it worse; samples as wide
as a pixel, which is what mip-mapped textures give, have lost contrast that sharpening brings back.

Where the scene moves, the frame before is moved along, which blurs it, and what was hidden has no history: how far that
is trusted, AA_HISTORY_TOLERANCE, is searched then. At rest it does nothing and stays as it is.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool

from diffrender.antialiasing.settings import PREFIX, AntiAliasing
from diffrender.atmosphere.celestial import Sun
from diffrender.parameters import defaults
from diffrender.scene import Exposure, Scene, places, weather_names
from fit import account, keyframes, report, sampled_photo, sharpening_pictures, sky_mask
from fit import photo as photos
from fit.asked import Search
from fit.gauss_newton import half_square
from fit.input_error import InputError
from fit.minimum import INTERRUPTED, Budget, Minimum, Point
from fit.photo import Photo
from fit.picture import Drawn
from fit.sampled_photo import MARGIN, Sampling, Scenery, Views
from fit.search_space import SearchSpace
from fit.sharpening_objective import JUMPING, SharpeningObjective
from fit.sharpening_uncertainty import uncertainty
from fit.solution import Solution
from fit.solvers import solver
from fit.weather_file import check

TILES = 24  # that a fit looks at
COARSE_TILES = 8  # at which starts are compared
SEARCHED = (
    "AA_SHARPENING",
    "AA_CONTRAST_RESPONSE",
    "AA_EDGE_THRESHOLD",
    "AA_EDGE_THRESHOLD_MINIMUM",
    "AA_SUBPIXEL",
)
OF_MOTION = "AA_HISTORY_TOLERANCE"  # searched too where the scene moves
# Of starts: FXAA's thresholds from its author's finest to one that no edge reaches; responses; subpixel blends.
THRESHOLDS = (
    (0.063, 0.0312),
    (0.166, 0.0833),
    (0.4, 0.05),
    (0.55, 0.05),
    (0.7, 0.05),
    (0.55, 0.55),
    (0.7, 0.7),
    (1.0, 1.0),
)
RESPONSES, BLENDS = (0.0, 4.0), (0.0, 0.4, 0.8)
SAME = 1e-4  # change of the loss, relative, that is as good as none
TURNS = 4  # of the solver and of comparing thresholds, at most
STEPS = (0.2, 0.1, 0.05, 0.025, 0.0125)  # by which thresholds are moved and compared


@dataclass(frozen=True)
class Options(Search):
    """What may be asked of a fit of sharpening beside what may be asked of every fit.

    Attributes:
        sampling: how the photo is sampled.
        textures: picture whose white pixels are textures, with the footprint; others are points. None: all of it is.
    """

    sampling: Sampling = field(default_factory=Sampling)
    textures: Path | None = None


@dataclass(frozen=True, eq=False)
class Sharpened:
    """A solution, with what it takes to draw it."""

    solution: Solution
    scenery: Scenery
    views: Views

    def draw(self, scene: Scene) -> Drawn:
        """The whole photo by a scene's anti-aliasing and by what it is compared with."""
        return sharpening_pictures.draw(self.scenery, _settings(scene))

    def page(self, _drawn: Drawn) -> str:
        """HTML of the report."""
        settings = _settings(self.solution.scene)
        return report.gallery_page(self.solution, sharpening_pictures.crops(settings, self.scenery, self.views))


def fit(photo: Photo | Path, options: Options | None = None) -> Solution:
    """Scene whose anti-aliasing comes nearest to the photo's mean over pixels, and the account of the fit.

    Raises:
        InputError: when the photo, a file beside it or an option cannot be used; the message says what to do.
    """
    return solve(photo if isinstance(photo, Photo) else photos.read(photo), options or Options()).solution


def solve(photo: Photo, options: Options) -> Sharpened:
    """Solution of a fit, and what it takes to draw it.

    Raises:
        InputError: as `fit` does.
    """
    began = time.monotonic()
    solver(options.solver)  # refuses an unknown one before the photo is looked at
    space = search_space(options)
    scenery = sampled_photo.scenery(photo, options.sampling, _textures(photo, options))
    corners = sampled_photo.tiles(scenery, TILES)
    views = scenery.tiles(corners, torch.float64)
    read = time.monotonic()
    objective = SharpeningObjective(space, views)
    minimum = search(objective, options)
    scene = space.scene(torch.from_numpy(minimum.point))
    known = uncertainty(objective, minimum.point)
    parameters = account.parameters(scene, space, known, partial(_unsearched, options=options))
    used = sampled_photo.pixels(scenery, corners)
    ended = account.Ended(scene, parameters, space.free, known, minimum)
    solution = Solution(
        **account.of_any(photo, used, options, ended),
        effect="sharpening",
        notes=(*photo.notes, *_notes(scenery, options, len(corners))),
        sun=None,
        gains=account.gains(scene),
        left_out={name: why for name, why in zip(space.free, known.why, strict=True) if why},
        error=2.0 * half_square(objective.residuals(torch.from_numpy(minimum.point))),
        seconds={"read": read - began, "solve": time.monotonic() - read},
        versions=account.versions("scikit-image"),
        measure="what the screen is sent",
        scores=sharpening_pictures.scores(_settings(scene), views),
    )
    return Sharpened(solution, scenery, views)


def search_space(options: Options) -> SearchSpace:
    """What is searched, and the values of all else: given ones, those of the scene to start at, defaults.

    Raises:
        InputError: for a name that is not one of anti-aliasing.
    """
    known = weather_names()
    for name in (*options.fixed, *options.free):
        if name not in known:
            check(name, 0.0)
        if not name.startswith(f"{PREFIX}_"):
            raise InputError(f"{name} is not for a sharpening fit's --fix and --free; give one of {PREFIX}_")
    plain = Scene(defaults(Exposure), defaults(Sun), sky=None, antialiasing=defaults(AntiAliasing))
    given = {} if options.start is None else keyframes.values(options.start)
    home = keyframes.scene({**keyframes.values(plain), **given, **options.fixed}, torch.float64)
    of_motion = () if options.sampling.is_at_rest else (OF_MOTION,)
    names = dict.fromkeys((*SEARCHED, *of_motion, *options.free))
    return SearchSpace(home, tuple(name for name in names if name not in options.fixed))


def search(objective: SharpeningObjective, options: Options) -> Minimum:
    """Where the loss is lowest: the solver's place, and by turns the thresholds that are best beside it.

    The solver is given what the picture is smooth in. Thresholds make it jump, so pictures are compared. In the end a
    coordinate that does nothing where it stands goes to its value at home.
    """
    deadline = None if options.seconds is None else time.monotonic() + options.seconds
    whole, point = objective.space, _start(objective, options)
    jumping = [index for index, name in enumerate(whole.free) if name in JUMPING]
    history: list[float] = []
    for turn in range(TURNS):
        scene = whole.scene(torch.from_numpy(point))
        smooth = replace(objective, space=SearchSpace(scene, tuple(n for n in whole.free if n not in JUMPING)))
        seconds = None if deadline is None else max(deadline - time.monotonic(), 0.0)
        budget = Budget(seconds=seconds, seed=options.seed)
        minimum = solver(options.solver)(smooth, smooth.space.point(scene), budget)
        history += minimum.history
        point[[index for index in range(point.size) if index not in jumping]] = minimum.point
        if minimum.reason == INTERRUPTED or seconds == 0.0 or turn == TURNS - 1:
            break
        found, losses = _compared(objective, point, minimum.loss, jumping)
        history += losses
        if np.array_equal(found, point):
            break
        point = found
    if minimum.reason != INTERRUPTED:
        point = _home_again(objective, point, minimum.loss)
    is_late = deadline is not None and time.monotonic() > deadline
    return replace(
        minimum,
        # That the smooth part is settled says nothing of thresholds that there was no time to compare.
        converged=minimum.converged and not is_late,
        reason="seconds used up" if is_late and minimum.reason != INTERRUPTED else minimum.reason,
        point=point,
        loss=half_square(objective.residuals(torch.from_numpy(point))),
        history=tuple(history),
        evaluations=len(history),
    )


def _compared(
    objective: SharpeningObjective, point: Point, loss: float, jumping: Sequence[int]
) -> tuple[Point, list[float]]:
    """Best point among those reached by ever shorter steps along some axes, and the losses of all that were tried.

    Also along all of them together: where one threshold lets no edge through, the other alone does nothing.
    """
    best, losses = point, []
    for step in STEPS:
        for axes, way in product([*([index] for index in jumping), list(jumping)], (-1.0, 1.0)):
            tried = best.copy()
            tried[axes] = (best[axes] + way * step).clip(0.0, 1.0)
            losses.append(half_square(objective.residuals(torch.from_numpy(tried))))
            if losses[-1] < loss * (1.0 - SAME):
                best, loss = tried, losses[-1]
    return best, losses


def _home_again(objective: SharpeningObjective, point: Point, loss: float) -> Point:
    home = objective.space.point(objective.space.start)
    for index in range(point.size):
        back = point.copy()
        back[index] = home[index]
        if half_square(objective.residuals(torch.from_numpy(back))) <= loss * (1.0 + SAME):
            point = back
    return point


def _start(objective: SharpeningObjective, options: Options) -> Point:
    """Of several thresholds, responses and blends, each with its best lobes, those with the least loss."""
    begun = objective.space.point(objective.space.start)
    if options.start is not None and options.start.antialiasing is not None:
        return begun
    few = replace(objective, views=objective.views.first(COARSE_TILES))
    found = [_with_best_lobes(few, point) for point in _tried(objective.space, begun)]
    return min(found, key=lambda one: one[0])[1]


def _tried(space: SearchSpace, begun: Point) -> Iterator[Point]:
    seen = set()
    for (threshold, least), response, blend in product(THRESHOLDS, RESPONSES, BLENDS):
        point = begun.copy()
        for name, number in zip(SEARCHED[1:], (response, threshold, least, blend), strict=True):
            if name in space.free:
                unit = places()[name].specification.to_unit(torch.tensor(number, dtype=torch.float64))
                point[space.free.index(name)] = float(unit)
        if tuple(point) not in seen:
            seen.add(tuple(point))
            yield point


def _with_best_lobes(objective: SharpeningObjective, point: Point) -> tuple[float, Point]:
    """Loss and point with the sharpening that is best beside the other coordinates: pictures are linear in it."""
    names = objective.space.free
    if SEARCHED[0] not in names:
        return half_square(objective.residuals(torch.from_numpy(point))), point
    index = names.index(SEARCHED[0])
    ends = []
    for end in (0.0, 1.0):
        moved = point.copy()
        moved[index] = end
        ends.append(objective.residuals(torch.from_numpy(moved)))
    slope = ends[1] - ends[0]
    power = float(slope @ slope)
    best = point.copy()
    best[index] = min(max(-float(ends[0] @ slope) / power, 0.0), 1.0) if power > 0.0 else point[index]
    return half_square(ends[0] + best[index] * slope), best


# What was found


def _settings(scene: Scene) -> AntiAliasing:
    assert scene.antialiasing is not None  # a sharpening fit's scene has them
    return scene.antialiasing


def _textures(photo: Photo, options: Options) -> Bool[np.ndarray, "height width"] | None:
    return None if options.textures is None else sky_mask.read(options.textures, photo).used


def _unsearched(name: str, options: Options) -> str:
    if name in options.fixed:
        return "given"
    return "kept" if options.start is not None else "default"


def _notes(scenery: Scenery, options: Options, count: int) -> Iterator[str]:
    rows, columns = scenery.size
    sampling = options.sampling
    yield f"a scene {sampling.factor} times as fine as pictures of {columns} x {rows}, {count} tiles of it compared"
    where = "" if options.textures is None else f" where {options.textures.name} is white, points elsewhere"
    yield f"samples are means over {max(sampling.footprint, 1.0 / sampling.factor):g} pixels{where}"
    yield f"shown in {sampling.screen} after its radiance was multiplied by {scenery.exposure:.4g}"
    yield f"{MARGIN} pixels at the borders of tiles are not judged"
    if sampling.is_at_rest:
        yield f"the scene is at rest: {OF_MOTION} does nothing here and stays"
    else:
        right, down = sampling.motion
        yield f"the scene moves {right:g},{down:g} pixels a frame, in tiles behind a disc at rest"
