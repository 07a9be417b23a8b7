"""`fit sky` run again: the same photo, seed and number of threads must give the same files, byte for byte.

    python -m experiments.sameness

Runs of one solver differ in what must not matter: the folder they run in, the folder of the photo and whether its path
is relative, Python's seed of hashes, the folder of the results and what stands in it.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from experiments import hostile_samples
from experiments.fit_command import COMMAND, DID_NOT_CONVERGE
from experiments.kills import PHOTO
from experiments.records import RESULTS, table, write

SOLVERS = ("least-squares", "nlopt:LD_SLSQP", "nlopt:G_MLSL_LDS", "nlopt:GN_CRS2_LM", "adam", "lbfgs")
SAME = ("weather.csv", "fitted.exr", "mask.png")  # report.html and fit.json tell how long the fit took


@dataclass(frozen=True)
class Repeated:
    """Runs of one solver.

    Attributes:
        digests: of each file, one for each run.
        differing: files that are not the same in all runs.
    """

    solver: str
    runs: int
    digests: dict[str, tuple[str, ...]]
    differing: tuple[str, ...]


def repeated(solver: str, photo: Path, folder: Path, runs: int) -> Repeated:
    """A photo fitted as often as that, each time from another folder.

    Raises:
        RuntimeError: when a run fails.
    """
    found: dict[str, list[str]] = {name: [] for name in SAME}
    for run in range(runs):
        here = folder / f"{solver.replace(':', ' ')} {run}"
        copied = here / f"photo {run}" / photo.name
        copied.parent.mkdir(parents=True)
        shutil.copyfile(photo, copied)
        given = copied.relative_to(here) if run % 2 else copied
        command = [*COMMAND, str(given), *hostile_samples.SUN, "--solver", solver, "--quiet", "--out", "out"]
        hashes = os.environ | {"PYTHONHASHSEED": str(run), "OMP_NUM_THREADS": "1"}
        ended = subprocess.run(command, cwd=here, env=hashes, capture_output=True, text=True, check=False)
        if ended.returncode not in (0, DID_NOT_CONVERGE) or ended.stderr:
            raise RuntimeError(f"--solver {solver} ended with status {ended.returncode}: {ended.stderr.strip()}")
        for name, digests in found.items():
            digests.append(hashlib.sha256((here / "out" / name).read_bytes()).hexdigest())
    differing = tuple(name for name, digests in found.items() if len(set(digests)) > 1)
    return Repeated(solver, runs, {name: tuple(digests) for name, digests in found.items()}, differing)


def all_repeated(solvers: Sequence[str], folder: Path, runs: int) -> Iterator[Repeated]:
    """Every solver's runs on a small photo."""
    photo = hostile_samples.first(folder, hostile_samples.photo(PHOTO))
    return (repeated(solver, photo, folder, runs) for solver in solvers)


def main(arguments: Sequence[str] | None = None) -> None:
    """Repeat fits, print and write what differs."""
    parser = argparse.ArgumentParser(description="Run `fit sky` again and compare its files.")
    parser.add_argument("solvers", nargs="*", default=SOLVERS)
    parser.add_argument("--runs", type=int, default=3, help="of each solver")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        found = list(all_repeated(asked.solvers, Path(name), asked.runs))
    write(asked.out / "sameness.json", {"records": [asdict(entry) for entry in found]})
    rows = [[entry.solver, str(entry.runs), ", ".join(entry.differing) or "none"] for entry in found]
    print(table(["solver", "runs", "files that differ"], rows))


if __name__ == "__main__":
    main()
