"""What may be asked of fits, whatever they fit."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from diffrender.scene import Scene
from fit.input_error import InputError
from fit.solution import SunPlace


@dataclass(frozen=True)
class Search:
    """What may be asked of every fit.

    Attributes:
        start: scene to begin at, whose values stay where they are not searched.
        fixed: names of weather files held at values in files' units.
        free: further names to search.
        solver: as on the command line.
        seconds: after which the best so far is taken; None gives the same result on every machine.
        seed: of the sample of pixels and of solvers that draw.
    """

    start: Scene | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] = ()
    solver: str = "least-squares"
    seconds: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            InputError: for a name that is both held and searched.
        """
        for name in self.free:
            if name in self.fixed:
                raise InputError(f"--fix and --free both name {name}; leave it out of one of them")


@dataclass(frozen=True)
class Options(Search):
    """What may be asked of a fit to what the sun lights.

    Attributes:
        mask: picture whose white pixels are used; None finds them.
        sun: where the sun stands; None finds it.
    """

    mask: Path | None = None
    sun: SunPlace | None = None
