"""Random weather files, good and bad: any number they may hold, what spreadsheets make of them, and what is wrong."""

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from diffrender.scene import weather_names
from fit.weather_file import CLOSEST, FIRST_LINE, HOURS, LARGEST, Weather

LETTERS = {
    "Latin": "azAZ019éßøŁ",
    "Greek": "αωΣ",
    "Cyrillic": "яЖ",
    "right to left": "שلم",
    "joined": "नमस्ते",
    "East Asian": "空雨한",
    "beyond 16 bits": "🌧𝄞",
    "signs": "#:;,.'()&/_=+-@%!?°²€“",
}
HEADER_NAMES = ("origin", "latitude", "date", "heading", "time", "Photo of", "x-1_")
FORMULA = re.compile(r"(?<=[,;])\s*[-=+@]|^[-=+@]")
PLACES = 12  # most hours of a random weather
NAMES = 10  # most parameters of one


def weather(generator: np.random.Generator) -> Weather:
    """A weather of a few hours, names and lines of header, with empty cells."""
    names = generator.permutation(sorted(weather_names()))[: int(generator.integers(1, NAMES + 1))]
    hours = _hours(generator)
    values = {str(name): tuple(_cell(str(name), generator) for _ in hours) for name in names}
    header_names = generator.permutation(HEADER_NAMES)[: int(generator.integers(0, 4))]
    return Weather(hours, values, {str(name): _text(generator) for name in header_names})


def _hours(generator: np.random.Generator) -> tuple[float, ...]:
    count = int(generator.integers(1, PLACES + 1))
    kinds = (
        generator.uniform(0.0, 24.0, count),
        generator.integers(0, 24, count).astype(float),
        generator.integers(0, 96, count) / 4.0,
        10.0 ** generator.uniform(-300.0, math.log10(24.0), count),
        np.array([0.0, 5e-324, CLOSEST, 24.0 - 2.0 * CLOSEST]),
    )
    found: list[float] = []
    for hour in sorted(map(float, kinds[int(generator.integers(len(kinds)))])):
        if not found or (hour - found[-1] >= CLOSEST and hour - found[0] <= 24.0 - CLOSEST):
            found.append(hour)
    return tuple(found)


def _cell(name: str, generator: np.random.Generator) -> float | None:
    low, high = weather_names()[name].file_bounds
    if generator.random() < 0.3:
        return None
    least = low if low > 0.0 else 5e-324
    largest = max(abs(low), abs(high))
    size = 10.0 ** generator.uniform(math.log10(least), math.log10(largest))
    places = int(generator.integers(0, 7))
    kinds = (
        float(generator.uniform(low, high)),
        round(float(generator.uniform(low, high)), places),
        float(size),
        -float(size),
        low,
        high,
        math.nextafter(low, math.inf),
        math.nextafter(high, -math.inf),
        float(generator.choice([0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1.0])),
    )
    value = kinds[int(generator.integers(len(kinds)))]
    return value if low <= value <= high else float(generator.uniform(low, high))


def _text(generator: np.random.Generator) -> str:
    """Words of all scripts; it begins and ends with a letter, and no cell of it begins as a formula does."""
    letters = [*"".join(LETTERS.values()), " "]
    inside = "".join(str(letter) for letter in generator.choice(letters, int(generator.integers(0, 30))))
    return f"a{FORMULA.sub('_', inside)}z" if generator.random() < 0.9 else ""


# What spreadsheets save


def saved(text: str, separator: str, line_end: str = "\n", quoting: Literal[0, 1] = csv.QUOTE_MINIMAL) -> str:
    """A file opened as a spreadsheet does, cut at commas and filled up to one width, and saved with a separator."""
    rows = list(csv.reader(text.split("\n")[:-1]))
    width = max(map(len, rows))
    written = io.StringIO()
    writer = csv.writer(written, delimiter=separator, lineterminator=line_end, quoting=quoting)
    writer.writerows([*row, *[""] * (width - len(row))] for row in rows)
    return written.getvalue()


DIALECTS: Mapping[str, Callable[[str], str]] = {
    "as written": str,
    "semicolons": lambda text: saved(text, ";"),
    "tabs": lambda text: saved(text, "\t"),
    "byte order mark": lambda text: "\ufeff" + text,
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "padded rows": lambda text: saved(text, ","),
    "quoted cells": lambda text: saved(text, ",", quoting=csv.QUOTE_ALL),
    "semicolons, byte order mark, CRLF": lambda text: "\ufeff" + saved(text, ";", "\r\n"),
    "tabs, quoted cells, CRLF": lambda text: saved(text, "\t", "\r\n", csv.QUOTE_ALL),
}


def with_decimal_commas(text: str, separator: str) -> tuple[str, str]:
    """A file as a spreadsheet with decimal commas saves it, and its first number that has one, as it was."""
    lines = text.split("\n")
    start = next(number for number, line in enumerate(lines) if line.startswith(HOURS))
    cells = [cell for line in lines[start:] for cell in line.split(",")[1:]]
    first = next((cell for cell in cells if "." in cell), "")
    table = [[cell.replace(".", ",") for cell in line.split(",")] for line in lines[start:-1]]
    written = io.StringIO()
    csv.writer(written, delimiter=separator, lineterminator="\n").writerows(table)
    return "\n".join([*lines[:start], written.getvalue()]), first


# What is wrong


Lines = list[str]


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a file.

    Attributes:
        spoil: changes the rows of a table, the first of which has the hours 6, 12 and 18.25 and the second EXPOSURE.
        said: what the refusal has to say.
    """

    spoil: Callable[[Lines], object]
    said: str


def _cell_put(row: int, column: int, cell: str) -> Callable[[Lines], object]:
    def spoil(rows: Lines) -> None:
        cells = rows[row].split(",")
        cells[column] = cell
        rows[row] = ",".join(cells)

    return spoil


FAULTS: Mapping[str, Fault] = {
    "unknown name": Fault(_cell_put(1, 0, "EXPOSUR"), "the nearest known one is EXPOSURE"),
    "small letters": Fault(_cell_put(1, 0, "exposure"), "the nearest known one is EXPOSURE"),
    "no name": Fault(_cell_put(1, 0, ""), "unknown name ''"),
    "name of a formula": Fault(_cell_put(1, 0, "=cmd()"), "unknown name '=cmd()'"),
    "name that moves the cursor": Fault(_cell_put(1, 0, "\x1b[2J"), "unknown name"),
    "name of many letters": Fault(_cell_put(1, 0, "X" * 100_000), "unknown name 'XXX"),
    "row twice": Fault(lambda rows: rows.append(rows[1]), "stands twice"),
    "row cut short": Fault(lambda rows: rows.append("SKY_OZONE,1"), "1 cells for 3"),
    "row too long": Fault(lambda rows: rows.append("SKY_OZONE,1,1,1,1"), "4 cells for 3"),
    "decimal comma in bare cells": Fault(lambda rows: rows.append("SKY_OZONE,1,0,5,1"), "decimals with a point"),
    "decimal comma": Fault(_cell_put(1, 1, '"0,5"'), "write 0.5"),
    "value too large": Fault(_cell_put(1, 1, "1e13"), "EXPOSURE is 10000000000000; allowed"),
    "value too small": Fault(_cell_put(1, 2, "-1"), "EXPOSURE is -1; allowed"),
    "value beyond all numbers": Fault(_cell_put(1, 3, "1e999"), "EXPOSURE is inf; allowed"),
    "nan": Fault(_cell_put(1, 1, "nan"), "is not a finite number"),
    "inf": Fault(_cell_put(1, 2, "-inf"), "is not a finite number"),
    "word": Fault(_cell_put(1, 3, "much"), "'much' is not a finite number"),
    "unit": Fault(_cell_put(1, 1, "0.5 1/m"), "is not a finite number"),
    "formula": Fault(_cell_put(1, 2, "=1+1"), "is not a finite number"),
    "error of a spreadsheet": Fault(_cell_put(1, 2, "#DIV/0!"), "is not a finite number"),
    "date of a spreadsheet": Fault(_cell_put(1, 2, "01.05.2020"), "is not a finite number"),
    "thousands": Fault(_cell_put(1, 3, '"1,000.5"'), "is not a finite number"),
    "Arabic digits": Fault(_cell_put(1, 1, "\u0663"), "is not a finite number"),
    "NUL": Fault(_cell_put(1, 1, "\0"), "is not a finite number"),
    "open quote": Fault(_cell_put(1, 3, '"1'), "check the quotes"),
    "hour 24": Fault(_cell_put(0, 3, "24"), "hour 24; allowed from 0 to below 24"),
    "negative hour": Fault(_cell_put(0, 1, "-1"), "hour -1; allowed from 0 to below 24"),
    "clock": Fault(_cell_put(0, 1, "6:30"), "for half past six, 6.5"),
    "hours that fall": Fault(_cell_put(0, 3, "7"), "hours rise from left to right"),
    "hour twice": Fault(_cell_put(0, 2, "6"), "hour 6 stands twice"),
    "hour left out": Fault(_cell_put(0, 2, ""), "'' is not a finite number"),
    "value under no hour": Fault(
        lambda rows: rows.__setitem__(slice(0, 2), [f"{rows[0]},", f"{rows[1]},1"]), "'1' stands under no hour"
    ),
    "no hours": Fault(lambda rows: rows.__setitem__(0, f"{HOURS},,,"), "no hours"),
    "no row of hours": Fault(lambda rows: rows.pop(0), "the first row of the table is TIME_OF_DAY"),
    "no table": Fault(lambda rows: rows.clear(), "no row TIME_OF_DAY"),
    "header without colon": Fault(lambda rows: rows.insert(0, "# origin"), "allowed is '# name: value'"),
    "header twice": Fault(lambda rows: rows.insert(0, "# a: 1\n# a: 2"), "header a stands twice"),
    "header after the table": Fault(lambda rows: rows.append("# a: 1"), "unknown name '# a: 1'"),
    "too large": Fault(lambda rows: rows.append("," * LARGEST), "bytes; is it a weather file?"),
}
ENCODINGS: Mapping[str, tuple[Callable[[str], bytes], str]] = {
    "UTF-16": (lambda text: text.encode("utf-16"), "not UTF-8; save it as CSV in UTF-8"),
    "Latin-1": (lambda text: text.replace("weather 1\n", "weather 1\n# a: é\n").encode("latin-1"), "not UTF-8"),
    "no first line": (lambda text: text.partition("\n")[2].encode(), "reads only '# weather 1'"),
    "another version": (lambda text: text.replace("weather 1", "weather 2").encode(), "format '# weather 2'"),
    "empty": (lambda _: b"", "reads only '# weather 1'"),
    "a picture": (lambda _: b"\x76\x2f\x31\x01" + bytes(range(256)), "not UTF-8"),
}
KINDS = (*FAULTS, *ENCODINGS)


def bad(kind: str, generator: np.random.Generator) -> tuple[bytes, str]:
    """A file with one fault in an otherwise good table of random numbers, and what its refusal has to say."""
    names = [name for name in weather_names() if name not in ("EXPOSURE", "SKY_OZONE")]
    rows = [f"{HOURS},6,12,18.25"]
    for name in ("EXPOSURE", *generator.choice(names, int(generator.integers(0, 5)), replace=False)):
        cells = (_cell(str(name), generator) for _ in range(3))
        rows.append(",".join([str(name), *("" if cell is None else repr(cell) for cell in cells)]))
    if kind in ENCODINGS:
        encoded, said = ENCODINGS[kind]
        return encoded(_whole(rows)), said
    FAULTS[kind].spoil(rows)
    return _whole(rows).encode(), FAULTS[kind].said


def _whole(rows: Sequence[str]) -> str:
    return "".join(f"{line}\n" for line in [FIRST_LINE, *rows])
