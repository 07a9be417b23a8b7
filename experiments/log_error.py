"""E3: how far a fitted sky's log radiance is from its photo's, with one free gain per channel.

Over the pixels i of a mask and the channels c, with P the photo, M the fitted picture and w the cosine of elevation:

    E3 = min over gains s of sum_i w_i 1/3 sum_c [ln(s_c max(M_ic, 0) + eps) - ln(max(P_ic, 0) + eps)]^2 / sum_i w_i

Pictures of 1024 x 512 are first reduced to 512 x 256, on which the peers were measured. It shares no code with the
fit, so it cannot share its mistakes.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO
from numpy.typing import NDArray

MEASURED_WIDTH = 512  # of the pictures on which the peers were measured
EPS_SHARE = 1e-3  # of the median radiance under the mask: what counts as black
STEPS, SETTLED = 100, 1e-9  # of the search for a gain, and the change of its logarithm that ends it

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Sky:
    """The masked pixels of a panorama.

    Attributes:
        log_radiance: ln(max(P, 0) + eps), one row a pixel.
        weight: share of each pixel in the solid angle; sums to 1.
        eps: what is added to radiance before its logarithm is taken, in the unit of the photo.
        mask: which pixels of the panorama they are, top row first.
    """

    log_radiance: Floats
    weight: Floats
    eps: float
    mask: Mask


@dataclass(frozen=True)
class LogError:
    """E3, and the gains that reach it."""

    error: float
    gains: tuple[float, float, float]
    eps: float
    pixels: int


def read_picture(path: Path) -> Floats:
    """Linear radiance of an .exr file's first part or of an .hdr file, at most 512 x 256; Rec. 709 is not checked.

    Raises:
        ValueError: when it is no whole panorama with R, G and B.
    """
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.parts[0].channels
            missing = [name for name in "RGB" if name not in channels]
            if missing:
                raise ValueError(f"{path} has no channel {missing[0]} in its first part; it needs R, G and B")
            picture = np.stack([channels[name].pixels.astype(np.float64) for name in "RGB"], -1)
    else:
        picture = read_pixels(path)[..., :3].astype(np.float64)
    return reduced(panorama(picture, path))


def read_mask(path: Path) -> Mask:
    """White pixels of a mask, at most 512 x 256; a reduced pixel counts where all it is made of do.

    Raises:
        ValueError: when it is no whole panorama.
    """
    grey = read_pixels(path)[..., 0]
    white: Mask = reduced(panorama((grey > 0.5).astype(np.float64), path)) == 1.0
    return white


def read_pixels(path: Path) -> NDArray[np.float32]:
    """All channels of an image file but an .exr with many parts, in its own size.

    Raises:
        ValueError: when it cannot be read.
    """
    buffer = OpenImageIO.ImageBuf(str(path))
    pixels = buffer.get_pixels(OpenImageIO.FLOAT)
    if buffer.has_error or pixels is None:
        raise ValueError(f"{path} cannot be read: {buffer.geterror()}")
    rows: NDArray[np.float32] = pixels.reshape(buffer.spec().height, buffer.spec().width, -1)
    return rows


def panorama(picture: Floats, path: Path) -> Floats:
    """The picture, if its shape is that of a whole sphere.

    Raises:
        ValueError: when it is not.
    """
    height, width = picture.shape[:2]
    if width != 2 * height:
        raise ValueError(f"{path} is {width} x {height}; only whole panoramas, 2:1, are measured")
    return picture


def reduced(picture: Floats) -> Floats:
    """Picture halved by 2 x 2 boxes until it is no wider than 512.

    Raises:
        ValueError: when its size is no power of 2 times that.
    """
    while picture.shape[1] > MEASURED_WIDTH:
        height, width = picture.shape[:2]
        if height % 2 or width % 2:
            raise ValueError(f"a picture {width} x {height} cannot be halved; give one whose sides are powers of 2")
        picture = picture.reshape(height // 2, 2, width // 2, 2, *picture.shape[2:]).mean((1, 3))
    return picture


def sky_under(mask: Mask, photo: Floats, eps: float | None) -> Sky:
    """Masked pixels of a photo; eps defaults to a thousandth of their median.

    Raises:
        ValueError: when mask and photo differ in size, or the mask is empty or shows pixels that are not finite.
    """
    if mask.shape != photo.shape[:2]:
        raise ValueError(f"the mask is {mask.shape}, the photo {photo.shape[:2]} rows and columns; make them equal")
    if not mask.any():
        raise ValueError("the mask has no white pixel")
    radiance = np.maximum(photo[mask], 0.0)
    if not np.isfinite(radiance).all():
        raise ValueError("the photo has pixels under the mask that are not finite; mask them")
    weight = cos_elevation(mask)
    if eps is None:
        eps = EPS_SHARE * float(np.median(radiance))
    return Sky(np.log(radiance + eps), weight / weight.sum(), eps, mask)


def cos_elevation(mask: Mask) -> Floats:
    """Cosine of the elevation of each masked pixel: its solid angle, but for a factor."""
    height = mask.shape[0]
    rows = np.nonzero(mask)[0]
    cosine: Floats = np.sin(np.pi * (rows + 0.5) / height)
    return cosine


def log_error(sky: Sky, fitted: Floats) -> LogError:
    """E3 of a fitted picture of the photo's size.

    Raises:
        ValueError: when their sizes differ, or the fitted picture has pixels under the mask that are not finite.
    """
    if fitted.shape[:2] != sky.mask.shape:
        raise ValueError(f"the fitted picture is {fitted.shape[:2]}, the photo {sky.mask.shape} rows and columns")
    radiance = np.maximum(fitted[sky.mask], 0.0)
    if not np.isfinite(radiance).all():
        raise ValueError("the fitted picture has pixels under the mask that are not finite")
    errors, gains = zip(*(_channel(sky, radiance[:, channel], channel) for channel in range(3)), strict=True)
    red, green, blue = gains
    return LogError(float(np.mean(errors)), (red, green, blue), sky.eps, int(sky.mask.sum()))


def _channel(sky: Sky, radiance: Floats, channel: int) -> tuple[float, float]:
    """Least mean square of one channel and the gain that reaches it, by Gauss-Newton steps on its logarithm."""
    wanted = sky.log_radiance[:, channel]
    log_gain = float(sky.weight @ (wanted - np.log(radiance + sky.eps)))
    for _ in range(STEPS):
        gained = np.exp(log_gain) * radiance
        residual = np.log(gained + sky.eps) - wanted
        slope = gained / (gained + sky.eps)
        steepness = float(sky.weight @ (slope * slope))
        step = -float(sky.weight @ (slope * residual)) / steepness if steepness > 0.0 else 0.0
        log_gain += step
        if abs(step) < SETTLED:
            return float(sky.weight @ (residual * residual)), float(np.exp(log_gain))
    raise ArithmeticError(f"the gain of channel {channel} did not settle in {STEPS} steps")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print E3 and the gains."""
    parser = argparse.ArgumentParser(description="E3 of a fitted sky")
    parser.add_argument("photo", type=Path)
    parser.add_argument("fitted", type=Path)
    parser.add_argument("mask", type=Path)
    parser.add_argument("--eps", type=float, help="default: a thousandth of the median under the mask")
    given = parser.parse_args(arguments)
    sky = sky_under(read_mask(given.mask), read_picture(given.photo), given.eps)
    found = log_error(sky, read_picture(given.fitted))
    gains = " ".join(f"{gain:.6g}" for gain in found.gains)
    print(f"E3 {found.error:.6f}  gains {gains}  eps {found.eps:.6g}  pixels {found.pixels}")


if __name__ == "__main__":
    main()
