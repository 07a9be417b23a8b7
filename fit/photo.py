"""Photo: an HDR file as radiance, the camera that saw it, and what the file says of the shot.

Formats are told apart by their first bytes. A picture's projection is the one asked for, or the one its attribute
`envmap` names, or the one its shape gives away; else it is a perspective picture and its field of view must be known.
"""

import math
import re
from collections import ChainMap
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender import rays
from diffrender.colour import REC709
from fit import exr
from fit.input_error import InputError
from fit.limits import check_packing, check_size
from fit.path_text import path_text

PROJECTIONS = {
    "equirectangular": "2:1, or 4:1 for the upper half",
    "hemisphere": "4:1, the upper half of an equirectangular panorama",
    "cubemap": "4:3 or 3:4 for a cross, 6:1 or 1:6 for a strip",
    "perspective": "any",
}
LAYOUTS = (rays.CROSS_LYING, rays.CROSS_STANDING, rays.STRIP_LYING, rays.STRIP_STANDING)

RADIANCE_MAGIC = b"#?"
LARGEST_RADIANCE_HEADER = 65_536  # bytes
OTHER_FORMATS = {
    b"\xff\xd8\xff": "a JPEG",
    b"\x89PNG": "a PNG",
    b"GIF8": "a GIF",
    b"BM": "a bitmap",
    b"RIFF": "a WebP",
    b"II*\0": "a TIFF or camera raw",
    b"MM\0*": "a TIFF or camera raw",
    b"II+\0": "a TIFF",
    b"IIU\0": "a camera raw",
    b"IIRO": "a camera raw",
    b"FUJIFILM": "a camera raw",
}
HOW_TO_GET_HDR = (
    "merge a bracketed series of shots, or develop a raw file linearly, to OpenEXR or Radiance .hdr, "
    "for example in darktable or Luminance HDR"
)


@dataclass(frozen=True, eq=False)
class Photo:
    """A picture in memory, in the precision of its file; use it by bands of rows.

    Attributes:
        path: where it was read from.
        radiance: linear Rec. 709; half where the file is half and needed no conversion, else float.
        camera: what its pixels saw.
        header: `time` (with its zone), `latitude`, `longitude` (degrees), `altitude` (metres); None where not known.
        notes: what was recognised, assumed or left aside, one sentence each.
        distance: channel Z of the file.
    """

    path: Path
    radiance: Float[np.ndarray, "height width 3"]
    camera: rays.Camera
    header: Mapping[str, object]
    notes: tuple[str, ...]
    distance: Float[np.ndarray, "height width"] | None

    def band(self, rows: slice) -> Float[Tensor, "rows width 3"]:
        """Radiance of some rows, as a float32 copy."""
        with np.errstate(invalid="ignore"):  # a half may be a signalling NaN
            return torch.from_numpy(self.radiance[rows].astype(np.float32))

    def valid(self, rows: slice) -> Bool[Tensor, "rows width"]:
        """Where some rows show something: radiance is finite and not negative in every channel."""
        band = self.band(rows)
        shown = self.camera.solid_angle(*rays.pixel_centres(self.camera, rows, band)) > 0.0
        return shown & (torch.isfinite(band) & (band >= 0.0)).all(-1)

    def counts(self) -> dict[str, int]:
        """Number of pixels with a channel that is `nonfinite`, and of the others with one that is `negative`."""
        nonfinite = negative = 0
        for rows in exr.bands(len(self.radiance)):
            band = self.band(rows)
            finite = torch.isfinite(band).all(-1)
            nonfinite += int((~finite).sum())
            negative += int((finite & (band < 0.0).any(-1)).sum())
        return {"nonfinite": nonfinite, "negative": negative}


def read(path: Path, projection: str | None = None, field_of_view: float | None = None, pitch: float = 0.0) -> Photo:
    """Photo of an OpenEXR or Radiance file.

    Args:
        path: of the file.
        projection: one of PROJECTIONS, or None to recognise it.
        field_of_view: across the width, in degrees, of a perspective picture.
        pitch: of a perspective camera, in degrees upwards.

    Raises:
        InputError: when the file is none that can be read, or the options do not suit it.
    """
    _check_options(projection, field_of_view, pitch)
    picture = read_picture(path)
    kind = projection or ("perspective" if field_of_view is not None else _recognised(picture))
    if kind == "perspective":
        camera, camera_notes = _perspective(path, picture, field_of_view, pitch)
    elif field_of_view is not None or pitch != 0.0:
        raise InputError(f"--fov and --pitch are for perspective pictures, and {path} is {kind}; leave them out")
    else:
        camera, camera_notes = _panorama(path, picture, kind)
    header, capture_notes = _capture(picture.header)
    notes = (*picture.notes, *camera_notes, *capture_notes)
    return Photo(path, picture.radiance, camera, header, notes, picture.distance)


def read_picture(path: Path) -> exr.Picture:
    """What an OpenEXR or Radiance file shows.

    Raises:
        InputError: when the file is none that can be read.
    """
    first = exr.first_bytes(path)
    if first.startswith(exr.MAGIC):
        return exr.read(path)
    if first.startswith(RADIANCE_MAGIC):
        return _read_radiance(path)
    raise _no_hdr(path, first)


def capture(path: Path) -> Mapping[str, object]:
    """What a file says of its shot, as in `Photo.header`, without reading its pixels.

    Raises:
        InputError: when the file is neither OpenEXR nor Radiance.
    """
    first = exr.first_bytes(path)
    if not first.startswith((exr.MAGIC, RADIANCE_MAGIC)):
        raise _no_hdr(path, first)
    # Of several parts the first that says something: they are of one shot.
    return _capture(ChainMap(*exr.headers_of(path)) if first.startswith(exr.MAGIC) else {})[0]


def _check_options(projection: str | None, field_of_view: float | None, pitch: float) -> None:
    if projection is not None and projection not in PROJECTIONS:
        raise InputError(f"--projection {projection} is unknown; allowed are {', '.join(PROJECTIONS)}")
    if field_of_view is not None and not 0.0 < field_of_view < 180.0:
        raise InputError(f"--fov {field_of_view:g}; allowed is a number of degrees above 0 and below 180")
    if not -90.0 <= pitch <= 90.0:
        raise InputError(f"--pitch {pitch:g}; allowed is a number of degrees from -90 to 90")


def _no_hdr(path: Path, first: bytes) -> InputError:
    named = [name for magic, name in OTHER_FORMATS.items() if first.startswith(magic)]
    if first[4:8] == b"ftyp":
        named = ["a HEIF or camera raw"]
    if named:
        return InputError(f"{path} is {named[0]}, which holds no linear radiance; {HOW_TO_GET_HDR}")
    return InputError(f"{path} is neither OpenEXR nor Radiance .hdr, whatever its name; {HOW_TO_GET_HDR}")


# Projections


def _recognised(picture: exr.Picture) -> str:
    """Projection that the attribute `envmap` or the shape of a picture gives away."""
    height, width = picture.radiance.shape[:2]
    layout = _layout(picture)
    named = _named(picture)
    if named is not None:
        return named
    if width == 2 * height:
        return "equirectangular"
    if width == 4 * height:
        return "hemisphere"
    return "cubemap" if layout is not None and _has_black_corners(picture, layout) else "perspective"


def _named(picture: exr.Picture) -> str | None:
    # By its text: a strange file may hold any type under this name.
    kinds = {"Envmap.ENVMAP_LATLONG": "equirectangular", "Envmap.ENVMAP_CUBE": "cubemap"}
    return kinds.get(str(picture.header.get("envmap")))


def _panorama(path: Path, picture: exr.Picture, kind: str) -> tuple[rays.Camera, list[str]]:
    height, width = picture.radiance.shape[:2]
    layout = _layout(picture)
    size = f"{width} x {height} picture taken as"
    if kind == "equirectangular" and (width == 2 * height or _named(picture) == kind):
        return rays.Equirectangular(width, height), [f"{size} a full equirectangular panorama"]
    if kind in ("equirectangular", "hemisphere") and width == 4 * height:
        return rays.Equirectangular(width, height, lowest=0.0), [
            f"{size} the upper half of an equirectangular panorama"
        ]
    if kind == "cubemap" and layout is not None:
        order = "OpenEXR's" if layout is rays.STRIP_OPENEXR else "OpenGL's"
        shape = f"a cubemap in {order} order" if min(len(layout), len(layout[0])) == 1 else "a cubemap in a cross"
        return rays.Cubemap(width // len(layout[0]), layout), [f"{size} {shape}"]
    raise InputError(
        f"{path} is {width} x {height}, which is the wrong projection for {kind} ({PROJECTIONS[kind]}); "
        "give the right --projection, or the picture uncropped"
    )


def _layout(picture: exr.Picture) -> tuple[tuple[str | None, ...], ...] | None:
    height, width = picture.radiance.shape[:2]
    for layout in LAYOUTS:
        rows, columns = len(layout), len(layout[0])
        if width * rows == height * columns and width % columns == 0:
            return rays.STRIP_OPENEXR if rows == 6 and _named(picture) == "cubemap" else layout
    return None


def _has_black_corners(picture: exr.Picture, layout: tuple[tuple[str | None, ...], ...]) -> bool:
    side = picture.radiance.shape[0] // len(layout)
    empty = [(r, c) for r, line in enumerate(layout) for c, face in enumerate(line) if face is None]
    return not any(picture.radiance[r * side : (r + 1) * side, c * side : (c + 1) * side].any() for r, c in empty)


def _perspective(
    path: Path, picture: exr.Picture, field_of_view: float | None, pitch: float
) -> tuple[rays.Camera, list[str]]:
    height, width = picture.radiance.shape[:2]
    aspect = float(picture.header.get("pixelAspectRatio", 1.0))
    if not abs(aspect - 1.0) < 0.01:
        raise InputError(f"{path} has pixels {aspect:g} times as wide as high; scale it to square pixels")
    notes = []
    if field_of_view is None:
        window = float(picture.header.get("screenWindowWidth", 1.0))
        if window == 1.0 or not 0.0 < window < math.inf:  # 1 is what is written where nothing is known
            raise InputError(
                f"{path} is {width} x {height}, which is no shape of a panorama; give its field of view across the "
                "width by --fov DEGREES, or its --projection"
            )
        field_of_view = math.degrees(2.0 * math.atan(window / 2.0))
        notes.append(f"field of view of {field_of_view:.4g} degrees taken from its screenWindowWidth")
    if np.any(picture.header.get("screenWindowCenter", 0.0)):
        notes.append("its screenWindowCenter is left aside: the camera looks at the middle of the picture")
    return rays.Perspective(width, height, math.radians(field_of_view), math.radians(pitch)), notes


# The shot


def _capture(header: Mapping[str, Any]) -> tuple[dict[str, object], list[str]]:
    """What the file says of place and time, and notes on what of it is left aside."""
    known: dict[str, object] = {"time": None}
    notes = []
    if "capDate" in header:
        try:
            local = datetime.strptime(header["capDate"], "%Y:%m:%d %H:%M:%S")
            # In OpenEXR utcOffset is what is added to local time to get universal time: positive in the west.
            known["time"] = local.replace(tzinfo=timezone(timedelta(seconds=-header["utcOffset"])))
        except (KeyError, TypeError, ValueError, OverflowError):
            notes.append("its capDate is left aside: it is no date, or has no utcOffset")
    for name, largest in (("latitude", 90.0), ("longitude", 180.0), ("altitude", 1e6)):
        value = header.get(name)
        is_known = isinstance(value, float) and abs(value) <= largest
        known[name] = value if is_known else None
        if value is not None and not is_known:
            notes.append(f"its {name} is left aside: it is out of range")
    return known, notes


# Radiance .hdr


def _read_radiance(path: Path) -> exr.Picture:
    """Picture of a Radiance file; its pixels are read by OpenImageIO, which looks at little of the header."""
    with path.open("rb") as file:
        header, _, rest = file.read(LARGEST_RADIANCE_HEADER).partition(b"\n\n")
    lines = [line.split("=", 1) for line in header.decode("latin-1").splitlines() if "=" in line and line[0] != "#"]
    variables = {line[0].strip(): line[1].strip() for line in lines}
    size = re.match(rb"([-+][XY]) +(\d{1,9}) +([-+][XY]) +(\d{1,9})\n", rest)
    if size is None:
        raise _damaged(path)
    if (size[1], size[3]) != (b"-Y", b"+X"):
        raise InputError(f"{path} is stored turned or mirrored; save it with its first row on top (-Y +X)")
    height, width = int(size[2]), int(size[4])
    check_size(path, width, height)
    check_packing(path, 3 * width * height * exr.VALUE_BYTES)
    given = variables.get("FORMAT", "")
    if given != "32-bit_rle_rgbe":
        raise InputError(f"{path} has the FORMAT {given!a}; needed is 32-bit_rle_rgbe: convert it with ra_xyze -r")
    radiance = _radiance_pixels(path, (height, width, 3))
    notes = [
        f"its {name} is left aside: radiance is known up to a factor for each channel"
        for name in ("EXPOSURE", "COLORCORR")
        if name in variables
    ]
    chromaticities = _primaries(path, variables.get("PRIMARIES", ""))
    if chromaticities:
        radiance = exr.to_rec709(path, radiance, chromaticities)
        notes.append("its primaries are converted to those of Rec. 709")
    return exr.Picture(radiance, None, {}, tuple(notes))


def _radiance_pixels(path: Path, shape: tuple[int, int, int]) -> Float[np.ndarray, "height width 3"]:
    reader = OpenImageIO.ImageInput.open(path_text(path))
    if reader is None:
        OpenImageIO.geterror()  # an error that nobody fetched is printed when the program ends
        raise _damaged(path)
    spec = reader.spec()
    # The size that was checked must be the one that is read, whatever a strange header may say.
    same = (spec.height, spec.width, spec.nchannels) == shape
    radiance: Float[np.ndarray, "height width 3"] | None = reader.read_image(OpenImageIO.FLOAT) if same else None
    reader.geterror()
    reader.close()
    if radiance is None:
        raise _damaged(path)
    return radiance


def _primaries(path: Path, given: str) -> tuple[float, ...]:
    """Chromaticities of the header, none where they are Rec. 709's or the eight zeros that some programs write."""
    try:
        chromaticities = tuple(float(word) for word in given.split())
    except ValueError:
        chromaticities = ()
    if given and len(chromaticities) != 8:
        raise InputError(f"{path} has PRIMARIES that are not eight numbers; correct or remove that line")
    if not any(chromaticities) or np.allclose(chromaticities, REC709, rtol=0.0, atol=1e-3):
        return ()
    return chromaticities


def _damaged(path: Path) -> InputError:
    return InputError(f"{path} cannot be read as Radiance .hdr; it is damaged or cut off: copy or export it again")
