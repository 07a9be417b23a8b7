"""What an experiment leaves: records in JSON with where and when they were taken, and a printed table."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.timing import THREADS, provenance

RESULTS = Path(__file__).parent / "results"


def write(path: Path, content: Mapping[str, Any], threads: int = THREADS) -> None:
    """Write an experiment's content with its provenance as JSON; its folder is made where it is missing."""
    _save(path, {"experiment": path.stem, **content, **provenance(threads)})


def write_part(path: Path, name: str, part: Mapping[str, Any], order: Iterable[str], threads: int = THREADS) -> None:
    """Write what was found of one effect, with its provenance, beside what the file tells of the others in `order`."""
    told = json.loads(path.read_text(encoding="utf-8"))["effects"] if path.exists() else {}
    found = told | {name: {**part, **provenance(threads)}}
    _save(path, {"experiment": path.stem, "effects": {one: found[one] for one in order if one in found}})


def _save(path: Path, content: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


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
