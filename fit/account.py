"""What a fit found, in the words of weather files: every parameter with its error, and a photo's gains as a sun."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from torch import Tensor

from diffrender.colour import luminance
from diffrender.parameters import specifications
from diffrender.scene import Scene, places, weather_names
from fit import keyframes
from fit.search_space import SearchSpace, value
from fit.solution import Fitted
from fit.uncertainty import Uncertainty


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
