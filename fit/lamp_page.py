"""A lamp's photometric file as one self-contained HTML page: what it says, and its polar diagram."""

import math
from pathlib import Path

from fit import page
from fit.lamp_sheet import PLANES, STEPS, Sheet

SIZE, RADIUS = 420.0, 170.0  # of the diagram, and of the circle of the peak
EVERY = 20  # directions between those that are drawn: 1 degree
RINGS = 4  # circles of even intensity
SPOKES = range(0, 360, 30)  # [degrees]


def write(path: Path, name: str, sheet: Sheet) -> None:
    """Write the page of a lamp's file with a name.

    Raises:
        InputError: for a path that is no HTML file's, or cannot be written.
    """
    page.write(path, html(name, sheet))


def html(name: str, sheet: Sheet) -> str:
    """HTML of the page: needs no other file and no network."""
    return page.template("lamp.html").render(
        name=name,
        sheet=sheet,
        size=SIZE,
        radius=RADIUS,
        rings=[(RADIUS * ring / RINGS, f"{sheet.peak * ring / RINGS:.3g} cd") for ring in range(1, RINGS + 1)],
        spokes=[(*_point(angle, RADIUS), *_point(angle, RADIUS + 14.0), _named(angle)) for angle in SPOKES],
        curves=[(plane.horizontal, _path(plane.intensity.tolist(), sheet.peak)) for plane in sheet.planes],
        planes=PLANES,
    )


def _named(angle: int) -> str:
    """Vertical angle of a direction round the diagram."""
    return f"{min(angle, 360 - angle)}°"


def _path(intensity: list[float], peak: float) -> str:
    # Divided first: over the faintest lamps RADIUS / peak is infinite.
    share = [one / peak if peak > 0.0 else 0.0 for one in intensity]
    angles = range(0, STEPS + 1, EVERY)
    points = [_point(360.0 * place / STEPS - 180.0, RADIUS * share[place]) for place in angles]
    return "M" + " L".join(f"{right:.2f},{down:.2f}" for right, down in points)


def _point(angle: float, radius: float) -> tuple[float, float]:
    """Place in the diagram of an angle from straight down [degrees]."""
    turn = math.radians(angle)
    return SIZE / 2.0 + radius * math.sin(turn), SIZE / 2.0 + radius * math.cos(turn)
