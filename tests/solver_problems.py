"""Small problems of least squares in the unit cube whose solutions are known, and what may befall their calls."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor


@dataclass
class Problem:
    """Residuals of a point of the unit cube, and what befalls the calls, counted from 1."""

    function: Callable[[Tensor], Tensor]
    size: int
    fault: Callable[[int], float] = lambda _: 1.0
    calls: int = 0
    asked: list[np.ndarray] = field(default_factory=list)

    def residuals(self, point: Tensor) -> Tensor:
        factor = self._call(point)
        return self.function(point) * factor

    def jacobian(self, point: Tensor) -> tuple[Tensor, Tensor]:
        factor = self._call(point)
        return self.function(point) * factor, derivative(self.function, point) * factor

    def _call(self, point: Tensor) -> float:
        self.calls += 1
        self.asked.append(point.numpy().copy())
        return self.fault(self.calls)

    def loss(self, point: np.ndarray) -> float:
        return 0.5 * float(self.function(torch.tensor(point)).square().sum())

    @property
    def start(self) -> np.ndarray:
        return np.full(self.size, 0.4)


def derivative(function: Callable[[Tensor], Tensor], point: Tensor) -> Tensor:
    # Central differences, right to ten digits; forward mode takes milliseconds for the smallest function.
    steps = 1e-6 * torch.eye(len(point), dtype=point.dtype)
    return torch.stack([(function(point + step) - function(point - step)) / 2e-6 for step in steps], dim=1)


def rosenbrock(size: int, low: float, high: float) -> Problem:
    def function(unit: Tensor) -> Tensor:
        x = low + (high - low) * unit
        return torch.cat([1.0 - x[:-1], 10.0 * (x[1:] - x[:-1] ** 2)])

    return Problem(function, size)


def bowl(*lowest: float) -> Problem:
    """Lowest where it says, or on the faces of the cube nearest to it."""
    place = torch.tensor(lowest, dtype=torch.float64)
    weights = torch.linspace(1.0, 2.0, len(lowest), dtype=torch.float64)
    return Problem(lambda unit: torch.cat([weights * (unit - place), torch.ones(1, dtype=torch.float64)]), len(lowest))


def decay(noise: float) -> Problem:
    """Height, rate and floor of a decaying exponential, true at 0.5, 0.3 and 0.2."""
    time = torch.linspace(0.0, 1.0, 60, dtype=torch.float64)

    def model(unit: Tensor) -> Tensor:
        return 4.0 * unit[0] * torch.exp(-10.0 * unit[1] * time) + unit[2]

    generator = torch.Generator().manual_seed(3)
    scatter = noise * torch.randn(60, generator=generator, dtype=torch.float64)
    measured = model(torch.tensor([0.5, 0.3, 0.2], dtype=torch.float64)) + scatter
    return Problem(lambda unit: model(unit) - measured, 3)


def curved(seed: int) -> Problem:
    """Log of a smooth positive model in eight parameters, true inside and outside the cube."""
    generator = torch.Generator().manual_seed(seed)
    directions = torch.randn(300, 3, generator=generator, dtype=torch.float64)
    waves = torch.tanh(directions @ torch.randn(3, 8, generator=generator, dtype=torch.float64))

    def model(unit: Tensor) -> Tensor:
        return torch.log((waves * torch.exp(2.0 * unit - 1.0)).sum(-1).square() + 0.5)

    truth = 1.6 * torch.rand(8, generator=generator, dtype=torch.float64) - 0.3
    measured = model(truth) + 0.1 * torch.randn(300, generator=generator, dtype=torch.float64)
    return Problem(lambda unit: model(unit) - measured, 8)


def raising(problem: Problem, error: BaseException, call: int) -> Problem:
    def fault(count: int) -> float:
        if count >= call:
            raise error
        return 1.0

    problem.fault = fault
    return problem


class Broken(Exception):  # noqa: N818 - what an objective might raise
    pass
