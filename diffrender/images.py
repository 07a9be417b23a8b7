"""Images: frames of a sequence, samples of a scene at jittered places, and values between pixels.

A place is x and y in pixels from the upper left corner of a picture, pixel centres at +0.5. A frame whose samples lie
beside the centres is rendered by an unchanged renderer whose camera is jittered [1]: pixel (x, y) of a frame with an
offset (a, b) shows the place (x + 0.5 + a, y + 0.5 + b). Edges between pixels are at offsets (1/2, 0) and (0, 1/2),
corners at (-1/2, -1/2).

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games".
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.parameters import record

Address = Callable[[Tensor, int], Tensor]  # index, number of entries -> index of an entry
Scene = Callable[[Tensor], Tensor]  # places (..., 2) -> colours (..., 3)


@record
class Frames:
    """Pictures of one camera, in the order of time, as screens show them; also one of them, without the axis of time.

    Motion is where what a pixel shows stood in the frame before, less where it stands now [pixels], x and y: 0 where
    nothing moves; NaN where it is not known, and None where nothing is known. Depth, of the motion's size, is the
    distance of what is seen: of overlapping surfaces the motion of the nearest counts. Both may have fewer rows and
    columns than the picture, such as half of them. Motion is between pixel centres: it has no jitter in it.
    """

    colour: Float[Tensor, "*batch height width 3"]
    motion: Float[Tensor, "*batch motion_height motion_width 2"] | None
    depth: Float[Tensor, "*batch motion_height motion_width"] | None

    def in_order(self) -> "list[Frames]":
        """The frames one by one, of records whose colour has the axes (..., time, height, width, 3)."""
        count = self.colour.shape[-4]
        motion = [None] * count if self.motion is None else self.motion.unbind(-4)
        depth = [None] * count if self.depth is None else self.depth.unbind(-3)
        return [Frames(*frame) for frame in zip(self.colour.unbind(-4), motion, depth, strict=True)]


def clamped(index: Int[Tensor, "*batch"], size: int) -> Int[Tensor, "*batch"]:
    """Index of the nearest entry: beyond the borders, what lies at them."""
    return index.clamp(0, size - 1)


def wrapped(index: Int[Tensor, "*batch"], size: int) -> Int[Tensor, "*batch"]:
    """Index of an entry of a picture that repeats without end."""
    return index % size


def bordered(
    picture: Float[Tensor, "*batch height width"], margin: int, address: Address
) -> Float[Tensor, "*batch bordered_height bordered_width"]:
    """Picture of one channel with a margin on all sides, filled by an address."""
    height, width = picture.shape[-2:]
    row, column = (torch.arange(-margin, size + margin, device=picture.device) for size in (height, width))
    return picture[..., address(row, height), :][..., address(column, width)]


def places(width: int, height: int, offset: Float[Tensor, "2"]) -> Float[Tensor, "height width 2"]:
    """Place of every pixel of a frame jittered by an offset [pixels]."""
    y, x = torch.meshgrid(torch.arange(height).to(offset), torch.arange(width).to(offset), indexing="ij")
    return torch.stack([x, y], -1) + (0.5 + offset)


def jittered(projection: Float[Tensor, "*batch 4 4"], offset: Float[Tensor, "2"], size: tuple[int, int]) -> Tensor:
    """Projection matrix of a camera whose pixels show what lies an offset [pixels] to the right and down.

    For column vectors and normalised device coordinates from -1 to 1, y up; size is columns and rows of the picture.
    The picture moves the other way, by twice the offset over the size, at every depth.
    """
    move = torch.eye(4).to(projection)
    shift = 2.0 * offset.to(projection) / offset.new_tensor(size).to(projection)
    move[:2, 3] = shift * shift.new_tensor([-1.0, 1.0])
    return move @ projection


def supersampled(scene: Scene, width: int, height: int, samples: int, like: Tensor) -> Float[Tensor, "h w 3"]:
    """Mean of a scene over each pixel, by samples x samples of them at the middles of equal squares."""
    steps = (torch.arange(samples).to(like) + 0.5) / samples - 0.5
    offsets = torch.cartesian_prod(steps, steps)
    mean = torch.zeros(height, width, 3).to(like)
    for offset in offsets:
        mean = mean + scene(places(width, height, offset)) / len(offsets)
    return mean


def sampled(
    fine: Float[Tensor, "*batch fine_height fine_width channels"],
    factor: int,
    offset: tuple[float, float],
    footprint: float,
) -> Float[Tensor, "*batch height width channels"]:
    """Frame of a scene that is a picture `factor` times as fine: its mean over a square round each pixel's place.

    The footprint is the square's side [pixels]: 1 is what a mip-mapped texture shows, small ones are what edges of
    geometry show: points. A picture knows nothing between its own pixels, so that the least footprint is one of those.
    Beyond the borders the picture repeats its last pixels.

    Gradient: of the fine picture; exact, as the mean is linear.
    """
    rows, columns = fine.shape[-3] // factor, fine.shape[-2] // factor
    halves = (_sampled_along(fine.movedim(-3, -1), rows, factor, offset[1], footprint).movedim(-1, -3),)
    return _sampled_along(halves[0].movedim(-2, -1), columns, factor, offset[0], footprint).movedim(-1, -2)


def _sampled_along(line: Tensor, count: int, factor: int, offset: float, footprint: float) -> Tensor:
    """Means along the last axis over pieces as long as the footprint round every factor-th place."""
    side = max(footprint * factor, 1.0)
    start = (0.5 + offset) * factor - side / 2
    first, last = math.floor(start), math.ceil(start + side)
    mean = torch.zeros_like(line[..., :1]).expand(*line.shape[:-1], count)
    for entry in range(first, last):
        share = (min(entry + 1.0, start + side) - max(float(entry), start)) / side
        index = entry + factor * torch.arange(count, device=line.device)
        mean = mean + share * line[..., clamped(index, line.shape[-1])]
    return mean


def bilinear(
    picture: Float[Tensor, "*batch height width channels"],
    place: Float[Tensor, "*#batch h w 2"],
    address: Address,
) -> Float[Tensor, "*batch h w channels"]:
    """Value of a picture at places, between the four nearest pixel centres; at a centre that pixel, to the bit.

    Gradient: of the picture, exact; of the place, the slope within the square of the four centres.
    By gather and lerp, because grid_sample has no forward-mode derivative.
    """
    pixel, share = _pixels_round(picture, place, address)
    across, down = share[..., 0, None], share[..., 1, None]
    upper = torch.lerp(pixel(0, 0), pixel(0, 1), across)
    lower = torch.lerp(pixel(1, 0), pixel(1, 1), across)
    return torch.lerp(upper, lower, down)


def catmull_rom(
    picture: Float[Tensor, "*batch height width channels"],
    place: Float[Tensor, "*#batch h w 2"],
    address: Address,
) -> Float[Tensor, "*batch h w channels"]:
    """Value of a picture at places by the cubic through 4 x 4 pixel centres; at a centre that pixel, to the bit.

    Keeps detail that `bilinear` blurs, from four times its pixels; overshoots at edges by up to an eighth of their step
    in each direction.

    Gradient: of the picture, exact; of the place, continuous.
    Source: E. Catmull, R. Rom, "A class of local interpolating splines", Computer Aided Geometric Design, 1974.
    """
    pixel, share = _pixels_round(picture, place, address)
    columns, rows = (_cubic_weights(share[..., axis, None]) for axis in (0, 1))
    total = torch.zeros_like(share[..., :1])
    for down, of_row in enumerate(rows, start=-1):
        along = sum(weight * pixel(down, across) for across, weight in enumerate(columns, start=-1))
        total = total + of_row * along
    return total


def _cubic_weights(share: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of the pixels one before, at, one after and two after the first, at a share of the way to the next."""
    rest = 1.0 - share
    outer, beyond = -0.5 * share * rest * rest, -0.5 * rest * share * share
    first = 1.0 + share * share * (1.5 * share - 2.5)
    return outer, first, share * (0.5 + share * (2.0 - 1.5 * share)), beyond


def _pixels_round(
    picture: Tensor, place: Tensor, address: Address
) -> tuple[Callable[[int, int], Tensor], Float[Tensor, "*#batch h w 2"]]:
    """Pixels some rows down and columns across from the last centres before places, and the way on to the next."""
    height, width, channels = picture.shape[-3:]
    corner = place - 0.5
    first = corner.detach().floor()
    column, row = (first[..., axis].long() for axis in (0, 1))
    flat = picture.flatten(-3, -2)

    def pixel(down: int, across: int) -> Tensor:
        index = address(row + down, height) * width + address(column + across, width)
        index = index.expand(*picture.shape[:-3], *index.shape[-2:])
        every_channel = index.flatten(-2)[..., None].expand(*picture.shape[:-3], -1, channels)
        return flat.gather(-2, every_channel).reshape(*index.shape, channels)

    return pixel, corner - first


def share_above(
    height: Float[Tensor, "*#batch"],
    softness: Float[Tensor, "*#batch"],
    place: tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]],
    texel: Callable[[Tensor, Tensor], Tensor],
) -> Float[Tensor, "*batch"]:
    """Share of 3 × 3 texels round a row and column of a map of depths that a height lies above.

    Each texel's share is a sigmoid of the difference over the softness, above 0 and in the height's unit; shares are
    bilinear between texels, where depths would put a slope between what is near and what is far. `texel` gives the
    map's value at whole rows and columns, wherever they are. As the softness goes to 0 it is percentage closer
    filtering [1].

    Gradient: exact, in all of them; of row and column the slope between texels.

    [1] W. Reeves, D. Salesin, R. Cook, "Rendering antialiased shadows with depth maps", SIGGRAPH 1987.
    """
    row, column = place
    above, before = row.detach().floor(), column.detach().floor()
    total = torch.zeros_like(row)
    for down, of_row in enumerate(_three_wide(row - above), start=-1):
        for across, of_column in enumerate(_three_wide(column - before), start=-1):
            caught = texel((above + down).long(), (before + across).long())
            total = total + of_row * of_column * torch.sigmoid((height - caught) / softness)
    return total / 9.0


def _three_wide(share: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """How much of texels one before, at, one after and two after the first lies in a row of three round a place."""
    return 1.0 - share, torch.ones_like(share), torch.ones_like(share), share


def resized(
    picture: Float[Tensor, "*batch height width channels"], rows: int, columns: int
) -> Float[Tensor, "*batch rows columns channels"]:
    """Picture with other numbers of rows and columns, bilinear between its pixels; of the same size, itself to the bit.

    Takes no mean over what it leaves out: to shrink a picture, sample it.
    """
    height, width = picture.shape[-3:-1]
    scale = picture.new_tensor([width / columns, height / rows])
    return bilinear(picture, places(columns, rows, picture.new_zeros(2)) * scale, clamped)


def require_finite(picture: Float[Tensor, "*batch height width channels"], name: str) -> None:
    """Refuse a picture that a filter would smear NaN or infinity over.

    Renderers do not look: they take what they are given, so whoever reads a picture asks here.

    Raises:
        ValueError: when any value is NaN or infinite.
    """
    lost = ~picture.isfinite()
    if bool(lost.any()):
        where = lost.nonzero()[0].tolist()
        raise ValueError(
            f"{name}: {int(lost.sum())} of {lost.numel()} values are NaN or infinite, the first in row {where[-3]}, "
            f"column {where[-2]}; anti-aliasing spreads them, so fill or crop them first"
        )
