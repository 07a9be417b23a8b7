"""Files that are written whole or not at all: aside, in the same folder, then renamed."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fit.input_error import InputError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Path of an empty file to write to, which takes the place of `path` when the block ends.

    When the block raises, `path` is as it was and nothing is left beside it. The block should do nothing but write:
    an OSError in it is taken as the disk's, and becomes an InputError.

    Raises:
        InputError: when the file cannot be written: no folder, no permission, no space.
    """
    aside = path.parent / f".{secrets.token_hex(8)}.part"
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path} is not a file and cannot be replaced by one; choose another name")
        # Not tempfile: its files are for the owner alone, and the umask cannot be asked without setting it.
        os.close(os.open(aside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield aside
        with aside.open("rb+") as written:
            os.fsync(written.fileno())
        aside.replace(path)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(
            f"{path} cannot be written ({reason}); choose a folder with space that you may write to"
        ) from error
    finally:
        with suppress(OSError):
            aside.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all."""
    with whole_file(path) as aside:
        aside.write_bytes(content)
