"""The files that `fit day` leaves: weather.csv, day.json and report.html, all of them or none."""

import json
import math
from collections.abc import Mapping
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from diffrender.scene import places
from fit import day_report, keyframes, weather_file
from fit.day import GAINS, Day, hour, values_at
from fit.day_curves import Curves
from fit.day_photo import Estimate
from fit.weather_file import Weather
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder

ACCOUNT = "day.json"  # takes its place last
SUN = ("SUN_ELEVATION", "SUN_AZIMUTH")


def write(place: Path, day: Day) -> None:
    """Write a day's files into a folder, which is made if it is not there.

    Raises:
        InputError: when they cannot be written; then none of them is.
    """
    made, account = weather(day), record(day)
    page = day_report.page(account)
    with whole_folder(place, last=ACCOUNT) as aside:
        weather_file.write(aside / "weather.csv", made)
        write_bytes(aside / "report.html", page.encode())
        write_bytes(aside / ACCOUNT, json.dumps(account, indent=1, allow_nan=False).encode() + b"\n")


def weather(day: Day) -> Weather:
    """Weather file of a day: keyframes where curves need them, and no sun, which the header's place and date put."""
    hours = tuple(sorted({at for keys in day.keyframes.values() for at in keys.hours} or {hour(day.times[0])}))
    columns = {at: _single(values_at(day.home, day.keyframes, at)) for at in hours}
    cells: dict[str, tuple[float | None, ...]] = {}
    for name in columns[hours[0]]:
        if name in SUN:
            continue
        held = day.keyframes[name].hours if name in day.keyframes else hours[:1]
        cells[name] = tuple(columns[at][name] if at in held else None for at in hours)
    asked, first = day.asked, day.times[day.used()[0]]
    header = {
        "origin": f"fit {version('diffrender')}, {len(day.used())} photos of a day",
        "latitude": f"{asked.latitude:.7g}",
        "longitude": f"{asked.longitude:.7g}",
        "date": first.date().isoformat(),
        "zone": zone(first),
        "heading": f"{asked.bearing:.7g}",
    }
    return Weather(hours, cells, header)


def _single(values: Mapping[str, float]) -> dict[str, float]:
    """The same values with no more digits than a picture of floats needs."""
    return keyframes.values(keyframes.scene(values))


def zone(time: datetime) -> str:
    """Offset of a time from universal time, as in +02:00."""
    return time.isoformat()[-6:] if time.utcoffset() else "+00:00"


def record(day: Day) -> dict[str, object]:
    """What day.json holds: finite numbers, texts, lists and objects, and nothing that another run has otherwise."""
    used = day.used()
    return {
        "photos": [_photo(day, index, used.index(index) if index in used else None) for index in range(len(day.times))],
        "curves": _curves(day, day.air) | _curves(day, day.gains),
        "cross_validation": {
            part: {
                "strengths": list(found.scores),
                "scores": list(found.scores.values()),
                "chosen": found.score,
                "scale": found.scale,
            }
            for part, found in (("air", day.air), ("gains", day.gains))
        },
        "latitude": day.asked.latitude,
        "longitude": day.asked.longitude,
        "heading": day.asked.bearing,
        "solver": day.asked.solver,
        "seed": day.asked.seed,
        "versions": {name: version(name) for name in ("diffrender", "torch", "numpy", "scipy", "nlopt", "pvlib")},
    }


def _photo(day: Day, index: int, place: int | None) -> dict[str, object]:
    one, judged = day.estimates[index], day.judged[index]
    told: dict[str, object] = {
        "photo": one.photo,
        "time": day.times[index].isoformat(),
        "hour": hour(day.times[index]),
        "sun": {"elevation": one.elevation, "bearing": one.bearing},
        "refused": one.refused or None,
    }
    if judged is None or place is None:
        return told
    assert one.point is not None
    assert one.noise is not None
    weight, distance = float(day.air.weights[place]), float(day.air.distances[place])
    return told | {
        "heading": one.heading,
        "heading_error": one.heading_error,
        "how": one.how,
        "pitch": one.pitch,
        "pitch_error": one.pitch_error,
        "sun_off": one.off,
        "doubtful": one.is_doubtful,
        "converged": one.converged,
        "error": one.error,
        "error_at_curve": judged.error,
        "gains": list(judged.gains),
        "weight": weight,
        "distance": distance if math.isfinite(distance) else None,
        "why": _why(one, weight),
        "parameters": {
            name: {
                "value": _in_file(name, float(one.point[row])),
                "interval": _interval(name, float(one.point[row]), math.sqrt(max(float(one.noise[row, row]), 0.0))),
                "determined": name in one.determined,
            }
            for row, name in enumerate(one.names)
        },
    }


def _why(one: Estimate, weight: float) -> str:
    """Why a photo has less say than others; empty where it has not."""
    if one.is_doubtful:
        return f"its sun is {one.off:.1f} degrees from where place and time put it: no say in the curves"
    if not one.names:
        return "determines no parameter: no say in the curves"
    if weight < 0.5:
        return "far from what the other photos foretell, as with clouds: counts less"
    return ""


def _curves(day: Day, found: Curves) -> dict[str, object]:
    told: dict[str, object] = {}
    for row, name in enumerate(found.names):
        error = np.hypot(found.errors[row], math.sqrt(day.held.get(name, 0.0)))
        ends = [_interval(name, *map(float, pair)) for pair in zip(found.values[row], error, strict=True)]
        keys = day.keyframes[name]
        told[name] = {
            "unit": places()[name].specification.file_unit,
            "strength": found.strengths[name],
            "hours": list(found.hours),
            "values": [_in_file(name, float(value)) for value in found.values[row]],
            "low": [low for low, _ in ends],
            "high": [high for _, high in ends],
            "keyframes": {
                "hours": list(keys.hours),
                "values": [_in_file(name, value) for value in keys.values],
            },
            "common": name not in GAINS,
        }
    return told


def _in_file(name: str, unit: float) -> float:
    known = places()[name].specification
    low, high = known.bounds
    if known.scale == "log":
        return low * math.exp(unit * math.log(high / low)) * known.file_factor
    return (low + unit * (high - low)) * known.file_factor


def _interval(name: str, unit: float, error: float) -> tuple[float, float]:
    """Ends of one standard error to each side, which end at the bounds."""
    ends = [_in_file(name, min(max(unit + side * error, 0.0), 1.0)) for side in (-1.0, 1.0)]
    return min(ends), max(ends)


def summary(place: Path, day: Day) -> str:
    """What a day's photos said, in a few lines."""
    used = day.used()
    dates = sorted({f"{time:%Y-%m-%d}" for time in day.times})
    lines = [] if len(dates) == 1 else [f"  photos of {len(dates)} dates, {dates[0]} to {dates[-1]}, taken for one day"]
    for index, (one, time) in enumerate(zip(day.estimates, day.times, strict=True)):
        if one.refused:
            lines.append(f"  {time:%H:%M} {one.photo}: left out, {one.refused}")
        elif why := _why(one, float(day.air.weights[used.index(index)])):
            lines.append(f"  {time:%H:%M} {one.photo}: {why}")
        if one.refused or one.how == "given":
            continue
        known = "" if one.heading_error is None else f" ± {one.heading_error:.1f}"
        tilted = "" if one.pitch_error is None else f", pitch {one.pitch:.1f} ± {one.pitch_error:.1f}"
        lines.append(f"  {time:%H:%M} {one.photo}: heading {one.heading:.1f}{known} degrees by {one.how}{tilted}")
    keys = sum(len(keys.hours) for keys in day.keyframes.values())
    return "\n".join(
        [
            f"{len(used)} of {len(day.times)} photos fitted, {len(day.keyframes)} curves of {keys} keyframes",
            *(line.replace("\n", "?") for line in lines),
            f"written to {place}",
        ]
    )
