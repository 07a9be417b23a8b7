"""OpenEXR files: one flat picture in, named parts out.

Read are scanline and tiled parts, of several resolutions the finest, in half, float or uint, with R, G and B, with
luminance and chroma [1], or with luminance alone, which is grey. Radiance comes in Rec. 709 primaries. A neutral colour
of the file stays neutral (Bradford adaptation of its white to D65); only where the primaries are X, Y and Z themselves
the values are tristimulus values, whose white is a formality, and are taken as they are.

[1] F. Kainz, R. Bogart, "Technical Introduction to OpenEXR", section "Luminance/Chroma Images".
"""

import contextlib
import io
import json
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
from jaxtyping import Float, Shaped

from diffrender.colour import REC709, rec709_from
from fit.input_error import InputError
from fit.limits import check_packing, check_size
from fit.path_text import path_text
from fit.whole_file import whole_file

LARGEST_BYTES = 2_200_000_000  # of all channels of all parts, for OpenEXR reads a file whole
VALUE_BYTES = 4  # headers do not tell halves from floats
DEEP_VALUE_BYTES = 160  # a deep pixel is an array of its own
BAND = 256  # rows that are converted at a time, so that no second picture of float32 is needed

MAGIC = b"\x76\x2f\x31\x01"
DEEP = (OpenEXR.deepscanline, OpenEXR.deeptile)
TILED = (OpenEXR.tiledimage, OpenEXR.deeptile)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)  # x and y of the primaries X, Y and Z

# What the binding raises for a damaged file: its own errors, those of names that are no UTF-8, and C++'s.
FAULTS = (RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError, OSError)

Values = Shaped[np.ndarray, "height width"]
Radiance = Float[np.ndarray, "height width 3"]
Header = Mapping[str, Any]

_silencing = threading.Lock()


@dataclass(frozen=True, eq=False)
class Picture:
    """What a file shows in its display window; NaN where its data window does not reach.

    Attributes:
        radiance: linear Rec. 709, in half where the file has halves that need no conversion, else in float.
        distance: channel Z, in float.
        header: attributes of the part, by their names in OpenEXR; of the channels, their names.
        notes: what was chosen, converted or left aside, one sentence each.
    """

    radiance: Radiance
    distance: Float[np.ndarray, "height width"] | None
    header: Header
    notes: tuple[str, ...]


class Window(NamedTuple):
    """A rectangle of pixels: first row and column, and size."""

    top: int
    left: int
    height: int
    width: int


def read(path: Path) -> Picture:
    """First flat part of a file that has R, G and B, or Y.

    Raises:
        InputError: when there is none, when the file is damaged, or when it is too large.
    """
    headers = headers_of(path)
    index = _chosen(path, headers)
    header = headers[index]
    whole = _parts(path, header_only=False)
    if len(whole) != len(headers):
        raise _damaged(path)
    channels = whole[index][1]
    del whole
    with np.errstate(all="ignore"):  # of infinite and NaN pixels, which are masked later
        radiance, colour_notes = _radiance(path, channels, header)
    distance = np.asarray(channels["Z"], np.float32) if "Z" in channels else None
    if distance is not None and distance.shape != radiance.shape[:2]:
        raise InputError(f"{path} has a channel Z of fewer pixels than its colours; export it at full resolution")
    data, display = _window(header, "dataWindow"), _window(header, "displayWindow")
    return Picture(
        radiance=_placed(path, radiance, data, display),
        distance=None if distance is None else _placed(path, distance, data, display),
        header=header,
        notes=(*_choice_notes(headers, index), *colour_notes, *_window_notes(data, display)),
    )


def read_channel(path: Path, names: Sequence[str]) -> Float[np.ndarray, "height width"]:
    """The first of some channels that a flat part of a file has, in float; NaN where its data window does not reach.

    Raises:
        InputError: when there is none, when the file is damaged, or when it is too large.
    """
    headers_of(path)
    flat = [(header, channels) for header, channels in _parts(path, header_only=False) if header["type"] not in DEEP]
    found = [(header, channels[name]) for header, channels in flat for name in names if name in channels]
    if not found:
        raise InputError(f"{path} has none of the channels {', '.join(names)}; export one without a layer's name")
    header, channel = found[0]
    data, display = _window(header, "dataWindow"), _window(header, "displayWindow")
    if channel.shape != (data.height, data.width):
        raise InputError(f"{path} has a distance for fewer pixels than its window; export it at full resolution")
    placed: Float[np.ndarray, "height width"] = _placed(path, np.array(channel, np.float32), data, display)
    return placed


def write(path: Path, parts: Mapping[str, Mapping[str, Values | Radiance]], metadata: Mapping[str, object]) -> None:
    """Write named parts of float channels, whole or not at all; the metadata goes as JSON into "diffrender".

    Channels are "RGB" of shape (height, width, 3), or "Y", "Z" ... of shape (height, width); colours are Rec. 709.
    """
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709,
        "diffrender": json.dumps(metadata, allow_nan=False),
    }
    # OpenEXR ignores strides: what is not contiguous would be written as other pixels (its issue 1929).
    contiguous = {
        name: {channel: np.ascontiguousarray(values, np.float32) for channel, values in channels.items()}
        for name, channels in parts.items()
    }
    with whole_file(path) as aside:
        try:
            with OpenEXR.File([OpenEXR.Part(dict(header), chans, name) for name, chans in contiguous.items()]) as file:
                file.write(path_text(aside))
        except RuntimeError as error:
            raise OSError(str(error).rpartition('". ')[2].rstrip(".")) from error


def first_bytes(path: Path) -> bytes:
    """First 16 bytes of a file, which tell its format better than its name.

    Raises:
        InputError: when it is missing, empty, a folder or a device, or may not be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path} is {'a folder' if path.is_dir() else 'no file'}; give an HDR picture")
        with path.open("rb") as file:
            first = file.read(16)
    except OSError as error:
        raise InputError(f"{path} cannot be opened ({error.strerror}); give an HDR picture") from error
    if not first:
        raise InputError(f"{path} is empty; give an HDR picture")
    return first


def to_rec709(path: Path, radiance: Radiance, chromaticities: Sequence[float]) -> Radiance:
    """Radiance in Rec. 709; float32 radiance is converted in place.

    Args:
        path: for the message.
        radiance: in the primaries of the chromaticities.
        chromaticities: x and y of red, green, blue and white.

    Raises:
        InputError: when the chromaticities are not those of any red, green, blue and white.
    """
    try:
        if tuple(chromaticities[:6]) == XYZ:
            x, y = REC709[6:]
            matrix = rec709_from((*XYZ, x, y)).numpy() / [x / y, 1.0, (1.0 - x - y) / y]
        else:
            matrix = rec709_from(chromaticities).numpy()
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    converted = radiance if radiance.dtype == np.float32 else np.empty(radiance.shape, np.float32)
    for rows in bands(len(radiance)):
        converted[rows] = radiance[rows].astype(np.float32) @ matrix.T.astype(np.float32)
    return converted


def bands(height: int) -> Iterator[slice]:
    """Rows of a picture, so many at a time that a band fits into a cache."""
    return (slice(top, min(top + BAND, height)) for top in range(0, height, BAND))


def headers_of(path: Path) -> list[dict[str, Any]]:
    """Header of each part, after a look at what the file is and how large; an InputError where that will not do."""
    if not first_bytes(path).startswith(MAGIC):
        raise InputError(f"{path} is not an OpenEXR file, whatever its name; export it as OpenEXR")
    headers = [header for header, _ in _parts(path, header_only=True)]
    _check_sizes(path, headers)
    return headers


def _parts(path: Path, *, header_only: bool) -> list[tuple[dict[str, Any], dict[str, Values]]]:
    """Header and channels of each part."""
    text = path_text(path)
    try:
        with _silence(), OpenEXR.File(text, separate_channels=True, header_only=header_only) as file:
            parts = [(_header(part), {n: c.pixels for n, c in part.channels.items()}) for part in file.parts]
    except FAULTS as error:
        raise _damaged(path) from error
    if not parts:  # what cannot be read is left out, with no other sign
        raise _damaged(path)
    return parts


def _header(part: OpenEXR.Part) -> dict[str, Any]:
    # Names of channels are decoded when they are asked for, which fails for those that are no UTF-8.
    return {**part.header, "channels": frozenset(channel.name for channel in part.header["channels"])}


def _damaged(path: Path) -> InputError:
    return InputError(f"{path} cannot be read as OpenEXR; it is damaged or cut off: copy or export it again")


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Drop what OpenEXR prints, on Python's and on the process's streams; what went wrong is said in our own line."""
    with _silencing, contextlib.redirect_stdout(io.StringIO()), Path(os.devnull).open("wb") as nowhere:
        kept = [(stream, os.dup(stream)) for stream in (1, 2)]
        try:
            for stream, _ in kept:
                os.dup2(nowhere.fileno(), stream)
            yield
        finally:
            for stream, copy in kept:
                os.dup2(copy, stream)
                os.close(copy)


def _check_sizes(path: Path, headers: Sequence[Header]) -> None:
    total = shown = 0
    for header in headers:
        data, display = _window(header, "dataWindow"), _window(header, "displayWindow")
        check_size(path, data.width, data.height)
        check_size(path, display.width, display.height)
        tile = header["tiles"] if header["type"] in TILED else None
        value_bytes = DEEP_VALUE_BYTES if header["type"] in DEEP else VALUE_BYTES
        # A tile may be larger than its picture, and takes that much room all the same.
        largest = max(data.width * data.height, tile.xSize * tile.ySize if tile else 0)
        total += largest * len(header["channels"]) * value_bytes
        shown = max(shown, 3 * display.width * display.height * VALUE_BYTES)
    if total > LARGEST_BYTES:
        raise InputError(
            f"{path} holds {total / 1e9:.1f} GB of pixels in all its channels; at most {LARGEST_BYTES / 1e9:.1f} GB "
            "are read: leave channels out or scale it down"
        )
    check_packing(path, max(total, shown))


def _window(header: Header, name: str) -> Window:
    (left, top), (right, bottom) = ((int(x), int(y)) for x, y in header[name])
    return Window(top, left, bottom - top + 1, right - left + 1)


# Which part


def _chosen(path: Path, headers: Sequence[Header]) -> int:
    flat = [index for index, header in enumerate(headers) if header["type"] not in DEEP]
    for index in flat:
        if headers[index]["channels"] >= {"R", "G", "B"} or "Y" in headers[index]["channels"]:
            return index
    if not flat:
        raise InputError(f"{path} is deep, with several samples a pixel; flatten it and give the flat picture")
    found = sorted(set().union(*(headers[index]["channels"] for index in flat)))
    shown = ", ".join(ascii(name)[1:-1] for name in found[:8]) + (" ..." if len(found) > 8 else "")
    raise InputError(
        f"{path} has the channels {shown}; needed are R, G and B, or Y: export them without a layer's name"
    )


def _choice_notes(headers: Sequence[Header], index: int) -> Iterator[str]:
    header = headers[index]
    if len(headers) > 1:
        yield f"part {index + 1} of {len(headers)} taken, named {header.get('name', '')!r}"
    views = header.get("multiView")
    if not isinstance(views, list):
        views = [other["view"] for other in headers if isinstance(other.get("view"), str)]
    if len(set(views)) > 1:
        yield f"view {header.get('view', views[0])!r} taken, of {len(set(views))} views"


# Its colours


def _radiance(path: Path, channels: Mapping[str, Values], header: Header) -> tuple[Radiance, list[str]]:
    """Radiance in Rec. 709, and notes on how it was had."""
    given = header.get("chromaticities", REC709)
    chromaticities = tuple(float(value) for value in given) if isinstance(given, tuple) else ()
    if len(chromaticities) != 8:
        raise _damaged(path)
    is_coloured = channels.keys() >= {"R", "G", "B"}
    full = [channels[name] for name in ("RGB" if is_coloured else "YYY")]
    data = _window(header, "dataWindow")
    if any(channel.shape != (data.height, data.width) for channel in full):
        raise InputError(
            f"{path} has red, green, blue or Y of fewer pixels than its window; export it at full resolution"
        )
    notes = ["its alpha channel is left aside"] if "A" in channels else []
    if is_coloured:
        radiance = _stacked(full)
    elif channels.keys() >= {"RY", "BY"}:
        radiance = _from_chroma(channels, _luminance_shares(path, chromaticities))
        notes.append("luminance and chroma taken apart into red, green and blue")
    else:
        return _stacked(full), [*notes, "luminance alone taken as grey"]
    if not np.allclose(chromaticities, REC709, rtol=0.0, atol=1e-4):
        radiance = to_rec709(path, radiance, chromaticities)
        notes.append("its primaries are converted to those of Rec. 709")
    return radiance, notes


def _stacked(channels: Sequence[Values]) -> Radiance:
    dtype = np.float16 if all(channel.dtype == np.float16 for channel in channels) else np.float32
    radiance = np.empty((*channels[0].shape, 3), dtype)
    for index, channel in enumerate(channels):
        radiance[..., index] = channel
    return radiance


def _from_chroma(channels: Mapping[str, Values], shares: Sequence[float]) -> Radiance:
    """Red, green and blue of luminance, (R - Y) / Y and (B - Y) / Y."""
    luminance = channels["Y"]
    height, width = luminance.shape
    radiance = np.empty((height, width, 3), np.float32)
    for rows in bands(height):
        bright = luminance[rows].astype(np.float32)
        red, blue = ((1.0 + _enlarged(channels[name], rows, (height, width))) * bright for name in ("RY", "BY"))
        green = (bright - shares[0] * red - shares[2] * blue) / shares[1]
        radiance[rows] = np.stack([red, green, blue], -1)
    return radiance


def _enlarged(chroma: Values, rows: slice, size: tuple[int, int]) -> Float[np.ndarray, "rows width"]:
    """Band of a channel that has every second row and column, by straight lines between them."""
    height, width = chroma.shape
    upper, lower, share = _between(height, np.arange(size[0])[rows] * height / size[0])
    tall = chroma[upper] * (1.0 - share[:, None]) + chroma[lower] * share[:, None]
    left, right, share = _between(width, np.arange(size[1]) * width / size[1])
    enlarged: Float[np.ndarray, "rows width"] = tall[:, left] * (1.0 - share) + tall[:, right] * share
    return enlarged


def _between(count: int, place: Float[np.ndarray, " n"]) -> tuple[Any, Any, Float[np.ndarray, " n"]]:
    first = place.astype(int)
    return first, np.minimum(first + 1, count - 1), (place - first).astype(np.float32)


def _luminance_shares(path: Path, chromaticities: Sequence[float]) -> Sequence[float]:
    """What red, green and blue of some primaries add to the luminance of their white."""
    points = np.asarray(chromaticities).reshape(4, 2)
    tristimulus = np.column_stack([points, 1.0 - points.sum(-1)])
    try:
        amounts = np.linalg.solve(tristimulus[:3].T, tristimulus[3] / tristimulus[3, 1])
    except np.linalg.LinAlgError as error:
        raise InputError(f"{path} has chromaticities without an area; correct them where it was written") from error
    shares: Sequence[float] = (amounts * points[:3, 1]).tolist()
    return shares


# Its frame


def _window_notes(data: Window, display: Window) -> Iterator[str]:
    if data != display:
        yield (
            f"display window of {display.width} x {display.height} taken, of a data window of "
            f"{data.width} x {data.height}; what the data does not reach is masked"
        )


def _placed(path: Path, values: Any, data: Window, display: Window) -> Any:
    """Values of the data window as they lie in the display window."""
    if data == display:
        return values
    top, left = max(data.top, display.top), max(data.left, display.left)
    bottom = min(data.top + data.height, display.top + display.height)
    right = min(data.left + data.width, display.left + display.width)
    if top >= bottom or left >= right:
        raise InputError(f"{path} has its data outside its display window; crop or shift it where it was written")
    shown = values[top - data.top : bottom - data.top, left - data.left : right - data.left]
    if shown.shape[:2] == (display.height, display.width):
        return np.ascontiguousarray(shown)
    placed = np.full((display.height, display.width, *values.shape[2:]), np.nan, values.dtype)
    placed[top - display.top : bottom - display.top, left - display.left : right - display.left] = shown
    return placed
