"""Options that several commands share: what may be given, and what it means."""

from pathlib import Path
from typing import Annotated

import typer

Projection = Annotated[
    str | None, typer.Option(help="equirectangular, hemisphere, cubemap or perspective; else it is recognised.")
]
FieldOfView = Annotated[float | None, typer.Option("--fov", help="Across the width of a perspective picture, degrees.")]
Pitch = Annotated[float, typer.Option(help="Of a perspective camera, degrees upwards.")]
Heading = Annotated[
    float | None, typer.Option(min=0, max=360, help="Compass bearing of the picture's middle column, degrees; else 0.")
]
Sun = Annotated[
    str | None,
    typer.Option(
        "--sun",
        metavar="ELEVATION,AZIMUTH",
        help="Degrees; azimuth to the right of the middle column. Goes before place and time.",
    ),
]
Latitude = Annotated[
    float | None,
    typer.Option(min=-90, max=90, help="Degrees north; with --longitude and --time it places the sun."),
]
Longitude = Annotated[float | None, typer.Option(min=-180, max=180, help="Degrees east.")]
Photo = Annotated[Path, typer.Argument(help="OpenEXR or Radiance .hdr file.")]
Out = Annotated[Path | None, typer.Option(help="Folder for the results; else tuned/<photo name>.")]
Mask = Annotated[Path | None, typer.Option(help="PNG of the photo's size; white is used.")]
Start = Annotated[Path | None, typer.Option(help="Weather file to begin at; keeps what is not free.")]
Fix = Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="Hold a parameter; repeatable.")]
Free = Annotated[list[str] | None, typer.Option(metavar="NAME", help="Search one more; repeatable.")]
Solver = Annotated[str, typer.Option(help="least-squares, nlopt:NAME, adam or lbfgs.")]
Seconds = Annotated[float | None, typer.Option(min=1e-3, help="Take the best after this long; not repeatable.")]
Seed = Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Of the sample of pixels and of solvers that draw.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Time = Annotated[str | None, typer.Option(help="With its zone, such as 2016-08-14T06:30+02:00.")]
Weather = Annotated[Path, typer.Argument(help="Weather file.")]
Hour = Annotated[float | None, typer.Option(min=0, max=24, help="Of the day; else that of --time, else 12.")]
