"""What goes to a terminal: only what can be seen, in letters that it has, and one line where it takes nothing."""

import locale
import os
import sys

import typer

from fit.input_error import InputError


def say(text: str) -> None:
    """Tell of results that are written.

    Raises:
        InputError: when standard output fails.
    """
    try:
        _echo(text)
    except OSError as error:
        raise InputError(
            f"the results are written, but not told: standard output fails ({error.strerror}); use --quiet"
        ) from error


def show(text: str) -> None:
    """Print what is itself the result; a reader who goes away early, such as `head`, has seen enough.

    Raises:
        InputError: when standard output fails otherwise.
    """
    try:
        _echo(text)
    except BrokenPipeError:
        return
    except OSError as error:
        raise InputError(f"standard output fails ({error.strerror}); give it another place") from error


def _echo(text: str) -> None:
    # File names may hold bytes that are no text and characters that move a terminal's cursor.
    try:
        typer.echo("\n".join(visible(line) for line in text.split("\n")))
    except OSError:
        # What is left in its buffer would fail again, with a traceback, when the program ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise


def visible(text: str) -> str:
    """Text in which a question mark stands for what is no letter."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def has(letter: str) -> bool:
    """Whether standard output has a letter, by its encoding and by the language that the user has set."""
    # A closed standard output is None, one that is caught in a text has no encoding.
    encoding = getattr(sys.stdout, "encoding", None) or "ascii"
    try:
        letter.encode(encoding)
    except UnicodeEncodeError:
        return False
    return locale.setlocale(locale.LC_CTYPE) not in ("C", "POSIX")
