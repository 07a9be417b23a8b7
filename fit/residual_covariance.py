"""Residuals of a fit that are alike over a distance: how much, over how far, and what that does to an estimate.

Clouds are alike over tens of degrees, and a fit takes away most of what is alike over the whole sky, so that the rest
tells too little of it. So the covariance of the noise is put together from fields of several widths, in brightness and
in two contrasts of colour, and their variances are those whose residuals, after the same fit, have the covariances
seen [1].

[1] C. R. Rao, "Estimation of variance and covariance components: MINQUE theory", Journal of Multivariate Analysis 1,
    1971; with variances held positive by non-negative least squares.
"""

import numpy as np
from jaxtyping import Float64
from scipy.optimize import nnls

# Standard deviations of the fields' Gaussian kernels [rad]; narrower ones act like noise of single pixels. Other widths
# and exponential kernels gave the same coverage.
WIDTHS = tuple(np.radians((6.0, 20.0, 60.0)))
PIXELS = 400  # at most; 250 and 650 gave the same coverage
PAIRED = 4000  # pixels at most, each of which is compared with each: 16 000 took 4 GB
# Brightness, red to blue and green to magenta, orthonormal: fields in one say nothing of the others.
CONTRASTS = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [1.0, -2.0, 1.0]]) / np.sqrt([[3.0], [2.0], [6.0]])
SMALLEST = 1e-6  # share of the slopes below which a direction is none


def score_covariance(
    direction: Float64[np.ndarray, "n 3"],
    residuals: Float64[np.ndarray, "n 3"],
    slopes: Float64[np.ndarray, "n 3 k"],
    wide_weight: float,
) -> Float64[np.ndarray, "k k"]:
    """Covariance of the sum of slopes times noise, from the residuals that a fit has left of the noise.

    The fit has taken a gain from each channel, and what looks like its slopes. Fields wider than a pixel count by a
    weight: where they are a model's errors and not nature's chance, parameters have hidden most of them.
    """
    count = len(direction)
    some = np.linspace(0, count - 1, min(count, PIXELS)).astype(int)
    seen = np.einsum("ck,nkp->cnp", CONTRASTS, slopes[some])
    left = np.einsum("ck,nk->cn", CONTRASTS, residuals[some])
    kernels = _kernels(direction[some])
    variances = _variances(left, _fitted(seen), kernels)
    # Noise of single pixels averages out over all of them, wider fields only over themselves.
    repeats = np.array([count / len(some), *[wide_weight * (count / len(some)) ** 2 for _ in WIDTHS]])
    total = np.zeros((slopes.shape[2],) * 2)
    for own, variance in zip(seen, variances, strict=True):
        total += own.T @ np.tensordot(variance * repeats, kernels, 1) @ own
    return total


def excess(direction: Float64[np.ndarray, "n 3"], residuals: Float64[np.ndarray, "n 3"]) -> float:
    """How much more alike residuals near each other are than noise of single pixels, in its standard deviations.

    The largest of the three contrasts', for the narrowest field; noise may be stronger in some pixels than in others.
    """
    some = np.linspace(0, len(direction) - 1, min(len(direction), PAIRED)).astype(int)
    direction, residuals = direction[some], residuals[some]
    near = np.exp(-0.5 * np.maximum(2.0 - 2.0 * direction @ direction.T, 0.0) / WIDTHS[0] ** 2)
    np.fill_diagonal(near, 0.0)
    seen = residuals @ CONTRASTS.T
    seen = seen - seen.mean(0)
    alike = np.einsum("nc,nc->c", seen, near @ seen)
    chance = np.sqrt(2.0 * np.einsum("nc,nc->c", seen**2, np.square(near, out=near) @ seen**2))
    return float((alike / np.where(chance > 0.0, chance, 1.0)).max())


def _kernels(direction: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "f n n"]:
    """Correlation between pixels of each kind of field, single pixels first."""
    chord_square = np.maximum(2.0 - 2.0 * direction @ direction.T, 0.0)
    wide = [np.exp(-0.5 * chord_square / width**2) for width in WIDTHS]
    return np.stack([np.eye(len(direction)), *wide])


def _fitted(slopes: Float64[np.ndarray, "3 n k"]) -> Float64[np.ndarray, "3 n q"]:
    """Orthonormal basis of all that the fit takes away: slopes, and a gain in each contrast."""
    contrasts, count, _ = slopes.shape
    gains = np.repeat(np.eye(contrasts)[:, None], count, 1)
    whole = np.concatenate([slopes, gains], 2).reshape(contrasts * count, -1)
    length = np.linalg.norm(whole, axis=0)
    basis, spread, _ = np.linalg.svd(whole[:, length > 0.0] / length[length > 0.0], full_matrices=False)
    return basis[:, spread > SMALLEST * spread[0]].reshape(contrasts, count, -1)


def _variances(
    left: Float64[np.ndarray, "3 n"], fitted: Float64[np.ndarray, "3 n q"], kernels: Float64[np.ndarray, "f n n"]
) -> Float64[np.ndarray, "3 f"]:
    """Variance of each field in each contrast: least squares between the residuals' products and their expectation.

    With M what the fit leaves of noise and K_i the fields, the normal equations are
    sum_j trace(M K_i M K_j) variance_j = residuals' M K_i M residuals.
    """
    contrasts, fields = len(left), len(kernels)
    left = left - np.einsum("cnq,q->cn", fitted, np.einsum("cnq,cn->q", fitted, left))
    spread = kernels[None] @ fitted[:, None]
    within = np.einsum("cnq,cfnr->cfqr", fitted, spread, optimize=True).reshape(contrasts * fields, -1)
    flat = kernels.reshape(fields, -1)
    traces = within @ within.T
    for contrast in range(contrasts):
        own = slice(contrast * fields, (contrast + 1) * fields)
        taken = spread[contrast].reshape(fields, -1)
        traces[own, own] += flat @ flat.T - 2.0 * taken @ taken.T
    products = np.einsum("cn,fnm,cm->cf", left, kernels, left, optimize=True).ravel()
    scale = 1.0 / np.sqrt(traces.diagonal())
    values, axes = np.linalg.eigh(scale[:, None] * traces * scale)
    # A square root of the normal equations, so that non-negative least squares may solve them.
    root = np.sqrt(np.maximum(values, SMALLEST * values[-1]))
    found, _ = nnls(root[:, None] * axes.T, (axes.T @ (scale * products)) / root)
    variances: Float64[np.ndarray, "3 f"] = (scale * found).reshape(contrasts, fields)
    return variances
