"""Parameters of an effect: each is declared once, with its default, bounds, unit and scale.

A record of them is a frozen dataclass of tensors; its specifications make it a point in a box, and the box a unit cube.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeVar, dataclass_transform

import torch
from torch import Tensor
from torch.utils import _pytree as pytree  # torch has no public name for registering one's own classes

Record = TypeVar("Record")

CHANNELS = ("R", "G", "B")
TURNS = {"rad": 2.0 * math.pi, "degrees": 360.0}  # a whole circle by the first word of its unit


@dataclass(frozen=True)
class Specification:
    """What is known of a parameter before it has a value."""

    default: float | tuple[float, float, float]
    bounds: tuple[float, float]
    unit: str
    about: str
    scale: Literal["linear", "log"] = "linear"
    in_files: tuple[str, float] | None = None  # unit in files where it differs, and the factor to it

    def __post_init__(self) -> None:
        """Refuse a declaration that no fit could use."""
        low, high = self.bounds
        values = self.default if isinstance(self.default, tuple) else (self.default,)
        if not (low < high and all(low <= value <= high for value in values)):
            raise ValueError(f"default {self.default} lies outside bounds {self.bounds}; widen the bounds")
        if self.scale == "log" and low <= 0.0:
            raise ValueError(f"a log parameter needs positive bounds, not {self.bounds}")

    @property
    def file_unit(self) -> str:
        """Unit of the parameter in files, on the command line and in reports."""
        return self.in_files[0] if self.in_files else self.unit

    @property
    def file_factor(self) -> float:
        """What a value is multiplied by on its way into a file."""
        return self.in_files[1] if self.in_files else 1.0

    @property
    def file_bounds(self) -> tuple[float, float]:
        """Bounds in the file's unit, the lower first."""
        low, high = sorted(bound * self.file_factor for bound in self.bounds)
        return low, high

    @property
    def turn(self) -> float | None:
        """What added to a direction gives it again, where both bounds are the same direction; else None."""
        low, high = self.bounds
        turn = TURNS.get(self.unit.partition(" ")[0], math.inf)  # such as "degrees to the right"
        return turn if math.isclose(high - low, turn) else None

    def in_file_unit(self) -> "Specification":
        """The same parameter as it stands in files."""
        channels = self.default if isinstance(self.default, tuple) else (self.default,)
        first, *more = (channel * self.file_factor for channel in channels)
        default = (first, more[0], more[1]) if more else first
        return Specification(default, self.file_bounds, self.file_unit, self.about, self.scale)

    def to_unit(self, value: Tensor) -> Tensor:
        """Place between the bounds, in the parameter's own scale: 0 at the lower one, 1 at the upper."""
        low, high = self.bounds
        if self.scale == "log":
            return torch.log(value / low) / math.log(high / low)
        return (value - low) / (high - low)

    def from_unit(self, unit: Tensor) -> Tensor:
        """Value at a place between the bounds; the inverse of `to_unit`.

        Measured from the nearer bound, so that 0 and 1 give the bounds themselves and nothing between lies outside.
        """
        low, high = self.bounds
        if self.scale == "log":
            span = math.log(high / low)
            return torch.where(unit < 0.5, low * torch.exp(unit * span), high * torch.exp((unit - 1.0) * span))
        return torch.where(unit < 0.5, low + unit * (high - low), high - (1.0 - unit) * (high - low))


def parameter(  # noqa: PLR0913 - all but the default by name, and each is a fact of its own
    default: float | tuple[float, float, float],
    *,
    bounds: tuple[float, float],
    unit: str,
    about: str,
    scale: Literal["linear", "log"] = "linear",
    in_files: tuple[str, float] | None = None,
) -> Any:
    """Declare a field of a record: the one place where its default, bounds, unit and scale are written."""
    return field(metadata={"specification": Specification(default, bounds, unit, about, scale, in_files)})


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(parameter,))
def record(cls: type[Record]) -> type[Record]:
    """Make a class a frozen dataclass of tensors that torch.func and tree maps see through.

    Equality is identity, because comparing tensors does not give a bool.
    """
    cls = dataclass(frozen=True, eq=False)(cls)
    names = [entry.name for entry in fields(cls)]  # type: ignore[arg-type]

    def unflatten(values: Any, _: Any) -> Record:
        # torch.func rebuilds records with ints and None in place of tensors; __init__ would refuse them.
        rebuilt = object.__new__(cls)
        for name, value in zip(names, values, strict=True):
            object.__setattr__(rebuilt, name, value)
        return rebuilt

    pytree.register_pytree_node(cls, lambda whole: ([getattr(whole, name) for name in names], None), unflatten)
    return cls


def specifications(record_type: type[Any]) -> dict[str, Specification]:
    """Specification of each parameter of a record, in the order of declaration."""
    return {e.name: e.metadata["specification"] for e in fields(record_type) if "specification" in e.metadata}


def defaults(record_type: type[Record], dtype: torch.dtype | None = None) -> Record:
    """Record in which every parameter has its default."""
    return record_type(**{n: torch.tensor(s.default, dtype=dtype) for n, s in specifications(record_type).items()})


def to_cube(values: Any) -> Tensor:
    """Point of the unit cube where a record without batch stands: its scalars and channels in the order of `names`."""
    known = specifications(type(values))
    return torch.cat([known[name].to_unit(getattr(values, name)).reshape(-1) for name in known])


def from_cube(record_type: type[Record], point: Tensor) -> Record:
    """Record at a point of the unit cube; the inverse of `to_cube`, differentiable."""
    known = specifications(record_type)
    shapes = [torch.Size([len(CHANNELS)] if isinstance(one.default, tuple) else []) for one in known.values()]
    parts = torch.split(point, [shape.numel() for shape in shapes])
    return record_type(
        **{
            name: one.from_unit(part.reshape(shape))
            for (name, one), shape, part in zip(known.items(), shapes, parts, strict=True)
        }
    )


def names(record_type: type[Any], prefix: str) -> dict[str, tuple[str, int | None]]:
    """Where each scalar of a record stands: name in weather files -> field and channel (None for a scalar).

    Names are <PREFIX>_<FIELD>, with _R, _G, _B where the field has three channels.
    """
    found: dict[str, tuple[str, int | None]] = {}
    for name, specification in specifications(record_type).items():
        whole = f"{prefix}_{name}".upper().lstrip("_")
        if isinstance(specification.default, tuple):
            found.update({f"{whole}_{letter}": (name, channel) for channel, letter in enumerate(CHANNELS)})
        else:
            found[whole] = (name, None)
    return found
