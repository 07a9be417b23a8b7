"""How well a photo determines settings of anti-aliasing: from how much parts of its tiles disagree."""

import numpy as np
import torch
from jaxtyping import Float64

from fit.minimum import Point
from fit.sampled_photo import MARGIN, TILE
from fit.sharpening_objective import SharpeningObjective
from fit.uncertainty import NEAR_BOUND, Uncertainty, of_covariance, reasons, unexplained

BLOCK = 8  # side of a part [pixels]: errors of anti-aliasing are alike over few


def uncertainty(objective: SharpeningObjective, point: Point) -> Uncertainty:
    """Standard errors in the unit cube: a sandwich with blocks of pixels as clusters [1].

    Neighbouring pixels err alike; blocks are taken for independent of each other. Coordinates on a face of the cube,
    without slope or with an error beyond WIDEST are not determined. Errors tell how another part of a scene like this
    one would differ, sampled in the same way, and nothing of other scenes.

    [1] K.-Y. Liang, S. L. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73, 1986.
    """
    residuals, slopes = (one.numpy() for one in objective.jacobian(torch.from_numpy(point)))
    why = reasons(slopes, point, NEAR_BOUND)
    free = unexplained(why)
    return of_covariance(why, _between_blocks(residuals, slopes[:, free]) if free else np.zeros((0, 0)))


def _between_blocks(
    residuals: Float64[np.ndarray, " m"], slopes: Float64[np.ndarray, "m k"]
) -> Float64[np.ndarray, "k k"]:
    bread = np.linalg.inv(slopes.T @ slopes)
    count = (TILE - 2 * MARGIN) // BLOCK
    pulls = (residuals[:, None] * slopes).reshape(-1, count, BLOCK, count, BLOCK, 3, slopes.shape[1])
    score = pulls.sum((2, 4, 5)).reshape(-1, slopes.shape[1])
    few = len(score) / (len(score) - 1)
    covariance: Float64[np.ndarray, "k k"] = few * bread @ score.T @ score @ bread
    return covariance
