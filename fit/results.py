"""The files that a fit leaves: weather.csv, fitted.exr, mask.png, report.html and fit.json, all of them or none."""

import dataclasses
import json
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Shaped

from diffrender.rays import Camera, Cubemap, Equirectangular, Perspective
from diffrender.scene import Scene
from fit import keyframes, picture, png, report, weather_file
from fit.exr import bands
from fit.input_error import InputError
from fit.path_text import path_text
from fit.photo import Photo
from fit.shot import Shot
from fit.solution import Solution, SunPlace
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder

Draw = Callable[[Scene], picture.Drawn]
Page = Callable[[picture.Drawn], str]

ACCOUNT = "fit.json"  # takes its place last: who finds it finds the files it speaks of
LARGEST_SHOWN = 1024  # columns or rows of the report's pictures


def folder(out: Path | None, photo: Path) -> Path:
    """Folder for the results, not made yet; looked at beforehand, so that no fit is lost to a slip in its name.

    Raises:
        InputError: when it is seen to be no folder that can be written to.
    """
    # Of "...exr" the stem is "..", which would be the folder above.
    place = out or Path("tuned") / (photo.stem if photo.stem.strip(".") else photo.name)
    try:
        nearest = next(path for path in (place, *place.parents) if path.exists())
    except OSError as error:
        raise InputError(f"{place} cannot be a folder ({error.strerror}); give another --out") from error
    if not nearest.is_dir():
        raise InputError(f"{nearest} is not a folder; give another --out")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{nearest} may not be written to; give another --out")
    path_text(place)
    return place


def write(place: Path, photo: Photo, solution: Solution, shot: Shot, draw: Draw) -> None:
    """Write a fit's five files into a folder, with a report that shows the first picture drawn beside the photo.

    Raises:
        InputError: when they cannot be written; then none of them is.
    """

    def page(drawn: picture.Drawn) -> str:
        return report.page(solution, _pictures(photo, next(iter(drawn.values())), solution.used))

    write_with(place, solution, shot, draw, page)


def write_with(place: Path, solution: Solution, shot: Shot, draw: Draw, page: Page) -> None:
    """Write a fit's five files into a folder, which is made if it is not there, with a page made of what is drawn.

    What is drawn is the scene as the weather file describes it, so that drawing the file again gives the same bits.

    Raises:
        InputError: when they cannot be written; then none of them is.
    """
    began = time.monotonic()
    values = keyframes.values(solution.scene)
    weather = weather_file.of_photo(values, shot.hour, _origin(solution) | shot.lines())
    drawn = draw(keyframes.scene(values))
    html = page(drawn)
    mask = png.encoded(np.where(solution.used, np.uint8(255), np.uint8(0))[..., None])
    with whole_folder(place, last=ACCOUNT) as aside:
        weather_file.write(aside / "weather.csv", weather)
        picture.write(aside / "fitted.exr", drawn, {"photo": solution.photo})
        write_bytes(aside / "mask.png", mask)
        write_bytes(aside / "report.html", html.encode())
        seconds = {**solution.seconds, "write": time.monotonic() - began}
        account = record(dataclasses.replace(solution, seconds=seconds))
        write_bytes(aside / ACCOUNT, json.dumps(account, indent=1, allow_nan=False).encode() + b"\n")


def record(solution: Solution) -> dict[str, object]:
    """What fit.json holds: only finite numbers, texts, lists and objects."""
    minimum = solution.minimum
    return {
        "photo": solution.photo,
        "effect": solution.effect,
        "camera": _camera(solution.camera),
        "sun": None if solution.sun is None else dataclasses.asdict(solution.sun),
        "gains": list(solution.gains),
        "pixels": dict(solution.pixels),
        "error": solution.error,
        "measure": solution.measure,
        "scores": {method: dict(scores) for method, scores in solution.scores.items()},
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


def summary(place: Path, solution: Solution) -> str:
    """What a fit found, in a few lines."""
    minimum = solution.minimum
    state = "converged" if minimum.converged else f"not converged: {minimum.reason}"
    lines = [
        f"{solution.photo}: mean square error of {solution.measure} {report.number(solution.error, 4)}, {state}",
        *(f"  {note}" for note in solution.notes),
    ]
    if solution.sun is not None:
        lines.append(_told(solution.sun))
    for method, scores in solution.scores.items():
        lines.append(f"  {method:<30} " + ", ".join(f"{name} {score:.4g}" for name, score in scores.items()))
    for name, fitted in solution.parameters.items():
        unit = "" if fitted.unit == "1" else f" {fitted.unit}"
        if fitted.standard_error is not None:
            lines.append(f"  {name:<30} {report.measured(fitted.value, fitted.standard_error)}{unit}")
        elif fitted.why not in ("default", "kept"):
            lines.append(f"  {name:<30} {report.number(fitted.value, 4)}{unit} ({fitted.why})")
    lines.append(f"written to {place}")
    return "\n".join(line.replace("\n", "?") for line in lines)  # names of files may hold line ends


def _told(sun: SunPlace) -> str:
    elevation = _angle(sun.elevation, sun.elevation_standard_error)
    azimuth = _angle(sun.azimuth, sun.azimuth_standard_error)
    return f"  sun {elevation} degrees high, {azimuth} to the right of the middle: {sun.how}"


def _angle(degrees: float, error: float | None) -> str:
    return report.number(degrees) if error is None else report.measured(degrees, error)


def _origin(solution: Solution) -> dict[str, str]:
    return {"origin": f"fit {solution.versions['diffrender']}, photo {solution.photo}"}


def _camera(camera: Camera) -> dict[str, object]:
    """A camera in the words of the command line."""
    size = {"width": camera.width, "height": camera.height}
    if isinstance(camera, Perspective):
        # Rounded, because radians do not give degrees back exactly.
        angles = {"fov_degrees": camera.field_of_view, "pitch_degrees": camera.pitch}
        return {"projection": "perspective", **size, **{n: round(math.degrees(a), 10) for n, a in angles.items()}}
    if isinstance(camera, Cubemap):
        return {"projection": "cubemap", **size, "layout": camera.layout}
    is_half = isinstance(camera, Equirectangular) and camera.lowest == 0.0
    return {"projection": "hemisphere" if is_half else "equirectangular", **size}


def _pictures(
    photo: Photo, fitted: Float[np.ndarray, "height width 3"], used: Bool[np.ndarray, "height width"]
) -> report.Pictures:
    """Pictures of the report, averaged over boxes; a box counts as used when all of its pixels are."""
    side = math.ceil(max(photo.camera.width, photo.camera.height) / LARGEST_SHOWN)
    shown = _boxes(fitted, side)
    shown[~(shown > 0.0).any(-1)] = np.nan
    return report.Pictures(photo=_boxes(photo.radiance, side), fitted=shown, mask=_boxes(used, side) == 1.0)


def _boxes(
    whole: Shaped[np.ndarray, "height width *channels"], side: int
) -> Float[np.ndarray, "rows columns *channels"]:
    """Means over square boxes, in single precision; rows and columns that fill no box are left out."""
    high, wide = whole.shape[0] // side, whole.shape[1] // side
    means = np.empty((high, wide, *whole.shape[2:]), np.float32)
    # By bands, so that a large picture of halves is never whole in single precision.
    for rows in bands(high):
        lines = whole[rows.start * side : rows.stop * side, : wide * side]
        with np.errstate(all="ignore"):  # of infinite and NaN pixels, which no one takes for colours
            means[rows] = lines.reshape(-1, side, wide, side, *whole.shape[2:]).mean((1, 3), dtype=np.float32)
    return means
