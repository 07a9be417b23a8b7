"""Photos of a day that are fitted already: each in a file of its own beside the results, written whole or not at all.

A file is named by its photo and by a digest of all that its content depends on: the photo's bytes, its time, what was
asked, and the versions of what computed it. A photo or an option that has changed is therefore fitted again.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

from fit.day_photo import Asked, of_text
from fit.input_error import InputError
from fit.whole_file import write_bytes

_OURS = re.compile(r".*-[0-9a-f]{16}\.json|\.[0-9a-f]{16}\.part", re.DOTALL)
VERSIONS = ("diffrender", "torch", "numpy", "scipy", "nlopt", "pvlib")


def folder(out: Path) -> Path:
    """Folder of the fitted photos of a day whose results are in another, which it stands beside."""
    return out.parent / f"{out.name}.parts"


def place(parts: Path, photo: Path, time: datetime, asked: Asked) -> Path:
    """File of one photo.

    Raises:
        InputError: when the photo or the mask cannot be read.
    """
    known = {
        "asked": asdict(asked) | {"mask": None if asked.mask is None else _digest(asked.mask)},
        "time": time.isoformat(),
        "photo": _digest(photo),
        "versions": {name: version(name) for name in VERSIONS},
    }
    digest = hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
    return parts / f"{photo.name}-{digest[:16]}.json"


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give another file") from error


def found(path: Path) -> str | None:
    """Text of a photo that is fitted already; None where it is not, or where the file is none of ours."""
    try:
        text = path.read_text(encoding="utf-8")
        of_text(text)
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return text


def keep(path: Path, text: str) -> None:
    """Write the text of a fitted photo.

    Raises:
        InputError: when it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, text.encode())


def clear(parts: Path, wanted: Sequence[Path]) -> None:
    """Remove what was fitted and is no longer asked for, and what a killed run has left half written.

    Raises:
        InputError: when something cannot be removed.
    """
    try:
        for left in parts.iterdir() if parts.is_dir() else ():
            if _OURS.fullmatch(left.name) and left not in wanted:
                left.unlink()
    except OSError as error:
        raise InputError(f"{parts} cannot be cleared ({error.strerror}); remove it, or give another --out") from error
