"""The pixels that a fit looks at: a photo averaged over boxes, so that no cost grows with its size, and samples."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from fit.exr import bands
from fit.photo import Photo
from fit.sun import cell_side

FLOOR = 1e-3  # of the median radiance: below it, noise would rule the logarithm


@dataclass(frozen=True, eq=False)
class Pixels:
    """A photo averaged over square boxes; a box counts as used when all of its pixels do."""

    radiance: Float[Tensor, "h w 3"]
    used: Bool[Tensor, "h w"]
    direction: Float[Tensor, "h w 3"]  # of the boxes' middles
    solid_angle: Float[Tensor, "h w"]  # [sr]

    @cached_property
    def floor(self) -> float:
        """Radiance that is added before a logarithm is taken."""
        return FLOOR * float(self.radiance[self.used].median())


def usable(photo: Photo, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Pixels of a mask that show something."""
    used = np.zeros(mask.shape, bool)
    for rows in bands(mask.shape[0]):
        used[rows] = mask[rows] & photo.valid(rows).numpy()
    return used


def averaged(photo: Photo, used_pixels: Bool[np.ndarray, "height width"]) -> Pixels:
    """The photo in boxes; rows and columns that fill no box at the right and lower border are left out."""
    side = cell_side(photo.camera)
    high, wide = photo.camera.height // side, photo.camera.width // side
    radiance, used = torch.zeros(high, wide, 3), torch.zeros(high, wide, dtype=torch.bool)
    lines = max(1, 256 // side)  # of boxes at a time
    for top in range(0, high, lines):
        rows = slice(top * side, min(top + lines, high) * side)
        here = slice(top, min(top + lines, high))
        radiance[here] = photo.band(rows)[:, : wide * side].reshape(-1, side, wide, side, 3).mean((1, 3))
        chosen = torch.from_numpy(used_pixels[rows][:, : wide * side].copy())
        used[here] = chosen.reshape(-1, side, wide, side).all(3).all(1)
    x, y = _middles(high, wide, side)
    return Pixels(radiance, used, photo.camera.direction(x, y), photo.camera.solid_angle(x, y) * side * side)


def _middles(high: int, wide: int, side: int) -> tuple[Tensor, Tensor]:
    y, x = (torch.arange(count, dtype=torch.float64).add(0.5).mul(side) for count in (high, wide))
    columns, lines = torch.meshgrid(x, y, indexing="xy")
    return columns, lines


def stratified(pixels: Pixels, count: int, seed: int) -> Int[Tensor, " n"]:
    """Indices among the used pixels, each standing for the same solid angle and drawn from a stratum of its own."""
    weight = torch.cumsum(pixels.solid_angle[pixels.used].double(), 0)
    if count >= weight.numel():
        return torch.arange(weight.numel())
    place = torch.rand(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    strata = (torch.arange(count, dtype=torch.float64) + place) / count
    return torch.searchsorted(weight, strata * weight[-1]).clamp(max=weight.numel() - 1)
