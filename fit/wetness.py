"""`fit wetness`: how wet the ground is, from two pictures of it, dry and wet.

Where the sun stands, how the ground lies and what it reflects are not asked: only how much darker it is. Ground that is
soaked keeps a share of its colour, and that share is the product of how wet it is and of how dark soaked ground gets;
so the wetness is searched, at the darkness of a weather file or the usual one, and where the wetness is given by --fix
the darkness. All ground is taken to be porous: of a road with smooth stones in it the wetness comes out too low. What
the wet ground reflects beside is one light by channel, found in closed form and told, but no parameter.

A mask says where it is wet. What lies outside has stayed dry, and tells how the light has changed.
"""

import math
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.atmosphere.celestial import Sun
from diffrender.parameters import defaults
from diffrender.scene import Exposure, Scene, weather_names
from diffrender.shading.wet_surface import Wetness
from diffrender.shading.wetness import EFFECT, kept
from fit import account, keyframes, sky_mask
from fit import photo as photos
from fit.asked import Search
from fit.exr import bands
from fit.gauss_newton import half_square
from fit.input_error import InputError
from fit.minimum import Budget
from fit.photo import Photo
from fit.picture import Drawn
from fit.pixels import usable
from fit.search_space import SearchSpace
from fit.solution import Solution
from fit.solvers import solver
from fit.weather_file import check
from fit.wetness_objective import Pairs, WetObjective, parts, uncertainty

AMOUNT, DARKNESS = "WETNESS_AMOUNT", "WETNESS_SOAKED_ALBEDO"
LONGEST = 256  # boxes along the longer side, over which pictures are averaged: no two shots meet to the pixel
LEAST_BOXES = 100  # that are used
BLACK = 1e-3  # of a channel's median, below which dry ground shows nothing


@dataclass(frozen=True)
class Options(Search):
    """What may be asked of a fit of wetness beside what may be asked of every fit.

    Attributes:
        mask: picture whose white pixels got wet, and whose others stayed dry. None: all of it got wet.
    """

    mask: Path | None = None


@dataclass(frozen=True, eq=False)
class Wetted:
    """A solution, with what it takes to draw it."""

    solution: Solution
    dry: Photo
    is_wet: Bool[np.ndarray, "height width"]
    light: Float[Tensor, "3"]
    added: Float[Tensor, "3"]

    def draw(self, scene: Scene) -> Drawn:
        """The dry picture made wet by a scene, in the light of the wet one, and that light alone; in float32."""
        assert scene.wetness is not None  # a fit of wetness has one
        one = torch.ones_like(scene.wetness.amount)
        share = float(kept(scene.wetness, one, scene.wetness.amount))
        light, added = (tensor.numpy().astype(np.float32) for tensor in (self.light, self.added))
        dry = np.empty(self.dry.radiance.shape, np.float32)
        wet = np.empty_like(dry)
        for rows in bands(len(dry)):
            dry[rows] = self.dry.band(rows).numpy() * light
            wet[rows] = np.where(self.is_wet[rows][..., None], dry[rows] * np.float32(share) + added, dry[rows])
        return {"wet": wet, "dry": dry}


def fit(dry: Photo | Path, wet: Photo | Path, options: Options | None = None) -> Solution:
    """Scene whose wetness makes the dry picture look like the wet one, and the account of the fit.

    Raises:
        InputError: when a picture, the mask or an option cannot be used; the message says what to do.
    """
    before, after = (one if isinstance(one, Photo) else photos.read(one) for one in (dry, wet))
    return solve(before, after, options or Options()).solution


def solve(dry: Photo, wet: Photo, options: Options) -> Wetted:
    """Solution of a fit, and what it takes to draw it.

    Raises:
        InputError: as `fit` does.
    """
    began = time.monotonic()
    minimise = solver(options.solver)  # refuses an unknown one before the pictures are looked at
    space = search_space(options)
    is_wet, notes = _mask(dry, wet, options)
    used = usable(wet, is_wet) & usable(dry, is_wet)
    objective = WetObjective(space, _got_wet(dry, wet, used), _stayed_dry(dry, wet, is_wet))
    read = time.monotonic()
    minimum = minimise(objective, space.point(space.start), Budget(seconds=options.seconds, seed=options.seed))
    point = torch.from_numpy(minimum.point)
    scene, known = space.scene(point), uncertainty(objective, minimum.point)
    drawn, added = objective.picture(point)
    parameters = account.parameters(scene, space, known, partial(_unsearched, options=options))
    share, light = float(objective.share(point)), objective.light
    ours = 2.0 * half_square(objective.residuals(point)[: objective.wet.wet.numel()])
    ended = account.Ended(scene, parameters, space.free, known, minimum)
    solution = Solution(
        **account.of_any(wet, used, options, ended),
        effect="wetness",
        notes=(*wet.notes, *notes, *_notes(objective, share, added)),
        sun=None,
        gains=(float(light[0]), float(light[1]), float(light[2])),
        left_out={name: why for name, why in zip(space.free, known.why, strict=True) if why},
        error=account.log_error(drawn, objective.wet.wet),
        seconds={"read": read - began, "solve": time.monotonic() - read},
        versions=account.versions(),
        scores={
            "soaked ground, one share": {"mean square": ours, "colour kept": share},
            "by optics (Lekner and Dorf)": objective.by_optics(),
        },
    )
    return Wetted(solution, dry, is_wet, light, added)


def search_space(options: Options) -> SearchSpace:
    """What is searched, and the values of all else: given ones, those of the scene to start at, defaults.

    Raises:
        InputError: for a name that is not one of wetness, or where nothing is left to search.
    """
    known = weather_names()
    for name in (*options.fixed, *options.free):
        if name not in known:
            check(name, 0.0)
        if not name.startswith(f"{EFFECT.prefix}_"):
            raise InputError(f"{name} is not for a wetness fit's --fix and --free; give one of {EFFECT.prefix}_")
    plain = Scene(defaults(Exposure), defaults(Sun), sky=None, wetness=defaults(Wetness))
    given = {} if options.start is None else keyframes.values(options.start)
    home = keyframes.scene({**keyframes.values(plain), **given, **options.fixed}, torch.float64)
    searched = (DARKNESS,) if AMOUNT in options.fixed else (AMOUNT,)
    names = tuple(name for name in dict.fromkeys((*searched, *options.free)) if name not in options.fixed)
    if not names:
        raise InputError(f"nothing is left to search; leave {AMOUNT} or {DARKNESS} out of --fix")
    return SearchSpace(home, names)


# What the pictures show


def _mask(dry: Photo, wet: Photo, options: Options) -> tuple[Bool[np.ndarray, "height width"], list[str]]:
    sizes = [f"{one.camera.width} x {one.camera.height}" for one in (dry, wet)]
    if sizes[0] != sizes[1]:
        raise InputError(f"{dry.path} is {sizes[0]}, but {wet.path} is {sizes[1]}; give the same view")
    if options.mask is None:
        return np.ones((wet.camera.height, wet.camera.width), bool), ["all of the picture is taken to be wet"]
    painted = sky_mask.read(options.mask, wet)
    return painted.used, [painted.how]


def _got_wet(dry: Photo, wet: Photo, used: Bool[np.ndarray, "height width"]) -> Pairs:
    found = _pairs(dry, wet, used)
    if (count := len(found.part)) < LEAST_BOXES:
        raise InputError(
            f"only {count} boxes of {_side(used)} pixels are usable, of at least {LEAST_BOXES}: finite and not black "
            f"in {dry.path} and {wet.path}; give a larger --mask or larger pictures"
        )
    return found


def _stayed_dry(dry: Photo, wet: Photo, is_wet: Bool[np.ndarray, "height width"]) -> Pairs | None:
    """What lies outside the mask; None where that is too little to tell of the light."""
    found = _pairs(dry, wet, usable(wet, ~is_wet) & usable(dry, ~is_wet))
    return found if len(found.part) >= LEAST_BOXES else None


def _pairs(dry: Photo, wet: Photo, used: Bool[np.ndarray, "height width"]) -> Pairs:
    """Means of both pictures over boxes that are used as a whole and are not black when dry."""
    side = _side(used)
    inside = _boxes(used[..., None].astype(np.float32), side)[..., 0] == 1.0
    before, after = (_boxes(one.radiance, side) for one in (dry, wet))
    if inside.any():
        inside &= (before > BLACK * np.median(before[inside], 0)).all(-1)
    line, column = np.nonzero(inside)
    was, became = (torch.from_numpy(one[line, column]).double() for one in (before, after))
    return Pairs(was, became, parts(line, column))


def _side(used: Bool[np.ndarray, "height width"]) -> int:
    longer: int = max(used.shape)
    return math.ceil(longer / LONGEST)


def _boxes(whole: np.ndarray, side: int) -> Float[np.ndarray, "rows columns channels"]:
    """Means over square boxes, in single precision; rows and columns that fill no box are left out."""
    high, wide = whole.shape[0] // side, whole.shape[1] // side
    means = np.empty((high, wide, whole.shape[2]), np.float32)
    for rows in bands(high):
        lines = whole[rows.start * side : rows.stop * side, : wide * side].astype(np.float32)
        with np.errstate(all="ignore"):  # of pixels that no one uses
            means[rows] = lines.reshape(-1, side, wide, side, whole.shape[2]).mean((1, 3))
    return means


# What was found


def _unsearched(name: str, options: Options) -> str:
    if name in options.fixed:
        return "given"
    return "kept" if options.start is not None else "default"


def _notes(objective: WetObjective, share: float, added: Float[Tensor, "3"]) -> list[str]:
    red, green, blue = (float(channel) for channel in objective.light)
    told = (
        "the light is taken to be the same in both: nothing outside the mask tells of it"
        if objective.dry is None
        else f"the wet picture's light is {red:.3g}, {green:.3g}, {blue:.3g} times the dry one's, by what stayed dry"
    )
    shone = ", ".join(f"{float(channel):.3g}" for channel in added)
    return [
        told,
        f"wet ground keeps {share:.3g} of its colour and reflects {shone} more, alike in all of it",
        f"{AMOUNT} and {DARKNESS} are seen as one product: one is searched, the other stays",
        "puddles, rings, rivulets and times are not looked at: they stay",
    ]
