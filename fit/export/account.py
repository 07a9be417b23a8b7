"""What an export keeps, approximates and drops, in words and numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class Difference(NamedTuple):
    """Relative differences of a target's radiance from ours: per direction, the channels' sum over that of ours."""

    mean: float
    largest: float

    def __str__(self) -> str:
        """In words."""
        return f"mean {100.0 * self.mean:.2g} %, largest {100.0 * self.largest:.2g} %"


def difference(ours: Float[Tensor, "n 3"], theirs: Float[Tensor, "n 3"]) -> Difference:
    """Difference of radiances at directions of equal weight; where ours is black, of 1e-12.

    >>> import torch
    >>> print(difference(torch.ones(2, 3), torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 1.3]])))
    mean 5 %, largest 10 %
    """
    apart = (theirs - ours).abs().sum(-1) / ours.sum(-1).clamp(min=1e-12)
    return Difference(float(apart.mean()), float(apart.max()))


@dataclass(frozen=True)
class Account:
    """Sentences on an export, each of one line.

    Attributes:
        verified: whether the target was run, and how; else that it was not.
        keeps: what looks the same in the target.
        approximates: what does not, each with its figures.
        drops: what the target does not have.
    """

    target: str
    verified: str
    keeps: Sequence[str]
    approximates: Sequence[str]
    drops: Sequence[str]

    def text(self) -> str:
        """The whole account, one heading a line and one sentence an indented line."""
        lines = [f"{self.target}: {self.verified}"]
        for heading in ("keeps", "approximates", "drops"):
            lines += [f"{heading}:", *(f"  {sentence}" for sentence in getattr(self, heading) or ("nothing",))]
        return "\n".join(lines)
