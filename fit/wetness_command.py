"""The command `fit wetness`: reads, fits, writes; no mathematics."""

from pathlib import Path
from typing import Annotated

import typer

from fit.command_options import (
    FieldOfView,
    Fix,
    Free,
    Out,
    Photo,
    Pitch,
    Projection,
    Quiet,
    Seconds,
    Seed,
    Solver,
    Start,
)
from fit.fitting_command import ended, progress, use_threads


def wetness(
    photo: Photo,
    dry: Annotated[Path, typer.Option(help="The same view when it was dry.")],
    out: Out = None,
    mask: Annotated[
        Path | None, typer.Option(help="PNG of the photo's size; white got wet, the rest tells of the light.")
    ] = None,
    projection: Projection = None,
    fov: FieldOfView = None,
    pitch: Pitch = 0.0,
    start: Start = None,
    fix: Fix = None,
    free: Free = None,
    solver: Solver = "least-squares",
    seconds: Seconds = None,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Fit how wet the ground of a photo is, from the same view when it was dry.

    Exit status: 0 fitted, 1 not converged, 2 bad input, 130 interrupted; all but 2 write what was found.
    """
    with progress("starting", quiet):
        from fit import options, results
        from fit import photo as photos
        from fit import wetness as wetness_fit
        from fit.shot import Shot

        use_threads()
    asked = wetness_fit.Options(
        mask=mask,
        start=options.first_scene(start) if start else None,
        fixed=options.assignments(fix or []),
        free=tuple(free or ()),
        solver=solver,
        seconds=seconds,
        seed=seed,
    )
    folder = results.folder(out, photo)
    with progress("reading and fitting", quiet):
        before, seen = (photos.read(path, projection, fov, pitch) for path in (dry, photo))
        found = wetness_fit.solve(before, seen, asked)
    with progress("writing", quiet):
        results.write(folder, seen, found.solution, Shot().completed(seen.header), found.draw)
    return ended(folder, found.solution, quiet)
