"""Skin by brute force: light from everywhere on it to every pixel, by distances in space, which shares no kernel code.

The picture, bilinear between pixels, is cut into many cells a pixel, and each counts by Burley's profile at its
distance in space times its area. The profile is 1 / r times what is smooth, and 1 / r is integrated exactly over cells
nearby as if the surface were flat there. Passes, areas, and the division by what counts are those of the fast ways.
Works in float64.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading.skin_passes import deferred, forward
from diffrender.shading.skin_view import Skin, SkinView, steps

CELLS = 8  # along a pixel; an even number, so that no cell's middle is a pixel's
_PAD = 2  # pixels round the picture, and how far cells are near
_AT_ONCE = 64  # pixels that gather at once


def reference(skin: Skin, view: SkinView, cells: int = CELLS) -> Float[Tensor, "*batch height width 3"]:
    """Radiance of skin towards the eye [W/(m² sr)], by so many cells along a pixel."""
    targets = deferred(skin, view)
    size = targets.diffuse.shape
    parts = [targets.diffuse, view.position.expand(size), view.mask.expand(size[:-1])]
    pictures = zip(*(part.reshape(-1, *part.shape[len(size) - 3 :]) for part in parts), strict=True)
    from_bright = skin.colour - 0.8
    path = skin.mean_free_path / (3.5 * from_bright**2 - skin.colour + 1.9)
    diffuse = torch.stack([_scattered(path, one, cells) for one in pictures])
    return forward(skin, view, replace(targets, diffuse=diffuse.reshape(size)))


def _scattered(path: Tensor, picture: tuple[Tensor, ...], cells: int) -> Tensor:
    """Light of a picture of light, positions and mask after it has wandered."""
    light, position, mask = picture
    height, width = mask.shape
    across, down = steps(position)
    weight = mask * torch.linalg.cross(across, down).norm(dim=-1)
    cut = [_cut(count, cells).to(light) for count in (height, width)]
    fine_position = _fine(_extrapolated(position), cut).reshape(-1, 3)
    fine_weight = _fine(_surrounded(weight[..., None]), cut).reshape(-1)
    fine_light = _fine(_surrounded(weight[..., None] * light), cut).reshape(-1, 3)
    near = _near(height, width, cells)
    found = []
    for some in torch.split(torch.arange(height * width), _AT_ONCE):
        here = position.reshape(-1, 3)[some]
        distance = torch.cdist(here, fine_position, compute_mode="donot_use_mm_for_euclid_dist")
        inverse = 1.0 / distance
        edges = (across.reshape(-1, 3)[some], down.reshape(-1, 3)[some])
        exact = inverse.gather(1, near[some]) * _correction(edges, cells)
        inverse = inverse.scatter(1, near[some], exact)
        channels = []
        for channel in range(3):
            counts = inverse * (torch.exp(-distance / path[channel]) + torch.exp(-distance / (3.0 * path[channel])))
            total = counts @ fine_weight
            mean = (counts @ fine_light[:, channel]) / torch.where(total == 0.0, torch.ones_like(total), total)
            channels.append(mean)
        found.append(torch.stack(channels, -1))
    return torch.cat(found).reshape(height, width, 3)


def _cut(count: int, cells: int) -> Tensor:
    """Matrix from pixels with a padding to the cells between their centres."""
    places = (torch.arange((count + 2 * _PAD - 1) * cells) + 0.5) / cells
    return torch.relu(1.0 - (places[:, None] - torch.arange(count + 2 * _PAD)).abs())


def _fine(picture: Tensor, cut: list[Tensor]) -> Tensor:
    return torch.einsum("ab,cd,bde->ace", cut[0], cut[1], picture)


def _surrounded(picture: Tensor) -> Tensor:
    """Picture with nothing around it."""
    return torch.nn.functional.pad(picture, (0, 0, _PAD, _PAD, _PAD, _PAD))


def _extrapolated(position: Tensor) -> Tensor:
    """Picture of positions that goes on beyond its border as it ends."""
    for axis in (0, 1):
        first, last = (position.narrow(axis, at, 1) for at in (0, position.shape[axis] - 1))
        before, after = first - position.narrow(axis, 1, 1), last - position.narrow(axis, position.shape[axis] - 2, 1)
        position = torch.cat([first + 2 * before, first + before, position, last + after, last + 2 * after], axis)
    return position


def _near(height: int, width: int, cells: int) -> Tensor:
    """Indices of the cells round every pixel's centre, within the padding."""
    row, column = (cells * torch.arange(count)[:, None] + torch.arange(2 * _PAD * cells) for count in (height, width))
    columns = (width + 2 * _PAD - 1) * cells
    return (row[:, None, :, None] * columns + column[None, :, None, :]).reshape(height * width, -1)


def _correction(edges: tuple[Tensor, Tensor], cells: int) -> Tensor:
    """Integral of 1 / r over cells near a pixel's centre, over what their middles and areas give."""
    place = (torch.arange(2 * _PAD * cells) - _PAD * cells).to(edges[0])
    row, column = torch.meshgrid(place, place, indexing="ij")
    first = edges[0] / edges[0].norm(dim=-1, keepdim=True)
    along = (edges[1] * first).sum(-1, keepdim=True)
    second = edges[1] - along * first
    second = second / second.norm(dim=-1, keepdim=True)

    def flat(columns: Tensor, rows: Tensor) -> Tensor:
        """Place in the surface's own plane."""
        place = (edges[0][:, None, None] * columns[..., None] + edges[1][:, None, None] * rows[..., None]) / cells
        return torch.stack([(place * one[:, None, None]).sum(-1) for one in (first, second)], -1)

    corners = [flat(column + x, row + y) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    beside = [_beside(start, end) for start, end in zip(corners, corners[1:] + corners[:1], strict=True)]
    total = torch.stack(beside).sum(0)
    area = torch.linalg.cross(*edges).norm(dim=-1)[:, None, None] / cells**2
    correction: Tensor = total.abs() / area * flat(column + 0.5, row + 0.5).norm(dim=-1)
    return correction.flatten(1)


def _beside(start: Tensor, end: Tensor) -> Tensor:
    """Integral of 1 / r over the triangle from the origin to an edge, signed by its turn."""
    edge = end - start
    length = edge.norm(dim=-1)
    height = (start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]) / length
    from_foot = [(one * edge).sum(-1) / length for one in (start, end)]
    through = height.abs() < 1e-12 * length
    over = torch.where(through, torch.ones_like(height), height.abs())
    angle = torch.asinh(from_foot[1] / over) - torch.asinh(from_foot[0] / over)
    return torch.where(through, torch.zeros_like(height), height * angle)
