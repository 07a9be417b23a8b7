"""Anti-aliasing of drifting scenes against 256 samples in a pixel: error, flicker, and how much detail is left.

Methods of equal cost stand side by side: the checkerboard shades half of the pixels, the smaller frame ("0.7 two
frames", a 1512p beside 2160p, enlarged bicubically) 0.7 of the columns and of the rows. Of the picture less its blur,
"detail" is the correlation with that of the truth, and "contrast" its amount as a share of the truth's, so that blur
lowers the second and aliasing the first.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from diffrender.antialiasing import checkerboard, edge_taa, fxaa, tangram
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames, require_finite
from diffrender.parameters import defaults
from experiments import records
from experiments.aliased_scenes import ROOT_OF_SAMPLES, SCENES, Drifting
from fit import png

SIZE, FRAMES = (256, 144), 4
SMALL_SIZE, SMALL_FRAMES = (24, 16), 3
SMALLER = 0.7  # size of the frame that costs as much as a checkerboard
BORDER = 4  # pixels that are not judged
BLUR = 1.5  # standard deviation of the blur that detail is what is left of [pixels]
CROP, ENLARGED, GAP = 44, 4, 4  # pixels of the picture's crops
CROP_AT = (0.35, 0.28)  # where crops are, from the top and the left, as shares of where they can be

SETTINGS = defaults(AntiAliasing)


@dataclass(frozen=True)
class Judged:
    """How near a method comes to the truth on a scene.

    Attributes:
        error: root mean square, over all frames but the first, as the rest below.
        flicker: root mean square change of the error from frame to frame.
        variance: over time, in a pixel; the scene's own is that of the truth.
        detail: correlation with the truth's.
        contrast: of the detail, over the truth's.
    """

    scene: str
    method: str
    error: float
    flicker: float
    variance: float
    detail: float
    contrast: float


def none(scene: Drifting, frames: int) -> Tensor:
    """One sample in each pixel's centre."""
    return torch.stack([scene.sampled(time, (0.0, 0.0)) for time in range(frames)])


def fxaa_alone(scene: Drifting, frames: int) -> Tensor:
    """The same, smoothed."""
    return fxaa.preset(SETTINGS, none(scene, frames), quality=12)


def two_frames(scene: Drifting, frames: int) -> Tensor:
    """Two frames at pixel edges."""
    colour = torch.stack([scene.sampled(time, edge_taa.OFFSETS[time % 2]) for time in range(frames)])
    return edge_taa.render(SETTINGS, Frames(colour, scene.motion(frames), None))


def checkered(scene: Drifting, frames: int) -> Tensor:
    """Two frames of half of the corners."""
    corners = [tangram.lit(scene.sampled(time, checkerboard.OFFSET), parity=time % 2) for time in range(frames)]
    return checkerboard.render(SETTINGS, Frames(torch.stack(corners), scene.motion(frames), None))


def smaller_two_frames(scene: Drifting, frames: int) -> Tensor:
    """Two frames at pixel edges of a smaller picture, enlarged."""
    width, height = (2 * round(SMALLER * size / 2) for size in (scene.width, scene.height))
    return _enlarged(two_frames(Drifting(scene.shown, width, height), frames), scene)


def half_two_frames(scene: Drifting, frames: int) -> Tensor:
    """Two frames at pixel edges of a picture of half the size (1080p beside 2160p), enlarged."""
    return _enlarged(two_frames(Drifting(scene.shown, scene.width // 2, scene.height // 2), frames), scene)


def four_samples(scene: Drifting, frames: int) -> Tensor:
    """2 x 2 samples in each pixel."""
    return torch.stack([scene.supersampled(time, 2) for time in range(frames)])


def sixteen_samples(scene: Drifting, frames: int) -> Tensor:
    """4 x 4 samples in each pixel."""
    return torch.stack([scene.supersampled(time, 4) for time in range(frames)])


def truth(scene: Drifting, frames: int) -> Tensor:
    """256 samples in each pixel."""
    return torch.stack([scene.supersampled(time, ROOT_OF_SAMPLES) for time in range(frames)])


METHODS: dict[str, Callable[[Drifting, int], Tensor]] = {
    "none": none,
    "fxaa": fxaa_alone,
    "two frames": two_frames,
    "0.5 two frames": half_two_frames,
    "0.7 two frames": smaller_two_frames,
    "checkerboard": checkered,
    "2 x 2": four_samples,
    "4 x 4": sixteen_samples,
    "truth": truth,
}


def judged(scene: str, method: str, drawn: Tensor, wanted: Tensor) -> Judged:
    """Figures of a sequence beside the truth's."""
    require_finite(drawn, f"{method} of {scene}")
    inner = (slice(1, None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
    found, right = drawn[inner], wanted[inner]
    error = found - right
    ours, theirs = (_detail(sequence)[inner] for sequence in (drawn, wanted))
    together, power = (ours * theirs).mean(), (theirs * theirs).mean()
    return Judged(
        scene=scene,
        method=method,
        error=_root(error.square().mean()),
        flicker=_root(error.diff(dim=0).square().mean()),
        variance=float(found.var(0).mean()),
        detail=float(together / (power * (ours * ours).mean()).sqrt()),
        contrast=_root((ours * ours).mean() / power),
    )


def _root(mean_square: Tensor) -> float:
    return float(mean_square.sqrt())


def _detail(sequence: Tensor) -> Tensor:
    """Pictures less their blur."""
    reach = torch.arange(-4.0, 5.0)
    weight = torch.exp(-0.5 * (reach / BLUR) ** 2)
    weight = (weight / weight.sum()).expand(3, 1, -1)
    channels = sequence.movedim(-1, -3)
    blurred = torch.nn.functional.conv2d(channels, weight[:, :, None], padding=(0, 4), groups=3)
    blurred = torch.nn.functional.conv2d(blurred, weight[..., None], padding=(4, 0), groups=3)
    return (channels - blurred).movedim(-3, -1)


def _enlarged(sequence: Tensor, scene: Drifting) -> Tensor:
    size = (scene.height, scene.width)
    channels = sequence.movedim(-1, -3)
    return torch.nn.functional.interpolate(channels, size, mode="bicubic", align_corners=False).movedim(-3, -1)


def crops(pictures: Sequence[Sequence[Tensor]]) -> np.ndarray:
    """Crops of pictures, enlarged, scenes below each other and methods side by side."""
    rows = [np.concatenate([_crop(picture) for picture in row], 1) for row in pictures]
    return np.concatenate(rows, 0)


def _crop(picture: Tensor) -> np.ndarray:
    top, left = (int(share * max(size - CROP, 0)) for share, size in zip(CROP_AT, picture.shape, strict=False))
    pixels = np.rint(255.0 * picture[top : top + CROP, left : left + CROP].clamp(0.0, 1.0).numpy()).astype(np.uint8)
    large = pixels.repeat(ENLARGED, 0).repeat(ENLARGED, 1)
    return np.pad(large, ((0, GAP), (0, GAP), (0, 0)), constant_values=255)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures, and write them as JSON and crops of the last frames as a picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=["small", "full"], default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    size, frames = (SMALL_SIZE, SMALL_FRAMES) if given.size == "small" else (SIZE, FRAMES)
    figures, pictures = [], []
    for name, shown in SCENES.items():
        scene = Drifting(shown, *size)
        drawn = {method: draw(scene, frames) for method, draw in METHODS.items()}
        figures += [judged(name, method, sequence, drawn["truth"]) for method, sequence in drawn.items()]
        pictures.append([sequence[-1] for sequence in drawn.values()])
    columns = list(asdict(figures[0]))[2:]
    rows = [[f"{row.scene}: {row.method}", *(f"{getattr(row, name):.4f}" for name in columns)] for row in figures]
    print(records.table(["scene and method", *columns], rows))
    records.write(given.out / "anti_aliasing.json", {"size": size, "records": [asdict(row) for row in figures]})
    (given.out / "anti_aliasing.png").write_bytes(png.encoded(crops(pictures)))


if __name__ == "__main__":
    main()
