"""Random weather files written and read, also as spreadsheets save them; and bad ones, each refused in one line.

    python -m experiments.weather_files --size full

Each good file is read back as it was written and as spreadsheets save it, and has to hold the same bits; with decimal
commas it has to be refused with its first number as it should be. Each bad file goes to `fit show`, in this process,
and one of every kind in a process of its own too: it has to end with status 2 and one line that says what is wrong.
"""

import argparse
import contextlib
import io
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments import fit_command
from experiments.random_weather import DIALECTS, KINDS, bad, weather, with_decimal_commas
from experiments.records import RESULTS, table, write
from experiments.timing import one_thread
from fit import __main__ as command
from fit import weather_file
from fit.input_error import InputError
from fit.weather_file import Weather

SIZES = {"small": (5, len(KINDS), 0), "full": (10_000, 5 * len(KINDS), len(KINDS))}  # good files, bad ones, processes
SUBNORMAL = 2.2250738585072014e-308  # the smallest number that is not
REFUSED = 2  # exit status


def bits(found: Weather) -> object:
    """What tells two weathers apart to the last bit, the sign of a zero and the order of lines."""
    rows = [
        (name, [cell is not None and struct.pack("<d", cell) for cell in row]) for name, row in found.values.items()
    ]
    return [struct.pack("<d", hour) for hour in found.hours], rows, list(found.header.items())


@dataclass(frozen=True)
class Ending:
    """How the command went with a bad file."""

    status: int
    told: str
    complained: str

    def fault(self, said: str) -> str:
        """What is wrong with a refusal that has to say something; empty where nothing is."""
        line, end, more = self.complained.partition("\n")
        if self.status != REFUSED or self.told:
            return f"ended with status {self.status}"
        if not (line.startswith("error: ") and line.isprintable() and end and not more):
            return "more or less than one line"
        return "" if said in line else "another reason"


def in_process(path: Path) -> Ending:
    """`fit show` in this process."""
    told, complained = io.StringIO(), io.StringIO()
    words, sys.argv = sys.argv, ["fit", "show", str(path)]
    status = 0
    try:
        with one_thread(), contextlib.redirect_stdout(told), contextlib.redirect_stderr(complained):
            command.main()
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 0
    finally:
        sys.argv = words
    return Ending(status, told.getvalue(), complained.getvalue())


def as_process(path: Path) -> Ending:
    """`fit show` in a process of its own."""
    ended = fit_command.run([sys.executable, "-m", "fit", "show", str(path)])
    return Ending(ended.status, ended.told, ended.complained)


def round_trips(folder: Path, count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """How many files read back the same by the way they were saved, what was in them, and what did not hold."""
    held: Counter[str] = Counter()
    faults = []
    path = folder / "weather.csv"
    for number in range(count):
        made = weather(np.random.default_rng((seed, number)))
        held.update(_content(made))
        weather_file.write(path, made)
        text = path.read_text(encoding="utf-8")
        for dialect, spoken in DIALECTS.items():
            path.write_bytes(spoken(text).encode())
            found = _read(path)
            if isinstance(found, Weather) and bits(found) == bits(made):
                held[dialect] += 1
            else:
                faults.append(f"{number}, {dialect}: {found if isinstance(found, str) else 'differs'}")
        for ending, separator in (("decimal commas", ";"), ("decimal commas, tabs", "\t"), ("quoted ones", ",")):
            changed, first = with_decimal_commas(text, separator)
            if first:
                path.write_bytes(changed.encode())
                refusal = _read(path)
                held[ending] += 1
                if not (isinstance(refusal, str) and _hint(refusal) == first):
                    faults.append(f"{number}, {ending}: {refusal}")
    return held, faults


def _read(path: Path) -> Weather | str:
    try:
        return weather_file.read(path)
    except InputError as error:
        return str(error)


def _hint(refusal: str) -> str:
    """What a refusal of a decimal comma says to write."""
    return refusal.partition("has a decimal comma; write ")[2].partition(",")[0]


def _content(made: Weather) -> Iterator[str]:
    numbers = [cell for cells in made.values.values() for cell in cells if cell is not None]
    yield from ["numbers"] * len(numbers)
    yield from ["subnormal numbers"] * sum(0.0 < abs(number) < SUBNORMAL for number in numbers)
    yield from ["empty cells"] * (len(made.hours) * len(made.values) - len(numbers))
    yield from ["lines of header"] * len(made.header)


def refusals(folder: Path, count: int, processes: int, seed: int) -> tuple[dict[str, str], list[str]]:
    """The line that the first file of each kind is refused with, and what did not hold."""
    lines: dict[str, str] = {}
    faults = []
    path = folder / "bad.csv"
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        content, said = bad(kind, np.random.default_rng((seed, number)))
        path.write_bytes(content)
        endings = [in_process(path)]
        if number < processes:
            endings.append(as_process(path))
        faults += [f"{number}, {kind}: {ending.fault(said)}" for ending in endings if ending.fault(said)]
        faults += [f"{number}, {kind}: processes differ"] * (len(set(endings)) - 1)
        lines.setdefault(kind, endings[0].complained.strip().replace(f"{folder}/", ""))
    return lines, faults


def main(arguments: Sequence[str] | None = None) -> None:
    """Write, read and refuse; print and write what came of it."""
    parser = argparse.ArgumentParser(description="Random weather files, good and bad.")
    parser.add_argument("--size", choices=SIZES, default="full")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    good, bad_ones, processes = SIZES[asked.size]
    with tempfile.TemporaryDirectory() as name:
        held, faults = round_trips(Path(name), good, asked.seed)
        lines, wrong = refusals(Path(name), bad_ones, processes, asked.seed)
    content = {
        "seed": asked.seed,
        "files": good,
        "content": {kind: held[kind] for kind in ("numbers", "subnormal numbers", "empty cells", "lines of header")},
        "same_bits": {dialect: held[dialect] for dialect in DIALECTS},
        "decimal_commas_refused": held["decimal commas"] + held["decimal commas, tabs"] + held["quoted ones"],
        "bad_files": bad_ones,
        "processes": processes,
        "refusals": lines,
        "faults": [*faults, *wrong],
    }
    write(asked.out / "weather_files.json", content)
    rows = [[dialect, str(good), str(held[dialect])] for dialect in DIALECTS]
    print(table(["saved", "files", "same bits"], rows))
    print(f"{content['decimal_commas_refused']} files with decimal commas, {bad_ones} bad ones of {len(lines)} kinds")
    print("\n".join(content["faults"]) or "every file is read or refused as it should be")


if __name__ == "__main__":
    main()
