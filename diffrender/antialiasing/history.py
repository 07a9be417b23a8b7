"""History: what the frame before shows of the same surface, and whether it may be used.

A surface is followed by its motion. Where both frames know its motion and agree on it, it is the same surface, and what
is seen of it may be used whatever its colour: a scene at rest then settles after two frames. Elsewhere (uncovered
surfaces, things that tell no motion) colours decide [1], in brightness, orange and green: either frame's pixel must
lie within the colours round the other's. Asking it both ways keeps details that only one of the two frames met.

What moves but claims to rest is drawn double, half as strong; tell NaN for it, and colours decide.

Gradient: hard acceptance is not differentiated; soft acceptance is, but not which surface is the same.

[1] B. Karis, "High Quality Temporal Supersampling", SIGGRAPH 2014 course "Advances in Real-Time Rendering in Games".
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.antialiasing.settings import AntiAliasing
from diffrender.colour import ycocg_from_rgb
from diffrender.images import Frames, bordered, clamped, places

SAME_MOTION = 0.5  # largest difference of what two frames tell of one surface [pixels]


@dataclass(frozen=True)
class Reprojected:
    """What the frame before shows where the surfaces of this one were."""

    colour: Float[Tensor, "*batch height width 3"]
    is_on_screen: Bool[Tensor, "*batch height width"]
    is_same_surface: Bool[Tensor, "*batch height width"]


Accept = Callable[[AntiAliasing, Tensor, Reprojected], Tensor]  # settings, current, previous -> weight from 0 to 1


def folded(
    step: Callable[[AntiAliasing, Frames, Any], tuple[Tensor, Any]], settings: AntiAliasing, frames: Frames
) -> Float[Tensor, "*batch time height width 3"]:
    """Pictures of a sequence, step by step from its first frame; each step gets what the one before left."""
    pictures, state = [], None
    for frame in frames.in_order():
        picture, state = step(settings, frame, state)
        pictures.append(picture)
    return torch.stack(pictures, -4)


def motion_of(frame: Frames, size: tuple[int, int]) -> Float[Tensor, "*batch height width 2"]:
    """Motion of every pixel of a picture of some rows and columns [pixels], NaN where it is not known.

    Of the nearest surface in 3 x 3 where depth is given, so that edges move with what is in front; then of the
    nearest entry of the motion's own size.
    """
    if frame.motion is None:
        batch = frame.colour.shape[:-3]
        return frame.colour.new_full((*batch, *size, 2), math.nan)
    motion = frame.motion if frame.depth is None else _of_nearest(frame.motion, frame.depth)
    rows, columns = motion.shape[-3:-1]
    row, column = (
        ((torch.arange(wanted, device=motion.device) + 0.5) * (given / wanted)).long()
        for wanted, given in zip(size, (rows, columns), strict=True)
    )
    return motion[..., row, :, :][..., column, :]


def _of_nearest(
    motion: Float[Tensor, "*batch height width 2"], depth: Float[Tensor, "*batch height width"]
) -> Float[Tensor, "*batch height width 2"]:
    height, width = depth.shape[-2:]
    around = bordered(depth, 1, clamped)
    along = bordered(motion.movedim(-1, -3), 1, clamped).movedim(-3, -1)
    nearest, found = depth, motion
    for down, right in product(range(3), range(3)):
        beside = around[..., down : down + height, right : right + width]
        is_nearer = beside < nearest
        nearest = torch.where(is_nearer, beside, nearest)
        found = torch.where(is_nearer[..., None], along[..., down : down + height, right : right + width, :], found)
    return found


def reprojected(
    shown_before: Callable[[Tensor], Tensor],
    motion_before: Float[Tensor, "*batch height width 2"],
    motion: Float[Tensor, "*batch height width 2"],
) -> Reprojected:
    """What a frame that gives colours at places shows of the surfaces of the next; unknown motion counts as none."""
    height, width = motion.shape[-3:-1]
    is_known = motion.isfinite().all(-1)
    place = places(width, height, motion.new_zeros(2)) + torch.where(is_known[..., None], motion, 0.0)
    column, row = (clamped(place[..., axis].detach().floor().long(), size) for axis, size in ((0, width), (1, height)))
    is_on_screen = ((place >= 0.0) & (place <= place.new_tensor([width, height]))).all(-1)
    entry = (row * width + column).flatten(-2)[..., None].expand(*motion.shape[:-3], -1, 2)
    then = motion_before.flatten(-3, -2).gather(-2, entry).reshape(motion.shape)
    agrees = ((then - motion).abs() <= SAME_MOTION).all(-1)  # false where either is NaN
    return Reprojected(shown_before(place), is_on_screen, agrees & is_on_screen)


def accept(
    settings: AntiAliasing, current: Float[Tensor, "*batch height width 3"], previous: Reprojected
) -> Float[Tensor, "*batch height width"]:
    """1 where history may be used, else 0."""
    is_near = strangeness(current, previous.colour) <= settings.history_tolerance
    return ((is_near | previous.is_same_surface) & previous.is_on_screen).to(current.dtype)


def accept_softly(
    settings: AntiAliasing,
    current: Float[Tensor, "*batch height width 3"],
    previous: Reprojected,
    *,
    softness: float,
) -> Float[Tensor, "*batch height width"]:
    """How far history may be used; becomes `accept` as the softness, in brightness, goes to 0."""
    is_near = torch.sigmoid((settings.history_tolerance - strangeness(current, previous.colour)) / softness)
    usable = torch.where(previous.is_same_surface, 1.0, is_near)
    return torch.where(previous.is_on_screen, usable, 0.0)


def strangeness(
    one: Float[Tensor, "*batch height width 3"], other: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width"]:
    """How far the pixels of one picture lie outside the colours of 3 x 3 pixels of another, the lesser of both ways."""
    first, second = ycocg_from_rgb(one), ycocg_from_rgb(other)
    return torch.minimum(_outside(first, second), _outside(second, first))


def _outside(
    colour: Float[Tensor, "*batch height width 3"], box_of: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width"]:
    height, width = box_of.shape[-3:-1]
    whole = bordered(box_of.movedim(-1, -3), 1, clamped)
    rows = torch.stack([whole[..., down : down + height, :] for down in range(3)])
    columns = [
        torch.stack([edge[..., right : right + width] for right in range(3)]) for edge in (rows.amin(0), rows.amax(0))
    ]
    low, high = columns[0].amin(0), columns[1].amax(0)
    channels = colour.movedim(-1, -3)
    return torch.relu(torch.maximum(low - channels, channels - high)).amax(-3)
