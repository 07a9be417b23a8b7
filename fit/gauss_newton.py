"""QuadraticModel: Gauss-Newton's picture of the loss around a point, and where it is lowest in the unit cube."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.optimize import lsq_linear
from torch import Tensor

SMALLEST_DAMPING = 1e-12  # keeps the curvature positive definite beside its rounding error of n times 1e-16


@dataclass(frozen=True)
class QuadraticModel:
    """Half the squared length of residuals + jacobian @ (x - point), over points x of the unit cube."""

    point: Float64[np.ndarray, " n"]
    residuals: Tensor
    jacobian: Tensor

    @cached_property
    def loss(self) -> float:
        """Half the sum of squares at the point; infinite where it or the curvature is not finite."""
        loss = half_square(self.residuals)
        return loss if math.isfinite(float(self.jacobian.square().sum())) else math.inf

    @property
    def is_finite(self) -> bool:
        """Whether residuals and derivatives are finite."""
        return math.isfinite(self.loss)

    @cached_property
    def gradient(self) -> Float64[np.ndarray, " n"]:
        """Gradient of the loss at the point, exact; 0 where the model is not finite, which no solver may follow."""
        if not self.is_finite:
            return np.zeros_like(self.point)
        gradient: np.ndarray[Any, np.dtype[np.float64]] = (self.jacobian.T @ self.residuals).numpy()
        return gradient

    @cached_property
    def curvature(self) -> Float64[np.ndarray, "n n"]:
        """Second derivative of the model: that of the loss without the curvature of the residuals."""
        curvature: np.ndarray[Any, np.dtype[np.float64]] = (self.jacobian.T @ self.jacobian).numpy()
        return curvature

    @property
    def turned_jacobian(self) -> Float64[np.ndarray, "m n"]:
        """Jacobian of n + 1 residuals that make the same model: axes turned so that the first is the residuals' own.

        There the residuals are their length and n zeros.
        """
        length = math.sqrt(2.0 * self.loss)
        along = self.gradient / length if length > 0.0 else np.zeros_like(self.gradient)
        across = self.curvature - np.outer(along, along)
        values, axes = np.linalg.eigh(across)
        # Rounding may take a value of 0 below it.
        return np.vstack([along, np.sqrt(values.clip(0.0))[:, None] * axes.T])

    def lowest(self, damping: float) -> Float64[np.ndarray, " n"]:
        """Point of the cube where the model is lowest, exactly on the faces that hold it back.

        Damping is relative to the geometric mean of each coordinate's curvature and the greatest: between Levenberg's,
        which freezes the coordinates that matter little, and Marquardt's, which lets them run. Turned up, the point
        stays closer.
        """
        own = self.curvature.diagonal()
        greatest = float(own.max())
        if greatest == 0.0:
            return self.point
        damped = self.curvature + np.diag(damping * np.sqrt(own * greatest) + SMALLEST_DAMPING * greatest)
        # A triangle with the same normal equations: n rows instead of one for each residual.
        triangle = np.linalg.cholesky(damped, upper=True)
        target = triangle @ self.point - np.linalg.solve(triangle.T, self.gradient)
        found = lsq_linear(triangle, target, bounds=(0.0, 1.0), method="bvls", tol=1e-14, max_iter=10 * target.size)
        lowest: np.ndarray[Any, np.dtype[np.float64]] = found.x.clip(0.0, 1.0)  # rounding may step over a bound
        return lowest

    def decrease(self, point: Float64[np.ndarray, " n"]) -> float:
        """How far the model lies below the loss there; a promise the loss itself may not keep."""
        step = point - self.point
        return -float(self.gradient @ step + 0.5 * step @ self.curvature @ step)


def half_square(residuals: Tensor) -> float:
    """Half the sum of squares; infinite where it is not finite.

    >>> half_square(Tensor([3.0, 4.0])), half_square(Tensor([0.0, math.nan]))
    (12.5, inf)
    """
    loss = 0.5 * float(residuals @ residuals)
    return loss if math.isfinite(loss) else math.inf
