"""The command `fit sky`, run as a user runs it: a process of its own, timed and weighed from outside."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.timing import THREADS

COMMAND = (sys.executable, "-m", "fit", "sky")
DID_NOT_CONVERGE = 1  # exit status of a fit that wrote its files all the same
MEMORY_UNIT = 1 if sys.platform == "darwin" else 1024  # bytes in one of ru_maxrss


@dataclass(frozen=True)
class Process:
    """A process that has ended.

    Attributes:
        status: exit status.
        told: what it wrote to standard output.
        complained: what it wrote to standard error.
        seconds: from its start to its end.
        peak_bytes: most memory that it, or any one process it started, held at a time.
    """

    command: tuple[str, ...]
    status: int
    told: str
    complained: str
    seconds: float
    peak_bytes: int

    @property
    def failure(self) -> str:
        """One line on how it ended, with the last line it wrote to standard error."""
        last = (self.complained.strip().splitlines() or ["nothing on standard error"])[-1]
        return f"{' '.join(self.command)} ended with status {self.status}: {last}"


@dataclass(frozen=True)
class FitRun:
    """A finished fit: its fit.json, and what the process took."""

    account: Mapping[str, Any]
    process: Process

    @property
    def solve_seconds(self) -> float:
        """By the fit's own account; reading, writing and error bars are not in it."""
        return float(self.account["seconds"]["solve"])

    @property
    def errors_seconds(self) -> float:
        """By the fit's own account: its error over all pixels, and the error bars."""
        return float(self.account["seconds"]["errors"])

    @property
    def read_seconds(self) -> float:
        """By the fit's own account: all it does with whole pictures before it solves."""
        return float(self.account["seconds"]["read"])


# A process counts the memory of the one that forked it as its own until it starts its program, so a small one forks.
WEIGH = """
import resource, subprocess, sys, time
began = time.perf_counter()
status = subprocess.call(sys.argv[2:])
seconds = time.perf_counter() - began
peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
with open(sys.argv[1], "w") as account:
    print(status, seconds, peak, file=account)
"""


def run(command: Sequence[str]) -> Process:
    """A command run to its end on two threads."""
    threads = {name: str(THREADS) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    with tempfile.TemporaryDirectory() as folder:
        account = Path(folder) / "account"
        weighed = [sys.executable, "-I", "-S", "-c", WEIGH, str(account), *command]
        ended = subprocess.run(weighed, capture_output=True, text=True, env=os.environ | threads, check=True)
        status, seconds, peak = account.read_text(encoding="utf-8").split()
    return Process(tuple(command), int(status), ended.stdout, ended.stderr, float(seconds), int(peak) * MEMORY_UNIT)


def run_well(command: Sequence[str]) -> Process:
    """A command run to a good end.

    Raises:
        RuntimeError: when it ends with another status than 0; with its last line on standard error.
    """
    process = run(command)
    if process.status != 0:
        raise RuntimeError(process.failure)
    return process


def fit_sky(photo: Path, mask: Path, sun: tuple[float, float], out: Path) -> FitRun:
    """Fit of a photo's sky with the sun at a place [degrees]; its files are in the folder `out`, also unconverged ones.

    Raises:
        RuntimeError: when the command fails.
    """
    return _fitted(photo, ["--mask", str(mask), "--sun", f"{sun[0]},{sun[1]}"], out)


def fit_sky_alone(photo: Path, out: Path) -> FitRun:
    """The same by a command that is told nothing but the photo.

    Raises:
        RuntimeError: when the command fails.
    """
    return _fitted(photo, [], out)


def _fitted(photo: Path, told: Sequence[str], out: Path) -> FitRun:
    account = out / "fit.json"
    account.unlink(missing_ok=True)  # an earlier fit's, which a crash would leave standing
    process = run([*COMMAND, str(photo), *told, "--out", str(out), "--quiet"])
    # Python also ends with status 1 when it crashes; a fit has written its files.
    if process.status not in (0, DID_NOT_CONVERGE) or not account.exists():
        raise RuntimeError(process.failure)
    return FitRun(json.loads(account.read_text(encoding="utf-8")), process)
