"""Paths as the libraries that read and write pictures take them: as text."""

from pathlib import Path

from fit.input_error import InputError


def path_text(path: Path) -> str:
    """The path itself.

    Raises:
        InputError: when it has bytes that are no UTF-8, which Python keeps as lone surrogates.
    """
    text = str(path)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{path} has letters in its name or folder that are no UTF-8; rename it") from error
    return text
