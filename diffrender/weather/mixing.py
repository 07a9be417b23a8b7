"""Mixtures of weathers: two in a transition, or what areas and sequences carry, laid over the weather of the world."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import groupby

import torch
from torch import Tensor

from diffrender.parameters import Specification
from diffrender.weather.own_scale import mean

Weather = Mapping[str, Tensor]
Known = Mapping[str, Specification]


@dataclass(frozen=True, eq=False)
class Carried:
    """A weather that lies over others.

    Attributes:
        values: of the parameters that it changes; what it does not name it leaves as it is.
        share: how much of it there is, from 0 to 1.
        priority: what has a higher one lies above.
    """

    values: Weather
    share: Tensor
    priority: int


def blend(first: Weather, second: Weather, share: Tensor, known: Known) -> dict[str, Tensor]:
    """Weather between two: the first at a share of 0, the second at 1, each parameter in its own scale.

    Gradient: exact in the weathers and the share.

    Raises:
        ValueError: when a name is in only one of them.
    """
    alone = sorted(first.keys() ^ second.keys())
    if alone:
        raise ValueError(f"{', '.join(alone)}: only one of two weathers has it; give both the same names")
    return {name: mean((first[name], second[name]), (1.0 - share, share), known[name]) for name in first}


def mixed(base: Weather, carried: Iterable[Carried], known: Known) -> dict[str, Tensor]:
    """The base with carried weathers over it, from the lowest priority to the highest.

    Each covers all below it by its share. Those of one priority are mixed as overlapping grids of light probes are in
    the talk: each counts by its share and what is below by the rest, until the shares fill the whole and divide it.

    Gradient: exact; by the shares it jumps where those of one priority fill the whole.

    Raises:
        ValueError: when a carried weather has a name that the base lacks, for there is nothing it could come from.
    """
    found = dict(base)
    for _, together in groupby(sorted(carried, key=_priority), key=_priority):
        layers = list(together)
        for name in dict.fromkeys(name for layer in layers for name in layer.values):
            if name not in base:
                raise ValueError(f"{name} is carried over a weather that lacks it; give the base a value, such as none")
            over = [layer for layer in layers if name in layer.values]
            found[name] = _covered(found[name], [layer.values[name] for layer in over], over, known[name])
    return found


def _priority(layer: Carried) -> int:
    return layer.priority


def _covered(below: Tensor, above: list[Tensor], layers: list[Carried], known: Specification) -> Tensor:
    total = sum((layer.share for layer in layers), torch.zeros_like(layers[0].share))
    whole = total.clamp(min=1.0)
    shares = [(1.0 - total).clamp(min=0.0), *(layer.share / whole for layer in layers)]
    return mean([below, *above], shares, known)
