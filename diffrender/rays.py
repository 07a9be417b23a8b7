"""Rays, and the camera models that turn a pixel into one.

Directions follow the library's conventions: z up, +x the horizontal direction under the centre of the picture, +y to
its left, pixel centres at +0.5, row 0 on top.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.parameters import record


@record
class Rays:
    """Half-lines, or pieces of them: origin [m] with z the altitude, unit direction from the eye, length [m]."""

    origin: Float[Tensor, "*#batch 3"]
    direction: Float[Tensor, "*batch 3"]
    length: Float[Tensor, "*#batch"]


@runtime_checkable  # the tests check argument types at run time
class Camera(Protocol):
    """What a picture's pixels saw: one direction and one solid angle each."""

    @property
    def width(self) -> int:
        """Columns of the picture."""

    @property
    def height(self) -> int:
        """Rows of the picture."""

    def direction(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
        """Unit direction seen at a place in the picture; a pixel's centre is at +0.5."""

    def solid_angle(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Solid angle of the pixel round a place [sr]; 0 where the picture shows nothing."""

    def place(self, direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
        """Where a direction appears, x and y in pixels; NaN where the picture does not show it."""


def pixel_centres(camera: Camera, rows: slice, like: Tensor) -> tuple[Float[Tensor, "h w"], Float[Tensor, "h w"]]:
    """Place (x, y) of every pixel's centre in a band of rows."""
    y = torch.arange(*rows.indices(camera.height)).to(like) + 0.5
    x = torch.arange(camera.width).to(like) + 0.5
    columns, lines = torch.meshgrid(x, y, indexing="xy")
    return columns, lines


def from_angles(elevation: Float[Tensor, "*batch"], azimuth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
    """Unit direction at an elevation above the horizon and an azimuth from +x towards +y [rad].

    >>> from_angles(torch.tensor(0.0), torch.tensor(math.pi / 2)).round(decimals=3).abs()
    tensor([0., 1., 0.])
    """
    level = torch.cos(elevation)
    return torch.stack([level * torch.cos(azimuth), level * torch.sin(azimuth), torch.sin(elevation)], -1)


def angles(direction: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Elevation above the horizon and azimuth from +x towards +y [rad] of a direction; the inverse of `from_angles`."""
    x, y, z = direction.unbind(-1)
    return torch.atan2(z, torch.hypot(x, y)), torch.atan2(y, x)


def unit(towards: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Unit vector along another, whose length is not 0."""
    length: Tensor = torch.linalg.vector_norm(towards, dim=-1, keepdim=True)
    return towards / length


@dataclass(frozen=True)
class Equirectangular:
    """Latitude and longitude on rows and columns: the whole sphere, or its upper half only."""

    width: int
    height: int
    lowest: float = -math.pi / 2  # elevation of the lower border [rad]

    def direction(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
        """Unit direction seen at a place in the picture."""
        elevation = math.pi / 2 - (math.pi / 2 - self.lowest) * (y / self.height)
        return from_angles(elevation, math.pi * (1.0 - 2.0 * x / self.width))

    def solid_angle(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Solid angle of the pixel round a place [sr]: exact for a whole pixel."""
        step = (math.pi / 2 - self.lowest) / self.height
        from_zenith = step * y
        return (2.0 * math.pi / self.width) * 2.0 * math.sin(step / 2) * torch.sin(from_zenith) * torch.ones_like(x)

    def place(self, direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
        """Where a direction appears; NaN below the lower border."""
        elevation, azimuth = angles(direction)
        y = self.height * (math.pi / 2 - elevation) / (math.pi / 2 - self.lowest)
        x = self.width * (0.5 - azimuth / (2.0 * math.pi))
        seen = torch.stack([x, y], -1)
        return torch.where((y <= self.height)[..., None], seen, seen.new_tensor(math.nan))


@dataclass(frozen=True)
class Perspective:
    """A pinhole camera, tilted up by its pitch."""

    width: int
    height: int
    field_of_view: float  # across the width [rad]
    pitch: float = 0.0  # [rad], up

    def direction(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
        """Unit direction seen at a place in the picture."""
        left, up = self._on_plane(x, y)
        forward = torch.cos(left.new_tensor(self.pitch)), torch.sin(left.new_tensor(self.pitch))
        towards = torch.stack([forward[0] - up * forward[1], left, forward[1] + up * forward[0]], -1)
        return unit(towards)

    def solid_angle(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Solid angle of the pixel round a place [sr], by the density at its centre."""
        left, up = self._on_plane(x, y)
        square = 1.0 + left * left + up * up
        side = 2.0 * math.tan(self.field_of_view / 2) / self.width
        return side * side / (square * torch.sqrt(square))

    def place(self, direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
        """Where a direction appears; NaN outside the frame and behind the camera."""
        ahead, left, z = direction.unbind(-1)
        forward = ahead * math.cos(self.pitch) + z * math.sin(self.pitch)
        up = z * math.cos(self.pitch) - ahead * math.sin(self.pitch)
        side = 2.0 * math.tan(self.field_of_view / 2) / self.width
        seen = torch.stack([self.width / 2 - left / forward / side, self.height / 2 - up / forward / side], -1)
        inside = (forward > 0) & ((seen >= 0) & (seen <= seen.new_tensor([self.width, self.height]))).all(-1)
        return torch.where(inside[..., None], seen, seen.new_tensor(math.nan))

    def _on_plane(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        side = 2.0 * math.tan(self.field_of_view / 2) / self.width
        return (self.width / 2 - x) * side, (self.height / 2 - y) * side


# Faces of a cube: outward normal, direction of growing x, direction of growing y (down the picture).
FACES = {
    "left": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
    "right": ((0, -1, 0), (-1, 0, 0), (0, 0, -1)),
    "up": ((0, 0, 1), (0, -1, 0), (1, 0, 0)),
    "down": ((0, 0, -1), (0, -1, 0), (-1, 0, 0)),
    "front": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "back": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
}


@dataclass(frozen=True)
class Cubemap:
    """Six square faces on a grid of cells; a cell without a face shows nothing.

    `layout` names the face of each cell, row by row; "back turned" is the back face upside down, as in a standing
    cross.
    """

    side: int  # of a face, in pixels
    layout: tuple[tuple[str | None, ...], ...]

    @property
    def width(self) -> int:
        """Columns of the picture."""
        return self.side * len(self.layout[0])

    @property
    def height(self) -> int:
        """Rows of the picture."""
        return self.side * len(self.layout)

    def direction(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
        """Unit direction seen at a place in the picture; straight ahead where a cell shows nothing."""
        cell, across, down = self._in_cell(x, y)
        normal, right, below = self._axes(x).unbind(-2)
        towards = normal[cell] + across[..., None] * right[cell] + down[..., None] * below[cell]
        return unit(towards)

    def solid_angle(self, x: Float[Tensor, "*batch"], y: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Solid angle of the pixel round a place [sr]; 0 where a cell shows nothing."""
        cell, across, down = self._in_cell(x, y)
        square = 1.0 + across * across + down * down
        shows = self._shows(x)[cell].to(x)
        return shows * (4.0 / (self.side * self.side)) / (square * torch.sqrt(square))

    def place(self, direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
        """Where a direction appears; a whole cubemap shows every direction."""
        axes, shows = self._axes(direction), self._shows(direction)
        along = torch.where(shows, direction @ axes[:, 0].mT, direction.new_tensor(-1.0))
        ahead, cell = along.max(-1)
        across = (axes[cell, 1] * direction).sum(-1) / ahead
        down = (axes[cell, 2] * direction).sum(-1) / ahead
        columns = len(self.layout[0])
        start = torch.stack([cell % columns, cell // columns], -1).to(direction) * self.side
        seen = start + (torch.stack([across, down], -1) + 1.0) / 2.0 * self.side
        # A border belongs to the cell after it, which may show something else or nothing.
        return torch.minimum(seen, torch.nextafter(start + self.side, start))

    def _in_cell(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        column = torch.floor(x / self.side).clamp(0, len(self.layout[0]) - 1)
        row = torch.floor(y / self.side).clamp(0, len(self.layout) - 1)
        cell = (row * len(self.layout[0]) + column).long()
        return cell, 2.0 * (x / self.side - column) - 1.0, 2.0 * (y / self.side - row) - 1.0

    def _axes(self, like: Tensor) -> Float[Tensor, "cells 3 3"]:
        def axes(face: str | None) -> list[list[float]]:
            normal, right, below = FACES[(face or "front").removesuffix(" turned")]
            turn = -1.0 if face and face.endswith(" turned") else 1.0
            return [[float(v) for v in normal], [turn * v for v in right], [turn * v for v in below]]

        return like.new_tensor([axes(face) for line in self.layout for face in line])

    def _shows(self, like: Tensor) -> Bool[Tensor, " cells"]:
        return torch.tensor([face is not None for line in self.layout for face in line], device=like.device)


CROSS_LYING = (
    (None, "up", None, None),
    ("left", "front", "right", "back"),
    (None, "down", None, None),
)
CROSS_STANDING = (
    (None, "up", None),
    ("left", "front", "right"),
    (None, "down", None),
    (None, "back turned", None),
)
# OpenGL's order of faces: +X, -X, +Y, -Y, +Z, -Z, its left-handed axes pointing right, up and ahead.
STRIP_LYING = (("right", "left", "up", "down", "front", "back"),)
STRIP_STANDING = tuple((face,) for face in STRIP_LYING[0])
# OpenEXR's envmap attribute: the same order, but its axes are right-handed, so with +Z ahead +X points left.
STRIP_OPENEXR = tuple((face,) for face in ("left", "right", "up turned", "down turned", "front", "back"))
