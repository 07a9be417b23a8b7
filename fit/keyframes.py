"""What the keyframes of a weather file say: its values at an hour, and the scene that they describe.

Numbers are in the files' units; a scene is in the library's.
"""

import math
from collections.abc import Mapping, Sequence
from types import NoneType
from typing import Any, get_args, get_type_hints

import torch

from diffrender.parameters import Specification, names, specifications
from diffrender.scene import RECORDS, Scene, weather_names
from diffrender.weather.timeline import DAY, between
from fit.input_error import InputError
from fit.weather_file import Weather, check


def at(weather: Weather, hour: float) -> dict[str, float]:
    """Values at an hour, for every name that has a keyframe; the day is cyclic, so 25 is 1.

    Monotone between keyframes, in the parameter's own scale: a log parameter in its logarithm, a whole circle the
    shorter way round. Exactly the keyframe's value at its hour.

    Raises:
        InputError: for an hour that is not finite.
    """
    if not math.isfinite(hour):
        raise InputError(f"hour {hour}; give hours of the day such as 18.5")
    time = hour % DAY % DAY  # twice, because -1e-20 % 24 is 24
    found = {name: values[0] for name, values in over(weather, [time]).items()}
    if time in weather.hours:
        # The sign of a zero is lost in between.
        cells = {name: row[weather.hours.index(time)] for name, row in weather.values.items()}
        found |= {name: cell for name, cell in cells.items() if cell is not None}
    return found


def over(weather: Weather, hours: Sequence[float]) -> dict[str, list[float]]:
    """Values at many hours, for every name that has a keyframe; a keyframe's zero may lose its sign."""
    known = weather_names()
    asked = torch.tensor(hours, dtype=torch.float64)
    found = {}
    for name, cells in weather.values.items():
        keyframes = [(there, cell) for there, cell in zip(weather.hours, cells, strict=True) if cell is not None]
        if keyframes:
            times, values = torch.tensor(keyframes, dtype=torch.float64).unbind(-1)
            found[name] = between(times, values, asked, known[name].in_file_unit()).tolist()
    return found


def scene(values: Mapping[str, float], dtype: torch.dtype = torch.float32) -> Scene:
    """Scene of values in files' units, converted in double precision; what has no value takes its default.

    An effect that a scene may lack is None unless a name of it has a value.

    Raises:
        InputError: for an unknown name or a value outside its bounds.
    """
    for name, value in values.items():
        check(name, value)
    parts: dict[str, Any] = {}
    for part, (prefix, kind, may_lack) in _parts().items():
        places = names(kind, prefix)
        given = {places[name]: value for name, value in values.items() if name in places}
        parts[part] = None if may_lack and not given else _record(kind, given, dtype)
    return Scene(**parts)


def values(scene: Scene) -> dict[str, float]:
    """Every value of a scene, in files' units.

    With the fewest digits whose way back through `scene` gives the same number; in float64, for parameters with a unit
    of their own in files, sometimes its neighbour. Zero loses its sign.
    """
    found = {}
    for part, (prefix, kind, _) in _parts().items():
        record = getattr(scene, part)
        if record is None:
            continue
        known = specifications(kind)
        for name, (field, channel) in names(kind, prefix).items():
            tensor = getattr(record, field).detach()
            found[name] = _in_file(tensor if channel is None else tensor[channel], known[field])
    return found


def _parts() -> dict[str, tuple[str, type[Any], bool]]:
    """Prefix and type of each record of a scene by its field, and whether a scene may lack it."""
    prefixes = {kind: prefix for prefix, kind in RECORDS.items()}
    parts = {}
    for part, hint in get_type_hints(Scene).items():
        kinds = get_args(hint) or (hint,)
        kind = next(one for one in kinds if one is not NoneType)
        parts[part] = prefixes[kind], kind, NoneType in kinds
    return parts


def _record(kind: type[Any], given: Mapping[tuple[str, int | None], float], dtype: torch.dtype) -> Any:
    """Record from values by field and channel."""
    tensors = {}
    for field, known in specifications(kind).items():
        number: float | list[float]
        if isinstance(known.default, tuple):
            number = [
                _from_file(given[field, channel], known) if (field, channel) in given else default
                for channel, default in enumerate(known.default)
            ]
        else:
            number = _from_file(given[field, None], known) if (field, None) in given else known.default
        tensors[field] = torch.tensor(number, dtype=dtype)
    return kind(**tensors)


def _from_file(value: float, known: Specification) -> float:
    low, high = known.bounds
    return min(max(value / known.file_factor, low), high)  # rounding may have left the bounds


def _in_file(number: torch.Tensor, known: Specification) -> float:
    exact = float(number) * known.file_factor
    low, high = known.file_bounds
    for digits in range(17):
        # Within the bounds, because float32 rounds some of them outwards.
        value = min(max(float(f"{exact:.{digits}e}"), low), high) + 0.0
        if number == torch.tensor(_from_file(value, known), dtype=number.dtype):
            return value
    return exact
