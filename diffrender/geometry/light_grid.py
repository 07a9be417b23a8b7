"""Which lights may reach which tiles of the screen, and which slices of depth in them: tiles [1], clusters [2].

View space is the blog's [3]: x to the right, y up, z ahead, with the eye at 0. A tile is a square of pixels whose
frustum has four planes through the eye and two at its least and greatest depth. With half as many tiles as there are
along an axis as the scale, and the scale less the tile's number as its bias, which is one less with every tile (the
blog's text says twenty), X = scale P x/z + bias runs from 0 to 1 across the tile; times z, that X >= 0 and 1 - X >= 0
are the two planes. y points up and rows down, so the scale of y is negative (the blog's text turns its vector instead).

Final Fantasy XV's clusters cut the depth into 32 slices of equal ratio. A cell, a tile's slice, keeps no list: only the
first and the last place in its tile's list, which is sorted by depth, between which all of its lights lie.

All of it is conservative: spheres near a frustum's edge are kept though they may not meet it, and between the first and
the last may be others. Lists hold numbers of lights, -1 beyond their end.

Gradient: none, all of it is decided. Where lights fade to 0 at their radius, pictures have that of all lights.

[1] A. Lauritzen, "Deferred Rendering for Current and Future Rendering Pipelines", SIGGRAPH 2010 course "Beyond
    Programmable Shading".
[2] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Local Lights".
[3] "Tile frustum calculation for the point light culling", which explains the code of [1].
"""

import math

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor
from torch.nn.functional import pad

from diffrender.parameters import record
from diffrender.rays import Perspective

SLICES = 32  # of depth [2]
_AT_ONCE = 512  # tiles that are held against all lights


@record
class Spheres:
    """Where lights end: middles in view space and radii [m]."""

    middle: Float[Tensor, "lights 3"]
    radius: Float[Tensor, " lights"]


@record
class Depths:
    """Least and greatest depth of something [m]."""

    least: Float[Tensor, "*shape"]
    greatest: Float[Tensor, "*shape"]


@record
class Cells:
    """First and last place in a tile's list of what may reach each of its slices; for none the last is before it."""

    first: Int[Tensor, "*tiles slices"]
    last: Int[Tensor, "*tiles slices"]


def in_view(
    camera: Perspective, eye: Float[Tensor, "3"], position: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Places in view space [m].

    >>> in_view(Perspective(4, 4, 1.0), torch.zeros(3), torch.tensor([5.0, 1.0, 2.0]))
    tensor([-1.,  2.,  5.])
    """
    rise, level = math.sin(camera.pitch), math.cos(camera.pitch)
    axes = position.new_tensor([[0.0, -1.0, 0.0], [-rise, 0.0, level], [level, 0.0, rise]])
    return (position - eye) @ axes.T


def side_planes(camera: Perspective, tile: int, like: Tensor) -> Float[Tensor, "rows columns 4 3"]:
    """Unit normals, pointing inside, of the planes to the left, right, top and bottom of every tile."""
    columns, rows = (math.ceil(size / tile) for size in (camera.width, camera.height))
    projection = camera.width / (2.0 * math.tan(camera.field_of_view / 2))  # in pixels; pixels are square
    across, down = (torch.arange(count).to(like) for count in (columns, rows))
    bias_across = camera.width / (2.0 * tile) - across
    bias_down = camera.height / (2.0 * tile) - down
    along = like.new_tensor(projection / tile)
    none = torch.zeros_like

    def planes(scale: Tensor, bias: Tensor, axis: int) -> Tensor:
        before = [none(bias), none(bias), bias]
        before[axis] = scale.expand_as(bias)
        beyond = [-value for value in before]
        beyond[2] = 1.0 - bias
        return torch.stack([torch.stack(before, -1), torch.stack(beyond, -1)], -2)

    sides = planes(along, bias_across, 0).expand(rows, columns, 2, 3)
    ends = planes(-along, bias_down, 1)[:, None].expand(rows, columns, 2, 3)
    normals = torch.cat([sides, ends], -2)
    length: Tensor = torch.linalg.vector_norm(normals, dim=-1, keepdim=True)
    return normals / length


def to_tiles(picture: Shaped[Tensor, "height width *rest"], tile: int) -> Shaped[Tensor, "tiles pixels *rest"]:
    """Pixels of every tile, row by row; what hangs over the border repeats the last pixel.

    >>> to_tiles(torch.arange(4).reshape(2, 2), 2)
    tensor([[0, 1, 2, 3]])
    """
    height, width = picture.shape[:2]
    rows, columns = math.ceil(height / tile), math.ceil(width / tile)
    down = torch.arange(rows * tile, device=picture.device).clamp(max=height - 1)
    across = torch.arange(columns * tile, device=picture.device).clamp(max=width - 1)
    whole = picture[down][:, across]
    cut = whole.reshape(rows, tile, columns, tile, *picture.shape[2:]).transpose(1, 2)
    return cut.reshape(rows * columns, tile * tile, *picture.shape[2:])


def from_tiles(
    tiles: Shaped[Tensor, "tiles pixels *rest"], height: int, width: int, tile: int
) -> Shaped[Tensor, "height width *rest"]:
    """The picture again; the inverse of `to_tiles`."""
    rows, columns = math.ceil(height / tile), math.ceil(width / tile)
    whole = tiles.reshape(rows, columns, tile, tile, *tiles.shape[2:]).transpose(1, 2)
    return whole.reshape(rows * tile, columns * tile, *tiles.shape[2:])[:height, :width]


def depth_bounds(depth: Float[Tensor, "tiles pixels"]) -> Depths:
    """Least and greatest depth of every tile's pixels: a low-resolution depth map."""
    return Depths(depth.amin(-1), depth.amax(-1))


def reaches(planes: Float[Tensor, "tiles 4 3"], bounds: Depths, lights: Spheres) -> Bool[Tensor, "tiles lights"]:
    """Whether a sphere is behind none of a tile's six planes; one of no radius reaches nothing."""
    ahead = lights.middle[:, 2]
    is_near = (ahead + lights.radius >= bounds.least[:, None]) & (ahead - lights.radius <= bounds.greatest[:, None])
    kept = is_near & (lights.radius > 0.0)
    for normals in planes.unbind(1):
        kept &= normals @ lights.middle.T >= -lights.radius
    return kept


def lists(planes: Float[Tensor, "tiles 4 3"], bounds: Depths, lights: Spheres) -> Int[Tensor, "tiles longest"]:
    """Numbers of the lights that may reach each tile, from the nearest middle on; as wide as the longest list."""
    order = torch.argsort(lights.middle[:, 2], stable=True)
    sorted_lights = Spheres(lights.middle[order], lights.radius[order])
    parts = zip(*(torch.split(of_tile, _AT_ONCE) for of_tile in (planes, bounds.least, bounds.greatest)), strict=True)
    found = torch.cat([reaches(part, Depths(least, greatest), sorted_lights) for part, least, greatest in parts])
    count = found.sum(-1)
    listed = torch.full((len(found), int(count.max())), -1, dtype=torch.long, device=found.device)
    tile, light = found.nonzero(as_tuple=True)
    before = torch.cumsum(count, 0) - count
    listed[tile, torch.arange(len(tile), device=found.device) - before[tile]] = order[light]
    return listed


def slice_of(depth: Float[Tensor, "*batch"], span: Depths, slices: int = SLICES) -> Int[Tensor, "*batch"]:
    """Number of the slice in which a depth lies, 0 for the nearest: of equal ratios; outside, that of the nearer end.

    >>> slice_of(torch.tensor([0.5, 1.0, 9.9, 10.1, 1e3]), Depths(torch.tensor(1.0), torch.tensor(100.0)), 2)
    tensor([0, 0, 0, 1, 1])
    """
    # Not below the near end: spheres round the eye reach behind it.
    ratio = torch.maximum(depth, span.least) / span.least
    place = torch.log(ratio) / torch.log(span.greatest / span.least)
    return (place * slices).floor().long().clamp(0, slices - 1)


def cells(listed: Int[Tensor, "tiles longest"], lights: Spheres, span: Depths, slices: int = SLICES) -> Cells:
    """First and last place of every tile's list that may reach each slice of a span of depths."""
    is_light, which = listed >= 0, listed.clamp(min=0)
    ahead, radius = lights.middle[which, 2], lights.radius[which]
    start, end = (slice_of(place, span, slices)[..., None] for place in (ahead - radius, ahead + radius))
    number = torch.arange(slices, device=listed.device)
    found = is_light[..., None] & (start <= number) & (number <= end)
    count = listed.shape[1]
    place = torch.arange(count, device=listed.device)[:, None]
    # A column that no slice holds, for lists of none.
    first = pad(torch.where(found, place, count), (0, 0, 0, 1), value=count).amin(1)
    last = pad(torch.where(found, place, -1), (0, 0, 0, 1), value=-1).amax(1)
    return Cells(first, last)
