"""The command `fit day`: reads, fits, writes; no mathematics."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from fit.command_options import FieldOfView, Projection, Quiet, Solver
from fit.input_error import InputError
from fit.terminal import say

RETRIES = 3  # of a photo whose worker died
WAIT = 30.0  # seconds for a scheduler to answer
# In its own words for numpy's libraries; more than one would give other last digits on other machines.
ALONE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def day(
    photos: Annotated[list[Path], typer.Argument(help="OpenEXR or Radiance .hdr files of one place.")],
    latitude: Annotated[float, typer.Option(min=-90, max=90, help="Degrees north.")],
    longitude: Annotated[float, typer.Option(min=-180, max=180, help="Degrees east.")],
    times: Annotated[
        Path | None, typer.Option(help="CSV of file names and times with zone; else by header or file name.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("tuned/day"),
    mask: Annotated[Path | None, typer.Option(help="PNG of the photos' size; white is used in all of them.")] = None,
    heading: Annotated[
        float | None, typer.Option(min=0, max=360, help="Compass bearing of the middle column; else it is found.")
    ] = None,
    pitch: Annotated[
        float | None, typer.Option(help="Of perspective cameras, degrees upwards; else it is found.")
    ] = None,
    projection: Projection = None,
    fov: FieldOfView = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Do not fit again what an earlier run into the same --out has fitted.")
    ] = False,
    jobs: Annotated[int, typer.Option(min=-1, help="Photos at a time; -1 for one on each processor.")] = -1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Of a dask cluster that sees the photos' paths.")
    ] = None,
    solver: Solver = "least-squares",
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 3, help="Of the sample of pixels and of solvers.")] = 0,
    quiet: Quiet = False,
) -> int:
    """Fit the photos of a day at one place, and write one weather file of few keyframes.

    Exit status: 0 fitted, 2 bad input, 130 interrupted. What is fitted stays in OUT.parts for --resume.
    """
    if jobs == 0:
        raise InputError("--jobs 0; give a number of photos at a time, or -1 for one on each processor")
    os.environ.update(dict.fromkeys(ALONE, "1"))  # before numpy is imported
    from fit import day as day_fit
    from fit import day_parts, day_photo, day_results, day_times, results
    from fit.day_sun import Turned

    folder = results.folder(out, photos[0])
    asked = day_photo.Asked(
        latitude=latitude,
        longitude=longitude,
        turned=Turned(heading, pitch, projection, fov),
        mask=None if mask is None else mask.absolute(),
        bearing=heading or 0.0,
        solver=solver,
        seed=seed,
    )
    options = day_fit.Options(
        asked=asked,
        parts=day_parts.folder(folder),
        times={} if times is None else day_times.read(times),
        resume=resume,
        jobs=jobs,
    )
    with _cluster(scheduler), _progress(quiet) as tell:
        found = day_fit.fit(photos, options, tell)
    day_results.write(folder, found)
    if not quiet:
        say(day_results.summary(folder, found))
    return 0


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Show on standard error, if it is a terminal, how many photos are fitted."""
    from fit.day import quietly

    if quiet or not sys.stderr.isatty():
        yield quietly
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("fitting photos")
        yield lambda done, whole: bar.update(task, completed=done, total=whole)


@contextmanager
def _cluster(scheduler: str | None) -> Iterator[None]:
    """Fit on the workers of a dask cluster; here, on the processors of this machine, where none is named.

    Raises:
        InputError: when dask is not installed or the scheduler does not answer.
    """
    if scheduler is None:
        yield
        return
    import joblib

    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs dask; install it: pip install 'diffrender[cluster]'") from error
    try:
        client = Client(scheduler, timeout=WAIT)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"--scheduler {scheduler} does not answer ({reason}); give tcp://HOST:PORT") from error
    with client, joblib.parallel_config(backend="dask", client=client, retries=RETRIES):
        yield
