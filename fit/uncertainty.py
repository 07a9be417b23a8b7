"""How well a photo determines each searched parameter: standard errors that allow for residuals alike in neighbours.

[1] K.-Y. Liang, S. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73(1), 1986: the
    variance of an estimate from the scatter of the gradient between clusters.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int
from torch import Tensor

PATCHES_PER_TURN = 12  # patches of the sky, 30 degrees across, taken as independent of each other
WIDEST = 0.25  # standard error, as a share of the bounds, from which a parameter counts as not determined
AT_BOUND = 1e-6
# Share of the slopes of a direction's unit step that its parameters' columns cancel to: below it, differences of a
# millionth cannot tell the parameters apart.
COLLINEAR = 1e-5


@dataclass(frozen=True)
class Uncertainty:
    """Of each coordinate of the unit cube."""

    standard_error: Float64[np.ndarray, " n"]  # NaN where not determined
    correlation: Float64[np.ndarray, "n n"]  # of the determined ones; 0 elsewhere, 1 on the diagonal
    why: tuple[str, ...]


def patches(direction: Tensor) -> Int[Tensor, " n"]:
    """Patch of the sky that a direction lies in: squares of the equal-area map of the hemisphere."""
    radius = torch.sqrt(torch.clamp(1.0 - direction[:, 2], min=0.0))
    level = direction[:, :2] / torch.clamp(torch.linalg.vector_norm(direction[:, :2], dim=-1, keepdim=True), min=1e-9)
    square = torch.floor((level * radius[:, None] + 1.5) * PATCHES_PER_TURN / 4.0).long()
    return square[:, 0] * 100 + square[:, 1]


def uncertainty(
    residuals: Tensor, jacobian: Tensor, patch: Int[Tensor, " n"], point: Float64[np.ndarray, " n"]
) -> Uncertainty:
    """Standard errors in the unit cube from residuals and slopes, three of each for every pixel [1].

    Coordinates on a face of the cube, without slope, or with an error beyond WIDEST are not determined; the others'
    errors are those with these held.
    """
    slopes, held = jacobian.numpy(), residuals.numpy()
    groups = patch.repeat_interleave(3).numpy()
    why = ["" for _ in point]
    for index, place in enumerate(point):
        if not np.abs(slopes[:, index]).max() > 0.0:
            why[index] = "without influence on this photo"
        elif place <= AT_BOUND or place >= 1.0 - AT_BOUND:
            why[index] = "at its lower bound" if place < 0.5 else "at its upper bound"
    while True:
        kept = [index for index, reason in enumerate(why) if not reason]
        if kept and (same := _collinear(slopes[:, kept])) is not None:
            why[kept[same]] = "not told apart from others by the photo"
            continue
        error, correlation = _clustered(slopes[:, kept], held, groups)
        if not kept or error.max() <= WIDEST:
            break
        why[kept[int(error.argmax())]] = "not determined by the photo"
    whole_error, whole_correlation = np.full(point.size, np.nan), np.eye(point.size)
    whole_error[kept] = error
    whole_correlation[np.ix_(kept, kept)] = correlation
    return Uncertainty(whole_error, whole_correlation, tuple(why))


def _collinear(slopes: Float64[np.ndarray, "m k"]) -> int | None:
    """Coordinate that does most what others do already; None where all are told apart."""
    unit = slopes / np.linalg.norm(slopes, axis=0)
    _, spread, directions = np.linalg.svd(unit, full_matrices=False)
    return int(np.abs(directions[-1]).argmax()) if spread[-1] < COLLINEAR else None


def _clustered(
    slopes: Float64[np.ndarray, "m k"], residuals: Float64[np.ndarray, " m"], groups: Int[np.ndarray, " m"]
) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, "k k"]]:
    names, group = np.unique(groups, return_inverse=True)
    scores = np.zeros((names.size, slopes.shape[1]))
    np.add.at(scores, group, slopes * residuals[:, None])
    # Few clusters underestimate the scatter by about one in each that the parameters use up.
    spare = max(names.size - slopes.shape[1], 1)
    bread = np.linalg.inv(slopes.T @ slopes)
    covariance = bread @ (scores.T @ scores) @ bread * (names.size / spare)
    error = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    scale = np.where(error > 0.0, error, 1.0)
    return error, covariance / np.outer(scale, scale)
