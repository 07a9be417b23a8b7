"""Weather files: a table of parameters over the hours of a day, as UTF-8 CSV that opens in any spreadsheet.

The first line is `# weather 1`, the version of the format. Lines `# name: value` follow, then a row of TIME_OF_DAY and
hours, then one row per parameter; a cell may be empty. Numbers are in files' units (degrees, azimuth to the right).
Names, bounds and units are those of `diffrender.scene.weather_names`; nothing here knows a parameter of its own.
"""

import csv
import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from diffrender.parameters import Specification
from diffrender.scene import weather_names
from fit.input_error import InputError
from fit.whole_file import write_bytes

FIRST_LINE = "# weather 1"
HOURS = "TIME_OF_DAY"
HOUR_OF_UNKNOWN_TIME = 12.0
LARGEST = 2**20  # bytes; twenty times what a day at every quarter of an hour needs, and read within seconds
CLOSEST = 1e-6  # hours, 4 ms: nearer hours count as the same one, and slopes between keyframes cannot overflow

_HEADER_NAME = re.compile(r"[A-Za-z]([A-Za-z0-9 _-]*[A-Za-z0-9_-])?")
_HEADER_LINE = re.compile(rf"#\s*(?P<name>{_HEADER_NAME.pattern})\s*:(?P<text>.*)")
_PADDING = ' \t",;'  # what spreadsheets put round a line
_SHOWN = 60  # letters of a text in a message
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_FORMULA = re.compile(r"([,;]\s*)[-=+@]")  # what a spreadsheet would calculate, at the start of a cell


@dataclass(frozen=True)
class Weather:
    """Keyframes of a day, as they stand in a file.

    Attributes:
        hours: rising, in [0, 24).
        values: name -> one cell per hour in the file's unit, None where the cell is empty.
        header: origin, latitude, longitude, date, heading, time ... in the order of their lines.
    """

    hours: tuple[float, ...]
    values: Mapping[str, tuple[float | None, ...]]
    header: Mapping[str, str]

    def __post_init__(self) -> None:
        """Refuse what `read` would not read back."""
        if not self.hours:
            raise InputError("a weather without hours; give at least one")
        earlier: list[float] = []
        for hour in self.hours:
            _check_hour(hour, earlier)
            earlier.append(hour)
        known = weather_names()
        for name, cells in self.values.items():
            self._check_row(name, cells, _known(name, known))
        for name in self.header:
            if not _HEADER_NAME.fullmatch(name):
                raise InputError(f"header name {_quoted(name)}; allowed are letters, digits, space, _ and -")

    def _check_row(self, name: str, cells: Sequence[float | None], specification: Specification) -> None:
        if len(cells) != len(self.hours):
            raise InputError(f"{name} has {len(cells)} cells for {len(self.hours)} hours; give one or None for each")
        for value in cells:
            if value is not None:
                _check(name, value, specification)


def of_photo(values: Mapping[str, float], hour: float | None, header: Mapping[str, str]) -> Weather:
    """Weather of a single photo; without an hour it stands in column 12 and the header says `time: unknown`."""
    if hour is None:
        hour, header = HOUR_OF_UNKNOWN_TIME, {**header, "time": "unknown"}
    return Weather((hour,), {name: (value,) for name, value in values.items()}, dict(header))


def check(name: str, value: float) -> None:
    """Refuse a value that no weather file may hold.

    Raises:
        InputError: for an unknown name, with the nearest known one, and for a value outside its bounds.
    """
    _check(name, value, _known(name, weather_names()))


def write(path: Path, weather: Weather) -> None:
    """Write a weather file, whole or not at all.

    Numbers have the fewest digits that read back as the same bits. In the texts of the header a "?" replaces what would
    break a line, a cell or a terminal, or be calculated by a spreadsheet: control characters and line ends, double
    quotes, and = + - @ directly after a separator.

    Raises:
        InputError: when the file cannot be written.
    """
    lines = [FIRST_LINE]
    lines += [f"# {name}: {_one_line(text)}".rstrip() for name, text in weather.header.items()]
    lines += [",".join([HOURS, *map(_written, weather.hours)])]
    lines += [",".join([name, *map(_written, cells)]) for name, cells in weather.values.items()]
    write_bytes(path, "".join(f"{line}\n" for line in lines).encode())


def read(path: Path) -> Weather:
    """Weather of a file; commas, semicolons or tabs between the cells, with or without a byte order mark.

    What spreadsheets leave behind is accepted: empty rows, rows filled up with empty cells to one width, quoted cells.

    Raises:
        InputError: for anything else that the format does not have; names file, row and column.
    """
    file = _printable(str(path))
    lines = [(f"{file}, row {number}", line) for number, line in _lines(file, path) if line.strip(_PADDING)]
    end = next((at for at, (_, line) in enumerate(lines) if not line.strip(_PADDING).startswith("#")), len(lines))
    if end == len(lines):
        raise InputError(f"{file}: no row {HOURS}; add the hours, such as {HOURS},12")
    separator = _separator(*lines[end])
    header = _header(lines[1:end], separator)
    first, *rows = [_row(where, line, separator) for where, line in lines[end:]]
    hours = _hours(first)
    known = weather_names()
    values: dict[str, tuple[float | None, ...]] = {}
    for row in rows:
        with row.column(1):
            specification = _known(row.cells[0], known)
        name, cells = row.cells[0], _values(row, specification, len(hours), len(first.cells))
        if name in values:
            with row.column(1):
                raise InputError(f"{name} stands twice; keep one row of it")
        values[name] = cells
    return Weather(hours, values, header)


@dataclass(frozen=True)
class _Row:
    """Cells of a line, and where it stands."""

    where: str
    cells: list[str]

    @contextmanager
    def column(self, number: int) -> Iterator[None]:
        """Give an InputError from inside its place."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.where}, column {number}: {error}") from None


def _lines(file: str, path: Path) -> list[tuple[int, str]]:
    """Numbered lines of a file whose first line is right."""
    try:
        with path.open("rb") as opened:
            content = opened.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"{file}: {error.strerror}; give a weather file that can be read") from None
    if len(content) > LARGEST:
        raise InputError(f"{file} has more than {LARGEST} bytes; is it a weather file?")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content[: error.start].count(b"\n") + 1
        raise InputError(f"{file}, row {row}, column 1: not UTF-8; save it as CSV in UTF-8") from None
    # Not splitlines(), which would also split at form feeds and Unicode's separators.
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    first = lines[0].rstrip(_PADDING).removeprefix('"')
    if first != FIRST_LINE:
        kind = "format" if first.startswith("# weather ") else "first line"
        lamp = "; a lamp's photometric file must be named .ies" if first.startswith("IES") else ""
        raise InputError(f"{file}, row 1, column 1: {kind} {_quoted(first)}; this fit reads only {FIRST_LINE!r}{lamp}")
    return list(enumerate(lines, start=1))


def _separator(where: str, line: str) -> str:
    """What follows TIME_OF_DAY in the first row of the table separates the cells of all lines."""
    found = re.match(rf'\s*"?{HOURS}"?\s*([,;\t])', line)
    if not found:
        raise InputError(f"{where}, column 1: {_quoted(line)}; the first row of the table is {HOURS} and hours")
    return found[1]


def _header(lines: Sequence[tuple[str, str]], separator: str) -> dict[str, str]:
    """Header of a file; a spreadsheet that opened it with commas has cut its texts there, whatever it saved."""
    header: dict[str, str] = {}
    for where, line in lines:
        found = _HEADER_LINE.fullmatch(",".join(_cells(where, line, separator)).strip(_PADDING))
        if not found:
            raise InputError(f"{where}, column 1: {_quoted(line)}; allowed is '# name: value'")
        if found["name"] in header:
            raise InputError(f"{where}, column 1: header {found['name']} stands twice; keep one")
        header[found["name"]] = _one_line(found["text"])
    return header


def _row(where: str, line: str, separator: str) -> _Row:
    return _Row(where, [cell.strip() for cell in _cells(where, line, separator)])


def _cells(where: str, line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator, strict=True))
    except csv.Error as error:
        raise InputError(f"{where}, column 1: {error}; check the quotes") from None


def _hours(row: _Row) -> tuple[float, ...]:
    texts = row.cells[1:]
    while texts and not texts[-1]:
        texts.pop()
    hours: list[float] = []
    for column, text in enumerate(texts, start=2):
        with row.column(column):
            hour = _number(text)
            _check_hour(hour, hours)
            hours.append(hour)
    if not hours:
        with row.column(2):
            raise InputError(f"no hours; give at least one, such as {HOURS},12")
    return tuple(hours)


def _values(row: _Row, specification: Specification, hours: int, width: int) -> tuple[float | None, ...]:
    """Cells of a row; beyond the hours there may only be what fills it up to the row of the hours."""
    name, *texts = row.cells
    with row.column(min(len(row.cells), width) + 1):
        if len(row.cells) != width:
            raise InputError(
                f"{name} has {len(texts)} cells for {width - 1}; give one for each hour, decimals with a point"
            )
    values: list[float | None] = [None] * len(texts)
    for column, text in enumerate(texts):
        if not text:
            continue
        with row.column(column + 2):
            if column >= hours:
                raise InputError(f"{_quoted(text)} stands under no hour; give it one")
            value = _number(text)
            _check(name, value, specification)
            values[column] = value
    return tuple(values[:hours])


def _number(text: str) -> float:
    if _NUMBER.fullmatch(text):
        return float(text)
    if _NUMBER.fullmatch(text.replace(",", ".", 1)):
        thousands = f", or {text.replace(',', '')} if it marks thousands" if _THOUSANDS.fullmatch(text) else ""
        raise InputError(f"{_quoted(text)} has a decimal comma; write {text.replace(',', '.', 1)}{thousands}")
    raise InputError(
        f"{_quoted(text)} is not a finite number; write numbers such as 0.5, 1e-3 or, for half past six, 6.5"
    )


def _check_hour(hour: float, earlier: Sequence[float]) -> None:
    """Refuse an hour that may not follow the earlier ones."""
    if not 0.0 <= hour < 24.0:
        raise InputError(f"hour {_written(hour)}; allowed from 0 to below 24")
    if not earlier or (hour - earlier[-1] >= CLOSEST and hour - earlier[0] <= 24.0 - CLOSEST):
        return
    if hour < earlier[-1] and hour not in earlier:
        raise InputError(f"hour {_written(hour)} after {_written(earlier[-1])}; hours rise from left to right")
    raise InputError(f"hour {_written(hour)} stands twice; hours are {CLOSEST:g} apart or more, over midnight too")


def _known(name: str, known: Mapping[str, Specification]) -> Specification:
    """What is known of a name."""
    if name not in known:
        # Shortened, because the search takes the square of the length.
        nearest = difflib.get_close_matches(name.upper()[:_SHOWN], known, n=1, cutoff=0.0)[0]
        raise InputError(f"unknown name {_quoted(name)}; the nearest known one is {nearest}")
    return known[name]


def _check(name: str, value: float, specification: Specification) -> None:
    low, high = specification.file_bounds
    if not low <= value <= high:
        unit = "" if specification.file_unit == "1" else f" {specification.file_unit}"
        raise InputError(f"{name} is {_written(value)}; allowed {_written(low)} to {_written(high)}{unit}")


def _written(value: float | None) -> str:
    """Text of a cell: whole numbers as such, 12 and -0, else the fewest digits that give the same bits."""
    return "" if value is None else repr(float(value)).removesuffix(".0")


def _one_line(text: str) -> str:
    """Text of a header line without what would break the line, a cell of it or a terminal."""
    return _FORMULA.sub(r"\1?", _printable(text).replace('"', "?")).strip(_PADDING)


def _printable(text: str) -> str:
    return "".join(" " if letter.isspace() else letter if letter.isprintable() else "?" for letter in text)


def _quoted(text: str) -> str:
    """Text from a file as it may stand in a message."""
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")
