"""`fit day` killed at random moments and resumed: the same bytes as a run that was left alone.

    python -m experiments.day_kills

Each run begins anew, is ended by SIGKILL together with the processes that it started, at any time until when
it would have ended by itself, and is run again with --resume.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from experiments import day_photos
from experiments.kills import start
from experiments.records import RESULTS, table, write

COMMAND: tuple[str, ...] = (sys.executable, "-m", "fit", "day")
FILES = ("day.json", "report.html", "weather.csv")
PARTS = "{}.parts"


@dataclass(frozen=True)
class Size:
    """How much is done."""

    kills: int
    photos: int
    width: int
    jobs: int


SIZES = {"small": Size(2, 2, 64, 1), "full": Size(20, 6, 64, 1)}


@dataclass(frozen=True)
class Kill:
    """A run that was killed, and the one that went on from there.

    Attributes:
        seconds: from the start to the kill.
        status: of the killed run; -9 where the kill came in time.
        kept: photos that were fitted by then.
        differing: files of the resumed run that are not those of the unbroken one.
    """

    seconds: float
    status: int
    kept: int
    differing: tuple[str, ...]


def kills(folder: Path, size: Size, seed: int) -> Iterator[Kill]:
    """So many killed runs, each resumed."""
    photos = day_photos.write(folder / "photos", size.photos, size.width)
    command = [*COMMAND, *map(str, photos), *day_photos.PLACE, "--jobs", str(size.jobs), "--quiet", "--out"]
    whole, broken = folder / "whole", folder / "broken"
    began = time.monotonic()
    _run([*command, str(whole)])
    pace = time.monotonic() - began
    generator = np.random.default_rng(seed)
    parts = broken.parent / PARTS.format(broken.name)
    for _ in range(size.kills):
        shutil.rmtree(broken, ignore_errors=True)
        shutil.rmtree(parts, ignore_errors=True)
        delay = float(generator.uniform(0.0, pace))
        process = start([*command, str(broken)])
        time.sleep(delay)
        _kill(process)
        kept = len(list(parts.glob("*.json"))) if parts.is_dir() else 0
        _run([*command, str(broken), "--resume"])
        same = {name: (whole / name).read_bytes() == (broken / name).read_bytes() for name in FILES}
        yield Kill(delay, process.returncode, kept, tuple(name for name, is_same in same.items() if not is_same))


def _kill(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)  # with its workers, which would go on
    process.wait()


def _run(command: Sequence[str]) -> None:
    status = start(command).wait()
    if status != 0:
        raise RuntimeError(f"{' '.join(command[-3:])} ended with status {status}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Kill and resume runs, print and write what was found."""
    parser = argparse.ArgumentParser(description="Kill `fit day` at random moments and resume it.")
    parser.add_argument("--size", choices=SIZES, default="full")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        found = list(kills(Path(name), SIZES[asked.size], asked.seed))
    write(asked.out / "day_kills.json", {"seed": asked.seed, "records": [asdict(kill) for kill in found]})
    rows = [
        [f"{kill.seconds:.1f} s", str(kill.status), str(kill.kept), ", ".join(kill.differing) or "none"]
        for kill in found
    ]
    print(table(["killed after", "status", "photos kept", "files that differ"], rows))


if __name__ == "__main__":
    main()
