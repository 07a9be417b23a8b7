"""Photometric files of lamps, IES LM-63: one lamp's intensity over directions, mirrored to the whole circle.

Read are files of 1986, which have no first line of their own, and of 1991, 1995 and 2002, of type C, without tilt. The
last horizontal angle tells a lamp's symmetry: 0 it is round, 90 its quadrants are alike, 180 its two sides, 360 none.
Of newer files, which are written as those of 2002 are, the first line is refused: it may mean things that are not known
here.

[1] IES LM-63-2002, "Standard File Format for the Electronic Transfer of Photometric Data".
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64

from diffrender.shading.light_profile import Profile
from fit.input_error import InputError

VERSIONS = ("IESNA91", "IESNA:LM-63-1991", "IESNA:LM-63-1995", "IESNA:LM-63-2002")  # of 1986 there is no line
TILT = "TILT="
TYPES = {1: "C", 2: "B", 3: "A"}
# By the last horizontal angle.
SYMMETRIES = {0.0: "round", 90.0: "alike in its quadrants", 180.0: "alike to both sides", 360.0: "none"}
STARTS, ENDS = (0.0, 90.0), (90.0, 180.0)  # of vertical angles
LARGEST_BYTES = 10_000_000
MOST_ANGLES = 10_000
HEAD = 13  # numbers before the angles

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
    version = next((line.strip() for line in lines if line.strip()), "")
    if version.upper().startswith("IESNA") and version.upper() not in VERSIONS:
        raise InputError(
            f"{path} is of {version[:40]}; allowed are {', '.join(VERSIONS)} and 1986; save it as one of them"
        )
    tilt = next((number for number, line in enumerate(lines) if line.lstrip().upper().startswith(TILT)), None)
    if tilt is None:
        raise InputError(f"{path} has no line that begins with {TILT}; give a photometric file, IES LM-63")
    if (kind := lines[tilt].strip()[len(TILT) :].strip()).upper() != "NONE":
        raise InputError(f"{path} has TILT={kind[:40]}; allowed is TILT=NONE; give a file measured as the lamp hangs")
    return Luminaire(*_photometry(path, _numbers(path, lines[tilt + 1 :], tilt + 2)), _keywords(lines[:tilt]))


def _lines(path: Path) -> list[str]:
    try:
        if (size := path.stat().st_size) > LARGEST_BYTES:
            raise InputError(f"{path} has {size} bytes; allowed are {LARGEST_BYTES}; give a photometric file")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error}); give a file that you may read") from error
    # Text is ASCII by the standard; makers' names are often not, and any byte is a letter of Latin 1.
    return content.decode("latin-1").splitlines()


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
            if not math.isfinite(value):
                raise InputError(f"{path} has {word[:40]!r} in line {number}; allowed are numbers from there on")
            found.append(value)
    return np.array(found)


def _photometry(path: Path, numbers: Numbers) -> tuple[Profile, float | None, str]:
    if len(numbers) < HEAD:
        raise InputError(
            f"{path} has {len(numbers)} numbers after {TILT}; needed are {HEAD} and the angles: is it whole?"
        )
    lamps, lumens, multiplier, rows, columns, kind = numbers[:6]
    ballast = numbers[10]
    if kind != 1:
        raise InputError(
            f"{path} is of type {TYPES.get(kind, f'{kind:g}')}; allowed is type C, written as 1; measure it so"
        )
    if multiplier <= 0.0 or ballast <= 0.0:
        raise InputError(f"{path} has multiplier {multiplier:g} and ballast factor {ballast:g}; allowed is above 0")
    height, width = (_count(path, *named) for named in (("vertical", rows, 2), ("horizontal", columns, 1)))
    needed = HEAD + height + width + height * width
    if len(numbers) != needed:
        raise InputError(f"{path} has {len(numbers)} numbers after {TILT}; {height} × {width} angles need {needed}")
    vertical, horizontal, candela = np.split(numbers[HEAD:], [height, height + width])
    _check_angles(path, vertical, horizontal)
    if candela.min() < 0.0:
        raise InputError(f"{path} has an intensity of {candela.min():g} candela; allowed is 0 and above")
    whole = _whole_circle(horizontal, multiplier * ballast * candela.reshape(width, height))
    declared = None if lumens < 0.0 else float(lamps * lumens)
    down, turn = (torch.from_numpy(np.deg2rad(one)) for one in (vertical, whole[0]))
    return Profile(down, turn, torch.from_numpy(whole[1].T.copy())), declared, SYMMETRIES[float(horizontal[-1])]


def _count(path: Path, name: str, number: float, least: int) -> int:
    if not (least <= number <= MOST_ANGLES and number == int(number)):
        raise InputError(f"{path} has {number:g} {name} angles; allowed are {least} to {MOST_ANGLES}")
    return int(number)


def _check_angles(path: Path, vertical: Numbers, horizontal: Numbers) -> None:
    for name, angles in (("vertical", vertical), ("horizontal", horizontal)):
        if (np.diff(angles) <= 0.0).any():
            raise InputError(f"{path} has {name} angles that do not rise; allowed is each above the one before")
    if not (vertical[0] in STARTS and vertical[-1] in ENDS):
        raise InputError(
            f"{path} has vertical angles from {vertical[0]:g} to {vertical[-1]:g}; allowed are 0 or 90 to 90 or 180"
        )
    if horizontal[0] != 0.0 or horizontal[-1] not in SYMMETRIES:
        raise InputError(
            f"{path} has horizontal angles from {horizontal[0]:g} to {horizontal[-1]:g}; "
            "allowed are 0 to 0, 90, 180 or 360"
        )


def _whole_circle(horizontal: Numbers, candela: Float64[np.ndarray, "columns rows"]) -> tuple[Numbers, np.ndarray]:
    """Horizontal angles from 0 to 360, mirrored at the last angle until it is 360, and intensities of each."""
    if horizontal[-1] == 0.0:
        return np.array([0.0, 360.0]), np.repeat(candela, 2, 0)
    while horizontal[-1] < 360.0:
        horizontal = np.concatenate([horizontal, (2.0 * horizontal[-1] - horizontal[-2::-1])])
        candela = np.concatenate([candela, candela[-2::-1]])
    return horizontal, candela
