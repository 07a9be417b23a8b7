"""`fit sky` killed at random moments: every file that it leaves must be whole or absent, and the next run must succeed.

    python -m experiments.kills --count 50

Each run is a process of its own that is ended by SIGKILL, which no program can answer: every second one at any time of
its run, the others while they write. Half of them write into a new folder, half into one that holds the results of an
earlier run, which must then be there still, or new ones in their place.
"""

import argparse
import itertools
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from experiments import hostile_samples
from experiments.fit_command import COMMAND
from experiments.records import RESULTS, table, write
from experiments.whole_results import FILES, faults, file_fault

PHOTO = Path(__file__).parent / "photos" / "spruit_sunrise.exr"
WATCH = 0.0002  # seconds between two looks for the folder that is written aside


@dataclass(frozen=True)
class Kill:
    """A run and how it ended.

    Attributes:
        while_writing: whether it was killed so long after it began to write, else after its start.
        seconds: the delay.
        had_results: whether results of an earlier run stood in the folder.
        status: -9 where the kill came in time.
        files: number of result files found afterwards.
        aside: number of files and folders beside them.
        faults: what was not whole; empty where all is well.
    """

    while_writing: bool
    seconds: float
    had_results: bool
    status: int
    files: int
    aside: int
    faults: tuple[str, ...]


@dataclass(frozen=True)
class Pace:
    """Seconds that an unbroken run takes, and that its files lie aside before they are in their places."""

    whole: float
    writing: float


class Runs:
    """Runs of the command on one photo."""

    def __init__(self, photo: Path) -> None:
        """Runs that end soon: what matters is how they write."""
        self._command = [*COMMAND, str(photo), *hostile_samples.SUN, *hostile_samples.QUICK, "--quiet"]

    def start(self, out: Path) -> subprocess.Popen[bytes]:
        """A process that has begun."""
        return start([*self._command, "--out", str(out)])

    def pace(self, out: Path) -> Pace:
        """Of a run that ends by itself."""
        began = time.monotonic()
        process = self.start(out)
        first = _seen(process, out, is_aside=True)
        last = _seen(process, out, is_aside=False)
        status = process.wait()
        ended = time.monotonic()
        if status not in (0, 1):
            raise RuntimeError(f"the run ended with status {status}")
        return Pace(ended - began, last - first)

    def killed(self, out: Path, pace: Pace, generator: np.random.Generator, *, while_writing: bool) -> Kill:
        """A run that is killed."""
        had_results = out.exists()
        process = self.start(out)
        delay = float(generator.uniform(0.0, pace.writing if while_writing else pace.whole))
        if while_writing:
            _seen(process, out, is_aside=True)
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        status = process.wait()
        left = list(out.iterdir()) if out.exists() else []
        present = [path for path in left if path.name in FILES]
        wrong = [fault for path in present if (fault := file_fault(path))]
        if had_results and len(present) != len(FILES):
            wrong.append("a file of an earlier run is lost")
        return Kill(while_writing, delay, had_results, status, len(present), len(left) - len(present), tuple(wrong))


def start(command: Sequence[str]) -> subprocess.Popen[bytes]:
    """A command that has begun, in a group of processes of its own."""
    alone = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, env=alone, stderr=subprocess.DEVNULL, start_new_session=True)


def _seen(process: subprocess.Popen[bytes], out: Path, *, is_aside: bool) -> float:
    """Time when a run is seen to write aside, or no longer to do so, or to have ended."""
    earlier = set(out.glob(".*.part"))  # of runs that were killed
    while process.poll() is None and bool(set(out.glob(".*.part")) - (earlier if is_aside else set())) != is_aside:
        time.sleep(WATCH)
    return time.monotonic()


def kills(folder: Path, count: int, seed: int) -> Iterator[Kill]:
    """So many killed runs, into a new folder and into one that holds results in turn.

    Raises:
        RuntimeError: when a run after them, into the same folders, fails or does not clear what they left.
    """
    photo = hostile_samples.first(folder, hostile_samples.photo(PHOTO))
    runs = Runs(photo)
    generator = np.random.default_rng(seed)
    places = folder / "new", folder / "again"
    pace = runs.pace(places[1])
    for number in range(count):
        out = places[number // 2 % 2]
        if out == places[0]:
            shutil.rmtree(out, ignore_errors=True)
        yield runs.killed(out, pace, generator, while_writing=number % 2 == 1)
    for out in places:
        for left in out.glob(".*.part"):
            os.utime(left, (0, 0))  # as if it had been left long ago
        runs.pace(out)
        if wrong := [*faults(out), *(f"{left.name} is left" for left in out.glob(".*"))]:
            raise RuntimeError(f"a run after the killed ones leaves: {', '.join(wrong)}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Kill runs, print and write what was found."""
    parser = argparse.ArgumentParser(description="Kill `fit sky` at random moments.")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        found = list(kills(Path(name), asked.count, asked.seed))
    write(asked.out / "kills.json", {"seed": asked.seed, "records": [asdict(kill) for kill in found]})
    rows = []
    for while_writing, had_results in itertools.product((False, True), repeat=2):
        some = [k for k in found if (k.while_writing, k.had_results) == (while_writing, had_results)]
        where = (
            f"{'while writing' if while_writing else 'at any time'}, {'over results' if had_results else 'new folder'}"
        )
        in_time = sum(kill.status == -signal.SIGKILL for kill in some)
        left_aside = sum(kill.aside > 0 for kill in some)
        rows.append([where, *map(str, (len(some), in_time, left_aside, sum(bool(kill.faults) for kill in some)))])
    print(table(["killed", "runs", "in time", "something aside", "faults"], rows))


if __name__ == "__main__":
    main()
