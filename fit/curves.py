"""The curve of each parameter of a weather file over its day, for those who draw it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from diffrender.parameters import Specification
from diffrender.scene import weather_names
from fit import keyframes
from fit.weather_file import Weather


@dataclass(frozen=True)
class Curve:
    """A parameter over the hours of a day, in the file's unit.

    Attributes:
        keyframes: hours and values that the file holds.
        values: at the hours asked for.
    """

    name: str
    known: Specification
    keyframes: tuple[tuple[float, float], ...]
    values: tuple[float, ...]

    @property
    def unit(self) -> str:
        """Unit, empty for a plain number."""
        return "" if self.known.file_unit == "1" else self.known.file_unit

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest value; the bounds of a direction that passes them."""
        if any(self.jumps(*pair) for pair in pairwise(self.values)):
            return self.known.bounds
        every = [*self.values, *(value for _, value in self.keyframes)]
        return min(every), max(every)

    def place(self, value: float) -> float:
        """Place between the ends in the parameter's own scale: 0 at the lower, 1 at the higher; 1/2 on a flat curve."""
        low, high = self.ends
        if low == high:
            return 0.5
        if self.known.scale == "log":
            value, low, high = math.log(value), math.log(low), math.log(high)
        # Two numbers that are not the same may have the same logarithm.
        return (value - low) / (high - low) if low < high else 0.5

    def jumps(self, value: float, later: float) -> bool:
        """Whether a direction passes from one end of its circle to the other between two values."""
        return self.known.turn is not None and abs(later - value) > 0.5 * (self.known.bounds[1] - self.known.bounds[0])


def curves(weather: Weather, hours: Sequence[float]) -> list[Curve]:
    """Curve of every parameter that has a keyframe."""
    known = weather_names()
    return [
        Curve(
            name,
            known[name].in_file_unit(),
            tuple((hour, v) for hour, v in zip(weather.hours, weather.values[name], strict=True) if v is not None),
            tuple(values),
        )
        for name, values in keyframes.over(weather, hours).items()
    ]
