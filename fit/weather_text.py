"""A weather file as text for a terminal: its table, and a plot of each parameter over the day."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from diffrender.scene import weather_names
from fit.curves import Curve, curves
from fit.weather_file import HOURS, Weather

LINES = 4  # of a plot
WIDEST, NARROWEST = 72, 16  # letters across a plot
LABEL = 10  # letters of a number beside a plot
TICKS = (0, 6, 12, 18, 24)  # hours


@dataclass(frozen=True)
class Letters:
    """Letters that plots are made of, each a grid of dots.

    Attributes:
        columns: dots across a letter.
        rows: dots down a letter.
        letter: for each set of dots, numbered from the left to the right and then down.
        axis: the line of hours, and a keyframe on it.
    """

    columns: int
    rows: int
    letter: Mapping[frozenset[int], str]
    axis: tuple[str, str]


def _braille() -> dict[frozenset[int], str]:
    bits = (0, 3, 1, 4, 2, 5, 6, 7)  # of a letter's number, for dots in reading order
    sets = [frozenset(dot for dot in range(8) if index >> dot & 1) for index in range(256)]
    return {dots: chr(0x2800 + sum(1 << bits[dot] for dot in dots)) if dots else " " for dots in sets}


BRAILLE = Letters(2, 4, _braille(), ("─", "┴"))
_ASCII = {(): " ", (0,): "'", (1,): "-", (2,): ".", (0, 1): "|", (1, 2): "|", (0, 2): ":", (0, 1, 2): "|"}
ASCII = Letters(1, 3, {frozenset(dots): letter for dots, letter in _ASCII.items()}, ("-", "+"))


def text(weather: Weather, width: int, letters: Letters) -> str:
    """What the header says, the table, and the plots, for a terminal so many letters wide.

    The table is cut into blocks of hours that fit the width; a row stands only in blocks where it has a keyframe.
    Numbers have four digits. On a terminal too narrow for it a name stands above its row.
    """
    across = min(max(width - LABEL - 2, NARROWEST), WIDEST)
    dots = across * letters.columns
    hours = [24.0 * dot / (dots - 1) for dot in range(dots)]
    parts = [[f"{name}: {said}" for name, said in weather.header.items()]]
    parts += _table(weather, width)
    parts += [_plot(curve, letters) for curve in curves(weather, hours)]
    return "\n\n".join("\n".join(line.rstrip() for line in part) for part in parts if part)


# The table


def _table(weather: Weather, width: int) -> Iterator[list[str]]:
    """Blocks of lines."""
    known = weather_names()
    units = {name: known[name].file_unit for name in weather.values}
    heads = {HOURS: "h"} | {name: "" if unit == "1" else unit for name, unit in units.items()}
    rows = {HOURS: [f"{hour:.8g}" for hour in weather.hours]}
    rows |= {name: ["" if v is None else f"{v:.4g}" for v in cells] for name, cells in weather.values.items()}
    widths = [max(map(len, column)) + 2 for column in zip(*rows.values(), strict=True)]
    name_width, unit_width = max(map(len, heads)), max(map(len, heads.values())) + 2
    is_narrow = name_width + unit_width + max(widths) > width
    room = width if is_narrow else width - name_width - unit_width
    for start, end in _blocks(widths, room):
        block = []
        for name, unit in heads.items():
            if name != HOURS and not any(rows[name][start:end]):
                continue
            cells = "".join(cell.rjust(w) for cell, w in zip(rows[name][start:end], widths[start:end], strict=True))
            if is_narrow:
                block += [f"{name}  {unit}", cells]
            else:
                block.append(f"{name.ljust(name_width)}  {unit.ljust(unit_width - 2)}{cells}")
        yield block
    empty = [name for name, cells in rows.items() if not any(cells)]
    if empty:
        yield ["without a value:", *(f"  {name}" for name in empty)]


def _blocks(widths: Sequence[int], room: int) -> Iterator[tuple[int, int]]:
    """Runs of columns that fit into the room; at least one column each."""
    start, used = 0, 0
    for column, width in enumerate(widths):
        if used + width > room and column > start:
            yield start, column
            start, used = column, 0
        used += width
    yield start, len(widths)


# Plots


def _plot(curve: Curve, letters: Letters) -> list[str]:
    scale = ["logarithmic"] if curve.known.scale == "log" else []
    title = ", ".join([f"{curve.name}  {curve.unit}".rstrip(), *scale])
    low, high = curve.ends
    if low == high:
        return [title, f"{low:.4g}".rjust(LABEL) + "  " + _drawn(curve, letters, 1)[0]]
    labels = [f"{high:.4g}", *[""] * (LINES - 2), f"{low:.4g}"]
    lines = [f"{label:>{LABEL}}  {line}" for label, line in zip(labels, _drawn(curve, letters, LINES), strict=True)]
    return [title, *lines, *(" " * (LABEL + 2) + line for line in _axis(curve, letters))]


def _drawn(curve: Curve, letters: Letters, lines: int) -> list[str]:
    """Lines of letters, whose dots are the curve."""
    last = lines * letters.rows - 1
    rows = [round((1.0 - curve.place(value)) * last) for value in curve.values]
    dots = {(row, column) for column, row in enumerate(rows)}
    for column, ((row, later), pair) in enumerate(zip(pairwise(rows), pairwise(curve.values), strict=True)):
        if not curve.jumps(*pair):  # joins what is steep
            middle = (row + later) // 2
            dots |= {(between, column) for between in range(min(row, middle), max(row, middle) + 1)}
            dots |= {(between, column + 1) for between in range(min(later, middle + 1), max(later, middle) + 1)}
    return [
        "".join(_letter(dots, line, column, letters) for column in range(len(rows) // letters.columns))
        for line in range(lines)
    ]


def _letter(dots: set[tuple[int, int]], line: int, column: int, letters: Letters) -> str:
    inside = [(down, across) for down in range(letters.rows) for across in range(letters.columns)]
    corner = line * letters.rows, column * letters.columns
    seen = frozenset(n for n, (down, across) in enumerate(inside) if (corner[0] + down, corner[1] + across) in dots)
    return letters.letter[seen]


def _axis(curve: Curve, letters: Letters) -> list[str]:
    """The line of hours with its keyframes, and the line of their numbers."""
    across = len(curve.values) // letters.columns
    line = [letters.axis[0]] * across
    for hour, _ in curve.keyframes:
        line[round(hour / 24.0 * (across - 1))] = letters.axis[1]
    numbers = [" "] * (across + 1)
    for hour in TICKS:
        at = round(hour / 24.0 * (across - 1))
        numbers[at : at + len(str(hour))] = str(hour)
    return ["".join(line), "".join(numbers)]
