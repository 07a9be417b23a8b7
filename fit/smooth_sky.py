"""A smooth sky under the part that is sure, by which other parts are recognised or not.

The logarithm of what is seen is a polynomial of second order in the direction and, where a sun is seen, two terms that
rise towards it. That is far from any atmosphere, but a wall, a mountain or a cloud is farther off: in thirty panoramas
what shines through trees lies within a tenth, and almost nothing else within half.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

NEAREST = 0.1  # least tolerance, of logarithms: textures of a clear sky
SPREAD = 3.0  # tolerance in standard deviations of what is left over where sky is sure
ROUNDS = 4  # of fits, each without what the one before is far from
RIDGE = 1e-3  # of the mean curvature: what is sure may be a small part of the sphere
GLOW_WIDTH, GLOW_DECAY = 0.05, 3.0  # of the two terms, in the chord to the sun
SCATTER = 1.4826  # standard deviation of a bell over its median distance from the middle


@dataclass(frozen=True, eq=False)
class SmoothSky:
    """How far from a smooth sky cells are, and how far they may be; one column for each quantity."""

    apart: Float[np.ndarray, "n columns"]
    tolerance: Float[np.ndarray, " columns"]

    def looks_like_sky(self, cells: Bool[np.ndarray, " n"]) -> bool:
        """Whether the median of some cells is near the smooth sky in every quantity."""
        return bool((np.abs(np.median(self.apart[cells], 0)) < self.tolerance).all())


def smooth_sky(
    direction: Float[np.ndarray, "n 3"],
    seen: Float[np.ndarray, "n columns"],
    is_sure: Bool[np.ndarray, " n"],
    to_sun: Float[np.ndarray, "3"] | None,
) -> SmoothSky:
    """Smooth sky through the cells that are sure to be sky, each quantity for itself.

    Args:
        direction: of each cell.
        seen: logarithms of what each cell shows.
        is_sure: which cells are sky.
        to_sun: of a sun that is seen.
    """
    terms = _terms(direction, to_sun)
    found = [_apart(terms, column, is_sure) for column in seen.T]
    return SmoothSky(np.stack([apart for apart, _ in found], -1), np.array([tolerance for _, tolerance in found]))


def _terms(direction: Float[np.ndarray, "n 3"], to_sun: Float[np.ndarray, "3"] | None) -> Float[np.ndarray, "n terms"]:
    x, y, z = direction.T
    terms = [np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, z * z]
    if to_sun is not None:
        chord = np.linalg.norm(direction - to_sun, axis=-1)
        terms += [np.log(chord + GLOW_WIDTH), np.exp(-GLOW_DECAY * chord)]
    return np.stack(terms, -1)


def _apart(
    terms: Float[np.ndarray, "n terms"], seen: Float[np.ndarray, " n"], is_sure: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], float]:
    chosen = is_sure
    for _ in range(ROUNDS):
        middle = seen[chosen].mean()
        curvature = terms[chosen].T @ terms[chosen]
        ridge = RIDGE * np.trace(curvature) / len(curvature) * np.eye(len(curvature))
        apart = seen - middle - terms @ np.linalg.solve(curvature + ridge, terms[chosen].T @ (seen[chosen] - middle))
        tolerance = max(NEAREST, SPREAD * SCATTER * float(np.median(np.abs(apart[chosen]))))
        chosen = is_sure & (np.abs(apart) < tolerance)
    return apart, tolerance
