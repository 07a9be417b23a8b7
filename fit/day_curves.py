"""Curves of parameters over a cyclic day, through what its photos say of them.

Each photo gives a normal distribution over some parameters; between photos a parameter drifts as a random walk round
the day, by so many of its prior's deviations in the root of an hour: a strength for each parameter, chosen by leaving
out one photo after the other and asking how well the others foretell it [1]. A photo far from what the others foretell
counts less, as if its errors had Student's distribution [2]: clouds. All in the unit cube, so log parameters in their
logarithms.

[1] G. Wahba, "Spline models for observational data", 1990, chapter 4: cross-validation of a smoother's strength. A
    random walk's curve is the spline of first differences, which a gap makes no bolder than a straight line.
[2] K. Lange, R. Little, J. Taylor, "Robust statistical modeling using the t distribution", Journal of the American
    Statistical Association 84, 1989, section 3: the weights.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from diffrender.weather.timeline import DAY

CLOSEST = 0.5  # hours between nodes of a curve; photos between them speak for both
# Drift in deviations of the prior per root of an hour: from a constant to as good as nothing in common.
STRENGTHS = tuple(float(f"{10.0**power:.3g}") for power in np.linspace(-3.0, 1.0, 13))
ROUNDS = 2  # in which each parameter's strength is chosen, given those of the others
FREEDOM = 4.0  # of Student's distribution [2]
SETTLED, MOST_WEIGHINGS = 1e-3, 30
WIDE = 1e-2  # information, in the unit cube, where there is no other
# Less than this share of the bounds no photo tells apart: the fit's own tolerance.
LEAST_DEVIATION = 1e-4

Strengths = Float64[np.ndarray, " k"]


@dataclass(frozen=True)
class Observation:
    """What a photo says at an hour: a normal distribution over some of the names."""

    hour: float
    names: tuple[str, ...]
    point: Float64[np.ndarray, " n"]
    covariance: Float64[np.ndarray, "n n"]


@dataclass(frozen=True)
class Curves:
    """Parameters over the day.

    Attributes:
        names: of the parameters.
        hours: of the nodes, rising.
        values: of each name at each node, in the unit cube; straight lines between.
        covariance: of all values, name after name, lack of fit allowed for.
        weights: of each photo, 1 for one that is as foretold or nearer; 0 for one that had no say.
        distances: of each photo from what the others foretell, in standard deviations; NaN without names of its own.
        foretold: what the others foretell of the names that each photo speaks of.
        strengths: of each name's drift, in deviations of its prior per root of an hour.
        scores: of each common strength tried, mean of minus log of the density at a photo that was left out.
        score: the same for the chosen strengths.
        scale: root of the variance of distances that is more than foretold; 1 or more.
    """

    names: tuple[str, ...]
    hours: tuple[float, ...]
    values: Float64[np.ndarray, "k t"]
    covariance: Float64[np.ndarray, "k*t k*t"]
    weights: Float64[np.ndarray, " p"]
    distances: Float64[np.ndarray, " p"]
    foretold: tuple[Mapping[str, float], ...]
    strengths: Mapping[str, float]
    scores: Mapping[float, float]
    score: float
    scale: float

    @property
    def errors(self) -> Float64[np.ndarray, "k t"]:
        """Standard errors of the values."""
        errors: Float64[np.ndarray, "k t"] = np.sqrt(self.covariance.diagonal()).reshape(self.values.shape)
        return errors

    def at(self, hour: float) -> Float64[np.ndarray, " k"]:
        """Values at an hour."""
        values: Float64[np.ndarray, " k"] = self.values @ _between(self.hours, hour)
        return values


def nodes(hours: Sequence[float]) -> tuple[float, ...]:
    """Hours of photos, without those that come sooner than half an hour after another."""
    kept: list[float] = []
    for hour in sorted(hours):
        if not kept or (hour - kept[-1] >= CLOSEST and hour - kept[0] <= DAY - CLOSEST):
            kept.append(hour)
    return tuple(kept)


def curves(observations: Sequence[Observation], spread: Mapping[str, float], silent: Sequence[int] = ()) -> Curves:
    """Curves of all names that have a spread, each named by one observation at least.

    Args:
        observations: of the photos.
        spread: deviation of each parameter's prior, as a share of its bounds.
        silent: indices of observations that are only judged.
    """
    day = _Day.of(observations, spread, silent)
    tried, before = {}, None
    for strength in STRENGTHS:
        tried[strength] = before = day.smoothed(np.full(len(day.names), strength), before)
    best = min(STRENGTHS, key=lambda strength: tried[strength].score)
    steps, last = _chosen(day, STRENGTHS.index(best), tried[best])
    shape = len(day.names), len(day.hours)
    return Curves(
        names=day.names,
        hours=day.hours,
        values=np.clip(last.mean.reshape(shape), 0.0, 1.0),
        covariance=last.scale**2 * last.covariance,
        weights=last.weights,
        distances=last.distances,
        foretold=tuple(
            dict(zip(one.names, map(float, expected), strict=True))
            for one, expected in zip(day.seen, last.foretold, strict=True)
        ),
        strengths={name: STRENGTHS[step] for name, step in zip(day.names, steps, strict=True)},
        scores={strength: one.score for strength, one in tried.items()},
        score=last.score,
        scale=last.scale,
    )


@dataclass(frozen=True)
class _Smoothed:
    mean: Float64[np.ndarray, " m"]
    covariance: Float64[np.ndarray, "m m"]
    weights: Float64[np.ndarray, " p"]
    distances: Float64[np.ndarray, " p"]
    foretold: tuple[Float64[np.ndarray, "..."], ...]
    score: float
    scale: float


def _chosen(day: "_Day", start: int, last: _Smoothed) -> tuple[list[int], _Smoothed]:
    """Step among the strengths of each name, one name after the other moved as long as that foretells better."""
    steps = [start] * len(day.names)
    for _ in range(ROUNDS if len(day.heard) > 2 else 0):
        for index, way in itertools.product(range(len(steps)), (-1, 1)):
            while 0 <= steps[index] + way < len(STRENGTHS):
                moved = [step + way * (place == index) for place, step in enumerate(steps)]
                found = day.smoothed(np.array([STRENGTHS[step] for step in moved]), last)
                if not found.score < last.score:
                    break
                steps, last = moved, found
    return steps, last


@dataclass(frozen=True)
class _Seen:
    """What a photo sees of the values of every name at every node: shares of a few of them."""

    names: tuple[str, ...]
    columns: Int64[np.ndarray, " c"]
    shares: Float64[np.ndarray, "n c"]
    point: Float64[np.ndarray, " n"]
    covariance: Float64[np.ndarray, "n n"]

    @classmethod
    def of(cls, one: Observation, names: Sequence[str], hours: Sequence[float]) -> "_Seen":
        kept = [index for index, name in enumerate(one.names) if name in names]
        rows = np.zeros((len(kept), len(names), len(hours)))
        for row, index in enumerate(kept):
            rows[row, names.index(one.names[index])] = _between(hours, one.hour)
        flat = rows.reshape(len(kept), len(names) * len(hours))
        columns = np.flatnonzero(flat.any(0))
        own = one.covariance[np.ix_(kept, kept)] + LEAST_DEVIATION**2 * np.eye(len(kept))
        return cls(tuple(one.names[index] for index in kept), columns, flat[:, columns], one.point[kept], own)


@dataclass(frozen=True)
class _Day:
    """All observations as one linear problem over the values of every name at every node, name after name."""

    names: tuple[str, ...]
    hours: tuple[float, ...]
    spread: Float64[np.ndarray, " k"]
    seen: tuple[_Seen, ...]
    heard: tuple[int, ...]  # photos that have a say

    @classmethod
    def of(cls, observations: Sequence[Observation], spread: Mapping[str, float], silent: Sequence[int]) -> "_Day":
        names = tuple(spread)
        hours = nodes([one.hour for one in observations])
        seen = tuple(_Seen.of(one, names, hours) for one in observations)
        heard = tuple(index for index, one in enumerate(seen) if one.point.size and index not in silent)
        return cls(names, hours, np.array(list(spread.values())), seen, heard)

    def smoothed(self, strengths: Strengths, like: _Smoothed | None = None) -> _Smoothed:
        """Curves of some strengths, the photos weighed, from weights like others, until those no longer change."""
        drift, heard = self._drift(strengths), list(self.heard)
        sizes = np.array([max(one.point.size, 1) for one in self.seen])
        has_say = np.zeros(len(self.seen))
        has_say[heard] = 1.0
        weights = has_say if like is None else like.weights
        for _ in range(MOST_WEIGHINGS):
            mean, covariance = self._posterior(drift, weights)
            squares, scores, foretold = self._left_out(mean, covariance, weights)
            scale = _scale(squares[heard], sizes[heard])
            now = has_say * np.minimum((FREEDOM + sizes) / (FREEDOM + squares / scale**2), 1.0)
            weights, change = now, float(np.abs(now - weights).max())
            if change < SETTLED:
                break
        distances = np.where([one.point.size > 0 for one in self.seen], np.sqrt(squares / sizes), np.nan)
        return _Smoothed(mean, covariance, weights, distances, foretold, float(np.mean(scores[heard])), scale)

    def _drift(self, strengths: Strengths) -> Float64[np.ndarray, "m m"]:
        """Information of the random walk round the day."""
        count = len(self.hours)
        walk = np.zeros((count, count))
        if count > 1:
            for index in range(count):
                after = (index + 1) % count
                step = np.zeros(count)
                step[index], step[after] = step[index] - 1.0, step[after] + 1.0
                walk += np.outer(step, step) / ((self.hours[after] - self.hours[index]) % DAY or DAY)
        return np.kron(np.diag((strengths * self.spread) ** -2.0), walk)

    def _posterior(
        self, drift: Float64[np.ndarray, "m m"], weights: Float64[np.ndarray, " p"]
    ) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, "m m"]]:
        # No name is without an end, even one of which photos hardly speak: a prior as wide as all bounds together.
        information, pull = drift + WIDE * np.eye(len(drift)), np.full(len(drift), 0.5 * WIDE)
        for index in self.heard:
            one = self.seen[index]
            said = weights[index] * np.linalg.solve(one.covariance, one.shares)
            information[np.ix_(one.columns, one.columns)] += one.shares.T @ said
            pull[one.columns] += one.point @ said
        covariance = np.linalg.inv(information)
        covariance = 0.5 * (covariance + covariance.T)
        return covariance @ pull, covariance

    def _left_out(
        self,
        mean: Float64[np.ndarray, " m"],
        covariance: Float64[np.ndarray, "m m"],
        weights: Float64[np.ndarray, " p"],
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, " p"], tuple[Float64[np.ndarray, "..."], ...]]:
        """Of each photo: squared distance from what the others foretell, minus log of Student's density there, that."""
        squares, scores = np.zeros(len(self.seen)), np.zeros(len(self.seen))
        foretold = [one.point for one in self.seen]
        for index, one in enumerate(self.seen):
            if not one.point.size:
                continue
            here = one.shares @ covariance[np.ix_(one.columns, one.columns)] @ one.shares.T
            expected = one.shares @ mean[one.columns]
            if weights[index] > 0.0:
                # Take the photo's own part out again: of a normal distribution by another of the same values.
                gain = here @ np.linalg.inv(here - one.covariance / weights[index])
                expected = expected - gain @ (expected - one.point)
                here = here - gain @ here
            foretold[index] = expected
            wanted = one.point - expected
            whole = 0.5 * (here + here.T) + one.covariance
            squares[index] = max(float(wanted @ np.linalg.solve(whole, wanted)), 0.0)
            density = (FREEDOM + wanted.size) * math.log1p(squares[index] / FREEDOM)
            scores[index] = 0.5 * (np.linalg.slogdet(whole)[1] + density)
        return squares, scores, tuple(foretold)


def _scale(squares: Float64[np.ndarray, " p"], sizes: Float64[np.ndarray, " p"]) -> float:
    """By how much distances are larger than foretold, from their median, which clouds do not move; at least 1."""
    return math.sqrt(max(float(np.median(squares / sizes)), 1.0))


def _between(hours: Sequence[float], hour: float) -> Float64[np.ndarray, " t"]:
    """Share of each node in a value at an hour of the cyclic day."""
    shares = np.zeros(len(hours))
    after = int(np.searchsorted(hours, hour, side="left")) % len(hours)
    before = (after - 1) % len(hours)
    gap = (hours[after] - hours[before]) % DAY
    share = 1.0 if hours[after] == hour or gap == 0.0 else ((hour - hours[before]) % DAY) / gap
    shares[before] += 1.0 - share
    shares[after] += share
    return shares


def spoken_of(observations: Sequence[Observation], least: int) -> list[str]:
    """Names that at least so many observations speak of, in order of their first mention."""
    every = list(dict.fromkeys(name for one in observations for name in one.names))
    counts: Bool[np.ndarray, "n p"] = np.array([[name in one.names for one in observations] for name in every])
    return [name for name, row in zip(every, counts, strict=True) if row.sum() >= least]
