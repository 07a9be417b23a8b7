"""What a fit of wetness makes small: relative differences between a wet picture and the dry one made wet.

The dry picture's light is multiplied by the share of colour that soaked ground keeps, and one light by channel is added
to all of it: what smoother ground reflects of the sky, which is solved for in closed form.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.func import jvp, vmap

from diffrender.shading.soaked_ground import wet_albedo
from diffrender.shading.wetness import kept
from fit.fog_objective import PRIOR_WEIGHT, robust
from fit.gauss_newton import half_square
from fit.minimum import Point
from fit.search_space import SearchSpace
from fit.uncertainty import NEAR_BOUND, Uncertainty, of_covariance, reasons, unexplained

FLOOR = 1e-2  # of the median radiance, which differences are relative to at least
STRIPS = 6  # of a picture, each of as many parts: neighbouring pixels err alike, parts are taken for independent
PALEST = 0.95  # albedo of the brightest ground that is tried
STEP = 1e-6  # of differences that stand for slopes, of the cube
SCALES = 40  # albedos of the brightest ground that are tried, down to a hundredth of that


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pixels that are seen twice, and in which part of the picture each lies."""

    dry: Float[Tensor, "n 3"]
    wet: Float[Tensor, "n 3"]
    part: Int[Tensor, " n"]

    def some(self, chosen: Bool[Tensor, " n"]) -> "Pairs":
        """Some of the pixels."""
        return Pairs(self.dry[chosen], self.wet[chosen], self.part[chosen])


@dataclass(frozen=True, eq=False)
class WetObjective:
    """Residuals over pixels that got wet; those that stayed dry tell how the light has changed.

    Without any that stayed dry the light is taken to be the same.
    """

    space: SearchSpace
    wet: Pairs
    dry: Pairs | None

    @cached_property
    def light(self) -> Float[Tensor, "3"]:
        """Light of the wet picture over that of the dry one, by channel: the median of what stayed dry."""
        if self.dry is None:
            return torch.ones_like(self.wet.dry[0])
        found: Tensor = (self.dry.wet / self.dry.dry).median(0).values
        return found

    def residuals(self, point: Float[Tensor, " n"]) -> Float[Tensor, " m"]:
        """Robust relative differences, three for each pixel, then distances from the start."""
        begun = torch.from_numpy(self.space.point(self.space.start)).to(point)
        drawn, _ = self.picture(point)
        return torch.cat([robust((drawn - self.wet.wet) / self._scale), PRIOR_WEIGHT * (point - begun)])

    def jacobian(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, " m"], Float[Tensor, "m n"]]:
        """Residuals and their exact derivatives by each coordinate, in forward mode."""
        slopes = vmap(lambda along: jvp(self.residuals, (point,), (along,))[1])(torch.eye(point.numel()).to(point))
        return self.residuals(point), slopes.T

    def picture(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "3"]]:
        """The dry pixels made wet, and what was added to all of them."""
        lit = self.share(point) * self.light * self.wet.dry
        added = self._added(lit)
        return lit + added, added

    def share(self, point: Float[Tensor, " n"]) -> Float[Tensor, ""]:
        """Share of the colour that porous ground keeps at a point."""
        wetness = self.space.scene(point).wetness
        assert wetness is not None  # a search space of wetness has one
        return kept(wetness, torch.ones_like(wetness.amount), wetness.amount)

    def by_optics(self) -> dict[str, float]:
        """How well Lekner and Dorf's darkening of every albedo explains it: error, share under water, brightest albedo.

        Of several albedos of the brightest ground the best; pale ground loses less, so that it shows in the contrast.
        """
        lit = self.light * self.wet.dry
        brightest = float(torch.quantile(lit.mean(-1), 0.99))
        tried = []
        for palest in PALEST * np.geomspace(1e-2, 1.0, SCALES):
            albedo = (lit * float(palest / brightest)).clamp(max=PALEST)
            lost = lit * (1.0 - wet_albedo(albedo) / albedo.clamp(min=1e-9))
            covered = self._covered(lit, lost)
            drawn = lit - covered * lost
            drawn = drawn + self._added(drawn)
            error = half_square(robust((drawn - self.wet.wet) / self._scale))
            tried.append((error, float(covered), float(palest)))
        error, covered_share, palest = min(tried)
        return {"mean square": 2.0 * error, "share under water": covered_share, "brightest albedo": palest}

    def _covered(self, lit: Tensor, lost: Tensor) -> Tensor:
        """Share under water by least squares, beside one light that is added by channel."""
        one = torch.ones_like(lit) / self._scale
        length = one.square().sum(0)

        def beside(column: Tensor) -> Tensor:
            return column - one * ((column * one).sum(0) / length)

        towards, left = beside(lost / self._scale), beside((lit - self.wet.wet) / self._scale)
        return ((towards * left).sum() / towards.square().sum()).clamp(0.0, 1.0)

    def _added(self, lit: Tensor) -> Tensor:
        """What is added by channel, from 0 up, in closed form."""
        weight = self._scale**-2
        return torch.relu((weight * (self.wet.wet - lit)).sum(0) / weight.sum(0))

    @cached_property
    def _scale(self) -> Tensor:
        """What differences are relative to: not the wet picture, whose noise would favour the dark."""
        lit = self.light * self.wet.dry
        return lit + FLOOR * lit.median(0).values

    def without(self, part: int) -> "WetObjective":
        """The same without a part of the picture."""
        stayed = None if self.dry is None else self.dry.some(self.dry.part != part)
        return replace(self, wet=self.wet.some(self.wet.part != part), dry=stayed)


def parts(line: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Int[Tensor, " n"]:
    """Part of a picture in which each pixel lies: strips of as many pixels each, cut into as many parts."""
    found = np.empty(len(line), np.int64)
    order = np.argsort(line, kind="stable")
    for strip, chosen in enumerate(np.array_split(order, STRIPS)):
        across = chosen[np.argsort(column[chosen], kind="stable")]
        for place, piece in enumerate(np.array_split(across, STRIPS)):
            found[piece] = strip * STRIPS + place
    return torch.from_numpy(found)


def uncertainty(objective: WetObjective, point: Point) -> Uncertainty:
    """Standard errors in the unit cube: how a point moves when one part of the picture after the other is left out [1].

    One Gauss-Newton step for each part; the change of light is taken anew, so that its error is among them. They tell
    how another part of the same ground would differ, and nothing of a model that is wrong for all of it.

    [1] B. Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", SIAM 1982, chapter 3.
    """
    place = torch.from_numpy(point)
    _, slopes = objective.jacobian(place)
    why = reasons(slopes[: objective.wet.wet.numel()].numpy(), point, NEAR_BOUND)
    free = unexplained(why)
    if not free:
        return of_covariance(why, np.zeros((0, 0)))
    moved = np.stack(
        [_moved(objective.without(part), place, free) for part in sorted(set(objective.wet.part.tolist()))]
    )
    away = moved - moved.mean(0)
    return of_covariance(why, (len(moved) - 1) / len(moved) * away.T @ away)


def _moved(objective: WetObjective, place: Tensor, free: list[int]) -> Float[np.ndarray, " f"]:
    residuals = objective.residuals(place)
    # By differences, a tenth of what exact slopes take: there are as many objectives as parts.
    steps = torch.diag(torch.where(place < 0.5, STEP, -STEP).to(place))[free]
    slopes = torch.stack([(objective.residuals(place + one) - residuals) / one.sum() for one in steps], -1)
    step, *_ = np.linalg.lstsq(slopes.numpy(), -residuals.numpy(), rcond=None)
    found: Float[np.ndarray, " f"] = place.numpy()[free] + step
    return found
