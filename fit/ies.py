"""Photometric files of lamps, IES LM-63: one lamp's intensity over directions, mirrored to the whole circle.

Read are files of 1986, which have no first line of their own, of 1991, 1995, 2002 and 2019, of type C, without tilt.
The last horizontal angle tells a lamp's symmetry: 0 it is round, 90 its quadrants are alike, 180 its two sides, 360
none; a lamp that is alike to both sides of the plane of 90 degrees may go from 90 to 270. The number after the ballast
factor is a second factor until 1991, was kept free then, and since 2019 tells how the file was made. Of newer files the
first line is refused: it may mean things that are not known here.

[1] IES LM-63-2002, "Standard File Format for the Electronic Transfer of Photometric Data".
[2] Khronos, glTF extension EXT_lights_ies: the first line of 2019, and angles from 90 to 270 in 1995.
"""

import codecs
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64

from diffrender.shading.light_profile import Profile
from fit.input_error import InputError

# Years by their first line; most files of 1986 have none.
VERSIONS = {
    "IESNA:LM-63-1986": 1986,
    "IESNA91": 1991,
    "IESNA:LM-63-1991": 1991,
    "IESNA:LM-63-1995": 1995,
    "IESNA:LM-63-2002": 2002,
    "IES:LM-63-2019": 2019,
}
LAST_OF_TWO_FACTORS = 1991
TILT = "TILT="
TYPES = {1.0: "C", 2.0: "B", 3.0: "A"}
# By the first and the last horizontal angle.
SYMMETRIES = {
    (0.0, 0.0): "round",
    (0.0, 90.0): "alike in its quadrants",
    (0.0, 180.0): "alike to both sides",
    (90.0, 270.0): "alike to both sides of the plane of 90 degrees",
    (0.0, 360.0): "none",
}
STARTS, ENDS = (0.0, 90.0), (90.0, 180.0)  # of vertical angles
LARGEST_BYTES = 10_000_000
MOST_ANGLES = 10_000
BRIGHTEST = 1e12  # candela and lumens: far above any lamp, and no sum of them is infinite
END_OF_FILE = b"\x1a\r\n"  # as DOS ended texts
HEAD = 13  # numbers before the angles

_TILT = re.compile(r"\s*TILT\s*=(?P<kind>.*)", re.IGNORECASE)

Numbers = Float64[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Luminaire:
    """What a file says of a lamp.

    Attributes:
        profile: intensity in candela, ballast and multiplier included, over the whole circle.
        lumens: of its bare lamps together; None where the file's intensities are absolute.
        symmetry: how the file needs less than the whole circle.
        keywords: what stands in square brackets, by name; of those that stand twice the last.
    """

    profile: Profile
    lumens: float | None
    symmetry: str
    keywords: dict[str, str]


def read(path: Path) -> Luminaire:
    """Lamp of a file.

    Raises:
        InputError: when it cannot be read, is no such file, or is of a kind that is not read.
    """
    lines = _lines(path)
    year = _year(path, next((line.strip() for line in lines if line.strip()), ""))
    tilt, kind = next(
        ((number, found["kind"].strip()) for number, line in enumerate(lines) if (found := _TILT.match(line))),
        (0, None),
    )
    if kind is None:
        raise InputError(
            f"{path} has no line that begins with {TILT}; give a photometric file, IES LM-63, as plain text "
            "(a weather file must not be named .ies)"
        )
    if kind.upper() != "NONE":
        raise InputError(f"{path} has TILT={kind[:40]}; allowed is TILT=NONE; give a file measured as the lamp hangs")
    numbers = _numbers(path, lines[tilt + 1 :], tilt + 2)
    return Luminaire(*_photometry(path, numbers, year), _keywords(lines[:tilt]))


def _year(path: Path, first: str) -> int:
    version = first.upper()
    if version.startswith(("IESNA", "IES:")) and version not in VERSIONS:
        raise InputError(
            f"{path} is of {first[:40]}; allowed are {', '.join(VERSIONS)} and none (1986); save it as one of them"
        )
    return VERSIONS.get(version, 1986)


def _lines(path: Path) -> list[str]:
    try:
        with path.open("rb") as opened:
            content = opened.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error}); give a file that you may read") from error
    if len(content) > LARGEST_BYTES:
        raise InputError(f"{path} has more than the allowed {LARGEST_BYTES} bytes; give a photometric file")
    # Text is ASCII by the standard; makers' names are often not, and any byte is a letter of Latin 1.
    text = content.removeprefix(codecs.BOM_UTF8).rstrip(END_OF_FILE).decode("latin-1")
    # Not splitlines(), which would also split at what is an ellipsis in Windows' letters.
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _keywords(lines: list[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    last = ""
    for line in lines:
        if line.startswith("[") and "]" in line:
            name, text = line[1:].split("]", 1)
            if name.upper() == "MORE" and last:
                found[last] += " " + text.strip()
            else:
                last = name.upper()
                found[last] = text.strip()
    return found


def _numbers(path: Path, lines: list[str], first: int) -> Numbers:
    """All numbers of lines, of which the first is that line of the file; commas part them as spaces do."""
    found = []
    for number, line in enumerate(lines, first):
        for word in line.replace(",", " ").split():
            try:
                value = float(word)
            except ValueError:
                value = math.nan
            if not math.isfinite(value) or "_" in word:  # Python's own way to part thousands
                raise InputError(
                    f"{path} has {word[:40]!r} in line {number}; allowed are only numbers after {TILT}; correct it"
                )
            found.append(value)
    return np.array(found)


def _photometry(path: Path, numbers: Numbers, year: int) -> tuple[Profile, float | None, str]:
    if len(numbers) < HEAD:
        raise InputError(
            f"{path} has {len(numbers)} numbers after {TILT}; needed are {HEAD} and the angles; give the whole file"
        )
    lamps, lumens, multiplier, rows, columns, kind = map(float, numbers[:6])
    if kind != 1:
        raise InputError(
            f"{path} is of type {TYPES.get(kind, f'{kind:g}')}; allowed is type C, written as 1; give one measured so"
        )
    height, width = (_count(path, *named) for named in (("vertical", rows, 2), ("horizontal", columns, 1)))
    needed = HEAD + height + width + height * width
    if len(numbers) != needed:
        raise InputError(
            f"{path} has {len(numbers)} numbers after {TILT}; {height} × {width} angles need {needed}; "
            "give the whole file"
        )
    vertical, horizontal, candela = np.split(numbers[HEAD:], [height, height + width])
    _check_angles(path, vertical, horizontal)
    second = float(numbers[11]) if year <= LAST_OF_TWO_FACTORS else 1.0
    candela = _scaled(path, candela, {"multiplier": multiplier, "ballast factor": float(numbers[10]), "factor": second})
    turn, whole = _whole_circle(horizontal, candela.reshape(width, height))
    profile = Profile(*map(torch.from_numpy, (np.deg2rad(vertical), np.deg2rad(turn), whole.T.copy())))
    return profile, _declared(path, lamps, lumens), SYMMETRIES[float(horizontal[0]), float(horizontal[-1])]


def _scaled(path: Path, candela: Numbers, factors: dict[str, float]) -> Numbers:
    for name, factor in factors.items():
        if factor <= 0.0:
            raise InputError(f"{path} has a {name} of {factor:g}; allowed is above 0; write 1 if there is none")
    if candela.min() < 0.0:
        raise InputError(f"{path} has an intensity of {candela.min():g} candela; allowed is 0 and above; correct it")
    scale = math.prod(factors.values())
    # Of floats: the product may be infinite, or infinity times nothing.
    if not (peak := float(candela.max()) * scale) <= BRIGHTEST:
        raise InputError(f"{path} has a peak of {peak:g} candela; allowed are {BRIGHTEST:g}; correct its multiplier")
    return candela * scale


def _declared(path: Path, lamps: float, lumens: float) -> float | None:
    if lamps < 0.0 or not lamps * lumens <= BRIGHTEST:
        raise InputError(
            f"{path} has {lamps:g} lamps of {lumens:g} lumens; allowed are 0 lamps and above, of together up to "
            f"{BRIGHTEST:g} lumens; correct them"
        )
    return None if lumens < 0.0 else lamps * lumens


def _count(path: Path, name: str, number: float, least: int) -> int:
    if not (least <= number <= MOST_ANGLES and number == int(number)):
        raise InputError(
            f"{path} has {number:g} {name} angles; allowed are {least} to {MOST_ANGLES} whole ones; correct it"
        )
    return int(number)


def _check_angles(path: Path, vertical: Numbers, horizontal: Numbers) -> None:
    for name, angles in (("vertical", vertical), ("horizontal", horizontal)):
        if (np.diff(angles) <= 0.0).any():
            raise InputError(
                f"{path} has {name} angles that do not rise; allowed is each above the one before; sort them "
                "and their intensities"
            )
    if not (vertical[0] in STARTS and vertical[-1] in ENDS):
        raise InputError(
            f"{path} has vertical angles from {vertical[0]:g} to {vertical[-1]:g}; allowed are 0 or 90 to 90 or 180; "
            "add those that lack"
        )
    if (horizontal[0], horizontal[-1]) not in SYMMETRIES:
        raise InputError(
            f"{path} has horizontal angles from {horizontal[0]:g} to {horizontal[-1]:g}; "
            "allowed are 0 to 0, 90, 180 or 360, and 90 to 270; add those that lack"
        )


def _whole_circle(horizontal: Numbers, candela: Float64[np.ndarray, "columns rows"]) -> tuple[Numbers, np.ndarray]:
    """Horizontal angles from 0 to 360, mirrored at the last angle until it is 360, and intensities of each.

    Angles from 90 are mirrored at 90; at 0 and 360 degrees they are those between their neighbours if none is there.
    """
    if horizontal[0] == 90.0:
        turn = np.concatenate([180.0 - horizontal[-2:0:-1], horizontal])
        candela = np.concatenate([candela[-2:0:-1], candela])
        whole = np.union1d(turn % 360.0, [0.0, 360.0])
        return whole, np.stack([np.interp(whole, turn, row, period=360.0) for row in candela.T], axis=1)
    if horizontal[-1] == 0.0:
        return np.array([0.0, 360.0]), np.repeat(candela, 2, 0)
    while horizontal[-1] < 360.0:
        horizontal = np.concatenate([horizontal, (2.0 * horizontal[-1] - horizontal[-2::-1])])
        candela = np.concatenate([candela, candela[-2::-1]])
    return horizontal, candela
