"""The report of a day: curves with every photo's own estimate, how their strengths were chosen, and the photos.

Made from nothing but the account that day.json holds.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from diffrender.parameters import Specification
from diffrender.scene import weather_names
from fit.page import template
from fit.report import measured, number

WIDTH, HEIGHT = 440.0, 150.0  # of a plot's inside
MARGIN = 0.08  # of a plot's height above and below what it shows
CLEAREST = 1e-3  # of the bounds: no plot shows less, so that a constant is a level line


def page(account: Mapping[str, Any]) -> str:
    """HTML of the report: needs no other file and no network, and shows whatever text a file's name holds as text."""
    photos = account["photos"]
    return template("day_report.html").render(
        account=account,
        photos=photos,
        used=[photo for photo in photos if photo["refused"] is None],
        plots=[_plot(name, curve, photos) for name, curve in account["curves"].items()],
        scores={part: _scores(found) for part, found in account["cross_validation"].items()},
        number=number,
        measured=measured,
        percent=_percent,
        clock=_clock,
        width=WIDTH,
        height=HEIGHT,
    )


def _percent(error: float) -> str:
    return f"{100.0 * math.sqrt(error):.2g} %"


def _clock(hour: float) -> str:
    minutes = round(60.0 * hour)
    return f"{minutes // 60 % 24:02d}:{minutes % 60:02d}"


def _plot(name: str, curve: Mapping[str, Any], photos: Sequence[Mapping[str, Any]]) -> dict[str, object]:
    """Paths and places of one parameter's plot."""
    specification = weather_names()[name]
    dots = [
        (photo["hour"], photo["parameters"][name], photo["weight"])
        for photo in photos
        if name in photo.get("parameters", {})
    ]
    low, high = _reach([*curve["low"], *curve["high"], *(value["value"] for _, value, _ in dots)], specification)

    def x(hour: float) -> float:
        return round(WIDTH * hour / 24.0, 1)

    def y(value: float) -> float:
        share = (_scaled(value, specification) - low) / (high - low)
        return round(HEIGHT * (1.0 - min(max(share, 0.0), 1.0)), 1)

    return {
        "name": name,
        "about": specification.about,
        "unit": "" if curve["unit"] == "1" else curve["unit"].replace("^2", "²"),
        "strength": number(curve["strength"]),
        "line": [(x(hour), y(value)) for hour, value in _closed(curve["hours"], curve["values"])],
        "band": [(x(hour), y(value)) for hour, value in _closed(curve["hours"], curve["high"])]
        + [(x(hour), y(value)) for hour, value in _closed(curve["hours"], curve["low"])[::-1]],
        "keyframes": [
            (x(hour), y(value))
            for hour, value in zip(curve["keyframes"]["hours"], curve["keyframes"]["values"], strict=True)
        ],
        "dots": [
            {
                "x": x(hour),
                "y": y(own["value"]),
                "ends": [y(end) for end in own["interval"]],
                "weight": round(weight, 2),
            }
            for hour, own, weight in dots
        ],
        "ticks": [(y(value), number(value)) for value in _ticks(low, high, specification)],
        "is_log": specification.scale == "log",
        "summary": f"keyframes: {len(curve['keyframes']['hours'])}, values: {number(min(curve['values']))} to "
        f"{number(max(curve['values']))}",
    }


def _closed(hours: Sequence[float], values: Sequence[float]) -> list[tuple[float, float]]:
    """Corners of a line over a whole day, which goes on over midnight as a straight one."""
    gap = hours[0] + 24.0 - hours[-1]
    share = (24.0 - hours[-1]) / gap
    midnight = values[-1] + share * (values[0] - values[-1])
    return [(0.0, midnight), *zip(hours, values, strict=True), (24.0, midnight)]


def _reach(values: Sequence[float], specification: Specification) -> tuple[float, float]:
    """Ends of a plot, in the parameter's own scale."""
    scaled = [_scaled(value, specification) for value in values]
    bounds = [_scaled(bound, specification) for bound in specification.file_bounds]
    middle = 0.5 * (min(scaled) + max(scaled))
    half = max(0.5 * (max(scaled) - min(scaled)) * (1.0 + 2.0 * MARGIN), CLEAREST * (bounds[1] - bounds[0]))
    return middle - half, middle + half


def _ticks(low: float, high: float, specification: Specification) -> list[float]:
    places = [low + share * (high - low) for share in (0.1, 0.5, 0.9)]
    return [math.exp(place) for place in places] if specification.scale == "log" else places


def _scaled(value: float, specification: Specification) -> float:
    return math.log(value) if specification.scale == "log" else value


def _scores(found: Mapping[str, Any]) -> dict[str, object]:
    """Places of the cross-validation's plot: mean of minus log density against the strength, both as they are tried."""
    strengths: Sequence[float] = found["strengths"]
    scores: Sequence[float] = found["scores"]
    low, high = float(min([*scores, found["chosen"]])), max(scores)
    span = (high - low) or 1.0
    first, last = math.log(strengths[0]), math.log(strengths[-1])

    def y(score: float) -> float:
        return round(HEIGHT * (1.0 - MARGIN - (1.0 - 2.0 * MARGIN) * (score - low) / span), 1)

    return {
        "dots": [
            (round(WIDTH * (math.log(strength) - first) / (last - first), 1), y(score))
            for strength, score in zip(strengths, scores, strict=True)
        ],
        "chosen": y(found["chosen"]),
        "ticks": [(y(score), number(score)) for score in (low, 0.5 * (low + high), high)],
        "strengths": [(WIDTH * share, number(math.exp(first + share * (last - first)))) for share in (0.0, 0.5, 1.0)],
        "best": number(strengths[scores.index(min(scores))]),
        "scale": number(found["scale"]),
    }
