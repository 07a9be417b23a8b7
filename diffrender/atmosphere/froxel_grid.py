"""Froxel grid: cells that fill what a camera sees up to a distance, their fog summed along each column of them [1].

Columns and rows are even in the picture. Slices are cut at view depths near × (far / near)^(k / slices), so that they
grow with distance; the first reaches back to the eye, and no fog is lost before it. A slice's light is integrated as
if its fog were even, which is exact for any number of slices of even fog and never gives more light than there is [2].

[1] B. Wronski, "Volumetric fog: unified compute shader based solution to atmospheric scattering", SIGGRAPH 2014 course
    "Advances in Real-Time Rendering in Games".
[2] S. Hillaire, "Physically based and unified volumetric rendering in Frostbite", SIGGRAPH 2015 course "Advances in
    Real-Time Rendering in Games".
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.numerics import decayed_length, mean_decay
from diffrender.parameters import record
from diffrender.rays import from_angles

_FARTHEST = 1e9  # length of rays into the sky, which may be given as infinite [m]


@dataclass(frozen=True)
class Grid:
    """How many froxels there are, and between which view depths their slices grow [m]."""

    columns: int = 160
    rows: int = 90
    slices: int = 64
    near: float = 0.5
    far: float = 100.0

    def halved(self) -> "Grid":
        """A grid of the same space with half as many along each axis."""
        halves = {axis: max(1, getattr(self, axis) // 2) for axis in ("columns", "rows", "slices")}
        return replace(self, **halves)


@record
class Eye:
    """A pinhole camera anywhere; of a sequence with an axis of time in front."""

    position: Float[Tensor, "*frames 3"]  # [m]
    axes: Float[Tensor, "*frames 3 3"]  # rows: unit directions ahead, to the left, up
    spread: Float[Tensor, "*frames 2"]  # tangents of half the picture's width and half its height


@record
class Froxels:
    """Samples of a grid in the world, one in each froxel."""

    from_eye: Float[Tensor, "slices rows columns 3"]  # [m]
    direction: Float[Tensor, "rows columns 3"]  # unit, from the eye
    stretch: Float[Tensor, "rows columns"]  # distance from the eye per view depth


def eye_at(
    position: Float[Tensor, "*frames 3"],
    elevation: Float[Tensor, "*frames"],
    azimuth: Float[Tensor, "*frames"],
    spread: Float[Tensor, "*#frames 2"],
) -> Eye:
    """Camera that looks at an elevation and an azimuth [rad], its picture upright."""
    ahead, up = from_angles(elevation, azimuth), from_angles(elevation + math.pi / 2.0, azimuth)
    axes = torch.stack([ahead, torch.linalg.cross(up, ahead), up], -2)
    return Eye(position, axes, spread + torch.zeros_like(position[..., :2]))


def directions(eye: Eye, rows: int, columns: int) -> tuple[Float[Tensor, "{rows} {columns} 3"], Tensor]:
    """Unit directions of the centres of a picture's pixels, and the distance per view depth along each."""
    left = 1.0 - (torch.arange(columns).to(eye.position) + 0.5) * (2.0 / columns)
    up = 1.0 - (torch.arange(rows).to(eye.position) + 0.5) * (2.0 / rows)
    high, wide = torch.meshgrid(up * eye.spread[1], left * eye.spread[0], indexing="ij")
    stretch = torch.sqrt(1.0 + wide * wide + high * high)
    ahead, leftward, upward = eye.axes
    towards = ahead + wide[..., None] * leftward + high[..., None] * upward
    return towards / stretch[..., None], stretch


def depth_at(grid: Grid, place: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """View depth [m] at a place counted in slices from the eye; cuts between slices are whole numbers."""
    ratio = grid.far / grid.near
    first = grid.near * ratio ** (1.0 / grid.slices)
    grown = grid.near * torch.exp(place * (math.log(ratio) / grid.slices))
    return torch.where(place < 1.0, first * place, grown)


def slice_at(grid: Grid, depth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Place of a view depth counted in slices from the eye; the inverse of `depth_at`.

    >>> slice_at(Grid(slices=64), depth_at(Grid(slices=64), torch.tensor([0.0, 0.5, 7.25, 64.0])))
    tensor([ 0.0000,  0.5000,  7.2500, 64.0000])
    """
    ratio = grid.far / grid.near
    first = grid.near * ratio ** (1.0 / grid.slices)
    grown = torch.log(depth.clamp(min=first) / grid.near) * (grid.slices / math.log(ratio))
    return torch.where(depth < first, depth / first, grown)


def cuts(grid: Grid, like: Tensor) -> Float[Tensor, " cuts"]:
    """View depths [m] between which the slices lie, from 0 to the grid's end."""
    return depth_at(grid, torch.arange(grid.slices + 1).to(like))


def froxels(grid: Grid, eye: Eye, shift: float) -> Froxels:
    """One sample in each froxel: in its middle, or moved by a shift from -1/2 to 1/2 along its slice."""
    direction, stretch = directions(eye, grid.rows, grid.columns)
    depth = depth_at(grid, torch.arange(grid.slices).to(stretch) + (0.5 + shift))
    distance = depth[:, None, None] * stretch
    return Froxels(distance[..., None] * direction, direction, stretch)


def place_of(grid: Grid, eye: Eye, from_eye: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Where the world lies in a camera's grid: counted in froxels by slice, row and column; -1 behind the camera.

    Given from the eye [m]: positions on a mountain would lose the digits of its nearest froxels in float32.
    """
    depth, left, up = from_eye.matmul(eye.axes.mT).unbind(-1)
    is_ahead = depth > 0.0
    divisor = torch.where(is_ahead, depth, torch.ones_like(depth))
    row = 0.5 * grid.rows * (1.0 - up / (divisor * eye.spread[1]))
    column = 0.5 * grid.columns * (1.0 - left / (divisor * eye.spread[0]))
    place = torch.stack([slice_at(grid, depth), row, column], -1)
    return torch.where(is_ahead[..., None], place, -torch.ones_like(place))


def integrated(
    grid: Grid, stretch: Float[Tensor, "rows columns"], medium: Float[Tensor, "slices rows columns 4"]
) -> Float[Tensor, "cuts rows columns 4"]:
    """Light on the way to the eye [W/(m² sr)] and optical depth at every cut, from froxels' scattered light.

    The medium is light sent to the eye per length and extinction [1/m].
    """
    edges = cuts(grid, stretch)
    length = (edges[1:] - edges[:-1])[:, None, None] * stretch
    scattered, extinction = medium[..., :3], medium[..., 3]
    depth = torch.cumsum(length * extinction, 0)
    before = torch.cat([torch.zeros_like(depth[:1]), depth[:-1]])
    light = scattered * (torch.exp(-before) * decayed_length(length, extinction))[..., None]
    behind = torch.cat([torch.cumsum(light, 0), depth[..., None]], -1)
    return torch.cat([torch.zeros_like(behind[:1]), behind])


def seen_through(
    grid: Grid,
    eye: Eye,
    summed: Float[Tensor, "cuts rows columns 4"],
    distance: Float[Tensor, "*batch height width"],
) -> tuple[Float[Tensor, "*batch height width 3"], Float[Tensor, "*batch height width"]]:
    """Light of the fog up to distances of a picture's pixels [W/(m² sr)], and transmittance; even beyond the grid.

    Linear between columns and rows; within a slice as in even fog: there optical depth grows linearly, light by the
    opacity gathered.
    """
    height, width = distance.shape[-2:]
    _, stretch = directions(eye, height, width)
    depth = (distance.clamp(max=_FARTHEST) / stretch).clamp(max=grid.far)
    first = slice_at(grid, depth).detach().floor().long().clamp(0, grid.slices - 1)
    edges = cuts(grid, depth)
    share = (depth - edges[first]) / (edges[first + 1] - edges[first])
    row, down = _between(height, grid.rows, depth)
    column, across = _between(width, grid.columns, depth)
    # Both cuts, both rows and both columns along axes of their own, so that all eight are gathered at once.
    layers = (1,) * (distance.ndim - 2)
    plane = (row[:, None, :, None] * grid.columns + column[:, None]).reshape(2, 2, *layers, height, width)
    index = torch.stack([first, first + 1])[:, None, None] * (grid.rows * grid.columns) + plane
    corners = summed.flatten(0, 2)[index]
    sides = torch.lerp(corners[:, 0], corners[:, 1], down[:, None, None])
    start, end = torch.lerp(sides[:, 0], sides[:, 1], across[:, None])
    thick = end[..., 3] - start[..., 3]
    gathered = share * mean_decay(share * thick) / mean_decay(thick)
    light = start[..., :3] + gathered[..., None] * (end[..., :3] - start[..., :3])
    return light, torch.exp(-(start[..., 3] + share * thick))


def _between(pixels: int, cells: int, like: Tensor) -> tuple[Int[Tensor, "2 {pixels}"], Float[Tensor, " {pixels}"]]:
    """Cells whose centres lie on both sides of each pixel's, and the share of the way between them."""
    place = ((torch.arange(pixels).to(like) + 0.5) * (cells / pixels) - 0.5).clamp(0.0, cells - 1.0)
    first = place.floor().long().clamp(0, max(cells - 2, 0))
    return torch.stack([first, (first + 1).clamp(max=cells - 1)]), place - first
