"""FXAA: finds edges in a finished picture, how far off their ends are, and blends across them by that [1].

Version 3.11, "quality". A pixel whose contrast with its four neighbours is below a threshold stays as it is. Of others
the edge is horizontal or vertical, and lies on the side with the steeper step; a search along it, in growing steps,
finds where the step ends on both sides. Nearer the end, the pixel takes up to half of its neighbour across the edge;
lone pixels and thin lines are blended by their difference from the mean around. Pictures are what a screen is sent
(sRGB or PQ); of radiance the thresholds would see nothing in the dark.

Departs from the shader in one point: comparisons of edges allow a thousandth. In the brightest or darkest pixel of a
neighbourhood both directions are often exactly as strong, and where a tap between pixels meets the end of an edge of
two colours, it leaves their mean by exactly the threshold; without that, rounding would decide.

The soft version weighs all four sides of a pixel and every length of the search by logistic functions of what the hard
one compares; their width is the softness, in brightness. As it goes to 0, the picture becomes the hard one's, but for
exact ties.

Gradient: of the picture and the subpixel blend, exact where the decisions stay as they are; the threshold test, the
direction and side of the edge, and the length of the search are not differentiated, so the thresholds have gradient 0.
The soft one differentiates all.

[1] T. Lottes, "FXAA", NVIDIA white paper, 2009, and the shader FXAA 3.11, 2011.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.antialiasing import footage
from diffrender.antialiasing.edges import (
    PRESETS,
    At,
    Search,
    Surroundings,
    contrasts,
    edge_strengths,
    encoded_luma,
    neighbours,
    subpixel_share,
)
from diffrender.antialiasing.settings import PREFIX, AntiAliasing
from diffrender.effect import Effect, Rung

TIE = 0.999  # what is as large but for rounding
SEARCH_END = 0.25 * TIE  # share of the edge's step by which a tap must leave its mean
SOFTNESS = 0.01  # of the rung "soft"


def filtered(
    settings: AntiAliasing,
    picture: Float[Tensor, "*batch height width channels"],
    luma: Float[Tensor, "*batch height width"],
    search: Search,
) -> Float[Tensor, "*batch height width channels"]:
    """Picture whose edges are smoothed where its brightness says, in any channels; the module tells how."""
    around = Surroundings.of(luma, search)
    contrast, least = contrasts(settings, around)
    is_edge = (contrast >= least) & (contrast > 0.0)
    horizontal, vertical = edge_strengths(around)
    is_horizontal = horizontal >= TIE * vertical
    first = torch.where(is_horizontal, around.at(-1, 0), around.at(0, -1)) - luma
    second = torch.where(is_horizontal, around.at(1, 0), around.at(0, 1)) - luma
    is_first = first.abs() >= second.abs()
    step = torch.where(is_first, first, second)
    edge = Edge(is_horizontal, is_first)

    (before, end_before), (after, end_after) = (_end(around, edge, step, search, way) for way in (-1, 1))
    is_before = before < after
    nearer = torch.where(is_before, before, after)
    # Where the pixel lies on the side that goes on beyond the nearer end, the edge is the other row's to smooth.
    is_ours = (torch.where(is_before, end_before, end_after) < 0.0) != (step > 0.0)
    along_edge = torch.where(is_ours, 0.5 - nearer / (before + after), torch.zeros_like(nearer))
    share = torch.maximum(along_edge, subpixel_share(settings, around, contrast))
    share = torch.where(is_edge, share, torch.zeros_like(share))[..., None]

    beyond = Edge(is_horizontal[..., None], is_first[..., None]).towards(neighbours(picture, search.address), 1, 0)
    return picture + share * (beyond - picture)


@dataclass(frozen=True)
class Edge:
    """Which way the edge of every pixel runs, and whether it is on the upper or left side."""

    is_horizontal: Bool[Tensor, "*batch"]
    is_first: Bool[Tensor, "*batch"]

    def towards(self, at: At, across: float | int, along: float | int) -> Tensor:
        """Value at a step across the edge, away from the pixel, and a step along it, right or down."""
        horizontal = torch.where(self.is_first, at(-across, along), at(across, along))
        vertical = torch.where(self.is_first, at(along, -across), at(along, across))
        return torch.where(self.is_horizontal, horizontal, vertical)


def _end(
    around: Surroundings, edge: Edge, step: Float[Tensor, "*batch"], search: Search, way: int
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Distance to the end of an edge [pixels], and by how much the last tap leaves the mean of both sides."""
    mean = around.at(0, 0) + step / 2
    distance = torch.full_like(mean, search.steps[0])
    leaving, is_open = torch.zeros_like(mean), torch.ones_like(mean, dtype=torch.bool)
    for tested, longer in zip(search.tested, search.steps[1:], strict=True):
        leaving = torch.where(is_open, edge.towards(around.at, 0.5, way * tested) - mean, leaving)
        is_open = is_open & (leaving.abs() < SEARCH_END * step.abs())
        distance = torch.where(is_open, distance + longer, distance)
    return distance, leaving


def softly_filtered(
    settings: AntiAliasing,
    picture: Float[Tensor, "*batch height width channels"],
    luma: Float[Tensor, "*batch height width"],
    search: Search,
    *,
    softness: float,
) -> Float[Tensor, "*batch height width channels"]:
    """Picture as `filtered`, with every decision replaced by a weight that changes over a softness of brightness."""
    around = Surroundings.of(luma, search)
    contrast, least = contrasts(settings, around)
    horizontal, vertical = edge_strengths(around)
    is_horizontal = torch.sigmoid((horizontal - vertical) / softness)
    subpixel = subpixel_share(settings, around, contrast)
    beside = neighbours(picture, search.address)

    change = torch.zeros_like(picture)
    for along, weight in ((True, is_horizontal), (False, 1 - is_horizontal)):
        sides = [Side(-1, along), Side(1, along)]
        first, second = (around.at(*side.neighbour) - luma for side in sides)
        is_first = torch.sigmoid((first.abs() - second.abs()) / softness)
        for side, step, chosen in zip(sides, (first, second), (is_first, 1 - is_first), strict=True):
            share = _soft_share(around, side, step, search, softness)
            share = torch.lerp(subpixel, share, torch.sigmoid((share - subpixel) / softness))
            change = change + (weight * chosen * share)[..., None] * (beside(*side.neighbour) - picture)
    is_edge = torch.sigmoid((contrast - least) / softness)
    return picture + is_edge[..., None] * change


@dataclass(frozen=True)
class Side:
    """One of the four sides of a pixel: the upper or left one is -1, the lower or right one 1."""

    sign: int
    is_horizontal: bool  # the edge

    @property
    def neighbour(self) -> tuple[float, float]:
        """Step to the pixel beyond."""
        return self.place(1.0, 0.0)

    def place(self, across: float, along: float) -> tuple[float, float]:
        """Step down and right to a place across the edge and along it."""
        return (self.sign * across, along) if self.is_horizontal else (along, self.sign * across)


def _soft_share(
    around: Surroundings, side: Side, step: Float[Tensor, "*batch"], search: Search, softness: float
) -> Float[Tensor, "*batch"]:
    """Share of the neighbour by where the edge on one side ends."""
    mean = around.at(0, 0) + step / 2
    ends = []
    for way in (-1, 1):
        taps = [around.at(*side.place(0.5, way * tested)) - mean for tested in search.tested]
        ends.append(_soft_end(taps, SEARCH_END * step.abs(), search, softness))
    (before, end_before), (after, end_after) = ends
    both = before + after
    is_before = torch.sigmoid((after - before) / (both * softness))
    nearer, leaving = torch.lerp(after, before, is_before), torch.lerp(end_after, end_before, is_before)
    is_ours = torch.sigmoid(leaving * step / (2 * softness * softness))
    return is_ours * (0.5 - nearer / both)


def _soft_end(
    taps: Sequence[Float[Tensor, "*batch"]], least: Float[Tensor, "*batch"], search: Search, softness: float
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Distance to the end of an edge [pixels] and the tap there, means over where the search may stop."""
    distance, end = torch.full_like(least, search.steps[0]), torch.zeros_like(least)
    is_open = torch.ones_like(least)
    for tap, longer in zip(taps, search.steps[1:], strict=True):
        still_open = is_open * torch.sigmoid((least - tap.abs()) / softness)
        end = end + (is_open - still_open) * tap
        distance = distance + still_open * longer
        is_open = still_open
    return distance, end + is_open * taps[-1]


def preset(settings: AntiAliasing, picture: Float[Tensor, "*batch height width 3"], *, quality: int) -> Tensor:
    """Picture smoothed with one of the shader's qualities."""
    return filtered(settings, picture, encoded_luma(picture), Search(PRESETS[quality]))


def soft(settings: AntiAliasing, picture: Float[Tensor, "*batch height width 3"]) -> Tensor:
    """Picture smoothed with the shader's default quality, 12, whose decisions are weights."""
    return softly_filtered(settings, picture, encoded_luma(picture), Search(PRESETS[12]), softness=SOFTNESS)


def render(settings: AntiAliasing, picture: Float[Tensor, "*batch height width 3"]) -> Tensor:
    """Picture smoothed with the shader's best quality, 39."""
    return preset(settings, picture, quality=39)


def skip(_settings: AntiAliasing, picture: Float[Tensor, "*batch height width 3"]) -> Tensor:
    """Picture as it is: one sample in each pixel's centre."""
    return picture


def largest_change(_settings: AntiAliasing, fine: Float[Tensor, "*batch fine_height fine_width 3"]) -> Tensor:
    """Bound on the change of any value: a pixel moves towards a neighbour, at most all the way."""
    return footage.spread(fine)


def _centres(_settings: AntiAliasing, fine: Tensor) -> Tensor:
    return footage.points(fine, (0.0, 0.0))


def _truth(_settings: AntiAliasing, fine: Tensor) -> Tensor:
    return footage.truth(fine)


EFFECT = Effect(
    parameters=AntiAliasing,
    prefix=PREFIX,
    rungs={
        "skip": Rung(skip, _centres),
        "preset 10": Rung(partial(preset, quality=10), _centres),
        "preset 12": Rung(partial(preset, quality=12), _centres),
        "soft": Rung(soft, _centres),
        "preset 39": Rung(render, _centres),
    },
    reference=_truth,
    # One sample in a pixel cannot tell which share of it a thin line or a disc fills.
    tolerance=0.6,
    largest_change=largest_change,
    example_inputs=footage.example_pictures,
)
