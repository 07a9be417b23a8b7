"""The command line: reads, fits, writes; no mathematics."""

import io
import os
import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from fit import day_command, export_command, terminal, wetness_command
from fit.command_options import (
    FieldOfView,
    Fix,
    Free,
    Heading,
    Hour,
    Latitude,
    Longitude,
    Mask,
    Out,
    Photo,
    Pitch,
    Projection,
    Quiet,
    Seconds,
    Seed,
    Solver,
    Start,
    Sun,
    Time,
    Weather,
)
from fit.fitting_command import INTERRUPTED, ended, progress, use_threads
from fit.input_error import InputError

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)

BAD_INPUT = 2


@app.callback()
def about() -> None:
    """Fit skies, fog and anti-aliasing to HDR photos and write tuned weather files."""


@app.command()
def sky(
    photo: Photo,
    out: Out = None,
    mask: Mask = None,
    sun: Sun = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    time: Time = None,
    heading: Heading = None,
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
    """Fit air, haze and clouds to the sky of a photo.

    Exit status: 0 fitted, 1 not converged, 2 bad input, 130 interrupted; all but 2 write what was found.
    """
    with progress("starting", quiet):
        from fit import options, picture, results
        from fit import photo as photos
        from fit import sky as sky_fit
        from fit import sun as sun_place

        use_threads()
    folder = results.folder(out, photo)
    shot = options.shot(latitude, longitude, time, heading)
    place = sun_place.given(sun) if sun is not None else shot.sun()
    asked = sky_fit.Options(
        mask=mask,
        start=options.start(start) if start else None,
        fixed=options.assignments(fix or []),
        free=tuple(free or ()),
        solver=solver,
        seconds=seconds,
        seed=seed,
    )
    with progress("reading and fitting", quiet):
        seen = photos.read(photo, projection, fov, pitch)
        solution = sky_fit.fit(seen, replace(asked, sun=place or shot.sun_by(seen.header)))
    with progress("writing", quiet):
        draw = partial(picture.draw, camera=seen.camera)
        results.write(folder, seen, solution, shot.completed(seen.header), draw)
    return ended(folder, solution, quiet)


@app.command()
def fog(
    photo: Photo,
    distance: Annotated[
        Path | None, typer.Option(help="OpenEXR of distances, m, or `level` for level ground; else the photo's Z.")
    ] = None,
    distance_kind: Annotated[str, typer.Option(help="euclidean, along rays, or depth, along the axis.")] = "euclidean",
    clear: Annotated[Path | None, typer.Option(help="The same view without fog.")] = None,
    eye_height: Annotated[float, typer.Option(help="Altitude of the camera above the fog's altitude 0, m.")] = 2.0,
    model: Annotated[str, typer.Option(help="height, a layer of fog, or aerial, the air of a landscape.")] = "height",
    with_sky: Annotated[
        bool, typer.Option("--with-sky", help="Fit the sky of the photo first, in as many --seconds again.")
    ] = False,
    out: Out = None,
    mask: Mask = None,
    sun: Sun = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    time: Time = None,
    heading: Heading = None,
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
    """Fit height fog to a photo, best with its distances and the same view without fog.

    Exit status: 0 fitted, 1 not converged, 2 bad input, 130 interrupted; all but 2 write what was found.
    """
    with progress("starting", quiet):
        from fit import fog as fog_fit
        from fit import fog_models, hidden_sun, options, results
        from fit import photo as photos
        from fit import sky as sky_fit
        from fit import sun as sun_place

        use_threads()
    solve = fog_models.model(model)
    folder = results.folder(out, photo)
    shot = options.shot(latitude, longitude, time, heading)
    place = sun_place.given(sun) if sun is not None else shot.sun()
    begun = options.first_scene(start) if start else None
    above = None
    with progress("reading and fitting", quiet):
        seen = photos.read(photo, projection, fov, pitch)
        place = place or shot.sun_by(seen.header)
        if with_sky:
            # What the header tells of the sun holds for the sky too, which searches the rest; else it searches all.
            begins, guessed = fog_fit.sun_of(seen, place)
            told, searched = (None, ()) if guessed == hidden_sun.NAMES else (begins, guessed)
            # Among distances white is not only sky.
            of_sky = mask if distance is None else None
            asked_above = sky_fit.Options(
                mask=of_sky, sun=told, free=searched, start=begun, solver=solver, seconds=seconds, seed=seed
            )
            above = sky_fit.fit(seen, asked_above)
            begun, place = above.scene, above.sun
        asked = fog_fit.Options(
            distance=distance,
            distance_kind=distance_kind,
            clear=clear,
            eye_height=eye_height,
            mask=mask,
            sun=place,
            start=begun,
            fixed=options.assignments(fix or []),
            free=tuple(free or ()),
            solver=solver,
            seconds=seconds,
            seed=seed,
        )
        solution, draw = solve(seen, asked)
        if above is not None:
            solution = fog_fit.under(solution, above)
    with progress("writing", quiet):
        results.write(folder, seen, solution, shot.completed(seen.header), draw)
    return ended(folder, solution, quiet)


@app.command()
def sharpening(
    photo: Photo,
    footprint: Annotated[float, typer.Option(help="Side of a sample, pixels: 0 points, 1 as mip maps.")] = 1.0,
    textures: Annotated[
        Path | None, typer.Option(help="PNG of the photo's size; white has the footprint, the rest is points.")
    ] = None,
    factor: Annotated[int, typer.Option(help="How many times as fine as the pictures the photo is; even.")] = 4,
    screen: Annotated[str, typer.Option(help="What the picture is encoded for: srgb or pq.")] = "srgb",
    motion: Annotated[
        str, typer.Option(metavar="RIGHT,DOWN", help="Of the scene from one frame to the next, pixels.")
    ] = "0,0",
    out: Out = None,
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
    """Fit sharpening and FXAA of two-frame anti-aliasing to a photo.

    Exit status: 0 fitted, 1 not converged, 2 bad input, 130 interrupted; all but 2 write what was found.
    """
    with progress("starting", quiet):
        from fit import options, results
        from fit import photo as photos
        from fit import sharpening as sharpening_fit
        from fit.sampled_photo import Sampling
        from fit.shot import Shot

        use_threads()
    asked = sharpening_fit.Options(
        sampling=Sampling(factor, footprint, screen, options.motion(motion)),
        textures=textures,
        start=options.first_scene(start) if start else None,
        fixed=options.assignments(fix or []),
        free=tuple(free or ()),
        solver=solver,
        seconds=seconds,
        seed=seed,
    )
    folder = results.folder(out, photo)
    with progress("reading and fitting", quiet):
        seen = photos.read(photo, projection, fov, pitch)
        found = sharpening_fit.solve(seen, asked)
    with progress("writing", quiet):
        shot = Shot().completed(seen.header)
        results.write_with(folder, found.solution, shot, found.draw, found.page)
    return ended(folder, found.solution, quiet)


@app.command()
def render(
    weather: Weather,
    out: Annotated[Path, typer.Option(help="OpenEXR file to write.")],
    hour: Hour = None,
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="In pixels.")] = "1024x512",
    sun: Sun = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    time: Time = None,
    heading: Heading = None,
    projection: Projection = None,
    fov: FieldOfView = None,
    pitch: Pitch = 0.0,
    tables: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Draw from these of `fit tables`; a second one is blended in."),
    ] = None,
    blend: Annotated[float | None, typer.Option(min=0, max=1, help="Share of the second of two --tables.")] = None,
) -> None:
    """Draw the sky of a weather file at an hour, and the sun's disc as a second part."""
    from fit import options, picture
    from fit import tables as stored

    use_threads()
    camera = options.camera(size, projection, fov, pitch)
    taken = options.shot(latitude, longitude, time, heading)
    at = options.hour_of(hour, taken)
    scene = options.scene_at(weather, at, sun, taken)
    light = stored.light(scene, tables or [], blend)
    picture.write(out, picture.draw(scene, camera, light), {"weather": weather.name, "hour": at})


@app.command()
def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Weather file, or LAMP.ies, a lamp's photometric file.")],
    out: Annotated[Path | None, typer.Option(metavar="HTML", help="Page to write, with larger plots.")] = None,
) -> None:
    """Print the table of a weather file and plot each parameter over the day; or tell what a lamp's .ies file says.

    Of a lamp: symmetry, angles, peak, flux beside what the file states, beam and field angle; its page has the polar
    diagram.
    """
    from fit import weather_file, weather_page, weather_text

    use_threads()
    width = shutil.get_terminal_size().columns
    if out is not None and os.path.realpath(out) == os.path.realpath(file):
        raise InputError(f"--out {out} is the file that is shown; give another name")
    if file.suffix.lower() == ".ies":
        from fit import ies, lamp_page, lamp_sheet

        sheet = lamp_sheet.sheet(ies.read(file))
        if out is not None:
            lamp_page.write(out, file.name, sheet)
        shown = lamp_sheet.text(sheet, width)
    else:
        weather = weather_file.read(file)
        if out is not None:
            weather_page.write(out, file.name, weather)
        shown = weather_text.text(weather, width, weather_text.BRAILLE if terminal.has("⣿") else weather_text.ASCII)
    terminal.show(shown if out is None else f"{shown}\n\nwritten to {out}")


@app.command()
def tables(
    out: Annotated[Path, typer.Option(help="File to write, such as sky.safetensors.")],
    photos: Annotated[list[Path] | None, typer.Argument(help="HDR photos to fit; else a sky is marched.")] = None,
    mask_folder: Annotated[
        Path | None, typer.Option(help="Of PNGs named as the photos, white where sky is; else it is found.")
    ] = None,
    weather: Annotated[Path | None, typer.Option(help="File of the marched sky; else the default one.")] = None,
    hour: Annotated[float, typer.Option(min=0, max=24, help="Of the day in the weather file.")] = 12.0,
    form: Annotated[
        str, typer.Option(help="two-tables (FFXV) or in-scatter (Decima); photos: two-tables.")
    ] = "two-tables",
    quiet: Quiet = False,
) -> None:
    """Make tables of the sky over the sun's elevation, from which `fit render --tables` draws."""
    with progress("making tables", quiet):
        from fit import stored_sky
        from fit import tables as files

        use_threads()
        made = stored_sky.made(stored_sky.Asked(form, tuple(photos or ()), mask_folder, weather, hour))
        files.save(out, made.tables, made.origin)
    if not quiet:
        terminal.say(f"{made.summary}\nwritten to {out}")


app.command("day")(day_command.day)
app.command("wetness")(wetness_command.wetness)
app.command("export")(export_command.export)


def main() -> None:
    """Run the command line; errors of the user are one line and exit status 2."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # not every terminal knows all letters
    try:
        status = app(standalone_mode=False)
    except InputError as error:
        status = _refuse(str(error))
    except typer.TyperException as error:
        status = _refuse(f"{error.format_message().rstrip('.')}; --help says what is allowed")
    except (typer.Abort, KeyboardInterrupt):
        status = INTERRUPTED
    sys.exit(status)


def _refuse(message: str) -> int:
    typer.echo("error: " + terminal.visible(" ".join(message.split())), err=True)
    return BAD_INPUT


if __name__ == "__main__":
    main()
