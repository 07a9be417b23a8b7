"""What the command line's options mean: their texts as values, a camera, a place and time, and a scene."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import torch

from diffrender.rays import Camera, Cubemap, Equirectangular, Perspective
from diffrender.scene import Scene
from fit import keyframes, weather_file
from fit import sun as sun_place
from fit.input_error import InputError
from fit.limits import LARGEST_PIXELS
from fit.photo import LAYOUTS, PROJECTIONS
from fit.shot import Shot, sun_of_weather


def assignments(texts: Sequence[str]) -> dict[str, float]:
    """Values by name, from texts such as SKY_OZONE=1.

    Raises:
        InputError: for a text of another form, an unknown or doubled name, or a value out of bounds.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, equals, number = (part.strip() for part in text.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not equals or not math.isfinite(value):
            raise InputError(f"--fix {text}; give NAME=VALUE such as SKY_OZONE=1")
        if name in found:
            raise InputError(f"--fix gives {name} twice; keep one of them")
        weather_file.check(name, value)
        found[name] = value
    return found


def motion(text: str) -> tuple[float, float]:
    """Two numbers, from a text such as 1.25,-0.5.

    Raises:
        InputError: for a text of another form.
    """
    try:
        right, down = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--motion {text}; give RIGHT,DOWN in pixels a frame, such as 1.25,-0.5") from None
    return right, down


def start(path: Path) -> Scene:
    """Scene of the first keyframe of a weather file, in double precision.

    Raises:
        InputError: when the file cannot be read or holds no sky.
    """
    return with_sky(first_scene(path), path)


def first_scene(path: Path) -> Scene:
    """Scene of the first keyframe of a weather file, in double precision, whatever it holds.

    Raises:
        InputError: when the file cannot be read.
    """
    weather = weather_file.read(path)
    return keyframes.scene(keyframes.at(weather, weather.hours[0]), torch.float64)


def with_sky(scene: Scene, weather: Path) -> Scene:
    """The scene itself.

    Raises:
        InputError: when it has no sky.
    """
    if scene.sky is None:
        raise InputError(f"{weather} holds no sky; give a weather file with rows of SKY_ names")
    return scene


def shot(latitude: float | None, longitude: float | None, time: str | None, heading: float | None) -> Shot:
    """Where and when a picture was taken.

    Raises:
        InputError: for a text that is no time with its zone, or place and time that do not go together.
    """
    return Shot(latitude, longitude, None if time is None else sun_place.parse_time(time), heading)


def hour_of(hour: float | None, taken: Shot) -> float:
    """Hour of the day that is given, else that of the time that places the sun, else noon."""
    if hour is not None:
        return hour
    return 12.0 if taken.hour is None else taken.hour


def scene_at(weather: Path, hour: float, sun: str | None, taken: Shot) -> Scene:
    """Scene of a weather file at an hour, its sun where it is given, else in the file, else by the file's header.

    Raises:
        InputError: when the file cannot be read or holds no sky.
    """
    place = sun_place.given(sun) if sun is not None else taken.sun()
    day = weather_file.read(weather)
    values = keyframes.at(day, hour)
    if place is None and not {"SUN_ELEVATION", "SUN_AZIMUTH"} & values.keys():
        place = sun_of_weather(day.header, hour, taken.heading)
    if place is not None:
        values |= {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    return with_sky(keyframes.scene(values), weather)


def camera(size: str, projection: str | None, field_of_view: float | None, pitch: float) -> Camera:
    """Camera of a picture to draw: the one that a photo of this size and these options is taken to have.

    Raises:
        InputError: for a size or projection that cannot be drawn, or options that do not suit it.
    """
    width, height = _size(size)
    if projection is not None and projection not in PROJECTIONS:
        raise InputError(f"--projection {projection} is unknown; allowed are {', '.join(PROJECTIONS)}")
    kind = projection or ("perspective" if field_of_view is not None else _recognised(width, height))
    if kind == "perspective":
        return _perspective(width, height, field_of_view, pitch)
    if field_of_view is not None or pitch != 0.0:
        raise InputError(f"--fov and --pitch are for perspective pictures, not for {kind}; leave them out")
    if kind == "equirectangular" and width != 4 * height:
        return Equirectangular(width, height)
    if kind != "cubemap" and width == 4 * height:
        return Equirectangular(width, height, lowest=0.0)
    for layout in LAYOUTS if kind == "cubemap" else ():
        side = width // len(layout[0])
        if (side * len(layout[0]), side * len(layout)) == (width, height):
            return Cubemap(side, layout)
    raise InputError(f"--size {size} is the wrong shape for {kind}; give {PROJECTIONS[kind]}")


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([1-9][0-9]{0,7})x([1-9][0-9]{0,7})", text)
    width, height = (int(number) for number in found.groups()) if found else (0, 0)
    if not 0 < width * height <= LARGEST_PIXELS:
        raise InputError(f"--size {text}; give WIDTHxHEIGHT such as 1024x512, at most {LARGEST_PIXELS:,} pixels")
    return width, height


def _recognised(width: int, height: int) -> str:
    """Projection that a shape gives away."""
    shapes = {2: "equirectangular", 4: "hemisphere", 6: "cubemap"}
    if width % height == 0 and width // height in shapes:
        return shapes[width // height]
    if height == 6 * width:
        return "cubemap"
    raise InputError(f"--size {width}x{height} is no shape of a panorama; give --fov DEGREES, or --projection")


def _perspective(width: int, height: int, field_of_view: float | None, pitch: float) -> Perspective:
    if field_of_view is None or not 0.0 < field_of_view < 180.0:
        raise InputError("a perspective picture needs --fov, a number of degrees above 0 and below 180")
    if not -90.0 <= pitch <= 90.0:
        raise InputError(f"--pitch {pitch:g}; allowed is a number of degrees from -90 to 90")
    return Perspective(width, height, math.radians(field_of_view), math.radians(pitch))
