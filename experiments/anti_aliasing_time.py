"""How long one frame of anti-aliasing takes and how much memory, beside a copy of the picture; eager and compiled.

Each is timed in turn with the copy, so that what else the machine does slows both. Memory is the peak of a process
of its own that draws one frame, less that of one that copies it, in pictures. `--once` is such a process.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from diffrender.antialiasing import checkerboard, edge_taa, fxaa
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames
from diffrender.parameters import defaults
from experiments import fit_command, records
from experiments.timing import THREADS, Spread, interleaved

SIZES, ROUNDS = ((1920, 1080), (3840, 2160)), 4
SMALL_SIZES, SMALL_ROUNDS = ((64, 36),), 1
BYTES = 3 * 4  # of a pixel

SETTINGS = defaults(AntiAliasing)
Work = Callable[[], Tensor]


@dataclass(frozen=True)
class FrameTime:
    """Time of one frame over that of a copy of the picture, and memory in pictures."""

    method: str
    width: int
    height: int
    eager: Spread
    compiled: Spread
    eager_pictures: float


def picture_of(width: int, height: int) -> Tensor:
    """Noise and blocks: edges of all kinds in a known share of the pixels."""
    generator = torch.Generator().manual_seed(0)
    blocks = torch.rand(-(-height // 8), -(-width // 8), 3, generator=generator)
    whole = blocks.repeat_interleave(8, 0).repeat_interleave(8, 1)[:height, :width]
    return whole + 0.02 * torch.rand(height, width, 3, generator=generator)


def copied(width: int, height: int) -> Work:
    """Copy of the picture."""
    return picture_of(width, height).clone


def smoothed(width: int, height: int) -> Work:
    """FXAA alone."""
    return partial(fxaa.preset, SETTINGS, picture_of(width, height), quality=12)


def two_frames(width: int, height: int) -> Work:
    """Second of two frames at pixel edges, at rest."""
    frame = Frames(picture_of(width, height), torch.zeros(height // 2, width // 2, 2), None)
    _, state = edge_taa.step(SETTINGS, frame, None)
    return lambda: edge_taa.step(SETTINGS, frame, state)[0]


def checkered(width: int, height: int) -> Work:
    """Second of two frames of half of the corners, at rest."""
    frame = Frames(picture_of(width // 2, height), torch.zeros(height // 2, width // 2, 2), None)
    _, state = checkerboard.step(SETTINGS, frame, None)
    return lambda: checkerboard.step(SETTINGS, frame, state)[0]


METHODS: dict[str, Callable[[int, int], Work]] = {
    "copy": copied,
    "fxaa": smoothed,
    "two frames": two_frames,
    "checkerboard": checkered,
}


def seconds(work: Work) -> float:
    """Time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def over_copy(work: Work, copy: Work, rounds: int) -> Spread:
    """Time of a work over that of copies taken in turn with it."""
    return interleaved(lambda: sum(seconds(copy) for _ in range(5)) / 5, lambda: seconds(work), rounds).ratio


def peak(method: str, width: int, height: int) -> int:
    """Largest memory of a process that draws one frame [bytes]."""
    module = [sys.executable, "-m", "experiments.anti_aliasing_time"]
    return fit_command.run_well([*module, "--once", method, str(width), str(height)]).peak_bytes


def measured(method: str, width: int, height: int, rounds: int) -> FrameTime:
    """Figures of one method."""
    work, copy = METHODS[method](width, height), copied(width, height)
    torch.compiler.reset()
    compiled = torch.compile(work, dynamic=False)
    return FrameTime(
        method=method,
        width=width,
        height=height,
        eager=over_copy(work, copy, rounds),
        compiled=over_copy(compiled, copy, rounds),
        eager_pictures=(peak(method, width, height) - peak("copy", width, height)) / (BYTES * width * height),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the ratios and write them as JSON; or draw one frame."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=["small", "full"], default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    parser.add_argument("--once", nargs=3, metavar=("METHOD", "WIDTH", "HEIGHT"))
    given = parser.parse_args(arguments)
    torch.set_num_threads(THREADS)
    if given.once:
        METHODS[given.once[0]](*map(int, given.once[1:]))()
        return
    sizes, rounds = (SMALL_SIZES, SMALL_ROUNDS) if given.size == "small" else (SIZES, ROUNDS)
    rows = [measured(method, *size, rounds) for size in sizes for method in list(METHODS)[1:]]
    lines = [
        [f"{row.width} x {row.height} {row.method}", str(row.eager), str(row.compiled), f"{row.eager_pictures:.1f}"]
        for row in rows
    ]
    print(records.table(["frame", "eager over a copy", "compiled over a copy", "memory in pictures"], lines))
    records.write(given.out / "anti_aliasing_time.json", {"records": [asdict(row) for row in rows]})


if __name__ == "__main__":
    main()
