"""Shadows of the sun by depth maps in cascades: where each looks, and what lies in shadow, by soft comparison.

The view is cut by depth [1]. Each piece lies in a sphere, whose radius hangs on the camera's lens alone, so that a
square map round it keeps its size while the camera turns; its middle is moved to whole texels, so that the map's texels
stay where they are in the world while the camera moves, and edges of shadows do not crawl. Maps hold, from the sun's
plane through the middle of the sphere, the height of what first catches its light: [m], more is nearer to the sun.

Effects that the sun lights take its shadow as an input: the share that is found here dims their irradiance, place by
place, as that of `wetness`. Fog, whose cells are larger than texels, takes shadows that `froxel_shadow` has blurred.

Gradient: visibility is differentiable in the map, the place and the softness, where a hard comparison is in none of
them. Cascades themselves are decided from detached numbers.

[1] F. Zhang et al., "Parallel-Split Shadow Maps for Large-scale Virtual Environments", VRCIA 2006.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.geometry.light_grid import Depths
from diffrender.images import share_above
from diffrender.numerics import smooth_rise
from diffrender.parameters import record
from diffrender.rays import Rays

BLEND = 0.1  # share of a cascade's depths over which it gives way to the next


@record
class Cascade:
    """A square map towards the sun. Its rows go along `down`, its columns along `right`."""

    middle: Float[Tensor, "3"]  # [m]
    right: Float[Tensor, "3"]
    down: Float[Tensor, "3"]
    to_sun: Float[Tensor, "3"]
    texel: Float[Tensor, ""]  # side of one [m]
    resolution: int  # texels along each side


@record
class Camera:
    """Where a perspective camera stands and looks, and the tangent of half of its angle from corner to corner."""

    eye: Float[Tensor, "3"]
    forward: Float[Tensor, "3"]
    tangent: Float[Tensor, ""]


def splits(near: float, far: float, count: int, evenness: float) -> tuple[float, ...]:
    """Depths between cascades, the ends included [m]: of equal ratio at an evenness of 0, of equal size at 1 [1].

    >>> [round(depth, 1) for depth in splits(0.1, 1000.0, 4, 0.5)]
    [0.1, 125.5, 255.0, 425.0, 1000.0]
    """
    shares = [place / count for place in range(count + 1)]
    return tuple(
        (1.0 - evenness) * near * (far / near) ** share + evenness * (near + (far - near) * share) for share in shares
    )


def cascade(camera: Camera, piece: tuple[float, float], to_sun: Float[Tensor, "3"], resolution: int) -> Cascade:
    """Map of a piece of the view between two depths, snapped to texels; one texel at each side is spare for that."""
    near, far = piece
    square = 1.0 + float(camera.tangent) ** 2
    # The smallest sphere round the piece; its middle is not beyond the far end.
    ahead = min(0.5 * (near + far) * square, far)
    radius = math.sqrt((far - ahead) ** 2 + far**2 * (square - 1.0))
    # Whichever axis of the world is far from the sun.
    world = to_sun.new_tensor((1.0, 0.0, 0.0) if abs(float(to_sun[2])) > 0.9 else (0.0, 0.0, 1.0))
    right = torch.linalg.cross(world, to_sun)
    right = right / torch.linalg.vector_norm(right)
    down = torch.linalg.cross(right, to_sun)
    texel = 2.0 * radius / (resolution - 2)
    middle = camera.eye + ahead * camera.forward
    axes = torch.stack([right, down, to_sun])
    inside = torch.round(axes.detach() @ middle.detach() / texel) * texel
    return Cascade(inside @ axes.detach(), right, down, to_sun, to_sun.new_tensor(texel), resolution)


def texel_rays(seen: Cascade, height: float) -> Rays:
    """Rays of all texels' middles from a height over the map's plane, against the light: (resolution, resolution).

    A map is the height less the length of a ray to what it first meets.
    """
    place = (torch.arange(seen.resolution).to(seen.middle) + 0.5 - 0.5 * seen.resolution) * seen.texel
    plane = seen.middle + place[:, None, None] * seen.down + place[:, None] * seen.right
    return Rays(plane + height * seen.to_sun, (-seen.to_sun).expand_as(plane), seen.texel.new_tensor(math.inf))


def on_map(seen: Cascade, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Row and column [texels], whole numbers at texels' middles, and height over the map's plane [m]."""
    away = position - seen.middle
    centre = 0.5 * (seen.resolution - 1)
    along = [(away * axis).sum(-1) for axis in (seen.down, seen.right, seen.to_sun)]
    return torch.stack([along[0] / seen.texel + centre, along[1] / seen.texel + centre, along[2]], -1)


def visibility(
    heights: Float[Tensor, "rows rows"],
    seen: Cascade,
    position: Float[Tensor, "*batch 3"],
    bias: Float[Tensor, "*#batch"],
    softness: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch"]:
    """Share of the sun that reaches places: mean of soft comparisons with 3 × 3 texels round each.

    A place is in shadow by a sigmoid of how far it lies below what the map saw, over a softness above 0 [m], less a
    bias [m] that lifts it off the surface itself: for a slope the texel times the tangent of its angle to the sun. Off
    the map all is lit.
    """
    row, column, height = on_map(seen, position).unbind(-1)
    last = seen.resolution - 1

    def texel(down: Tensor, across: Tensor) -> Tensor:
        return heights[down.clamp(0, last), across.clamp(0, last)]

    share = share_above(height + bias, softness, (row, column), texel)
    inside = (row >= 0.0) & (row <= last) & (column >= 0.0) & (column <= last)
    return torch.where(inside, share, torch.ones_like(share))


def cascaded(
    shares: Sequence[Float[Tensor, "*batch"]], pieces: Depths, depth: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch"]:
    """Visibility by the cascade of a depth, the nearest first; the last tenth of each leads over to the next."""
    found = shares[-1]
    for share, near, far in reversed(list(zip(shares[:-1], pieces.least[:-1], pieces.greatest[:-1], strict=True))):
        width = BLEND * (far - near)
        found = torch.lerp(share, found, smooth_rise(depth - (far - width), width))
    return found
