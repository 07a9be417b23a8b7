"""What an experiment leaves: records in JSON with where and when they were taken, and a printed table."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.timing import THREADS, provenance

RESULTS = Path(__file__).parent / "results"


def write(path: Path, content: Mapping[str, Any], threads: int = THREADS) -> None:
    """Write an experiment's content with its provenance as JSON; its folder is made where it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    whole = {"experiment": path.stem, **content, **provenance(threads)}
    path.write_text(json.dumps(whole, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Text of a table: the first column to the left, the others to the right.

    >>> print(table(["photo", "E3"], [["dawn", "0.1"]]))
    photo   E3
    dawn   0.1
    """
    lines = [list(head), *map(list, rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        "  ".join(
            [line[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))]
        )
        for line in lines
    )
