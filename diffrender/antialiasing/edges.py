"""Brightness round the pixels of a picture, and what it tells of their edges, as FXAA measures it [1].

[1] T. Lottes, "FXAA", NVIDIA white paper, 2009, and the shader FXAA 3.11, 2011.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate, product

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Address, bordered, clamped

# Steps of the search along an edge by the shader's names of its qualities [pixels]; the last one is taken untested.
PRESETS: dict[int, tuple[float, ...]] = {
    10: (1.5, 3.0, 12.0),
    11: (1.0, 1.5, 3.0, 12.0),
    12: (1.0, 1.5, 2.0, 4.0, 12.0),
    13: (1.0, 1.5, 2.0, 2.0, 4.0, 12.0),
    14: (1.0, 1.5, 2.0, 2.0, 2.0, 4.0, 12.0),
    15: (1.0, 1.5, 2.0, 2.0, 2.0, 2.0, 4.0, 12.0),
    20: (1.5, 2.0, 8.0),
    21: (1.0, 1.5, 2.0, 8.0),
    22: (1.0, 1.5, 2.0, 2.0, 8.0),
    23: (1.0, 1.5, *[2.0] * 3, 8.0),
    24: (1.0, 1.5, *[2.0] * 3, 3.0, 8.0),
    25: (1.0, 1.5, *[2.0] * 4, 4.0, 8.0),
    26: (1.0, 1.5, *[2.0] * 5, 4.0, 8.0),
    27: (1.0, 1.5, *[2.0] * 6, 4.0, 8.0),
    28: (1.0, 1.5, *[2.0] * 7, 4.0, 8.0),
    29: (1.0, 1.5, *[2.0] * 8, 4.0, 8.0),
    39: (*[1.0] * 5, 1.5, *[2.0] * 4, 4.0, 8.0),
}
At = Callable[[float, float], Tensor]  # step down, step right [pixels] -> value there for every pixel
REC601 = (0.299, 0.587, 0.114)  # shares of red, green and blue in the brightness of encoded colours (ITU-R BT.601)


@dataclass(frozen=True)
class Search:
    """How far an edge is followed, and what lies beyond the picture's borders."""

    steps: tuple[float, ...] = PRESETS[12]
    address: Address = clamped

    @property
    def tested(self) -> tuple[float, ...]:
        """Distances at which the search looks [pixels]; multiples of a half."""
        return tuple(accumulate(self.steps[:-1]))


@dataclass(frozen=True)
class Surroundings:
    """Brightness round every pixel, at steps of half a pixel."""

    fields: dict[tuple[bool, bool], Tensor]  # whether half a pixel further down and right -> bordered means
    margin: int
    size: tuple[int, int]

    @classmethod
    def of(cls, luma: Float[Tensor, "*batch height width"], search: Search) -> "Surroundings":
        """Surroundings as far as a search looks."""
        margin = int(search.tested[-1]) + 2
        whole = bordered(luma, margin, search.address)
        down = (whole[..., :-1, :] + whole[..., 1:, :]) / 2
        right = (whole[..., :, :-1] + whole[..., :, 1:]) / 2
        both = (down[..., :, :-1] + down[..., :, 1:]) / 2
        halves = {(False, False): whole, (True, False): down, (False, True): right, (True, True): both}
        return cls(halves, margin, (luma.shape[-2], luma.shape[-1]))

    def at(self, down: float | int, right: float | int) -> Tensor:
        """Brightness at a step from every pixel, bilinear."""
        field = self.fields[down % 1 != 0, right % 1 != 0]
        top, left = (self.margin + int(step // 1) for step in (down, right))
        return field[..., top : top + self.size[0], left : left + self.size[1]]


def encoded_luma(picture: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Brightness of encoded colours, as video has it."""
    return (picture * picture.new_tensor(REC601)).sum(-1)


def contrasts(settings: AntiAliasing, around: Surroundings) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Range of brightness of each pixel and its four neighbours, and the least that is an edge."""
    cross = torch.stack([around.at(*side) for side in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))])
    brightest = cross.amax(0)
    return brightest - cross.amin(0), torch.maximum(
        settings.edge_threshold_minimum, brightest * settings.edge_threshold
    )


def edge_strengths(around: Surroundings) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Second differences of brightness across a horizontal edge and across a vertical one.

    Of differences to the middle pixel: of two colours these are 0 or the same number, so that what is symmetric ties
    in every precision. Outer ones are added first, so that a mirrored picture has the same bits.
    """
    middle = around.at(0, 0)

    def step(down: int, right: int) -> Tensor:
        return around.at(down, right) - middle

    def bend(first: Tensor, between: Tensor, last: Tensor) -> Tensor:
        return (first + last - 2 * between).abs()

    up_left, up, up_right = step(-1, -1), step(-1, 0), step(-1, 1)
    left, none, right = step(0, -1), torch.zeros_like(middle), step(0, 1)
    down_left, down, down_right = step(1, -1), step(1, 0), step(1, 1)
    horizontal = 2 * bend(up, none, down) + (bend(up_left, left, down_left) + bend(up_right, right, down_right))
    vertical = 2 * bend(left, none, right) + (bend(up_left, up, up_right) + bend(down_left, down, down_right))
    return horizontal, vertical


def subpixel_share(
    settings: AntiAliasing, around: Surroundings, contrast: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch"]:
    """Share of the neighbour that a pixel takes for standing out from the mean around it; 0 where nothing does."""
    middle = around.at(0, 0)
    near = torch.stack([around.at(*side) - middle for side in ((-1, 0), (1, 0), (0, -1), (0, 1))]).sum(0)
    far = torch.stack([around.at(*side) - middle for side in product((-1, 1), (-1, 1))]).sum(0)
    has_contrast = contrast > 0.0
    outstanding = (2 * near + far).abs() / 12 / torch.where(has_contrast, contrast, torch.ones_like(contrast))
    share = outstanding.clamp(max=1.0)
    return (share * share * (3 - 2 * share)) ** 2 * settings.subpixel


def neighbours(picture: Float[Tensor, "*batch height width channels"], address: Address) -> At:
    """What gives every pixel's neighbour at a whole step down and right, at most 1."""
    height, width = picture.shape[-3:-1]
    whole = bordered(picture.movedim(-1, -3), 1, address).movedim(-3, -1)
    return lambda down, right: whole[..., int(1 + down) :, int(1 + right) :, :][..., :height, :width, :]
