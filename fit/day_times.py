"""When each photo of a day was taken: by a table, by its header, or by its name."""

import csv
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from fit import photo as photos
from fit.input_error import InputError
from fit.sun import YEARS

EXAMPLE = "2016-08-14T06:30+02:00"
LARGEST = 2**20  # bytes of a table: ten thousand photos
_IN_NAME = re.compile(
    r"(?<!\d)(?P<date>\d{4}-?\d{2}-?\d{2})[T_ ](?P<clock>\d{2}[:-]?\d{2}(?:[:-]?\d{2})?)(?!\d)"
    r"(?P<zone>Z|[+-]\d{2}:?\d{2}(?!\d))?"
)


def read(path: Path) -> dict[str, datetime]:
    """Times by file name, from a table of two columns; a first row without a time is its head.

    Raises:
        InputError: for anything else, with the row.
    """
    found: dict[str, datetime] = {}
    for number, row in _rows(path):
        where = f"{path}, row {number}"
        cells = [cell.strip() for cell in row]
        if len(cells) != 2 or not cells[0]:
            raise InputError(f"{where}: {','.join(cells)!r}; give a file name and its time, such as noon.exr,{EXAMPLE}")
        name, text = cells
        try:
            time = datetime.fromisoformat(text)
        except ValueError:
            if number == 1 and not any(letter.isdigit() for letter in text):
                continue
            raise InputError(f"{where}: time {text!r}; give date, time and zone such as {EXAMPLE}") from None
        if time.tzinfo is None:
            raise InputError(f"{where}: {text} has no zone; add it, as in {text}+02:00")
        if name in found:
            raise InputError(f"{where}: {name} stands twice; keep one row of it")
        _check(time, where)
        found[name] = time
    return found


def _check(time: datetime, where: str) -> None:
    """Refuse a time that no weather file's header can hold, or no table of the sun has."""
    offset = time.utcoffset()
    if offset is not None and offset.total_seconds() % 60.0:
        raise InputError(f"{where}: the zone of {time.isoformat()} has seconds; give whole minutes, as in {EXAMPLE}")
    if not YEARS[0] <= time.year < YEARS[1]:
        raise InputError(
            f"{where}: the year of {time.isoformat()}; allowed are those from {YEARS[0]} to {YEARS[1] - 1}"
        )


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows that hold something, with their numbers."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give --times a CSV of file names and times") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not UTF-8; save it as CSV in UTF-8") from None
    if len(content) > LARGEST:
        raise InputError(f"{path} has more than {LARGEST} bytes; is it a table of times?")
    lines = [line.removesuffix("\r") for line in text.split("\n")]
    try:
        between = next((letter for letter in ",;\t" if letter in text), ",")
        filled = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]
        return [(number, next(csv.reader([line], delimiter=between))) for number, line in filled]
    except csv.Error as error:
        raise InputError(f"{path}: {error}; give --times a CSV of file names and times") from None


def of_name(name: str) -> datetime | None:
    """Time in a file's name; None where it has none, without zone where it names none.

    >>> of_name("roof_2016-08-14T0630+0200.exr").isoformat(), of_name("noon.exr")
    ('2016-08-14T06:30:00+02:00', None)
    """
    found = _IN_NAME.search(name)
    if found is None:
        return None
    date, clock = (found[part].replace("-", "").replace(":", "") for part in ("date", "clock"))
    try:
        return datetime.fromisoformat(f"{date}T{clock}{found['zone'] or ''}")
    except ValueError:
        return None


def of_photos(paths: Sequence[Path], table: Mapping[str, datetime]) -> list[datetime]:
    """Time of each photo: of the table; else of the photo's header, else of its name.

    Raises:
        InputError: for a photo that is no HDR file or has no time, or none with a zone, and for a row of the table
            that names no photo.
    """
    unknown = sorted(set(table) - {path.name for path in paths})
    if unknown:
        raise InputError(f"--times has a row for {unknown[0]}, which is none of the photos; name files without folders")
    return [_of_photo(path, table.get(path.name)) for path in paths]


def _of_photo(path: Path, given: datetime | None) -> datetime:
    header = photos.capture(path)  # looked at even where the time is given: what cannot be read is told at once
    said = header["time"]
    time = given or (said if isinstance(said, datetime) else of_name(path.name))
    if time is None:
        raise InputError(f"{path} has no time in its header or its name; give --times a CSV with {path.name},{EXAMPLE}")
    if time.tzinfo is None:
        raise InputError(f"{path} has a time without a zone in its name; add it, as in {EXAMPLE}, or give --times CSV")
    _check(time, str(path))
    return time
