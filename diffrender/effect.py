"""Effect: a record of parameters and a ladder of renderers of a picture, from "skip it" to a trusted reference."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

Render = Callable[[Any, Any], Tensor]


def as_given(_parameters: object, inputs: Any) -> Any:
    """Inputs unchanged: what a rung that precomputes nothing prepares."""
    return inputs


@dataclass(frozen=True)
class Rung:
    """One renderer of an effect.

    `prepare(parameters, inputs)` gives what `render(parameters, prepared)` draws from, so that tables are made, and
    timed, once for many pictures. Both are pure and differentiable; calling the rung does both.
    """

    render: Render
    prepare: Callable[[Any, Any], Any] = as_given

    def __call__(self, parameters: Any, inputs: Any) -> Tensor:
        """Picture of the parameters and inputs, tables included."""
        return self.render(parameters, self.prepare(parameters, inputs))


@dataclass(frozen=True)
class Effect:
    """All that may be known of an effect; fits, weather files, tests and experiments ask nothing else.

    Attributes:
        parameters: the record type.
        prefix: of the parameters' names in weather files.
        rungs: name -> renderer, cheapest first; the last is the module's `render`.
        reference: slow and trusted, sharing no formula with the last rung except what is not under test.
        tolerance: largest relative error of the last rung against the reference on `example_inputs`.
        largest_change: upper bound on abs(last rung - skip), from parameters and inputs.
        example_inputs: small fixed inputs in a dtype, the hard cases among them.
    """

    parameters: type[Any]
    prefix: str
    rungs: Mapping[str, Rung]
    reference: Render
    tolerance: float
    largest_change: Render
    example_inputs: Callable[[Any], Any]
