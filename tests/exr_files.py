"""EXR files of all kinds that the tests of fit.exr read."""

import resource
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

HEIGHT, WIDTH = 6, 8
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


def random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape, dtype=np.float32) + 0.5


def save(path: Path, channels: Mapping[str, np.ndarray], **header: Any) -> Path:
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)) as file:
        file.write(str(path))
    return path


def save_parts(path: Path, *parts: tuple[str, Mapping[str, np.ndarray], dict[str, Any]]) -> Path:
    with OpenEXR.File([OpenEXR.Part(dict(header), dict(channels), name) for name, channels, header in parts]) as file:
        file.write(str(path))
    return path


def attribute(name: str, kind: str, value: bytes) -> bytes:
    return b"\0".join([name.encode(), kind.encode(), struct.pack("<i", len(value)) + value])


def by_hand(channels: Mapping[str, np.ndarray], size: tuple[int, int], *extra: bytes) -> bytes:
    """Uncompressed file of float channels, which may have fewer rows and columns than the picture."""
    height, width = size
    names = sorted(channels)
    steps = {name: (height // channels[name].shape[0], width // channels[name].shape[1]) for name in names}
    table = b"".join(name.encode() + struct.pack("<xiBxxxii", 2, 0, steps[name][1], steps[name][0]) for name in names)
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<ii", 20000630, 2) + b"".join(
        [
            attribute("channels", "chlist", table + b"\0"),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
            *extra,
            b"\0",
        ]
    )
    lines = []
    for y in range(height):
        shown = [name for name in names if y % steps[name][0] == 0]
        line = b"".join(channels[name][y // steps[name][0]].astype("<f4").tobytes() for name in shown)
        lines.append(struct.pack("<ii", y, len(line)) + line)
    starts = len(head) + 8 * height + np.cumsum([0, *map(len, lines)])[:-1]
    return head + starts.astype("<u8").tobytes() + b"".join(lines)


def declared(width: int, height: int, channels: int) -> bytes:
    """Header of a file that would be as large, and nothing behind it."""
    names = {f"c{index}": np.zeros((1, 1)) for index in range(channels - 1)} | {"Y": np.zeros((1, 1))}
    content = by_hand(names, (1, 1))
    return content.replace(struct.pack("<5i", 16, 0, 0, 0, 0), struct.pack("<5i", 16, 0, 0, width - 1, height - 1))


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# Writing
