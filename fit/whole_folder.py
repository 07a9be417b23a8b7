"""Several files that are written together or not at all: aside, in the folder itself, then renamed."""

import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fit.input_error import InputError

ASIDE = re.compile(r"\.[0-9a-f]{16}\.part")
STALE = 3600.0  # seconds without a new file in it, after which a folder aside is what a killed run has left


@contextmanager
def whole_folder(folder: Path, last: str) -> Iterator[Path]:
    """Path of an empty folder to write to, whose files take their places in `folder` when the block ends.

    Files of the same names are replaced, the one named `last` after all others; other files stay. When the block
    raises, `folder` is as it was, and not there if it was not. The block should do nothing but write: an OSError in it
    is taken as the disk's, and becomes an InputError. What a run that was killed an hour ago or earlier has left aside
    is removed.

    Raises:
        InputError: when a file or the folder cannot be written.
    """
    aside = folder / f".{secrets.token_hex(8)}.part"
    made: list[Path] = []
    try:
        made = [path for path in (folder, *folder.parents) if not path.exists()]
        aside.mkdir(parents=True)
        _clear(folder)
        yield aside
        files = sorted(aside.iterdir(), key=lambda file: file.name == last)
        for place in (folder / file.name for file in files):
            if place.exists() and not place.is_file():
                raise InputError(f"{place} is not a file and cannot be replaced by one; give another --out")
        for file in files:
            file.replace(folder / file.name)
        made = []
    except OSError as error:
        raise InputError(
            f"{folder} cannot be written to ({error.strerror or error}); give an --out with space where you may write"
        ) from error
    except InputError as error:
        # Of a file written aside: the user knows it by its own place.
        raise InputError(str(error).replace(str(aside), str(folder))) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        for path in made:
            with suppress(OSError):
                path.rmdir()


def _clear(folder: Path) -> None:
    for left in folder.iterdir():
        if ASIDE.fullmatch(left.name):
            with suppress(OSError):  # another run may be removing it too
                if time.time() - left.lstat().st_mtime > STALE:
                    shutil.rmtree(left)
