"""Good small files of every kind that `fit` reads, made from one photo, to be damaged."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO
from numpy.typing import NDArray

from experiments.mutations import ANY, EXR, TEXT, Mutation
from fit import exr, png

WIDTH, HEIGHT = 64, 32
SUN = ("--sun", "10,36")
# Stops after the first evaluation: what is judged is reading and writing. Every tenth fit goes on to its end.
QUICK = ("--seconds", "0.001")
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
SCANLINE = {"type": OpenEXR.scanlineimage}
TILED = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}

Picture = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Sample:
    """A good file and how a command is given it.

    Attributes:
        file: its name in the folder of the samples.
        mutations: by which it is damaged.
        words: of the command, in which "{}" stands for the damaged file.
        is_weather: whether it is a weather file, else a photo or mask.
    """

    file: str
    mutations: tuple[Mutation, ...]
    words: tuple[str, ...]
    is_weather: bool


def photo(path: Path) -> NDArray[np.float32]:
    """A photo made small by means of boxes; negative radiance becomes 0."""
    radiance = np.maximum(exr.read(path).radiance.astype(np.float32), 0.0)
    rows, columns = radiance.shape[0] // HEIGHT, radiance.shape[1] // WIDTH
    small: NDArray[np.float32] = radiance.reshape(HEIGHT, rows, WIDTH, columns, 3).mean((1, 3), dtype=np.float32)
    return small


def first(folder: Path, picture: NDArray[np.float32]) -> Path:
    """Write a good photo into a folder."""
    path = folder / "good.exr"
    _save(path, {"": {**SCANLINE, "RGB": picture}})
    return path


def write(folder: Path, picture: NDArray[np.float32], weather: bytes) -> list[Sample]:
    """Write the samples into a folder: photos, masks and weather files."""
    samples = [*_exr_photos(folder, picture), *_other_photos(folder, picture), *_weather(folder, weather)]
    for sample in samples:
        assert (folder / sample.file).stat().st_size > 0
    return samples


def _exr_photos(folder: Path, picture: NDArray[np.float32]) -> Iterator[Sample]:
    half = np.clip(picture, 0.0, 6e4).astype(np.float16)
    compressions = {
        name: getattr(OpenEXR, f"{name}_COMPRESSION")
        for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
    }
    files: dict[str, Mapping[str, Mapping[str, Any]]] = {}
    for name, compression in compressions.items():
        files[f"half_{name}.exr"] = {"": {**SCANLINE, "compression": compression, "RGB": half}}
    for name in ("ZIP", "PIZ", "NO"):
        chosen = compressions[name]
        files[f"float_{name}.exr"] = {"": {**SCANLINE, "compression": chosen, "RGB": picture}}
        files[f"tiled_{name}.exr"] = {"": {**TILED, "compression": chosen, "RGB": half}}
    zipped = {**SCANLINE, "compression": compressions["ZIP"]}
    depth = np.ones((HEIGHT, WIDTH), np.float32)
    files["parts.exr"] = {"beauty": {**zipped, "RGB": half}, "depth": {**zipped, "Z": depth}}
    files["grey.exr"] = {"": {**zipped, "Y": picture.mean(-1), "Z": depth}}
    files["said.exr"] = {
        "": {
            **zipped,
            "RGBA": np.dstack([half, np.ones_like(half[..., :1])]),
            "chromaticities": ACES,
            "owner": "nobody",
            "capDate": "2016:08:14 06:30:00",
            "utcOffset": -7200.0,
            "latitude": -26.2,
        }
    }
    for name, parts in files.items():
        _save(folder / name, parts)
        yield Sample(name, EXR, ("sky", "{}"), is_weather=False)
        yield Sample(name, EXR, ("sky", "{}", *SUN), is_weather=False)


def _save(path: Path, parts: Mapping[str, Mapping[str, Any]]) -> None:
    """Write parts, whose arrays are channels and the rest attributes."""
    made = []
    for name, entries in parts.items():
        channels = {key: np.ascontiguousarray(v) for key, v in entries.items() if isinstance(v, np.ndarray)}
        made.append(OpenEXR.Part({k: v for k, v in entries.items() if k not in channels}, channels, name))
    with OpenEXR.File(made) as file:
        file.write(str(path))


def _other_photos(folder: Path, picture: NDArray[np.float32]) -> Iterator[Sample]:
    for name, pixels in (("photo.hdr", picture), ("noisy.hdr", picture * np.linspace(1.0, 1.3, WIDTH)[:, None])):
        if not OpenImageIO.ImageBuf(np.ascontiguousarray(pixels, np.float32)).write(str(folder / name)):
            raise RuntimeError(OpenImageIO.geterror())
        yield from [Sample(name, (*ANY, *TEXT[-3:]), ("sky", "{}", *SUN), is_weather=False)] * 3
    above = np.zeros((HEIGHT, WIDTH, 1), np.uint8)
    above[: HEIGHT // 2 - 2] = 255
    for name, channels in (("grey.png", 1), ("colour.png", 3), ("alpha.png", 4)):
        (folder / name).write_bytes(png.encoded(above.repeat(channels, -1)))
        words = ("sky", str(folder / "half_ZIP.exr"), *SUN, "--mask", "{}")
        yield Sample(name, ANY, words, is_weather=False)


def _weather(folder: Path, weather: bytes) -> Iterator[Sample]:
    (folder / "weather.csv").write_bytes(weather)
    rows = [row for row in weather.decode().splitlines() if not row.startswith("#")]
    table = [row.split(",") for row in rows]
    day = [";".join([name, value, "", value]) for name, value in table[1:]]
    header = ["# weather 1", "# origin: spreadsheet", "# latitude: -26.2", "# date: 2016-08-14"]
    (folder / "day.csv").write_text("\n".join([*header, "TIME_OF_DAY;6.5;12;18", *day]) + "\n", encoding="utf-8")
    for name in ("weather.csv", "day.csv"):
        start = ("sky", str(folder / "half_ZIP.exr"), *SUN, "--start", "{}")
        yield Sample(name, TEXT, start, is_weather=True)
        yield from [Sample(name, TEXT, ("render", "{}", "--size", "16x8", "--hour", "6.5"), is_weather=True)] * 3
