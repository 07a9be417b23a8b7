"""What the commands read beside photos, and the files that a fit leaves."""

import dataclasses
import json
import math
import re
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from diffrender.rays import Camera, Equirectangular, Perspective
from diffrender.scene import Scene
from fit import keyframes, picture, png, report, weather_file
from fit.input_error import InputError
from fit.minimum import INTERRUPTED as INTERRUPTED
from fit.photo import Photo
from fit.solution import Solution, SunPlace
from fit.whole_file import write_bytes

LARGEST_SIZE = 16_384
REPORT_COLUMNS = 1024


def folder(out: Path | None, photo: Path) -> Path:
    """Folder of the results; made if it is not there.

    Raises:
        InputError: when it cannot be made or written to.
    """
    place = out or Path("tuned") / photo.stem
    if not photo.exists():
        raise InputError(f"{photo} does not exist; give an OpenEXR or Radiance .hdr file")
    return place


def scene_of(path: Path) -> Scene:
    """Scene of the first keyframe of a weather file, in double precision."""
    weather = weather_file.read(path)
    return keyframes.scene(keyframes.at(weather, weather.hours[0]), torch.float64)


def assignments(texts: Sequence[str]) -> dict[str, float]:
    """Values by name, from texts such as SKY_OZONE=1.

    Raises:
        InputError: for an unknown name, a value out of bounds or a text of another form.
    """
    found = {}
    for text in texts:
        name, equals, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not equals or not math.isfinite(value):
            raise InputError(f"--fix {text}; give NAME=VALUE such as SKY_OZONE=1")
        weather_file.check(name, value)
        found[name] = value
    return found


def camera(size: str, projection: str | None, field_of_view: float | None, pitch: float) -> Camera:
    """Camera of a picture to draw.

    Raises:
        InputError: for a size or projection that cannot be drawn.
    """
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if match is None or not all(1 <= int(number) <= LARGEST_SIZE for number in match.groups()):
        raise InputError(f"--size {size}; give WIDTHxHEIGHT from 1x1 to {LARGEST_SIZE}x{LARGEST_SIZE}, such as 1024x512")
    width, height = (int(number) for number in match.groups())
    if projection == "perspective" or (projection is None and field_of_view is not None):
        if field_of_view is None or not 0.0 < field_of_view < 180.0:
            raise InputError("a perspective picture needs --fov between 0 and 180 degrees")
        return Perspective(width, height, math.radians(field_of_view), math.radians(pitch))
    if projection not in (None, "equirectangular", "hemisphere"):
        raise InputError(f"--projection {projection}; fit render draws equirectangular, hemisphere and perspective")
    return Equirectangular(width, height, 0.0 if projection == "hemisphere" else -math.pi / 2)


def render(weather: Path, out: Path, hour: float, place: SunPlace | None, seen: Camera) -> None:
    """Draw a weather file at an hour.

    Raises:
        InputError: when the file holds no sky.
    """
    values = keyframes.at(weather_file.read(weather), hour)
    if place is not None:
        values |= {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    scene = keyframes.scene(values)
    if scene.sky is None:
        raise InputError(f"{weather} holds no sky; give a weather file with SKY_ rows")
    picture.write(out, picture.draw(scene, seen), {"weather": weather.name, "hour": hour})


def write(place: Path, photo: Photo, solution: Solution, hour: float | None) -> None:
    """Write a fit's five files, each whole or not at all.

    Raises:
        InputError: when they cannot be written.
    """
    began = time.monotonic()
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{place}: {error.strerror}; give another --out") from error
    values = keyframes.values(solution.scene)
    weather = weather_file.of_photo(values, hour, _header(photo, solution))
    drawn = picture.draw(keyframes.scene(values), photo.camera)
    picture.write(place / "fitted.exr", drawn, {"photo": solution.photo})
    write_bytes(place / "mask.png", png.encoded(np.where(solution.used, np.uint8(255), np.uint8(0))[..., None]))
    weather_file.write(place / "weather.csv", weather)
    pictures = _pictures(photo, drawn.sky, solution)
    write_bytes(place / "report.html", report.page(solution, pictures).encode())
    solution = dataclasses.replace(solution, seconds={**solution.seconds, "write": time.monotonic() - began})
    write_bytes(place / "fit.json", json.dumps(record(solution), indent=1, allow_nan=False).encode() + b"\n")


def hour_of(photo: Photo, text: str | None) -> float | None:
    """Local hour at which a photo was taken, as given or as its header says; None where neither does."""
    taken = datetime.fromisoformat(text) if text is not None else photo.header.get("time")
    if not isinstance(taken, datetime):
        return None
    return taken.hour + taken.minute / 60.0 + taken.second / 3600.0


def summary(place: Path, solution: Solution) -> str:
    """What a fit found, in a few lines."""
    found = solution.parameters
    rows = [
        f"  {name:<34}{report.measured(found[name].value, found[name].standard_error)} {found[name].unit}"
        if found[name].standard_error is not None
        else f"  {name:<34}{report.number(found[name].value)} {found[name].unit} ({found[name].why})"
        for name in found
        if found[name].why not in ("default", "kept")
    ]
    state = "converged" if solution.minimum.converged else f"not converged: {solution.minimum.reason}"
    head = f"{solution.photo}: mean square log error {solution.error:.4f}, {state}"
    return "\n".join([head, *(f"  {note}" for note in solution.notes), *rows, f"written to {place}"])


def record(solution: Solution) -> dict[str, object]:
    """What fit.json holds: only finite numbers, texts, lists and objects."""
    minimum = solution.minimum
    return {
        "photo": solution.photo,
        "effect": solution.effect,
        "camera": {"kind": type(solution.camera).__name__.lower(), **_plain_fields(solution.camera)},
        "sun": dataclasses.asdict(solution.sun),
        "gains": list(solution.gains),
        "pixels": dict(solution.pixels),
        "error": solution.error,
        "solver": solution.solver,
        "seed": solution.seed,
        "threads": torch.get_num_threads(),
        "versions": dict(solution.versions),
        "converged": minimum.converged,
        "reason": minimum.reason,
        "iterations": minimum.iterations,
        "evaluations": minimum.evaluations,
        "seconds": dict(solution.seconds),
        "loss": [loss if math.isfinite(loss) else None for loss in minimum.history],
        "left_out": dict(solution.left_out),
        "notes": list(solution.notes),
        "parameters": {name: dataclasses.asdict(fitted) for name, fitted in solution.parameters.items()},
    }


def _plain_fields(camera: Camera) -> dict[str, object]:
    assert dataclasses.is_dataclass(camera)
    assert not isinstance(camera, type)
    return {"width": camera.width, "height": camera.height, **dataclasses.asdict(camera)}


def _header(photo: Photo, solution: Solution) -> dict[str, str]:
    origin = {"origin": f"fit {solution.versions['diffrender']}, photo {solution.photo}"}
    known = {name: f"{photo.header[name]}" for name in ("latitude", "longitude") if photo.header.get(name) is not None}
    return {**origin, **known}


def _pictures(photo: Photo, fitted: Float[np.ndarray, "height width 3"], solution: Solution) -> report.Pictures:
    """Pictures of the report: the photo averaged over boxes, and the others to match."""
    side = max(1, math.ceil(photo.camera.width / REPORT_COLUMNS))
    high, wide = photo.camera.height // side, photo.camera.width // side

    def boxes(whole: np.ndarray) -> np.ndarray:
        lines = whole[: high * side, : wide * side]
        return lines.reshape(high, side, wide, side, *whole.shape[2:])

    def mean(whole: np.ndarray) -> np.ndarray:
        # By lines of boxes, so that a large half picture is never whole in single precision.
        return np.stack([line.astype(np.float32).mean((0, 2)) for line in boxes(whole)])

    shown = mean(fitted)
    shown[~(shown > 0.0).any(-1)] = np.nan
    return report.Pictures(photo=mean(photo.radiance), fitted=shown, mask=boxes(solution.used).all(3).all(1))
