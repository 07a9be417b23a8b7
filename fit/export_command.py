"""The command `fit export`: reads, exports, writes; no mathematics."""

from pathlib import Path
from typing import Annotated

import typer

from fit.terminal import say


def export(
    weather: Annotated[Path, typer.Argument(help="Weather file.")],
    to: Annotated[str, typer.Option(help="unreal, unity, godot, blender or threejs.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the files; else exported/<target>.")] = None,
    hour: Annotated[float, typer.Option(min=0, max=24, help="Of the day.")] = 12.0,
    sun: Annotated[
        str | None,
        typer.Option(metavar="ELEVATION,AZIMUTH", help="Degrees; azimuth to the right of the middle column."),
    ] = None,
    latitude: Annotated[
        float | None,
        typer.Option(min=-90, max=90, help="Degrees north; with --longitude and --time it places the sun."),
    ] = None,
    longitude: Annotated[float | None, typer.Option(min=-180, max=180, help="Degrees east.")] = None,
    time: Annotated[str | None, typer.Option(help="With its zone, such as 2016-08-14T06:30+02:00.")] = None,
    heading: Annotated[
        float | None, typer.Option(min=0, max=360, help="Compass bearing of the middle column, degrees; else 0.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Write the sky, sun and fog of a weather file at an hour for an engine, and what it keeps, approximates and drops.

    three.js and Blender draw our own sky and fog. Files for Unreal, Unity and Godot are not verified in the engine.
    """
    import torch

    from fit import keyframes, options, results, shot, weather_file
    from fit import sun as sun_place
    from fit.export import targets

    torch.set_num_threads(1)  # what more threads gain, they lose in waiting for each other
    targets.check(to)
    folder = results.folder(out or Path("exported") / to, weather)
    taken = shot.Shot(latitude, longitude, None if time is None else sun_place.parse_time(time), heading)
    place = sun_place.given(sun) if sun is not None else taken.sun()
    values = keyframes.at(weather_file.read(weather), hour)
    if place is not None:
        values |= {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    scene = options.with_sky(keyframes.scene(values), weather)
    account = targets.write(to, scene, weather.name, hour, folder)
    if not quiet:
        say(f"{account}written to {folder}")
