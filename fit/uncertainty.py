"""How well a photo determines each searched parameter: standard errors that hold.

Three things keep an estimate from the truth, and their variances are added: noise, which in skies is alike over tens of
degrees [1]; parameters that the fit holds still and nature does not, by their priors; and the prior of the parameter
itself where the photo says little. A standard error is one in the parameter's own scale: about value +- error for most,
value times or over a factor for log parameters. Near a bound the interval ends at the bound.

How often intervals hold the truth is measured by `experiments.coverage`.

[1] W. Newey, K. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance
    matrix", Econometrica 55(3), 1987: the variance of an estimate by least squares under correlated noise.
[2] C. D. Rodgers, "Inverse methods for atmospheric sounding", 2000, section 2.4: the averaging kernel.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from fit import priors
from fit.minimum import Minimum
from fit.objective import PRIOR_WEIGHT, SkyObjective
from fit.residual_covariance import score_covariance

WIDEST = 0.25  # standard error, as a share of the bounds, from which a parameter counts as not determined
LEAST_RESOLUTION = 0.5  # below which the prior has the greater say, and the photo does not determine a parameter
# So near a face of the cube the noise alone may have led there, and slopes say little of what is beyond.
NEAR_BOUND = 1e-2
# Share of the slopes of a direction's unit step that its parameters' columns cancel to: below it, differences of a
# millionth cannot tell the parameters apart.
COLLINEAR = 1e-5
NO_INFLUENCE = "without influence on this photo"
# The noise is known from one photo, a few clouds: Student's t of ten degrees of freedom varies by this much more than a
# normal distribution. Chosen by `experiments.coverage`: without it intervals of 95 % held 92 % of truths, with it 94.
FEW_CLOUDS = 10.0 / 8.0


@dataclass(frozen=True)
class Evidence:
    """What a photo says around a point: three values of each pixel, robust, half their square sum the loss."""

    direction: Float64[np.ndarray, "n 3"]
    residuals: Float64[np.ndarray, "n 3"]
    slopes: Float64[np.ndarray, "n 3 k"]  # by each searched coordinate
    # Change of residuals when what is held takes its prior's centre less and plus one deviation.
    changes: Float64[np.ndarray, "h n 3"]
    spread: Float64[np.ndarray, " k"]  # standard deviations of the searched coordinates' priors
    wide_weight: float = 1.0  # of the variance of noise wider than a pixel


@dataclass(frozen=True)
class Uncertainty:
    """Of each coordinate of the unit cube."""

    standard_error: Float64[np.ndarray, " n"]  # NaN where not determined
    correlation: Float64[np.ndarray, "n n"]  # of the determined ones; 0 elsewhere, 1 on the diagonal
    why: tuple[str, ...]


def evidence(objective: SkyObjective, minimum: Minimum, held: Sequence[str]) -> Evidence:
    """What a photo says around a minimum, and what names that are held may do to it."""
    place = torch.from_numpy(minimum.point)
    residuals, slopes = minimum.derivatives(objective)
    shape = tuple(objective.sample.log_radiance.shape)
    count = objective.sample.log_radiance.numel()
    pixels = slopes[:count].reshape(*shape, minimum.point.size)
    return Evidence(
        direction=objective.sample.direction.numpy(),
        residuals=residuals[:count].reshape(shape).numpy(),
        # Gains in closed form have taken the mean already; what robustness has put back of it would be noise.
        slopes=(pixels - pixels.mean(0)).numpy(),
        changes=objective.changes(place, held).reshape(-1, *shape).numpy(),
        spread=priors.in_unit_cube(objective.space.free).spread,
    )


def uncertainty(evidence: Evidence, point: Float64[np.ndarray, " k"]) -> Uncertainty:
    """Standard errors in the unit cube.

    Coordinates on a face of the cube, without slope, with an error beyond WIDEST or where the prior has the greater say
    are not determined. They stay free in the errors of the others: the face may be the noise's doing.
    """
    why = reasons(evidence.slopes.reshape(-1, point.size), point, NEAR_BOUND)
    parts = covariances(evidence)
    covariance, resolution = parts.noise + parts.held, parts.resolution
    error = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    for index in unexplained(why):
        if error[index] > WIDEST or resolution[index] < LEAST_RESOLUTION:
            why[index] = "not determined by the photo"
    kept = unexplained(why)
    whole_error, whole_correlation = np.full(point.size, np.nan), np.eye(point.size)
    whole_error[kept] = error[kept]
    # Residuals of 0 leave errors of 0, which have no correlation.
    scale = np.where(error > 0.0, error, 1.0)[kept]
    whole_correlation[np.ix_(kept, kept)] = covariance[np.ix_(kept, kept)] / np.outer(scale, scale)
    return Uncertainty(whole_error, whole_correlation, tuple(why))


def reasons(slopes: Float64[np.ndarray, "m k"], point: Float64[np.ndarray, " k"], nearness: float) -> list[str]:
    """Why coordinates are not determined whatever the noise; empty for those that may be.

    A coordinate nearer to a face of the cube than `nearness` is at its bound.
    """
    why = ["" for _ in point]
    for index, place in enumerate(point):
        if not np.abs(slopes[:, index]).max() > 0.0:
            why[index] = NO_INFLUENCE
        elif place <= nearness or place >= 1.0 - nearness:
            why[index] = "at its lower bound" if place < 0.5 else "at its upper bound"
    while (same := _collinear(slopes, kept := unexplained(why))) is not None:
        why[kept[same]] = "not told apart from others by the photo"
    return why


def unexplained(why: list[str]) -> list[int]:
    """Indices of the empty reasons."""
    return [index for index, reason in enumerate(why) if not reason]


def of_covariance(why: list[str], covariance: Float64[np.ndarray, "f f"]) -> Uncertainty:
    """Uncertainty of coordinates whose `unexplained` ones have a covariance in the unit cube.

    Those with an error beyond WIDEST are not determined either.
    """
    free, why = unexplained(why), list(why)
    error, correlation = np.full(len(why), np.nan), np.eye(len(why))
    deviation = np.sqrt(covariance.diagonal())
    for index, spread in zip(free, deviation, strict=True):
        if spread > WIDEST:
            why[index] = "not determined by the photo"
    error[free] = np.where(deviation > WIDEST, np.nan, deviation)
    scale = np.where(deviation > 0.0, deviation, 1.0)
    correlation[np.ix_(free, free)] = covariance / np.outer(scale, scale)
    return Uncertainty(error, correlation, tuple(why))


def _collinear(slopes: Float64[np.ndarray, "m n"], kept: list[int]) -> int | None:
    """Coordinate among some that does most what others do already; None where all are told apart."""
    if not kept:
        return None
    unit = slopes[:, kept] / np.linalg.norm(slopes[:, kept], axis=0)
    _, spread, directions = np.linalg.svd(unit, full_matrices=False)
    return int(np.abs(directions[-1]).argmax()) if spread[-1] < COLLINEAR else None


@dataclass(frozen=True)
class Covariances:
    """Mean square of the distance between estimate and truth in the unit cube, to first order in slopes, by its cause.

    Attributes:
        noise: the photo's own, and the pull of the prior: another photo of the same air has another.
        held: what is held still and not known, which all photos of a day have in common.
        resolution: share of a small change of the truth that the estimate follows, the rest being the prior's [2].
    """

    noise: Float64[np.ndarray, "k k"]
    held: Float64[np.ndarray, "k k"]
    resolution: Float64[np.ndarray, " k"]


def covariances(evidence: Evidence) -> Covariances:
    """Of all searched coordinates, those that the photo does not determine among them."""
    flat = evidence.slopes.reshape(-1, evidence.slopes.shape[2])
    ridge = (PRIOR_WEIGHT / evidence.spread) ** 2
    bread = np.linalg.inv(flat.T @ flat + np.diag(ridge))
    noise = FEW_CLOUDS * score_covariance(evidence.direction, evidence.residuals, evidence.slopes, evidence.wide_weight)
    # Of centre less and plus a deviation, each counts half.
    held = evidence.changes.reshape(len(evidence.changes), flat.shape[0]) @ flat
    own = np.diag((ridge * evidence.spread) ** 2)
    resolution = 1.0 - bread.diagonal() * ridge
    return Covariances(bread @ (noise + own) @ bread, bread @ (0.5 * held.T @ held) @ bread, resolution)
