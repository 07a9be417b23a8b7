"""A photo and its mask made larger, to see whether a fit's cost grows with the size of its photo."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from experiments.log_error import read_pixels
from experiments.shots import Shot


def enlarged(shot: Shot, width: int, folder: Path) -> Shot:
    """The shot with each pixel repeated until it is so wide, as a float .exr and a mask in a folder.

    Raises:
        ValueError: when the width is no multiple of the photo's.
    """
    photo, mask = folder / f"{shot.name}_{width}.exr", folder / f"{shot.name}_{width}.png"
    _write_repeated(read_pixels(shot.photo)[..., :3], width, photo, "float")
    _write_repeated(read_pixels(shot.mask)[..., :1], width, mask, "uint8")
    return replace(shot, photo=photo, mask=mask)


def _write_repeated(pixels: NDArray[np.float32], width: int, path: Path, number: str) -> None:
    """Written row by row: the whole picture would count towards the memory of processes started later."""
    rows, columns, channels = pixels.shape
    times = width // columns
    if width != times * columns:
        raise ValueError(f"{path.stem} cannot be made {width} wide from {columns}; give a multiple")
    specification = OpenImageIO.ImageSpec(width, rows * times, channels, number)
    specification.attribute("compression", "zip")
    output = OpenImageIO.ImageOutput.create(str(path))
    if output is None or not output.open(str(path), specification):
        raise ValueError(f"{path} cannot be written: {OpenImageIO.geterror()}")
    for row in range(rows):
        band = np.broadcast_to(np.repeat(pixels[row], times, axis=0), (times, width, channels))
        if not output.write_scanlines(row * times, (row + 1) * times, 0, np.ascontiguousarray(band)):
            raise ValueError(f"{path} cannot be written: {output.geterror()}")
    output.close()
