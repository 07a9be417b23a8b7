"""Does float32 follow float64, in value and gradient, over every effect's box, its corners and its hard inputs?

Both draw from the same numbers, those that float32 holds. Compared are every value of the picture, its derivative by
every parameter (forward, in the unit cube of the record, so that a derivative is the change over the whole box), and
the gradient of a weighted sum by every parameter and input (backward).

An error is relative to the number itself or, near zero, to a floor: a thousandth of the picture's largest value; of a
derivative, a thousandth of the largest by that parameter or of the picture, whichever is more; of a backward gradient,
times the size of its tensor, the largest by that tensor or a thousandth of the picture. ULPs are steps of float32 at
the number or the floor. What is 0 in both is not counted.

Numbers off by more than 1e-4 are listed each with its cause, found by rounding: float64 is asked again with inputs and
parameters moved by half a step of float32 each. Where that moves its own answer as far, within a factor of four,
the inputs do not determine the number any better; where it does not, the arithmetic is to blame.

Effects that are not asked for keep their records, each with the machine and date of its own.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.catalogue import EFFECTS
from diffrender.effect import Effect, Rung
from diffrender.parameters import from_cube, names
from experiments import effects, hard_places, plots, records

ALLOWED, SHARE = 1e-4, 0.999  # relative error, and the share of numbers that must keep it
FLOOR = 1e-3
ENDS = 3  # of the corners, these first: defaults, all low and all high
LISTED = 20  # of the numbers beyond, the worst; the others are counted
ROUNDINGS, LIKE_ROUNDING = 4, 4.0
BLACK = 1e-30  # below it float32 ends
INPUTS, ARITHMETIC = "the inputs do not determine it better", "arithmetic"


@dataclass(frozen=True)
class Size:
    """How much of the box is swept; None is all."""

    inputs: int | None = None
    corners: int | None = None
    scattered: int = 16  # corners, and as many points inside


SMALL = Size(inputs=1, corners=ENDS, scattered=1)


@dataclass(frozen=True)
class Beyond:
    """A number that float32 misses by more than allowed, and whether its inputs or the arithmetic are the cause."""

    of: str  # value, derivative or gradient
    inputs: str
    point: str
    place: tuple[int, ...]
    name: str  # of the parameter, where it is a derivative
    float64: float
    float32: float | None  # None where it is not finite
    error: float | None  # None where float32 is not finite
    moved: float  # float64 by rounding its inputs, likewise relative
    cause: str


@dataclass(frozen=True)
class Followed:
    """How float32 follows float64 in one kind of number."""

    of: str
    count: int
    not_finite: int
    within: float  # share of the numbers
    median: float
    most: float  # 99.9 % are nearer
    largest: float
    median_ulps: float
    largest_ulps: float


@dataclass(frozen=True)
class Swept:
    """One rung over all points and inputs."""

    effect: str
    rung: str
    cases: int
    followed: tuple[Followed, ...]
    beyond: tuple[Beyond, ...]


# Tensors of each kind of number, each of which has a scale of its own: the picture, its derivative by each scalar of
# the parameters, and the gradient by each tensor of parameters and inputs.
Numbers = Mapping[str, tuple[Tensor, ...]]


@dataclass(frozen=True)
class Case:
    """A point of the box and inputs, as float32 holds them."""

    inputs: str
    point: str
    parameters: Any
    tangents: Any  # of the parameters, with a leading axis
    seen: Any

    def numbers(self, rung: Rung, dtype: torch.dtype) -> Numbers:
        """What a rung gives in a dtype."""
        given = effects.in_dtype((self.parameters, self.tangents, self.seen), dtype)
        return _forward(rung, *given) | {"gradient": _gradient(rung, given[0], given[2])}

    def rounded(self, rung: Rung, generator: torch.Generator, kinds: Iterable[str]) -> Numbers:
        """Some kinds of numbers in float64, with parameters and inputs moved by half a step of float32."""
        exact = effects.in_dtype((self.parameters, self.seen), torch.float64)
        parameters, seen = pytree.tree_map(lambda tensor: _moved(tensor, generator), exact)
        if set(kinds) == {"gradient"}:  # by far the cheapest, and the most frequent
            return {"gradient": _gradient(rung, parameters, seen)}
        tangents = effects.in_dtype(self.tangents, torch.float64)
        return _forward(rung, parameters, tangents, seen) | {"gradient": _gradient(rung, parameters, seen)}


def _forward(rung: Rung, parameters: Any, tangents: Any, seen: Any) -> dict[str, tuple[Tensor, ...]]:
    def along(tangent: Any) -> tuple[Tensor, Tensor]:
        value, derivative = torch.func.jvp(lambda record: rung(record, seen), (parameters,), (tangent,))[:2]
        return value, derivative

    value, derivative = torch.func.vmap(along)(tangents)
    return {"value": (value[0],), "derivative": derivative.unbind()}


def _moved(tensor: Any, generator: torch.Generator) -> Any:
    """A tensor with every number half a step of float32 up or down; 0 by that of the tensor's largest."""
    if not (isinstance(tensor, Tensor) and tensor.is_floating_point()):
        return tensor
    signs = 2 * torch.randint(0, 2, tensor.shape, generator=generator) - 1
    finite = tensor.nan_to_num(posinf=0.0, neginf=0.0)
    return tensor + signs * torch.where(tensor == 0.0, finite.abs().amax(), finite) * 2.0**-24


def _gradient(rung: Rung, parameters: Any, inputs: Any) -> tuple[Tensor, ...]:
    """Gradient, times the size of each tensor, of a sum with uneven weights, in which nothing cancels by symmetry."""
    leaves, structure = pytree.tree_flatten((parameters, inputs))
    free = [isinstance(leaf, Tensor) and leaf.is_floating_point() for leaf in leaves]
    leaves = [leaf.detach().requires_grad_() if one else leaf for leaf, one in zip(leaves, free, strict=True)]
    drawn = rung(*pytree.tree_unflatten(leaves, structure))
    weight = torch.cos(torch.arange(drawn.numel(), dtype=torch.float64)).to(drawn.dtype).reshape(drawn.shape)
    asked = list(itertools.compress(leaves, free))
    if not drawn.requires_grad:
        return tuple(torch.zeros_like(leaf) for leaf in asked)
    slopes = torch.autograd.grad((drawn * weight).sum(), asked, allow_unused=True, materialize_grads=True)
    return tuple(slope * _size(leaf) for slope, leaf in zip(slopes, asked, strict=True))


def _size(tensor: Tensor) -> float:
    """Largest value of a tensor; 1 of one that is 0 or endless."""
    largest = float(tensor.detach().abs().max())
    return largest if 0.0 < largest < math.inf else 1.0


def scales(truth: Numbers) -> Numbers:
    """To what the error of each number is relative, as the module says."""
    (picture,) = truth["value"]
    brightest = picture.abs().amax()

    def floor(kind: str, tensor: Tensor) -> Tensor:
        largest = tensor.abs().amax()
        if kind == "gradient":
            return torch.maximum(largest, FLOOR * brightest)
        return FLOOR * torch.maximum(largest, brightest)

    return {
        kind: tuple(torch.maximum(one.abs(), floor(kind, one).clamp(min=BLACK)) for one in those)
        for kind, those in truth.items()
    }


def relative(found: Numbers, truth: Numbers) -> Numbers:
    """Error of every number found; infinite where one of the two is not finite."""

    def error(single: Tensor, double: Tensor, scale: Tensor) -> Tensor:
        apart = (single.double() - double).abs() / scale
        return torch.where(single.isfinite() & double.isfinite(), apart, torch.full_like(apart, math.inf))

    scale = scales(truth)
    return {kind: tuple(map(error, ours, truth[kind], scale[kind])) for kind, ours in found.items()}


def _ulps(error: Tensor, scale: Tensor) -> Tensor:
    """Relative errors in steps of float32."""
    return error * scale / torch.ldexp(torch.ones_like(scale), torch.frexp(scale).exponent - 24)


def cases(name: str, effect: Effect, size: Size) -> Iterable[Case]:
    """The middle and the ends of the box with every input of the effect, other points with the inputs in turn."""
    kind = effect.parameters

    def case(shown: str, inputs: Any, where: str, point: Tensor) -> Case:
        def along(direction: Tensor) -> Any:
            return torch.func.jvp(partial(from_cube, kind), (point,), (direction,))[1]

        tangents = torch.func.vmap(along)(torch.eye(len(point), dtype=point.dtype))
        return Case(shown, where, *effects.in_dtype((from_cube(kind, point), tangents, inputs), torch.float32))

    shown = list(hard_places.hard_inputs(name).items())[: size.inputs]
    corners = list(effects.corners(kind).items())
    others = [*corners[ENDS : size.corners], *effects.scattered(kind, size.scattered).items()]
    pairs = [*itertools.product(shown, corners[:ENDS]), *zip(itertools.cycle(shown), others, strict=False)]
    for (seen, inputs), (where, point) in pairs:
        yield case(seen, inputs, where, point)


def swept(name: str, effect: Effect, rung: str, size: Size) -> Swept:
    """How a rung in float32 follows itself in float64, over all cases."""
    errors: dict[str, list[Tensor]] = {}
    ulps: dict[str, list[Tensor]] = {}
    beyond: list[Beyond] = []
    count = 0
    for case in cases(name, effect, size):
        count += 1
        truth, single = (case.numbers(effect.rungs[rung], dtype) for dtype in (torch.float64, torch.float32))
        error, scale = relative(single, truth), scales(truth)
        for kind, those in error.items():
            for part, one in enumerate(those):
                # What is 0 in both, as a sky below the ground's edge, would only flatter the shares.
                counts = (truth[kind][part] != 0.0) | (single[kind][part] != 0.0)
                errors.setdefault(kind, []).append(one[counts])
                ulps.setdefault(kind, []).append(_ulps(one, scale[kind][part])[counts])
        beyond += _beyond(case, effect, effect.rungs[rung], truth, single)
    followed = tuple(_followed(kind, torch.cat(errors[kind]), torch.cat(ulps[kind])) for kind in errors)
    beyond.sort(key=lambda one: -math.inf if one.error is None else -one.error)
    return Swept(name, rung, count, followed, tuple(beyond))


def _followed(kind: str, error: Tensor, ulps: Tensor) -> Followed:
    finite = error[error.isfinite()]
    if not len(finite):
        return Followed(kind, len(error), len(error), 0.0 if len(error) else 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    steps = ulps[error.isfinite()]
    return Followed(
        of=kind,
        count=len(error),
        not_finite=len(error) - len(finite),
        within=float((error <= ALLOWED).double().mean()),
        median=float(finite.median()),
        most=float(finite.sort().values[math.ceil(SHARE * len(finite)) - 1]),
        largest=float(finite.max()),
        median_ulps=float(steps.median()),
        largest_ulps=float(steps.max()),
    )


def _beyond(case: Case, effect: Effect, rung: Rung, truth: Numbers, single: Numbers) -> list[Beyond]:
    """Numbers of a case that are off by more than allowed, with their causes."""
    error = relative(single, truth)
    error = {kind: those for kind, those in error.items() if any(bool((one > ALLOWED).any()) for one in those)}
    if not error:
        return []
    draw = torch.Generator().manual_seed(0)
    rounded = [relative(case.rounded(rung, draw, error), truth) for _ in range(ROUNDINGS)]
    labels = {"derivative": list(names(effect.parameters, effect.prefix))}
    found = []
    for kind, those in error.items():
        for part, one in enumerate(those):
            moved = torch.stack([by_kind[kind][part] for by_kind in rounded]).amax(0)
            for place in (one > ALLOWED).nonzero().tolist():
                at = tuple(place)
                off, by_rounding = float(one[at]), float(moved[at])
                found.append(
                    Beyond(
                        of=kind,
                        inputs=case.inputs,
                        point=case.point,
                        name=labels.get(kind, [f"tensor {part}"] * (part + 1))[part],
                        place=at,
                        float64=float(truth[kind][part][at]),
                        float32=_finite(single[kind][part][at]),
                        error=off if math.isfinite(off) else None,
                        moved=by_rounding,
                        cause=INPUTS if off <= LIKE_ROUNDING * by_rounding else ARITHMETIC,
                    )
                )
    return found


def _finite(number: Tensor) -> float | None:
    return float(number) if number.isfinite() else None


def table(found: Sequence[Swept]) -> str:
    """Text of the table."""
    head = ["rung", "cases", "numbers", "not finite", "beyond", "median", "99.9 %", "largest", "ULPs", "largest ULPs"]
    return records.table(
        head,
        [
            [
                f"{rung.effect}: {rung.rung}, {one.of}",
                str(rung.cases),
                str(one.count),
                str(one.not_finite),
                f"{1.0 - one.within:.2g}",
                *(f"{error:.2g}" for error in (one.median, one.most, one.largest, one.median_ulps, one.largest_ulps)),
            ]
            for rung in found
            for one in rung.followed
        ],
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables of each effect, and write them as JSON; draw all that the file holds."""
    given = effects.ask("float32 beside float64 over the box", arguments)
    size = SMALL if given.is_small else Size()
    written = given.out / "stability.json"
    for name in given.names:
        found = [swept(name, EFFECTS[name], rung, size) for rung in EFFECTS[name].rungs]
        print(table(found))
        causes = {one.rung: dict(Counter(f"{far.of}: {far.cause}" for far in one.beyond)) for one in found}
        for rung, counted in causes.items():
            for cause, count in counted.items():
                print(f"{name}: {rung}, beyond {ALLOWED:g}: {count} of {cause}")
        listed = [asdict(replace(one, beyond=one.beyond[:LISTED])) for one in found]
        part = {"size": asdict(size), "allowed": ALLOWED, "share": SHARE, "records": listed, "causes": causes}
        records.write_part(written, name, part, EFFECTS)
    plots.stability(written)


if __name__ == "__main__":
    main()
