"""`fit day` on more than one worker: time on two against one, memory of each, and the same file from loky and dask.

    python -m experiments.day_workers time
    python -m experiments.day_workers same

`time` fits every so many-th of the photos on one worker and on two in turn, both warm: each has fitted two photos
before the clock runs. `same` fits all of them on this machine's processors, then on a dask cluster of three workers on
loopback, one of which is killed when a third of the photos is fitted (extra `cluster`; left out where dask is not
installed).
"""

import argparse
import importlib.util
import itertools
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import joblib

from experiments import day_photos
from experiments.fit_command import MEMORY_UNIT, run_well
from experiments.records import RESULTS, table, write
from experiments.timing import Spread, spread
from fit import day_times
from fit.day_photo import Asked, fitted
from fit.day_sun import Turned

COMMAND = (sys.executable, "-m", "fit", "day")
PORT = 18787
WORKERS = 3
SIZES = {"small": (4, 64, 2, 1), "full": (200, 128, 4, 4)}  # photos, width, every so many-th timed, rounds
ASKED = Asked(day_photos.LATITUDE, day_photos.LONGITUDE, Turned(heading=day_photos.HEADING))


def weighed(photo: Path, taken: datetime) -> tuple[int, int]:
    """Fit a photo: the process that did so, and most bytes that it has held."""
    fitted(photo, taken, ASKED)
    return os.getpid(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MEMORY_UNIT


def timed(photos: Sequence[Path], jobs: int) -> dict[str, Any]:
    """Warm time of fits on so many workers, processes of their own, and their memory."""
    times = day_times.of_photos(photos, {})
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1), joblib.Parallel(jobs) as parallel:
        tasks = [joblib.delayed(weighed)(photo, taken) for photo, taken in zip(photos, times, strict=True)]
        parallel(tasks[: 2 * jobs])
        began = time.perf_counter()
        found = parallel(tasks)
        seconds = time.perf_counter() - began
    peaks = {str(process): peak for process, peak in found}
    return {"jobs": jobs, "seconds": seconds, "peak_bytes": sorted(peaks.values())}


def on_loky(photos: Sequence[Path], out: Path) -> bytes:
    """Weather file by the processors of this machine."""
    run_well([*COMMAND, *map(str, photos), *day_photos.PLACE, "--quiet", "--out", str(out)])
    return (out / "weather.csv").read_bytes()


def on_dask(photos: Sequence[Path], out: Path) -> dict[str, Any]:
    """Weather file by a cluster that loses a worker."""
    address = f"tcp://127.0.0.1:{PORT}"
    dask = [sys.executable, "-m", "dask"]
    alone = os.environ | {"OMP_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(PORT), "--no-dashboard"], env=alone, **quiet
    )  # type: ignore[call-overload]
    processes = [scheduler]
    try:
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(out.parent)]
        processes += [
            subprocess.Popen([*dask, "worker", address, *options], env=alone, **quiet)  # type: ignore[call-overload]
            for _ in range(WORKERS)
        ]
        command = [*COMMAND, *map(str, photos), *day_photos.PLACE, "--scheduler", address, "--quiet", "--out", str(out)]
        fit = subprocess.Popen(command)
        parts, kept = out.parent / f"{out.name}.parts", 0
        while fit.poll() is None and kept < len(photos) // 3:
            time.sleep(0.1)
            kept = len(list(parts.glob("*.json"))) if parts.is_dir() else 0
        processes[-1].send_signal(signal.SIGKILL)
        status = fit.wait()
    finally:
        for process in processes:
            process.kill()
            process.wait()
    if status != 0:
        raise RuntimeError(f"fit day on dask ended with status {status}")
    return {"killed_after_photos": kept, "weather": (out / "weather.csv").read_bytes()}


def time_of_workers(folder: Path, size: str) -> dict[str, Any]:
    """One worker against two."""
    count, width, step, rounds = SIZES[size]
    photos = day_photos.write(folder / "photos", count, width)[::step]
    found = [[timed(photos, jobs) for jobs in (1, 2)] for _ in range(rounds)]
    ratio = spread([one["seconds"] / two["seconds"] for one, two in found])
    return {"photos": len(photos), "of": count, "rounds": found, "ratio": asdict(ratio)}


def same_file(folder: Path, size: str) -> dict[str, Any]:
    """This machine's processors against a cluster."""
    count, width, _, _ = SIZES[size]
    photos = day_photos.write(folder / "photos", count, width)
    by_loky = on_loky(photos, folder / "loky")
    if importlib.util.find_spec("distributed") is None:
        return {"photos": count, "dask": None}
    by_dask = on_dask(photos, folder / "dask")
    shutil.rmtree(folder / "dask", ignore_errors=True)
    is_same = by_dask["weather"] == by_loky
    return {
        "photos": count,
        "dask": {"workers": WORKERS, "killed_after_photos": by_dask["killed_after_photos"], "same_bytes": is_same},
    }


PARTS = {"time": time_of_workers, "same": same_file}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one of the two parts, print and write what was found."""
    parser = argparse.ArgumentParser(description="`fit day` on more than one worker.")
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--size", choices=SIZES, default="full")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        content = PARTS[asked.part](Path(name), asked.size)
    write(asked.out / f"day_workers_{asked.part}.json", content)
    if asked.part == "time":
        rows = [
            [str(one["jobs"]), f"{one['seconds']:.1f}", ", ".join(f"{peak / 2**20:.0f}" for peak in one["peak_bytes"])]
            for one in itertools.chain(*content["rounds"])
        ]
        print(table(["workers", "seconds", "peak MiB of each"], rows))
        print(f"{content['photos']} of {content['of']} photos: {Spread(**content['ratio'])} times as fast on two")
    else:
        print(content["dask"] or "dask is not installed (extra `cluster`)")


if __name__ == "__main__":
    main()
