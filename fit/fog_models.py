"""The names by which the command line knows what lies between the eye and what a photo shows."""

from collections.abc import Callable, Mapping
from functools import partial

from fit import aerial, fog, fog_picture
from fit.foggy_photo import Options
from fit.input_error import InputError
from fit.photo import Photo
from fit.results import Draw
from fit.solution import Solution

Solve = Callable[[Photo, Options], tuple[Solution, Draw]]


def _height(photo: Photo, options: Options) -> tuple[Solution, Draw]:
    found = fog.solve(photo, options)
    return found.solution, partial(fog_picture.draw, found)


def _aerial(photo: Photo, options: Options) -> tuple[Solution, Draw]:
    found = aerial.solve(photo, options)
    return found.solution, partial(aerial.draw, found)


MODELS: Mapping[str, Solve] = {"height": _height, "aerial": _aerial}


def model(name: str) -> Solve:
    """What solves for a model of a name, and draws what it has found: height or aerial.

    Raises:
        InputError: when there is none of that name.
    """
    if name not in MODELS:
        raise InputError(f"the model {name!r} does not exist; use {' or '.join(MODELS)}")
    return MODELS[name]
