"""What experiments ask of effects: which ones, in which precision, and at which points of their boxes."""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.catalogue import EFFECTS
from diffrender.parameters import defaults, names, to_cube
from experiments.records import RESULTS


@dataclass(frozen=True)
class Given:
    """What an experiment was asked for: names of effects, or of what else it is about."""

    names: tuple[str, ...]
    is_small: bool
    out: Path


def ask(about: str, arguments: Sequence[str] | None, known: Iterable[str] = EFFECTS) -> Given:
    """Names and size from a command line; `known` are the names that the experiment knows."""
    known = tuple(known)
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(known)}; all where none is given")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    unknown = sorted(set(asked.names) - set(known))
    if unknown:
        parser.error(f"{', '.join(unknown)} is not known here; known: {', '.join(known)}")
    chosen = tuple(name for name in known if not asked.names or name in asked.names)
    return Given(chosen, asked.size == "small", asked.out)


def in_dtype(inputs: Any, dtype: torch.dtype) -> Any:
    """The same numbers in another dtype; whole numbers and truth values stay what they are."""
    return pytree.tree_map_only(torch.Tensor, lambda t: t.to(dtype) if t.is_floating_point() else t, inputs)


def corners(kind: type[Any]) -> dict[str, Float[Tensor, " n"]]:
    """Points of a record's cube by name: defaults, all low, all high, and each scalar alone at either bound."""
    middle = to_cube(defaults(kind, torch.float64))
    found = {"defaults": middle, "all low": torch.zeros_like(middle), "all high": torch.ones_like(middle)}
    for place, name in enumerate(names(kind, "")):
        for side, bound in (("low", 0.0), ("high", 1.0)):
            found[f"{name} {side}"] = middle.index_fill(0, torch.tensor(place), bound)
    return found


def scattered(kind: type[Any], count: int) -> dict[str, Float[Tensor, " n"]]:
    """So many corners of a record's cube in which every scalar is at either bound, and as many points inside it."""
    dimensions, draw = len(names(kind, "")), torch.Generator().manual_seed(0)
    at_bounds = torch.randint(0, 2, (count, dimensions), generator=draw).double()
    inside = torch.rand(count, dimensions, generator=draw, dtype=torch.float64)
    found = {f"corner {place}": point for place, point in enumerate(at_bounds)}
    return found | {f"inside {place}": point for place, point in enumerate(inside)}
