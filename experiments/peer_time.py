"""How long a fit's solve takes beside that of a peer in the same run, and beside its own on a larger photo.

Ours is the solve of the command `fit sky` by its own account, cold; the peer's is `experiments.mitsuba_sky`, three
starts of L-BFGS-B, warm. Both are processes of their own on two threads, run in turn. Reading a photo and averaging
its pixels to fewer is in neither; it grows with the photo, and is told beside the growth of the solve. The peer gives
no error bars: what ours take is told too, and a second ratio counts it.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from experiments import fit_command, plots, records, shots
from experiments.enlarged import enlarged
from experiments.fit_command import FitRun
from experiments.log_error import log_error, read_mask, read_picture, sky_under
from experiments.mitsuba_sky import PeerFit
from experiments.shots import Shot
from experiments.timing import Spread, geometric_mean, interleaved, ratio, spread

ROUNDS, LARGE_WIDTH, LARGE_SHOTS = 5, 8192, 2
SMALL_ROUNDS, SMALL_LARGE_WIDTH = 1, 2048  # of the smallest size
MEBIBYTE = 2**20


@dataclass(frozen=True)
class PeerTime:
    """Solve times of one photo [s]; the ratio is the peer's over ours.

    Attributes:
        errors: what our error bars take on top.
        ratio_with_errors: the same when they count.
        peer_first_start: of the peer's three starts the first alone, by the same clock.
        error: E3 of our fit.
        peer_error: E3 of the peer's, and as it is in the table of the peers.
    """

    photo: str
    ours: Spread
    peer: Spread
    ratio: Spread
    errors: Spread
    ratio_with_errors: Spread
    peer_first_start: Spread
    peer_compile: Spread
    peer_evaluations: int
    error: float
    peer_error: float
    peer_error_in_table: float


@dataclass(frozen=True)
class Growth:
    """Solve times of a photo as it is and enlarged [s], and what else the command takes on the large one."""

    photo: str
    width: int
    as_it_is: Spread
    large: Spread
    ratio: Spread
    read_seconds: Spread
    command_seconds: Spread
    peak_mebibytes: float


def peer_fit(shot: Shot) -> PeerFit:
    """The peer's fit of a photo, in a process of its own.

    Raises:
        RuntimeError: when that fails.
    """
    place = f"--sun={shot.sun[0]},{shot.sun[1]}"
    module = [sys.executable, "-m", "experiments.mitsuba_sky"]
    told = fit_command.run_well([*module, str(shot.photo), str(shot.mask), place, "--eps", str(shot.eps)]).told
    return PeerFit(**json.loads(told))


def our_fit(shot: Shot, folder: Path) -> FitRun:
    """Our fit of a photo, in a process of its own."""
    return fit_command.fit_sky(shot.photo, shot.mask, shot.sun, folder)


def against_peer(shot: Shot, rounds: int) -> PeerTime:
    """Solve times of one photo by us and by the peer, in turn."""
    fits: list[PeerFit] = []
    runs: list[FitRun] = []

    def theirs() -> float:
        fits.append(peer_fit(shot))
        return fits[-1].seconds

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)

        def ours() -> float:
            runs.append(our_fit(shot, out))
            return runs[-1].solve_seconds

        timed = interleaved(ours, theirs, rounds)
        sky = sky_under(read_mask(shot.mask), read_picture(shot.photo), shot.eps)
        error = log_error(sky, read_picture(out / "fitted.exr")).error
    return PeerTime(
        photo=shot.name,
        ours=timed.first,
        peer=timed.second,
        ratio=timed.ratio,
        errors=spread([run.errors_seconds for run in runs[1:]]),
        ratio_with_errors=ratio(timed.second, spread([run.solve_seconds + run.errors_seconds for run in runs[1:]])),
        peer_first_start=spread([fit.seconds_each[0] for fit in fits[1:]]),
        peer_compile=spread([fit.compile_seconds for fit in fits[1:]]),
        peer_evaluations=fits[-1].evaluations,
        error=error,
        peer_error=fits[-1].error,
        peer_error_in_table=shot.mitsuba_error,
    )


def growth(shot: Shot, width: int, rounds: int) -> Growth:
    """Solve times of one photo as it is and enlarged to a width, in turn."""
    runs: list[FitRun] = []

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        large = enlarged(shot, width, out)

        def solve_large() -> float:
            runs.append(our_fit(large, out / "large"))
            return runs[-1].solve_seconds

        timed = interleaved(lambda: our_fit(shot, out / "as_it_is").solve_seconds, solve_large, rounds)
    return Growth(
        photo=shot.name,
        width=width,
        as_it_is=timed.first,
        large=timed.second,
        ratio=timed.ratio,
        read_seconds=spread([run.read_seconds for run in runs[1:]]),
        command_seconds=spread([run.process.seconds for run in runs[1:]]),
        peak_mebibytes=max(run.process.peak_bytes for run in runs) / MEBIBYTE,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables, and write them as JSON and the ratios as a bar chart."""
    given = shots.ask("solve time beside a peer's and on a larger photo", arguments)
    rounds, width = (SMALL_ROUNDS, SMALL_LARGE_WIDTH) if given.is_small else (ROUNDS, LARGE_WIDTH)
    beside = [against_peer(shot, rounds) for shot in given.shots]
    grown = [growth(shot, width, rounds) for shot in given.shots[:LARGE_SHOTS]]
    mean_ratio = geometric_mean(row.ratio.median for row in beside)
    mean_with_errors = geometric_mean(row.ratio_with_errors.median for row in beside)
    print(peer_table(beside))
    print(f"geometric mean of the ratios: {mean_ratio:.3g}, with our error bars {mean_with_errors:.3g}\n")
    print(growth_table(grown))
    written = given.out / "peer_time.json"
    content = {"peer": [asdict(row) for row in beside], "growth": [asdict(row) for row in grown]}
    means = {"geometric_mean_ratio": mean_ratio, "geometric_mean_ratio_with_errors": mean_with_errors}
    records.write(written, content | means)
    plots.peer_time(written)


def peer_table(rows: Sequence[PeerTime]) -> str:
    """Text of the table of solve times beside the peer's."""
    head = [
        "photo",
        "ours s",
        "peer s",
        "ratio",
        "with error bars",
        "to its first start",
        "E3",
        "peer E3",
        "in PEERS.csv",
    ]
    return records.table(
        head,
        [
            [
                row.photo,
                str(row.ours),
                str(row.peer),
                str(row.ratio),
                str(row.ratio_with_errors),
                f"{row.peer_first_start.median / row.ours.median:.3g}",
                *(f"{error:.5f}" for error in (row.error, row.peer_error, row.peer_error_in_table)),
            ]
            for row in rows
        ],
    )


def growth_table(rows: Sequence[Growth]) -> str:
    """Text of the table of solve times on larger photos."""
    head = ["photo", "width", "solve s", "solve s large", "ratio", "read s", "command s", "peak MiB"]
    return records.table(
        head,
        [
            [
                row.photo,
                str(row.width),
                str(row.as_it_is),
                str(row.large),
                str(row.ratio),
                str(row.read_seconds),
                str(row.command_seconds),
                f"{row.peak_mebibytes:.0f}",
            ]
            for row in rows
        ],
    )


if __name__ == "__main__":
    main()
