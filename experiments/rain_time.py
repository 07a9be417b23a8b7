"""How long a picture of rain takes and how much memory, beside a copy of the picture, by rung and number of drops.

Each rung takes turns with the copy, so that what else the machine does slows both. Memory is the peak of a process of
its own that draws one picture, less that of one that copies it, in pictures. `--once` is such a process.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path

import torch
from torch import Tensor

from diffrender.weather import rain
from experiments import fit_command, records
from experiments.rain import FALLING, Panel, dice, moment_of, rain_of
from experiments.rain_street import rain_view
from experiments.timing import Spread, interleaved, one_thread

SIZE, ROUNDS = (480, 270), 3
SMALL_SIZE, SMALL_ROUNDS = (16, 9), 1
RATES = (4e3, 16e3)  # [1/s]
COPIES = 20  # that are timed at once
BYTES = 3 * 4  # of a pixel

Work = Callable[[], Tensor]


@dataclass(frozen=True)
class RainTime:
    """Time of one picture over that of its copy, and memory in pictures."""

    rung: str
    rate: float
    drops: int
    time: Spread
    pictures: float


def work_of(rung: str, rate: float, size: tuple[int, int]) -> Work:
    """Picture of the street in rain, or a copy of the street's."""
    some_rain = rain_of({"particle_emit_rate": rate})
    view = rain_view(some_rain, dice(some_rain), size, moment_of(Panel("")), FALLING)
    return view.background.clone if rung == "copy" else partial(rain.EFFECT.rungs[rung], some_rain, view)


def seconds(work: Work, times: int) -> float:
    """Processor time of one call, of so many."""
    start = time.process_time()
    for _ in range(times):
        work()
    return (time.process_time() - start) / times


@cache
def peak(rung: str, rate: float, size: tuple[int, int]) -> int:
    """Largest memory of a process that draws one picture [bytes]."""
    module = [sys.executable, "-m", "experiments.rain_time"]
    return fit_command.run_well([*module, "--once", rung, str(rate), *map(str, size)]).peak_bytes


def measured(rung: str, rate: float, size: tuple[int, int], rounds: int) -> RainTime:
    """Figures of one rung."""
    work, copy = work_of(rung, rate, size), work_of("copy", rate, size)
    found = interleaved(partial(seconds, copy, COPIES), partial(seconds, work, 1), rounds)
    more = peak(rung, rate, size) - peak("copy", rate, size)
    drops = len(dice(rain_of({"particle_emit_rate": rate})).rank)
    return RainTime(rung, rate, drops, found.ratio, more / (BYTES * size[0] * size[1]))


@torch.no_grad()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the ratios and write them as JSON; or draw one picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    parser.add_argument("--once", nargs=4, metavar=("RUNG", "RATE", "WIDTH", "HEIGHT"))
    given = parser.parse_args(arguments)
    with one_thread():
        if given.once:
            rung, rate, width, height = given.once
            work_of(rung, float(rate), (int(width), int(height)))()
            return
        size, rounds, rates = (SMALL_SIZE, SMALL_ROUNDS, RATES[:1]) if given.size == "small" else (SIZE, ROUNDS, RATES)
        rungs = [rung for rung in rain.EFFECT.rungs if rung != "skip"]
        rows = [measured(rung, rate, size, rounds) for rate in rates for rung in rungs]
    lines = [[f"{row.rung}, {row.rate:g} 1/s", str(row.drops), str(row.time), f"{row.pictures:.0f}"] for row in rows]
    print(records.table(["rung and rate", "drops", "time over a copy", "memory in pictures"], lines))
    records.write(given.out / "rain_time.json", {"size": size, "records": [asdict(row) for row in rows]}, threads=1)


if __name__ == "__main__":
    main()
