"""Shots: photos of skies with their masks, where the sun stands in them, and how well the peers fitted them."""

import argparse
import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.records import RESULTS

MASKS, PEERS = "masks", "PEERS.csv"  # where they are beside the photos


@dataclass(frozen=True)
class Shot:
    """One photo, and what is known of it.

    Attributes:
        sun: elevation and azimuth to the right of the centre, in degrees; where it is not seen, the brightest place.
        eps: by which the peers' errors were measured.
        mitsuba_error: E3 of Mitsuba's sunsky with the sun at its place.
        lalonde_matthews_error: E3 of the sky of Lalonde and Matthews, likewise.
    """

    photo: Path
    mask: Path
    sun: tuple[float, float]
    eps: float
    mitsuba_error: float
    lalonde_matthews_error: float
    is_sun_visible: bool

    @property
    def name(self) -> str:
        """Of the photo, without its ending."""
        return self.photo.stem

    @property
    def peer_error(self) -> float:
        """E3 of the better peer."""
        return min(self.mitsuba_error, self.lalonde_matthews_error)


@dataclass(frozen=True)
class Given:
    """What an experiment on photos was asked for."""

    shots: tuple[Shot, ...]
    is_small: bool
    out: Path


def read_shots(photos: Path, masks: Path, peers: Path) -> tuple[Shot, ...]:
    """Photos of a folder, in the order of the peers' table, as far as that knows them."""
    with peers.open(encoding="utf-8", newline="") as lines:
        return tuple(
            Shot(
                photo=photos / row["file"],
                mask=masks / f"{Path(row['file']).stem}.png",
                sun=(float(row["sun_elevation"]), float(row["sun_azimuth_right_of_centre"])),
                eps=float(row["eps"]),
                mitsuba_error=float(row["mitsuba_fixed_E3"]),
                lalonde_matthews_error=float(row["lm_fixed_E3"]),
                is_sun_visible=row["sun_visible"] == "True",
            )
            for row in csv.DictReader(lines)
            if (photos / row["file"]).exists()
        )


def has_sun(shot: Shot) -> bool:
    """Whether the sun is seen, without which the peers cannot be given its place."""
    return shot.is_sun_visible


def ask(about: str, arguments: Sequence[str] | None, suits: Callable[[Shot], bool] = has_sun) -> Given:
    """Shots that suit and size from a command line; the smallest size is the first shot alone."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("names", nargs="*", help="photos without their endings; all where none is named")
    parser.add_argument("--photos", type=Path, required=True, help="folder of the photos")
    parser.add_argument("--masks", type=Path, help=f"folder of their masks; default {MASKS} in that of the photos")
    parser.add_argument("--peers", type=Path, help=f"table of the peers' errors; default {PEERS} beside the photos")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    known = read_shots(asked.photos, asked.masks or asked.photos / MASKS, asked.peers or asked.photos / PEERS)
    found = [shot for shot in known if suits(shot)]
    unknown = sorted(set(asked.names) - {shot.name for shot in found})
    if unknown or not found:
        parser.error(
            f"no {', '.join(unknown) or 'photo'} that suits in {asked.photos}; known: "
            f"{', '.join(shot.name for shot in found) or 'none'}"
        )
    chosen = tuple(shot for shot in found if not asked.names or shot.name in asked.names)
    is_small = asked.size == "small"
    return Given(chosen[:1] if is_small else chosen, is_small, asked.out)
