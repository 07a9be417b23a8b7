"""Files damaged at random: what a bad disk, a cut-off copy or somebody hostile makes of a good one."""

import re
import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

Mutation = Callable[[bytes, np.random.Generator], bytes]

HEAD = 400  # bytes from the start, where files say what they are; half of the damage is done there
EXTREMES = (0, 1, -1, 7, 255, 65_535, 65_536, 16_777_216, 999_999_999, 2**31 - 1, -(2**31))
TYPES = (b"box2i", b"chlist", b"compression", b"float", b"int", b"string", b"v2f", b"chromaticities", b"rational", b"x")
NUMBERS = (
    *(
        "nan",
        "inf",
        "-inf",
        "1e999",
        "-1e999",
        "1e-999",
        "0x10",
        "1_000",
        "-0",
        "--1",
        "1,5",
        "1.5.5",
        "9" * 20,
        "=1+1",
    ),
    *"\"'#;",
)
OTHER_DIGITS = "\u0661\u0662\U0001d7d9"  # that Python takes for digits too
TEXTS = ("\0", "\x1b[2J", "\u202e", "\u2028", "\ufeff", "\r", "\n", "\t", "\xa0", *"\"',;#e", "<script>", OTHER_DIGITS)


def mutated(content: bytes, mutations: Sequence[Mutation], generator: np.random.Generator) -> tuple[bytes, str]:
    """Content after one to three mutations, and their names."""
    names = []
    for mutation in generator.choice(np.array(mutations, object), int(generator.choice((1, 1, 1, 2, 3)))):
        content = mutation(content, generator)
        names.append(mutation.__name__)
    return content, ", ".join(names)


# Of any file


def flip_bits(content: bytes, generator: np.random.Generator) -> bytes:
    """One to eight bits turned."""
    values = np.frombuffer(content, np.uint8).copy()
    for _ in range(int(generator.integers(1, 9))):
        if len(values):
            values[_place(content, generator)] ^= np.uint8(1 << int(generator.integers(8)))
    return values.tobytes()


def overwrite(content: bytes, generator: np.random.Generator) -> bytes:
    """A run of bytes replaced by zeros, by ones or by noise."""
    start = _place(content, generator)
    run = content[start : start + int(generator.integers(1, 64))]
    filling = (bytes(len(run)), b"\xff" * len(run), generator.bytes(len(run)))[int(generator.integers(3))]
    return content[:start] + filling + content[start + len(run) :]


def truncate(content: bytes, generator: np.random.Generator) -> bytes:
    """The end lost."""
    return content[: _place(content, generator)]


def insert(content: bytes, generator: np.random.Generator) -> bytes:
    """Bytes put in between."""
    at = _place(content, generator)
    return content[:at] + generator.bytes(int(generator.integers(1, 40))) + content[at:]


def remove(content: bytes, generator: np.random.Generator) -> bytes:
    """Bytes taken out."""
    at = _place(content, generator)
    return content[:at] + content[at + int(generator.integers(1, 40)) :]


def swap(content: bytes, generator: np.random.Generator) -> bytes:
    """Two stretches in each other's place."""
    length = int(generator.integers(1, 1 + max(1, len(content) // 4)))
    first, second = sorted(_place(content, generator) for _ in range(2))
    second = max(second, first + length)
    between = content[first + length : second]
    return (
        content[:first]
        + content[second : second + length]
        + between
        + content[first : first + length]
        + content[second + length :]
    )


def extreme_number(content: bytes, generator: np.random.Generator) -> bytes:
    """Four bytes replaced by a number at the end of some range, in either order of bytes."""
    at = _place(content, generator)
    order = "<i" if generator.integers(2) else ">i"
    return content[:at] + struct.pack(order, int(generator.choice(EXTREMES))) + content[at + 4 :]


ANY = (flip_bits, overwrite, truncate, insert, remove, swap, extreme_number)


def _place(content: bytes, generator: np.random.Generator) -> int:
    end = len(content) if generator.integers(2) else min(len(content), HEAD)
    return int(generator.integers(max(end, 1)))


# Of OpenEXR files


class Attribute(NamedTuple):
    """Where an attribute of a header stands in its file."""

    name: slice
    kind: slice
    length: slice
    value: slice


def attributes(content: bytes) -> list[Attribute]:
    """Attributes of the first header of an OpenEXR file, as far as they can be followed."""
    found = []
    at = 8
    while name := re.compile(rb"([^\0]{1,255})\0([^\0]{1,255})\0(.{4})", re.DOTALL).match(content, at):
        end = name.end() + struct.unpack("<i", name[3])[0]
        if not name.end() <= end <= len(content):
            break
        found.append(
            Attribute(slice(*name.span(1)), slice(*name.span(2)), slice(*name.span(3)), slice(name.end(), end))
        )
        at = end
    return found


def header_field(content: bytes, generator: np.random.Generator) -> bytes:
    """Name, type, length or value of an attribute replaced by another."""
    found = attributes(content)
    if not found:
        return flip_bits(content, generator)
    chosen, other = (found[index] for index in generator.integers(len(found), size=2))
    # Sizes and lists of channels more often than the rest: most depends on them.
    windows = [a for a in found if content[a.kind] in (b"box2i", b"chlist", b"tiledesc")]
    part = int(generator.integers(7))
    if part > 3 and windows:
        chosen = windows[int(generator.integers(len(windows)))]
        return _number_inside(content, chosen.value, generator)
    if part == 0:
        return _replaced(content, chosen.name, content[other.name])
    if part == 1:
        return _replaced(content, chosen.kind, TYPES[int(generator.integers(len(TYPES)))])
    if part == 2:
        return _replaced(content, chosen.length, struct.pack("<i", int(generator.choice(EXTREMES))))
    return _number_inside(content, chosen.value, generator)


def chunk_offset(content: bytes, generator: np.random.Generator) -> bytes:
    """An entry of the table of chunks lost, doubled or pointed astray."""
    found = attributes(content)
    start = found[-1].value.stop + 1 if found else 0
    first, second = (start + 8 * int(generator.integers(8)) for _ in range(2))
    entry = (bytes(8), content[second : second + 8], struct.pack("<q", int(generator.choice(EXTREMES))))
    return content[:first] + entry[int(generator.integers(3))] + content[first + 8 :]


EXR = (*ANY, header_field, header_field, header_field, chunk_offset)


def _number_inside(content: bytes, where: slice, generator: np.random.Generator) -> bytes:
    at = where.start + 4 * int(generator.integers(max(1, (where.stop - where.start) // 4)))
    if generator.integers(2):
        # A small change, which keeps a header believable.
        old = int.from_bytes(content[at : at + 4], "little", signed=True)
        new = max(min(old + int(generator.integers(-300, 300)), 2**31 - 1), -(2**31))
    else:
        new = int(generator.choice(EXTREMES))
    return content[:at] + struct.pack("<i", new) + content[at + 4 :]


def _replaced(content: bytes, where: slice, new: bytes) -> bytes:
    return content[: where.start] + new + content[where.stop :]


# Of text


def cell(content: bytes, generator: np.random.Generator) -> bytes:
    """A number replaced by what is none, or is too large."""
    numbers = list(re.finditer(rb"[-+.\dEe]+", content))
    if not numbers:
        return flip_bits(content, generator)
    chosen = numbers[int(generator.integers(len(numbers)))]
    return _replaced(content, slice(*chosen.span()), NUMBERS[int(generator.integers(len(NUMBERS)))].encode())


def strange_text(content: bytes, generator: np.random.Generator) -> bytes:
    """A letter that means something to a reader or a terminal, once or many times."""
    at = _place(content, generator)
    text: bytes = TEXTS[int(generator.integers(len(TEXTS)))].encode()
    times: int = (1, 1, 2, 100, 100_000)[int(generator.integers(5))]
    return content[:at] + text * times + content[at:]


def lines(content: bytes, generator: np.random.Generator) -> bytes:
    """A line lost, doubled, joined with another, torn in two, filled with cells or with other separators."""
    rows = content.split(b"\n")
    first, second = (int(index) for index in generator.integers(len(rows), size=2))
    row = rows[first]
    half = len(row) // 2
    torn: tuple[list[bytes], ...] = (
        [],
        [row, row],
        [row + rows[second]],
        [row[:half], row[half:]],
        [row + b"," * 1000],
        [row.replace(b",", b";")],
    )
    return b"\n".join([*rows[:first], *torn[int(generator.integers(len(torn)))], *rows[first + 1 :]])


TEXT = (*ANY, cell, cell, strange_text, lines, lines)
