"""How near fitted skies come to photos, beside the better of two peers and beside what any smooth sky may reach.

Each photo is fitted by the command line with its mask and the sun at its seen place, and judged by E3 from the file
`fitted.exr`. The peers, Mitsuba 3's sunsky (Hosek-Wilkie) and the sky of Lalonde and Matthews, had the same masks, the
same place of the sun, and gains per channel.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from experiments import plots, records, shots
from experiments.fit_command import fit_sky
from experiments.harmonics_floor import harmonics_floor
from experiments.log_error import log_error, read_mask, read_picture, sky_under
from experiments.shots import Shot
from experiments.timing import geometric_mean


@dataclass(frozen=True)
class Accuracy:
    """Errors E3 on one photo; ratios are to the better peer."""

    photo: str
    error: float
    peer: float
    ratio: float
    floor: float
    floor_ratio: float
    solve_seconds: float
    converged: bool


def accuracy(shot: Shot) -> Accuracy:
    """Errors of the fit of one photo, of its better peer and of the floor."""
    sky = sky_under(read_mask(shot.mask), read_picture(shot.photo), shot.eps)
    with tempfile.TemporaryDirectory() as folder:
        fit = fit_sky(shot.photo, shot.mask, shot.sun, Path(folder))
        error = log_error(sky, read_picture(Path(folder) / "fitted.exr")).error
    floor = harmonics_floor(sky).error
    return Accuracy(
        photo=shot.name,
        error=error,
        peer=shot.peer_error,
        ratio=error / shot.peer_error,
        floor=floor,
        floor_ratio=floor / shot.peer_error,
        solve_seconds=fit.solve_seconds,
        converged=bool(fit.account["converged"]),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it as JSON and as a bar chart."""
    given = shots.ask("accuracy of fitted skies", arguments)
    found = [accuracy(shot) for shot in given.shots]
    means = {
        name: geometric_mean(getattr(row, name) for row in found)
        for name in ("error", "peer", "ratio", "floor", "floor_ratio", "solve_seconds")
    }
    lines = [
        [
            str(row["photo"]),
            *(f"{row[name]:.5f}" for name in ("error", "peer")),
            f"{row['ratio']:.3f}",
            f"{row['floor']:.5f}",
            f"{row['floor_ratio']:.3f}",
            f"{row['solve_seconds']:.2f}",
        ]
        for row in [*map(asdict, found), {"photo": "geometric mean", **means}]
    ]
    print(records.table(["photo", "E3", "better peer", "ratio", "floor", "floor ratio", "solve s"], lines))
    written = given.out / "fit_accuracy.json"
    records.write(written, {"records": [asdict(row) for row in found], "geometric_means": means})
    plots.fit_accuracy(written)


if __name__ == "__main__":
    main()
