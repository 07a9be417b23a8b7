"""Whether what `fit` leaves is whole: every file is read to its end."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO

from fit import exr, weather_file
from fit.input_error import InputError

FILES = ("fit.json", "fitted.exr", "mask.png", "report.html", "weather.csv")


def faults(out: Path) -> list[str]:
    """What is wrong with a folder of results, or with a drawn picture; empty where all is whole."""
    if out.is_file():
        return [fault] if (fault := file_fault(out)) else []
    missing = [f"{name} is missing" for name in FILES if not (out / name).is_file()]
    present = [out / name for name in FILES if (out / name).is_file()]
    return [*missing, *(fault for path in present if (fault := file_fault(path)))]


def file_fault(path: Path) -> str:
    """Why a file of the results is not whole; empty where it is."""
    return "" if READERS[path.suffix](path) else f"{path.name} is not whole"


def _is_json(path: Path) -> bool:
    try:
        return "parameters" in json.loads(path.read_bytes())
    except ValueError:
        return False


def _is_exr(path: Path) -> bool:
    try:
        return bool(np.isfinite(exr.read(path).radiance).all())  # refuses a file any part of which is damaged
    except InputError:
        return False


def _is_png(path: Path) -> bool:
    pixels = OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.UINT8)
    OpenImageIO.geterror()
    return pixels is not None and pixels.size > 0 and path.read_bytes().endswith(b"IEND\xaeB`\x82")


def _is_page(path: Path) -> bool:
    return path.read_bytes().rstrip().endswith(b"</html>")


def _is_weather(path: Path) -> bool:
    try:
        return len(weather_file.read(path).values) > 0
    except InputError:
        return False


READERS: dict[str, Callable[[Path], bool]] = {
    ".json": _is_json,
    ".exr": _is_exr,
    ".png": _is_png,
    ".html": _is_page,
    ".csv": _is_weather,
}
