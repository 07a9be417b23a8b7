"""Pictures of streaks, tile by tile.

Each tile is drawn with the `NEAREST` streaks that hide most of it, of the `MOST` that a picture has: what is further
from a tile than any of its pixels can see comes last. In denser rain the faintest are lost. Tiles are drawn in turn, so
that memory does not grow with the picture, but where gradients are kept: those hold all pairs of pixels and streaks.

Gradient: exact of what is drawn. Which streaks those are is not differentiated.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.parameters import record
from diffrender.weather.rain_streaks import FILTER, Streaks, featured, hidden_by, seen

TILE = 16  # side, where the picture is as large [pixels]
MOST = 2**14  # streaks of a picture
NEAREST = 64  # streaks of a tile
AT_ONCE = 2**20  # pairs of pixels and streaks that are held in memory at a time
REACH = 3.5  # beyond which a filter sees nothing [standard deviations]
_BESIDE = 0.1  # of the picture's cone, in which streaks are still counted among it
_UNSEEN = 1e-6  # weight of the others, should there be room for them


@record
class Screen:
    """Directions of the pixels of a picture, how far the scene is seen along each, and the side of a pixel."""

    direction: Float[Tensor, "*batch height width 3"]
    distance: Float[Tensor, "*batch height width"]  # infinite for the sky [m]
    pixel: Float[Tensor, "*#batch"]  # [rad]


def unhidden(streaks: Streaks, screen: Screen, nearest: int = NEAREST) -> Float[Tensor, "*batch height width"]:
    """Share of each pixel's light that passes between the drops; all of it where there are none."""
    features = _first(featured(streaks), screen.direction)
    sigma = (FILTER * screen.pixel)[..., None, None]
    direction, distance = _tiled(screen.direction), _tiled(screen.distance[..., None])[..., 0]
    count = direction.shape[-3]
    kept = min(nearest, features.shape[-2])
    batch = math.prod(direction.shape[:-3])
    # Whichever is more: a tile's search among all streaks, or its pixels with those it keeps.
    size = max(1, AT_ONCE // max(1, batch * max(features.shape[-2], direction.shape[-2] * kept)))
    parts = []
    for first in range(0, count, size):
        tiles = slice(first, first + size)
        towards = direction[..., tiles, :, :]
        chosen = _chosen(features, towards, sigma, kept)
        hidden = hidden_by(chosen, towards, distance[..., tiles, :], sigma[..., None])
        parts.append(torch.exp(streaks.number[..., None, None] * torch.log1p(-hidden).sum(-1)))
    height, width = screen.distance.shape[-2:]
    return _whole(torch.cat(parts, -2), height, width)


def _first(
    features: Tensor, direction: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch most features"]:
    """The streaks that a picture has: those that are there and in its cone first, the larger before the smaller."""
    if features.shape[-2] <= MOST:
        return features
    known, axis = features.detach(), direction.detach().mean((-3, -2))
    edge = (direction.detach() @ axis[..., None, :, None])[..., 0].amin((-2, -1))
    middle = known[..., 0:3] + 0.5 * known[..., 3:6]
    far = torch.linalg.vector_norm(middle, dim=-1)
    reach = 0.5 * torch.sqrt(known[..., 10])  # of a streak, to either side
    is_seen = (middle @ axis[..., None])[..., 0] + reach > edge[..., None] * far - _BESIDE * far
    score = known[..., 12] * known[..., 11] / (far + reach) * torch.where(is_seen, 1.0, _UNSEEN)
    index = score.topk(MOST, -1).indices[..., None]
    return features.gather(-2, index.expand(*index.shape[:-1], features.shape[-1]))


def _chosen(features: Tensor, towards: Tensor, sigma: Tensor, kept: int) -> Float[Tensor, "*batch tiles kept features"]:
    """Streaks that each tile is drawn with."""
    tiles, count = towards.shape[-3], features.shape[-2]
    if kept == count:
        return features[..., None, :, :].expand(*features.shape[:-2], tiles, count, features.shape[-1])
    index = _strongest(features.detach(), towards.detach(), sigma.detach(), kept)
    flat = index.flatten(-2)[..., None]
    found = features.gather(-2, flat.expand(*flat.shape[:-1], features.shape[-1]))
    return found.reshape(*features.shape[:-2], tiles, kept, features.shape[-1])


def _strongest(features: Tensor, towards: Tensor, sigma: Tensor, kept: int) -> Int[Tensor, "*batch tiles kept"]:
    """Streaks that hide most of a tile, of those that come near it."""
    middle = towards.mean(-2)
    axis = middle / torch.linalg.vector_norm(middle, dim=-1, keepdim=True)
    reach = torch.linalg.vector_norm(towards - axis[..., None, :], dim=-1).amax(-1, keepdim=True) / sigma + REACH
    _, across, first, last, half = seen(features, axis, sigma)
    beside = torch.relu(torch.maximum(first, -last))
    gap = torch.hypot(across, beside) - half - reach
    weight = features[..., None, :, 12] * (half > 0.0).to(half)
    # Its peak, if the filter were as wide as it is long.
    strength = weight * half / (half + 1.0) * half / (half + 1.0 + last - first)
    score = torch.where(gap < 0.0, strength, torch.where(weight > 0.0, -1.0 - gap, -torch.inf))
    return score.topk(kept, -1).indices


def _sides(height: int, width: int) -> tuple[int, int]:
    return min(TILE, height), min(TILE, width)


def _tiled(picture: Float[Tensor, "*batch height width c"]) -> Float[Tensor, "*batch tiles pixels c"]:
    """Picture in tiles, row by row; those at the borders repeat the last pixels."""
    down, across = _sides(*picture.shape[-3:-1])
    for axis, side in ((-3, down), (-2, across)):
        size = picture.shape[axis]
        index = torch.arange(-(-size // side) * side, device=picture.device).clamp(max=size - 1)
        picture = picture.index_select(axis, index)
    *batch, height, width, channels = picture.shape
    cut = picture.reshape(*batch, height // down, down, width // across, across, channels).movedim(-4, -3)
    return cut.reshape(*batch, -1, down * across, channels)


def _whole(tiles: Float[Tensor, "*batch tiles pixels"], height: int, width: int) -> Float[Tensor, "*batch h w"]:
    """The picture that was cut into tiles, of one channel."""
    down, across = _sides(height, width)
    rows, columns = -(-height // down), -(-width // across)
    cut = tiles.reshape(*tiles.shape[:-2], rows, columns, down, across).movedim(-2, -3)
    return cut.reshape(*tiles.shape[:-2], rows * down, columns * across)[..., :height, :width]
