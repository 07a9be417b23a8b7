"""A weather file as one self-contained HTML page: its table, and a plot of each parameter over the day."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from fit import page as pages
from fit.curves import Curve, curves
from fit.report import number
from fit.weather_file import Weather

STEPS = 288  # of five minutes
WIDTH, HEIGHT = 420.0, 120.0  # of a plot


@dataclass(frozen=True)
class _Plot:
    curve: Curve
    scale: str
    low: str
    high: str
    path: str
    dots: list[tuple[float, float, str]]  # right, down, what it is


def write(path: Path, name: str, weather: Weather) -> None:
    """Write the page of a weather file with a name.

    Raises:
        InputError: for a path that is no HTML file's, or cannot be written.
    """
    pages.write(path, page(name, weather))


def page(name: str, weather: Weather) -> str:
    """HTML of the page: needs no other file and no network."""
    hours = sorted({24.0 * step / STEPS for step in range(STEPS + 1)} | set(weather.hours))
    return pages.template("weather.html").render(
        name=name,
        weather=weather,
        number=number,
        size=(WIDTH, HEIGHT),
        plots=[_plot(curve, hours) for curve in curves(weather, hours)],
    )


def _plot(curve: Curve, hours: list[float]) -> _Plot:
    low, high = curve.ends
    dots = [(*_point(curve, hour, value), f"{hour:g} h: {number(value, 4)}") for hour, value in curve.keyframes]
    return _Plot(
        curve=curve,
        scale={"log": "logarithmic"}.get(curve.known.scale, ""),
        low="" if low == high else number(low, 4),
        high=number(high, 4),
        path=_path(curve, hours),
        dots=dots,
    )


def _path(curve: Curve, hours: list[float]) -> str:
    points = ["{:.2f},{:.2f}".format(*_point(curve, *pair)) for pair in zip(hours, curve.values, strict=True)]
    pens = ["L" if not curve.jumps(*pair) else "M" for pair in pairwise(curve.values)]
    return " ".join(pen + point for pen, point in zip(["M", *pens], points, strict=True))


def _point(curve: Curve, hour: float, value: float) -> tuple[float, float]:
    return hour / 24.0 * WIDTH, (1.0 - curve.place(value)) * HEIGHT
