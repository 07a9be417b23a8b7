"""Damaged and hostile files given to `fit`: what is no good picture must end in one line.

    python -m experiments.hostile_files --files FOLDER --count 10000

Every file of a folder, as a panorama and as a view; then half as many damaged photos and masks as are asked for, and as
many damaged weather files; each in a process of its own. A case holds when the command ends by itself within 10 s of
the processor and 1 GB, and either with status 0 or 1, nothing on standard error and all of its files whole, or with
status 2, one line on standard error and no file.
"""

import argparse
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments import hostile_samples
from experiments.fork_server import Ended, Server
from experiments.hostile_samples import QUICK, SUN, Sample
from experiments.mutations import mutated
from experiments.records import RESULTS, table, write
from experiments.whole_results import faults
from fit import exr

PHOTO = Path(__file__).parent / "photos" / "spruit_sunrise.exr"
MOST_SECONDS, MOST_MEMORY = 10.0, 10**9  # of the processor, and bytes
SAVED = 500  # cases after which the record is written
EVERY = 50  # one fit out of so many is not cut short
REFUSED, WRITTEN = 2, (0, 1)  # exit statuses


@dataclass(frozen=True)
class Verdict:
    """How a case went.

    Attributes:
        case: the file, or the sample with its number and mutations.
        kind: "photo", "weather" or "given".
        ended: "written", "refused", or what should not be.
        said: the line of a refusal.
        fault: why it does not hold; empty where it does.
        has_holes: whether a picture was fitted in which rows of the good one have become zeros.
        peak_bytes: most memory that the process held at a time.
    """

    case: str
    kind: str
    ended: str
    said: str
    fault: str
    has_holes: bool
    seconds: float
    peak_bytes: int


def fault(ended: Ended, out: Path) -> str:
    """What is wrong with a command's end and with what it left at `out`; empty where nothing is."""
    last = (ended.complained.strip().splitlines() or ["nothing on standard error"])[-1]
    if ended.seconds >= MOST_SECONDS:
        return f"took {ended.seconds:.1f} s"
    if ended.peak_bytes >= MOST_MEMORY:
        return f"took {ended.peak_bytes / 1e9:.2f} GB"
    if ended.status == REFUSED:
        return _fault_of_refusal(ended, out)
    if ended.status not in WRITTEN:
        return f"ended with status {ended.status}: {last}"
    return f"complained: {last}" if ended.complained else "; ".join(faults(out))


def _fault_of_refusal(ended: Ended, out: Path) -> str:
    line, end, more = ended.complained.partition("\n")
    if not line.startswith("error: ") or not line.isprintable() or not end or more or ended.told:
        return f"refused in other words than one line: {line}"
    return "refused, yet something is written" if out.exists() or list(out.parent.glob(".*.part")) else ""


class Judge:
    """Runs cases in a folder that holds the samples."""

    def __init__(self, server: Server, folder: Path, good: NDArray[np.float32]) -> None:
        """Judge with the good picture that the samples show."""
        self._server, self._folder, self._good = server, folder, good

    def judge(self, case: str, kind: str, path: Path, words: Sequence[str]) -> Verdict:
        """A command with one file in place of "{}"."""
        out = self._folder / "out" / ("out.exr" if words[0] == "render" else "out")
        out.parent.mkdir()
        ended = self._server.run([word.format(path) for word in words] + ["--out", str(out)])
        wrong = fault(ended, out)
        is_fitted = ended.status in WRITTEN and not wrong
        holed = is_fitted and words[:2] == ("sky", "{}") and path.suffix != ".hdr" and self._has_holes(path)
        shutil.rmtree(out.parent)
        how = wrong or ("written" if is_fitted else "refused")
        said = ended.complained.strip().replace(f"{path.parent}/", "")
        return Verdict(case, kind, how, said, wrong, holed, ended.seconds, ended.peak_bytes)

    def _has_holes(self, path: Path) -> bool:
        seen = exr.read(path).radiance
        if seen.shape != self._good.shape:
            return False
        # Not any(), which warns of a NaN that signals.
        return bool(((seen == 0.0).all((1, 2)) & (self._good != 0.0).any((1, 2))).any())


def given_cases(judge: Judge, files: Path) -> Iterator[Verdict]:
    """Every file of a folder as a panorama, and as a view of a part of the sky."""
    for path in sorted(files.iterdir()):
        yield judge.judge(path.name, "given", path, ("sky", "{}", *QUICK))
        view = ("--fov", "60", "--pitch", "30", "--sun", "40,10")
        yield judge.judge(f"{path.name} as a view", "given", path, ("sky", "{}", *view, *QUICK))


def damaged_cases(judge: Judge, samples: Sequence[Sample], folder: Path, count: int, seed: int) -> Iterator[Verdict]:
    """So many damaged copies of the samples, each the same for the same seed and number."""
    for number in range(count):
        sample = samples[number % len(samples)]
        content, names = damaged(sample, folder, seed, number)
        path = folder / f"damaged{Path(sample.file).suffix}"
        path.write_bytes(content)
        words = sample.words if sample.words[0] == "render" or number % EVERY == 0 else (*sample.words, *QUICK)
        kind = "weather" if sample.is_weather else "photo"
        yield judge.judge(f"{sample.file} {number}: {names}", kind, path, words)


def damaged(sample: Sample, folder: Path, seed: int, number: int) -> tuple[bytes, str]:
    """Content of a damaged copy, and the names of its mutations."""
    generator = np.random.default_rng((seed, number))
    return mutated((folder / sample.file).read_bytes(), sample.mutations, generator)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases, print and write what came of them."""
    parser = argparse.ArgumentParser(description="Give hostile files to `fit`.")
    parser.add_argument("--files", type=Path, help="folder of files that are given as photos")
    parser.add_argument("--count", type=int, default=10_000, help="of damaged photos and weather files together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    verdicts: list[Verdict] = []
    with tempfile.TemporaryDirectory() as name:
        for verdict in _verdicts(Path(name), asked.files, asked.count, asked.seed):
            verdicts.append(verdict)
            if verdict.fault or verdict.has_holes:
                print(f"{verdict.case}: {verdict.fault or 'fitted with holes'}", flush=True)
            if len(verdicts) % SAVED == 0:  # hours may be lost else
                write(asked.out / "hostile_files.json", {"seed": asked.seed, **_summary(verdicts)})
    write(asked.out / "hostile_files.json", {"seed": asked.seed, **_summary(verdicts)})
    judged = {"fitted or drawn": _is_written, "refused": _is_refused, "fault": _fails}
    rows = []
    for kind in dict.fromkeys(verdict.kind for verdict in verdicts):
        some = [verdict for verdict in verdicts if verdict.kind == kind]
        rows.append([kind, str(len(some)), *(str(sum(map(holds, some))) for holds in judged.values())])
    print(table(["kind", "files", *judged], rows))


def _verdicts(folder: Path, files: Path | None, count: int, seed: int) -> Iterator[Verdict]:
    good = hostile_samples.photo(PHOTO)
    first = hostile_samples.first(folder, good)
    with Server(folder, ("sky", str(first), *SUN, "--quiet", "--out", str(folder / "good"))) as server:
        # The server answers after it has warmed up, and so left a weather file.
        refused = server.run(("sky", "none"))
        assert refused.status == REFUSED
        samples = hostile_samples.write(folder, good, (folder / "good" / "weather.csv").read_bytes())
        judge = Judge(server, folder, good)
        if files is not None:
            yield from given_cases(judge, files)
        photos, weather = (
            damaged_cases(judge, [s for s in samples if s.is_weather == is_weather], folder, count // 2, seed)
            for is_weather in (False, True)
        )
        for pair in zip(photos, weather, strict=True):
            yield from pair


def _is_written(verdict: Verdict) -> bool:
    return verdict.ended == "written"


def _is_refused(verdict: Verdict) -> bool:
    return verdict.ended == "refused"


def _fails(verdict: Verdict) -> bool:
    return bool(verdict.fault)


def _summary(verdicts: Sequence[Verdict]) -> dict[str, object]:
    kinds = {kind: [v for v in verdicts if v.kind == kind] for kind in ("given", "photo", "weather")}
    return {
        "cases": {kind: len(found) for kind, found in kinds.items()},
        "written": {kind: sum(map(_is_written, found)) for kind, found in kinds.items()},
        "refused": {kind: sum(map(_is_refused, found)) for kind, found in kinds.items()},
        "longest_seconds": max((v.seconds for v in verdicts), default=0.0),
        "largest_peak_bytes": max((v.peak_bytes for v in verdicts), default=0),
        "given": {v.case: v.said or v.ended for v in kinds["given"]},
        "faults": [asdict(v) for v in verdicts if v.fault],
        "fitted_with_holes": [v.case for v in verdicts if v.has_holes],
    }


if __name__ == "__main__":
    main()
