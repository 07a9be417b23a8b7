"""What a fit found, in the words of weather files: every parameter with its error, and a photo's gains as a sun."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.colour import luminance
from diffrender.parameters import specifications
from diffrender.scene import Scene, places, weather_names
from fit import keyframes
from fit.asked import Search
from fit.minimum import Minimum
from fit.photo import Photo
from fit.search_space import SearchSpace, value
from fit.solution import Fitted
from fit.uncertainty import Uncertainty

PACKAGES = ("diffrender", "torch", "numpy", "scipy", "nlopt")


@dataclass(frozen=True, eq=False)
class Ended:
    """Where a search has ended.

    Attributes:
        names: searched parameters, in the order of `known`, which may go on with coordinates that are none.
    """

    scene: Scene
    parameters: Mapping[str, Fitted]
    names: tuple[str, ...]
    known: Uncertainty
    minimum: Minimum


def of_any(photo: Photo, used: Bool[np.ndarray, "height width"], options: Search, ended: Ended) -> dict[str, Any]:
    """What every solution tells, by the names of its fields."""
    kept = [index for index, name in enumerate(ended.names) if ended.parameters[name].determined]
    return {
        "photo": photo.path.name,
        "camera": photo.camera,
        "scene": ended.scene,
        "parameters": ended.parameters,
        "correlated": tuple(ended.names[index] for index in kept),
        "correlation": ended.known.correlation[np.ix_(kept, kept)],
        "used": used,
        "pixels": {"used": int(used.sum()), "masked": used.size - int(used.sum()), **photo.counts()},
        "minimum": ended.minimum,
        "solver": options.solver,
        "seed": options.seed,
    }


def log_error(drawn: Float[Tensor, "n 3"], seen: Float[Tensor, "n 3"]) -> float:
    """Mean square difference of log radiance, where both are above 0."""
    difference = torch.log(drawn / seen)
    return float(difference[difference.isfinite()].square().mean())


def versions(*more: str) -> dict[str, str]:
    """Versions of the packages that every fit runs, and of more."""
    return {name: version(name) for name in (*PACKAGES, *more)}


def parameters(
    scene: Scene, space: SearchSpace, known: Uncertainty, unsearched: Callable[[str], str]
) -> Mapping[str, Fitted]:
    """Every parameter of a scene, in files' units; `unsearched` says why a name has the value that it has."""
    stands = places()
    found = {}
    for name, in_file in keyframes.values(scene).items():
        specification = stands[name].specification
        error, why = None, unsearched(name)
        if name in space.free:
            index = space.free.index(name)
            why = known.why[index] or "searched"
            if not known.why[index]:
                error = float(known.standard_error[index]) * _stretch(value(scene, stands[name]), name)
        found[name] = Fitted(
            value=in_file,
            unit=specification.file_unit,
            bounds=specification.file_bounds,
            standard_error=error,
            determined=error is not None or why == "closed form",
            why=why,
        )
    return found


def _stretch(now: Tensor, name: str) -> float:
    """Change of a value in its file's unit for one whole range of the unit cube."""
    specification = weather_names()[name]
    low, high = specification.bounds
    span = float(now) * float(np.log(high / low)) if specification.scale == "log" else high - low
    return abs(span * specification.file_factor)


def exposed(scene: Scene, gains: Float[Tensor, "3"]) -> Scene:
    """Scene whose exposure and sun share the gains: the sun keeps its own luminance and takes the colour."""
    plain = gains.new_tensor(specifications(type(scene.sun))["irradiance"].default)
    exposure = luminance(gains) / luminance(plain)
    return replace(
        scene,
        exposure=replace(scene.exposure, exposure=exposure),
        sun=replace(scene.sun, irradiance=gains / exposure),
    )


def gains(scene: Scene) -> tuple[float, float, float]:
    """Exposed irradiance of a scene's sun, by channel."""
    red, green, blue = (float(gain) for gain in scene.exposure.exposure * scene.sun.irradiance)
    return red, green, blue
