"""What the commands that fit one picture share: progress, threads, and how they end."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fit import terminal

if TYPE_CHECKING:
    from fit.solution import Solution

FITTED, NOT_CONVERGED, INTERRUPTED = 0, 1, 130
# One thread: for what a fit does at a time, the second core of an idle machine gains nothing that the waiting of
# threads for each other does not cost many times over on a busy one. It also gives the same bits on every machine.
THREADS = 1


def ended(folder: Path, solution: "Solution", quiet: bool) -> int:
    """Exit status of a fit, after its summary."""
    from fit import minimum, results

    if not quiet:
        terminal.say(results.summary(folder, solution))
    if solution.minimum.reason == minimum.INTERRUPTED:
        return INTERRUPTED
    return FITTED if solution.minimum.converged else NOT_CONVERGED


def use_threads() -> None:
    """Compute in one thread."""
    import torch

    torch.set_num_threads(THREADS)


@contextmanager
def progress(what: str, quiet: bool) -> Iterator[None]:
    """Show on standard error, if it is a terminal, what takes its time."""
    if quiet or not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield
