"""How well `fit sky` does without help: its own mask and sun beside given ones.

Masks are compared by intersection over union: whole, and within what both may hold, which is what stands 4 degrees
high and, where a sun is seen, 8 degrees away from it. Fits are compared by E3 on the given mask: that of a command told
nothing but the photo, over that of one which has the mask and the sun's place. Where no sun is seen, the place is the
brightest one and no truth.
"""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments import plots, records, shots
from experiments.fit_command import fit_sky, fit_sky_alone
from experiments.harmonics_floor import directions
from experiments.log_error import Floats, Mask, log_error, read_mask, read_picture, sky_under
from experiments.shots import Shot
from experiments.timing import geometric_mean

LOWEST, GLARE = math.radians(4.0), math.radians(8.0)  # of the recipe by which the given masks were made
SHOWN = 2.5  # times the median that is mapped to the middle of the tones


@dataclass(frozen=True)
class Beside:
    """One photo fitted without help and with it; angles are in degrees, IoU is intersection over union."""

    photo: str
    iou: float
    fair_iou: float
    sun_seen: bool
    sun_seen_by_peers: bool
    sun_apart: float
    sun_errors: tuple[float | None, float | None]
    error_alone: float
    error_helped: float
    ratio: float
    converged: bool


@dataclass(frozen=True, eq=False)
class Pictures:
    """The photo and both masks."""

    photo: Floats
    given: Mask
    found: Mask


def beside(shot: Shot) -> tuple[Beside, Pictures]:
    """Both fits of one photo, beside each other."""
    photo, given = read_picture(shot.photo), read_mask(shot.mask)
    sky = sky_under(given, photo, shot.eps)
    with tempfile.TemporaryDirectory() as folder:
        helped, alone = Path(folder) / "helped", Path(folder) / "alone"
        fit_sky(shot.photo, shot.mask, shot.sun, helped)
        account = fit_sky_alone(shot.photo, alone).account
        errors = [log_error(sky, read_picture(out / "fitted.exr")).error for out in (alone, helped)]
        found = read_mask(alone / "mask.png")
    sun = account["sun"]
    fair = fair_domain(given.shape[0], shot.sun if shot.is_sun_visible else None)
    row = Beside(
        photo=shot.name,
        iou=over_union(given, found),
        fair_iou=over_union(given & fair, found & fair),
        sun_seen=sun["visible"],
        sun_seen_by_peers=shot.is_sun_visible,
        sun_apart=degrees_between((sun["elevation"], sun["azimuth"]), shot.sun),
        sun_errors=(sun["elevation_standard_error"], sun["azimuth_standard_error"]),
        error_alone=errors[0],
        error_helped=errors[1],
        ratio=errors[0] / errors[1],
        converged=bool(account["converged"]),
    )
    return row, Pictures(photo, given, found)


def over_union(one: Mask, other: Mask) -> float:
    """Intersection over union; 1 where both are empty."""
    union = int((one | other).sum())
    return float((one & other).sum() / union) if union else 1.0


def fair_domain(height: int, sun: tuple[float, float] | None) -> Mask:
    """Pixels of a panorama that a mask made by the recipe may hold, and ours."""
    seen = directions(np.ones((height, 2 * height), dtype=bool))
    fair = seen[:, 2] > math.sin(LOWEST)
    if sun is not None:
        fair &= seen @ towards(sun) < math.cos(GLARE)
    return np.asarray(fair.reshape(height, 2 * height))


def towards(place: tuple[float, float]) -> NDArray[np.float64]:
    """Unit direction of an elevation and an azimuth to the right [degrees]."""
    elevation, azimuth = np.radians(place)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), -level * math.sin(azimuth), math.sin(elevation)])


def degrees_between(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Angle between two places; from the chord, because the cosine of a small angle has few digits.

    >>> round(degrees_between((89.0, 0.0), (89.0, 180.0)), 9)
    2.0
    """
    chord = float(np.linalg.norm(towards(one) - towards(other)))
    return math.degrees(2.0 * math.asin(min(chord / 2.0, 1.0)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it as JSON, as a chart and as a sheet of the masks over their photos."""
    given = shots.ask("fits without help beside fits with mask and sun", arguments, has_mask)
    found = [beside(shot) for shot in given.shots]
    rows = [row for row, _ in found]
    means = {name: geometric_mean(getattr(row, name) for row in rows) for name in ("iou", "fair_iou", "ratio")}
    lines = [
        [
            row.photo,
            f"{row.iou:.3f}",
            f"{row.fair_iou:.3f}",
            f"{row.sun_apart:.2f}" + ("" if row.sun_seen else " (hidden)"),
            f"{row.error_alone:.5f}",
            f"{row.error_helped:.5f}",
            f"{row.ratio:.3f}",
        ]
        for row in rows
    ]
    lines.append(
        ["geometric mean", f"{means['iou']:.3f}", f"{means['fair_iou']:.3f}", "", "", "", f"{means['ratio']:.3f}"]
    )
    head = ["photo", "IoU", "fair IoU", "sun apart", "E3 alone", "E3 helped", "ratio"]
    print(records.table(head, lines))
    written = given.out / "automatic_mask.json"
    records.write(written, {"records": [asdict(row) for row in rows], "geometric_means": means})
    plots.automatic_mask(written)
    plots.masks({row.photo: (toned(seen.photo), seen.given, seen.found) for row, seen in found}, written)


def has_mask(shot: Shot) -> bool:
    """Whether a mask was given."""
    return shot.mask.exists()


def toned(photo: Floats) -> Floats:
    """Photo as a picture for a screen, from 0 to 1."""
    radiance = np.maximum(np.nan_to_num(photo), 0.0)
    relative = radiance / (SHOWN * float(np.median(radiance[: len(radiance) // 2])))
    shown: Floats = (relative / (1.0 + relative)) ** (1.0 / 2.2)
    return shown


if __name__ == "__main__":
    main()
