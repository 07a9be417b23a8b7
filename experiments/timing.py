"""How long things take: warmed up, as median and quartiles, two of them in turn; and on which machine that was."""

import math
import os
import platform
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

LEAST_SECONDS = 5e-3  # that a work is timed for
THREADS = 2  # of whatever is timed, so that machines with more cores give the same ratios
PACKAGES = ("torch", "numpy", "scipy", "nlopt", "OpenEXR", "OpenImageIO", "mitsuba", "drjit")
ROOT = Path(__file__).parents[1]

Seconds = Callable[[], float]


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of repeated measurements, and the measurements in the order they were taken."""

    median: float
    lower: float
    upper: float
    each: tuple[float, ...]

    def __str__(self) -> str:
        """Median with its quartiles."""
        return f"{self.median:.3g} ({self.lower:.3g}-{self.upper:.3g})"


@dataclass(frozen=True)
class Comparison:
    """Two things timed in turn, and how many times longer the second takes than the first, round by round."""

    first: Spread
    second: Spread
    ratio: Spread


def spread(measurements: Sequence[float]) -> Spread:
    """Median and quartiles.

    >>> str(spread([4.0, 1.0, 2.0, 3.0, 5.0]))
    '3 (2-4)'
    """
    each = tuple(float(value) for value in measurements)
    if len(each) == 1:
        return Spread(each[0], each[0], each[0], each)
    lower, median, upper = statistics.quantiles(each, n=4, method="inclusive")
    return Spread(median, lower, upper, each)


def geometric_mean(values: Iterable[float]) -> float:
    """Root of the product.

    >>> round(geometric_mean([1.0, 4.0]), 6)
    2.0
    """
    logs = [math.log(value) for value in values]
    return math.exp(sum(logs) / len(logs))


def interleaved(first: Seconds, second: Seconds, rounds: int) -> Comparison:
    """Comparison of two timed works, run A B A B after one round that does not count.

    A machine that slows down for a while then slows both; the ratio is taken within a round.
    """
    timed = in_turn({"first": first, "second": second}, rounds)
    return Comparison(timed["first"], timed["second"], ratio(timed["second"], timed["first"]))


def in_turn(works: Mapping[str, Seconds], rounds: int) -> dict[str, Spread]:
    """Any number of timed works by name, run A B C A B C after one round that does not count."""
    each = [{name: work() for name, work in works.items()} for _ in range(rounds + 1)][1:]
    return {name: spread([one[name] for one in each]) for name in works}


def ratio(longer: Spread, shorter: Spread) -> Spread:
    """How many times longer one work takes than another with which it took turns, round by round."""
    return spread([a / b for a, b in zip(longer.each, shorter.each, strict=True)])


def seconds_of(work: Callable[[], object]) -> float:
    """Processor time of one call [s]: the slices that other processes of a shared machine get do not count.

    Called again and again for a few milliseconds, so that the clock does not count either.
    """
    calls, taken = 0, 0.0
    began = time.process_time()
    while taken < LEAST_SECONDS:
        work()
        calls += 1
        taken = time.process_time() - began
    return taken / calls


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch on one thread: there processor time is the time that a work takes on a machine of its own."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def provenance(threads: int = THREADS) -> dict[str, Any]:
    """Machine, versions, commit and date of a record; nothing that names the machine or its user."""
    return {
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "threads": threads,
            "load": os.getloadavg(),
            "system": f"{platform.system()} {platform.machine()}",
        },
        "versions": {"python": platform.python_version()} | _versions(),
        "commit": _commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _processor() -> str:
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor()


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # mitsuba is not everywhere
            continue
    return found


def _commit() -> str:
    """Hash of the checkout, ending in -dirty where files differ from it; "unknown" outside of one."""
    git = shutil.which("git")
    if git is None:
        return "unknown"
    asked = [git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    told = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False)
    return told.stdout.strip() or "unknown"
