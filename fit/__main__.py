"""The command line: reads, fits, writes; no mathematics."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fit.input_error import InputError

if TYPE_CHECKING:
    from fit.solution import SunPlace

app = typer.Typer(add_completion=False, rich_markup_mode=None, no_args_is_help=True, pretty_exceptions_enable=False)

NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 1, 2, 130


@app.callback()
def about() -> None:
    """Fit skies of HDR photos and write tuned weather files."""


Projection = Annotated[
    str | None, typer.Option(help="equirectangular, hemisphere, cubemap or perspective; else it is recognised.")
]
FieldOfView = Annotated[float | None, typer.Option("--fov", help="Across the width of a perspective picture, degrees.")]
Pitch = Annotated[float, typer.Option(help="Of a perspective camera, degrees upwards.")]
Heading = Annotated[float, typer.Option(help="Compass bearing of the picture's middle column, degrees.")]
SunOption = Annotated[
    str | None,
    typer.Option("--sun", metavar="ELEVATION,AZIMUTH", help="Degrees; azimuth to the right of the middle column."),
]
Latitude = Annotated[float | None, typer.Option(help="Degrees north; with --longitude and --time it places the sun.")]
Longitude = Annotated[float | None, typer.Option(help="Degrees east.")]
Time = Annotated[str | None, typer.Option(help="With its zone, such as 2016-08-14T06:30+02:00.")]


@app.command()
def sky(
    photo: Annotated[Path, typer.Argument(help="OpenEXR or Radiance .hdr file.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the results; else tuned/<photo name>.")] = None,
    mask: Annotated[Path | None, typer.Option(help="PNG of the photo's size; white is used.")] = None,
    sun: SunOption = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    time: Time = None,
    heading: Heading = 0.0,
    projection: Projection = None,
    fov: FieldOfView = None,
    pitch: Pitch = 0.0,
    start: Annotated[Path | None, typer.Option(help="Weather file to begin at; keeps what is not free.")] = None,
    fix: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="Hold a parameter; repeatable.")] = None,
    free: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Search one more; repeatable.")] = None,
    solver: Annotated[str, typer.Option(help="least-squares, nlopt:NAME, adam or lbfgs.")] = "least-squares",
    seconds: Annotated[float | None, typer.Option(help="Take the best after this long; not repeatable.")] = None,
    seed: Annotated[int, typer.Option(help="Of the sample of pixels and of solvers that draw.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Fit air, haze and clouds to the sky of a photo."""
    from fit import photo as photos
    from fit import results
    from fit import sky as sky_fit
    from fit import sun as sun_place

    folder = results.folder(out, photo)
    with _progress("reading and fitting", quiet):
        seen = photos.read(photo, projection, fov, pitch)
        place = _sun(sun_place, sun, latitude, longitude, time, heading)
        options = sky_fit.Options(
            mask=mask,
            sun=place,
            start=results.scene_of(start) if start else None,
            fixed=results.assignments(fix or []),
            free=tuple(free or ()),
            solver=solver,
            seconds=seconds,
            seed=seed,
        )
        solution = sky_fit.fit(seen, options)
    with _progress("writing", quiet):
        results.write(folder, seen, solution, results.hour_of(seen, time))
    if not quiet:
        typer.echo(results.summary(folder, solution))
    if solution.minimum.reason == results.INTERRUPTED:
        raise typer.Exit(INTERRUPTED)
    if not solution.minimum.converged:
        raise typer.Exit(NOT_CONVERGED)


@app.command()
def render(
    weather: Annotated[Path, typer.Argument(help="Weather file.")],
    out: Annotated[Path, typer.Option(help="OpenEXR file to write.")],
    hour: Annotated[float, typer.Option(help="Of the day.")] = 12.0,
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="In pixels.")] = "1024x512",
    sun: SunOption = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    time: Time = None,
    heading: Heading = 0.0,
    projection: Projection = None,
    fov: FieldOfView = None,
    pitch: Pitch = 0.0,
) -> None:
    """Draw the sky of a weather file at an hour."""
    from fit import results
    from fit import sun as sun_place

    place = _sun(sun_place, sun, latitude, longitude, time, heading)
    results.render(weather, out, hour, place, results.camera(size, projection, fov, pitch))


def _sun(
    sun_place: Any,  # noqa: ANN401 - the module, which only the commands import
    sun: str | None,
    latitude: float | None,
    longitude: float | None,
    time: str | None,
    heading: float,
) -> "SunPlace | None":
    if sun is not None:
        found: SunPlace = sun_place.given(sun)
        return found
    given = [latitude is not None, longitude is not None, time is not None]
    if not any(given):
        return None
    if not all(given):
        raise InputError("the sun's place needs --latitude, --longitude and --time together; or give --sun")
    placed: SunPlace = sun_place.from_place(latitude, longitude, sun_place.parse_time(time), heading)
    return placed


def _progress(what: str, quiet: bool) -> Any:  # noqa: ANN401 - rich's context manager
    from rich.console import Console

    return Console(stderr=True, quiet=quiet).status(what)


def main() -> None:
    """Run the command line; errors of the user are one line and exit status 2."""
    try:
        status = app(standalone_mode=False)
    except InputError as error:
        sys.exit(_refuse(str(error)))
    except typer.TyperException as error:
        sys.exit(_refuse(error.format_message()))
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(INTERRUPTED)
    sys.exit(status or 0)


def _refuse(message: str) -> int:
    typer.echo("error: " + " ".join(message.split()), err=True)
    return BAD_INPUT


if __name__ == "__main__":
    main()
