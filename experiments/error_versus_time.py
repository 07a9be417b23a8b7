"""How far each rung of an effect is from its reference, and what it costs.

Errors are those of float32 at the defaults, on the effect's examples, where the hard cases are, and on a small picture.
Times are processor times of one thread on a larger picture: what a rung prepares apart from what it draws, eager and
compiled; all rungs and a copy of the picture's bytes take turns, and ratios are taken within a turn.

Effects that are not asked for keep their records, each with the machine and date of its own.
"""

import shutil
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torch._dynamo.exc import TorchDynamoException  # torch has no public name for what torch.compile raises

from diffrender.catalogue import EFFECTS
from diffrender.effect import Effect
from diffrender.parameters import defaults
from experiments import effect_pictures, effects, plots, records
from experiments.timing import Spread, in_turn, one_thread, ratio, seconds_of, spread

COMPILERS = ("g++", "c++", "clang++")
LONGEST = 120.0  # of compiling one rung [s of processor time]; splashes of rain take more than 300
LIT = 1e-6  # share of a picture's largest value above which a value has an error of its own


@dataclass(frozen=True)
class Size:
    """Width and height of what is timed, and of what is judged; rounds of timing; whether compiled too."""

    timed: tuple[int, int] = (128, 64)
    judged: tuple[int, int] = (48, 24)
    rounds: int = 7
    is_compiled: bool = True


SMALL = Size(timed=(16, 8), judged=(8, 4), rounds=1, is_compiled=False)


@dataclass(frozen=True)
class Error:
    """Distance of a picture from the reference.

    Attributes:
        largest: of any value, in the reference's largest.
        median: of the values, each in the reference's own there.
    """

    largest: float
    median: float


@dataclass(frozen=True)
class Times:
    """What a rung costs [s], and in other times of the same turns.

    Attributes:
        ratio: of preparing and drawing, in that of the cheapest rung that draws.
        copies: of drawing alone, in that of a copy of the picture's bytes.
        compiled: of drawing by torch.compile; None where that was not timed.
        compiled_speed: how many times faster compiled is than eager.
    """

    prepare: Spread
    render: Spread
    ratio: Spread
    copies: Spread
    compiled: Spread | None
    compiled_speed: Spread | None


@dataclass(frozen=True)
class Step:
    """One rung.

    Attributes:
        on_picture: None where the effect has no picture of its own.
        compiled_difference: largest between compiled and eager, in the picture's largest value.
    """

    effect: str
    rung: str
    on_examples: Error
    on_picture: Error | None
    times: Times
    compiled_difference: float | None


def error(drawn: Tensor, reference: Tensor) -> Error:
    """Distance of a picture from its reference.

    Raises:
        ValueError: when the reference is black.
    """
    truth, apart = reference.double().abs(), (drawn.double() - reference.double()).abs()
    brightest = truth.max()
    if not brightest > 0.0:
        raise ValueError("the reference is black; give inputs on which the effect draws something")
    lit = truth > LIT * brightest
    return Error(float(apart.max() / brightest), float((apart[lit] / truth[lit]).median()))


def errors(effect: Effect, inputs: Any) -> dict[str, Error]:
    """Error of each rung at the defaults, in float32, from the reference on the same numbers in float64."""
    parameters, inputs = (effects.in_dtype(given, torch.float32) for given in (defaults(effect.parameters), inputs))
    reference = effect.reference(*(effects.in_dtype(given, torch.float64) for given in (parameters, inputs)))
    return {name: error(rung(parameters, inputs), reference) for name, rung in effect.rungs.items()}


def times(effect: Effect, inputs: Any, rounds: int, compiled: Mapping[str, Callable[..., Tensor]]) -> dict[str, Times]:
    """Times of each rung at the defaults; `compiled` are those rungs that were."""
    parameters = defaults(effect.parameters, torch.float32)
    works: dict[str, Callable[[], object]] = {}
    for name, rung in effect.rungs.items():
        prepared = rung.prepare(parameters, inputs)
        works[f"prepare {name}"] = partial(rung.prepare, parameters, inputs)
        works[f"render {name}"] = partial(rung.render, parameters, prepared)
        if name in compiled:
            works[f"compiled {name}"] = partial(compiled[name], parameters, prepared)
    drawn = rung.render(parameters, prepared)
    works["copy"] = partial(torch.empty_like(drawn).copy_, drawn)
    found = in_turn({name: partial(seconds_of, work) for name, work in works.items()}, rounds)
    whole = {
        name: spread([a + b for a, b in zip(found[f"prepare {name}"].each, found[f"render {name}"].each, strict=True)])
        for name in effect.rungs
    }
    cheapest = next(name for name in effect.rungs if name != "skip")
    return {
        name: Times(
            prepare=found[f"prepare {name}"],
            render=found[f"render {name}"],
            ratio=ratio(whole[name], whole[cheapest]),
            copies=ratio(found[f"render {name}"], found["copy"]),
            compiled=found.get(f"compiled {name}"),
            compiled_speed=ratio(found[f"render {name}"], found[f"compiled {name}"]) if name in compiled else None,
        )
        for name in effect.rungs
    }


@dataclass(frozen=True)
class Compiled:
    """What torch.compile makes of rungs by name: renderers, their difference from eager, and why others are missing."""

    renderers: Mapping[str, Callable[..., Tensor]]
    differences: Mapping[str, float]
    refused: Mapping[str, str]


def compiled_rungs(effect: Effect, inputs: Any) -> Compiled:
    """The rungs compiled, each tried on the inputs."""
    if not any(map(shutil.which, COMPILERS)):
        return Compiled({}, {}, dict.fromkeys(effect.rungs, f"no compiler of {', '.join(COMPILERS)} is installed"))
    parameters = defaults(effect.parameters, torch.float32)
    renderers, differences, refused = {}, {}, {}
    for name, rung in effect.rungs.items():
        prepared = rung.prepare(parameters, inputs)
        eager = rung.render(parameters, prepared)
        compiled = torch.compile(rung.render)
        try:
            with _at_most(LONGEST):
                drawn = compiled(parameters, prepared)
        except TorchDynamoException as refusal:
            refused[name] = str(refusal).splitlines()[0]
            continue
        brightest = eager.abs().max().clamp(min=torch.finfo(eager.dtype).tiny)
        renderers[name], differences[name] = compiled, float((drawn - eager).abs().max() / brightest)
    return Compiled(renderers, differences, refused)


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """End what takes more processor time of this process, as compilers in Python do, as a refusal to compile."""

    def stop(*_: object) -> None:
        raise TorchDynamoException(f"not compiled within {seconds:g} s")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def steps(name: str, effect: Effect, size: Size) -> tuple[list[Step], Mapping[str, str]]:
    """Every rung of an effect, cheapest first, and why some of them are not compiled."""
    on_examples = errors(effect, effect.example_inputs(torch.float64))
    has_picture = name in effect_pictures.PICTURES
    on_picture = errors(effect, effect_pictures.picture_inputs(name, *size.judged)) if has_picture else {}
    inputs = effects.in_dtype(effect_pictures.picture_inputs(name, *size.timed), torch.float32)
    made = compiled_rungs(effect, inputs) if size.is_compiled else Compiled({}, {}, {})
    timed = times(effect, inputs, size.rounds, made.renderers)
    found = [
        Step(name, rung, on_examples[rung], on_picture.get(rung), timed[rung], made.differences.get(rung))
        for rung in effect.rungs
    ]
    return found, made.refused


def table(found: Sequence[Step]) -> str:
    """Text of the table."""

    def line(step: Step) -> list[str]:
        picture = step.on_picture
        times = step.times
        return [
            f"{step.effect}: {step.rung}",
            f"{step.on_examples.largest:.2g}",
            f"{step.on_examples.median:.2g}",
            f"{picture.largest:.2g}" if picture else "-",
            f"{picture.median:.2g}" if picture else "-",
            *(f"{1e3 * spread.median:.3g}" for spread in (times.prepare, times.render)),
            str(times.ratio),
            f"{times.copies.median:.3g}",
            str(times.compiled_speed or "-"),
            "-" if step.compiled_difference is None else f"{step.compiled_difference:.1g}",
        ]

    head = ["rung", "largest error", "median", "on picture", "median", "prepare ms", "render ms", "to cheapest"]
    return records.table([*head, "render to copy", "eager to compiled", "apart"], [line(step) for step in found])


@torch.no_grad()
@one_thread()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table of each effect, and write it as JSON; draw all that the file holds."""
    given = effects.ask("error of every rung against its time", arguments)
    size = SMALL if given.is_small else Size()
    written = given.out / "error_versus_time.json"
    for name in given.names:
        found, refused = steps(name, EFFECTS[name], size)
        print(table(found))
        part = {"size": asdict(size), "records": [asdict(step) for step in found], "not_compiled": refused}
        records.write_part(written, name, part, EFFECTS, threads=1)
    plots.error_versus_time(written)


if __name__ == "__main__":
    main()
