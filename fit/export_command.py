"""The command `fit export`: reads, exports, writes; no mathematics."""

from pathlib import Path
from typing import Annotated

import typer

from fit.command_options import Heading, Hour, Latitude, Longitude, Quiet, Sun, Time, Weather
from fit.terminal import say


def export(
    weather: Weather,
    to: Annotated[str, typer.Option(help="unreal, unity, godot, blender or threejs.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the files; else exported/<target>.")] = None,
    hour: Hour = None,
    sun: Sun = None,
    latitude: Latitude = None,
    longitude: Longitude = None,
    time: Time = None,
    heading: Heading = None,
    quiet: Quiet = False,
) -> None:
    """Write the sky, sun and fog of a weather file at an hour for an engine, and what it keeps, approximates and drops.

    three.js and Blender draw our own sky and fog. Files for Unreal, Unity and Godot are not verified in the engine.
    """
    import torch

    from fit import options, results
    from fit.export import targets

    torch.set_num_threads(1)  # what more threads gain, they lose in waiting for each other
    targets.check(to)
    folder = results.folder(out or Path("exported") / to, weather)
    taken = options.shot(latitude, longitude, time, heading)
    at = options.hour_of(hour, taken)
    scene = options.scene_at(weather, at, sun, taken)
    account = targets.write(to, scene, weather.name, at, folder)
    if not quiet:
        say(f"{account}written to {folder}")
