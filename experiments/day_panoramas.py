"""A day rendered by something else, fitted by `fit day`: are the curves found, and do their intervals hold?

    python -m experiments.day_panoramas

24 panoramas of one day at one place by Mitsuba's sunsky (Hosek-Wilkie), whose turbidity and albedo swing over the day,
with noise, a heading and an exposure; one is missing, two are spoilt by clouds (patches several times as bright). Their
names tell the times. `fit day` is told latitude and longitude and nothing else.

Turbidity has no counterpart among our parameters, so the truth of a curve is what `fit sky` finds on the clean panorama
of that hour, missing and spoilt ones among them, at a finer resolution; and its shape is compared with the turbidity's.
"""

import argparse
import importlib
import json
import math
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import plots
from experiments.fit_command import run_well
from experiments.mitsuba_sky import LLVM_VARIABLE, find_llvm
from experiments.records import RESULTS, table, write
from fit import exr, sun

LATITUDE, LONGITUDE, DATE = 48.0, 11.0, "2020-06-21"
ZONE = 2.0  # hours
HEADING = 100.0  # degrees
NOISE = 0.05  # standard deviation of log radiance in each pixel
CLOUDS, CLOUD = 40, math.radians(14.0)  # number and radius of clouds in a spoilt panorama
COMMAND = (sys.executable, "-m", "fit", "day")
JUDGED = ("SKY_HAZINESS", "SKY_MIE_SCALE", "SKY_RAYLEIGH_SCALE", "SKY_RAYLEIGH_COLOUR_EXPONENT")

SHOWN = ("error", "alone", "swing", "at_missing", "within_one", "within_two")

Picture = NDArray[np.float32]


@dataclass(frozen=True)
class Size:
    """How much is done.

    Attributes:
        width: of a panorama, pixels.
        hours: of the photos.
        missing: index of the one that is not given.
        spoilt: indices of those with clouds.
    """

    width: int
    hours: tuple[float, ...]
    missing: int
    spoilt: tuple[int, ...]


SIZES = {
    "small": Size(64, (8.0, 11.0, 14.0, 17.0), 2, (1,)),
    # The sun is up from 5.2 to 21.3 o'clock.
    "full": Size(256, tuple(float(hour) for hour in np.round(np.linspace(5.5, 21.0, 24) * 12.0) / 12.0), 9, (5, 16)),
}


@dataclass(frozen=True)
class Compared:
    """One curve against what is known of it, in the parameter's own scale: logarithms of log parameters.

    Attributes:
        error: root mean square of curve less truth over all hours, the missing and the spoilt ones among them.
        alone: the same of the photos' own estimates, where they have one.
        swing: standard deviation of the truth over the day.
        at_missing: curve less truth at the missing hour, in standard errors.
        within_one: share of hours at which the truth is within one standard error.
        within_two: within 1.96 of them.
        keyframes: of the curve.
    """

    name: str
    error: float
    alone: float
    swing: float
    at_missing: float
    within_one: float
    within_two: float
    keyframes: int


def turbidity(hour: float) -> float:
    """Of the rendered sky: hazier in the morning and the evening."""
    return 3.5 + 1.5 * math.cos(2.0 * math.pi * (hour - 3.0) / 24.0)


def time_of(hour: float) -> datetime:
    """Universal time of a local hour."""
    return datetime.fromisoformat(f"{DATE}T00:00").replace(tzinfo=UTC) + timedelta(hours=hour - ZONE)


def name_of(hour: float) -> str:
    """File name that tells the local time."""
    local = time_of(hour) + timedelta(hours=ZONE)
    return f"roof_{local:%Y%m%dT%H%M}+0200.exr"


def rendered(hours: Sequence[float], width: int) -> list[Picture]:
    """Panoramas by Mitsuba, with the sun's disc."""
    os.environ[LLVM_VARIABLE] = find_llvm()  # read when drjit is imported
    mitsuba: Any = importlib.import_module("mitsuba")
    drjit: Any = importlib.import_module("drjit")
    mitsuba.set_variant("llvm_ad_rgb")
    drjit.set_thread_count(1)
    towards = directions(width)
    made = []
    for hour in hours:
        place = sun.from_place(LATITUDE, LONGITUDE, time_of(hour), HEADING)
        to_sun = sun.to_sun(place).double().numpy()
        emitter = mitsuba.load_dict(
            {
                "type": "sunsky",
                "sun_direction": [float(value) for value in to_sun],
                "turbidity": turbidity(hour),
                "albedo": {"type": "rgb", "value": [0.2] * 3},
                "sun_scale": 0.0,
            }
        )
        seen = drjit.zeros(mitsuba.SurfaceInteraction3f, towards.size // 3)
        seen.wi = mitsuba.Vector3f(-towards.reshape(-1, 3).T.astype(np.float32))
        sky = np.maximum(np.array(emitter.eval(seen), dtype=np.float64).T.reshape(towards.shape), 0.0)
        ground = towards[..., 2] <= 0.0
        sky[ground] = 0.2 * sky[~ground].mean(0)
        # The disc, as wide as a pixel at least, holds 50 000 times the mean of the sky over half a degree.
        disc = max(math.radians(0.27), 0.6 * 2.0 * math.pi / width)
        apart = np.linalg.norm(towards - to_sun, axis=-1)
        share = math.radians(0.27) ** 2 / disc**2
        sky[(apart < 2.0 * math.sin(disc / 2.0)) & ~ground] += 50_000.0 * share * sky[~ground].mean()
        made.append(sky.astype(np.float32))
    return made


def directions(width: int) -> NDArray[np.float64]:
    """Directions of a panorama's pixels, +x in the middle, +y to the left."""
    azimuth = math.pi - (np.arange(width) + 0.5) * (2.0 * math.pi / width)
    elevation = math.pi / 2.0 - (np.arange(width // 2) + 0.5) * (2.0 * math.pi / width)
    up, round_ = np.meshgrid(elevation, azimuth, indexing="ij")
    return np.stack([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)], -1)


def noisy(picture: Picture, generator: np.random.Generator) -> Picture:
    """Picture with noise in every pixel and channel."""
    return (picture * generator.lognormal(0.0, NOISE, picture.shape)).astype(np.float32)


def clouded(picture: Picture, generator: np.random.Generator) -> Picture:
    """Picture with soft white patches, which no smooth layer follows."""
    towards = directions(picture.shape[1])
    white = picture[towards[..., 2] > 0.0].mean()
    covered = picture.astype(np.float64)
    for _ in range(CLOUDS):
        place = generator.normal(size=3)
        place[2] = abs(place[2])
        place /= np.linalg.norm(place)
        share = 0.9 * np.exp(-0.5 * (np.linalg.norm(towards - place, axis=-1) / CLOUD) ** 2)[..., None]
        covered += share * (generator.uniform(0.5, 3.0) * white - covered) * (towards[..., 2:] > 0.0)
    return covered.astype(np.float32)


def save(path: Path, picture: Picture) -> None:
    """Write a panorama as OpenEXR."""
    exr.write(path, {"": {"RGB": picture}}, {})


def fitted_day(folder: Path, out: Path) -> dict[str, Any]:
    """Account of `fit day` on a folder's panoramas."""
    photos = [str(path) for path in sorted(folder.glob("*.exr"))]
    place = ["--latitude", str(LATITUDE), "--longitude", str(LONGITUDE)]
    run_well([*COMMAND, *photos, *place, "--out", str(out), "--quiet"])
    account: dict[str, Any] = json.loads((out / "day.json").read_text(encoding="utf-8"))
    return account


def compared(day: Mapping[str, Any], truth: Mapping[str, Any], size: Size) -> list[Compared]:
    """Each judged curve against the estimates from clean panoramas."""
    clean = {photo["hour"]: photo for photo in truth["photos"]}
    found = []
    for name in JUDGED:
        if name not in day["curves"]:
            continue
        hours = [hour for hour in clean if name in clean[hour].get("parameters", {})]
        is_log = name.endswith("SCALE")
        known = _scaled([clean[hour]["parameters"][name]["value"] for hour in hours], is_log)
        curve, error = _curve(day["curves"][name], hours, is_log)
        own = {p["hour"]: p["parameters"][name]["value"] for p in day["photos"] if name in p.get("parameters", {})}
        alone = [_scaled([own[hour]], is_log)[0] - one for hour, one in zip(hours, known, strict=True) if hour in own]
        away = (curve - known) / error
        missing = [a for a, hour in zip(away, hours, strict=True) if abs(hour - size.hours[size.missing]) < 1e-6]
        found.append(
            Compared(
                name=name,
                error=_root_mean_square(curve - known),
                alone=_root_mean_square(np.array(alone)),
                swing=float(known.std()),
                at_missing=float(missing[0]) if missing else 0.0,
                within_one=float((np.abs(away) < 1.0).mean()),
                within_two=float((np.abs(away) < 1.96).mean()),
                keyframes=len(day["curves"][name]["keyframes"]["hours"]),
            )
        )
    return found


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _scaled(values: Sequence[float], is_log: bool) -> NDArray[np.float64]:  # noqa: FBT001 - by a parameter's scale
    return np.log(values) if is_log else np.array(values)


def _curve(
    curve: Mapping[str, Any],
    hours: Sequence[float],
    is_log: bool,  # noqa: FBT001 - by a parameter's scale
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values and standard errors of a curve at some hours."""
    middle, low, high = (
        np.interp(hours, curve["hours"], _scaled(curve[end], is_log), period=24.0) for end in ("values", "low", "high")
    )
    return middle, (high - low) / 2.0


def day(size: Size, folder: Path, seed: int) -> dict[str, Any]:
    """Panoramas rendered and fitted: clean ones for the truth, then the day as it was photographed."""
    generator = np.random.default_rng(seed)
    clean, given = folder / "clean", folder / "given"
    for place in (clean, given):
        place.mkdir(parents=True, exist_ok=True)
    for index, (hour, picture) in enumerate(zip(size.hours, rendered(size.hours, size.width), strict=True)):
        save(clean / name_of(hour), picture)
        photo = clouded(picture, generator) if index in size.spoilt else picture
        if index != size.missing:
            save(given / name_of(hour), noisy(photo, generator))
    truth, found = fitted_day(clean, folder / "truth"), fitted_day(given, folder / "day")
    spoilt = {name_of(size.hours[index]) for index in size.spoilt}
    photos = [photo for photo in found["photos"] if photo["refused"] is None]
    headings = [
        (photo["heading"] - HEADING + 180.0) % 360.0 - 180.0 for photo in photos if photo["photo"] not in spoilt
    ]
    haze = found["curves"].get("SKY_MIE_SCALE")
    return {
        "seed": seed,
        "records": [asdict(one) for one in compared(found, truth, size)],
        "weights": {photo["photo"]: photo["weight"] for photo in photos},
        "spoilt": sorted(spoilt),
        "largest_heading_error_degrees": float(np.abs(headings).max()),
        "correlation_with_turbidity": (
            float(np.corrcoef(haze["values"], [turbidity(hour) for hour in haze["hours"]])[0, 1]) if haze else None
        ),
        "keyframes": sum(len(curve["keyframes"]["hours"]) for curve in found["curves"].values()),
        "curves": found["curves"],
        "truth": {
            name: [
                [photo["hour"], photo["parameters"][name]["value"]]
                for photo in truth["photos"]
                if name in photo.get("parameters", {})
            ]
            for name in JUDGED
        },
        "estimates": {
            name: [
                [photo["hour"], photo["parameters"][name]["value"], photo["weight"]]
                for photo in photos
                if name in photo["parameters"]
            ]
            for name in JUDGED
        },
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Render, fit, compare; print a table, write JSON and a plot."""
    parser = argparse.ArgumentParser(description="`fit day` on panoramas rendered by Mitsuba.")
    parser.add_argument("--size", choices=SIZES, default="full")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder in which panoramas and results stay")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        content = day(SIZES[asked.size], asked.keep or Path(name), asked.seed)
    path = asked.out / "day_panoramas.json"
    write(path, content)
    plots.day_panoramas(path)
    head = ["curve", "error", "photos alone", "swing", "missing hour", "68 %", "95 %", "keyframes"]
    rows = [[one["name"], *(f"{one[key]:.3g}" for key in SHOWN), str(one["keyframes"])] for one in content["records"]]
    print(table(head, rows))
    weights = ", ".join(f"{content['weights'].get(name, 0.0):.2g}" for name in content["spoilt"])
    largest = content["largest_heading_error_degrees"]
    print(f"weights of the spoilt photos: {weights}; headings within {largest:.2g} degrees")


if __name__ == "__main__":
    main()
