"""Tangram: a checkerboard of pixel corners as a square texture, turned by 45 degrees and cut to fit [1].

Corner (i, j) of a picture, i <= W and j <= H counted from its upper left corner, is lit in frames of parity p where
(i + j) % 2 == p. Lit corners form a square lattice along the screen's diagonals: u = (i + j + p) / 2 and
v = (i - j + p) / 2 are whole numbers, and one step of either is one diagonal of a pixel. Texel (a, b), row a and
column b, of a texture S x S holds u = a and v = b modulo S. No two corners of S rows and up to 2 S columns meet [2]:
equal texels would need i - i' and j - j' to be S times m + n and m - n; rows less than S apart leave m = n, columns
less than 2 S apart m = 0.

So nothing is lost, a step between texels is a diagonal of the screen everywhere, and what lies across a border of the
texture is found on the other side of it, by wrap addressing. Of S^2 texels, those of the columns W <= i < 2 S are
padding: 12.5 % more than the samples at 16:9.

What lies beyond the picture's upper or lower border wraps to rows of the other border, shifted by S columns.

Gradient: packing moves values and adds none, so its derivative is a permutation of the samples; the derivative of a
sample at a place is that of bilinear interpolation.

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games".
[2] The derivation is ours; the talk shows the shuffle as a picture.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.images import bilinear, wrapped


def pack(corners: Float[Tensor, "*batch height half channels"], *, parity: int) -> Float[Tensor, "..."]:
    """Texture (*batch, height, height, channels) of a checkerboard's lit corners, row by row; its padding is 0.

    Row j holds the corners (2 c + (j + parity) % 2, j), c from 0 to W/2 - 1.

    Raises:
        ValueError: when the height is above the width or below half of it, or the parity is neither 0 nor 1.

    >>> pack(torch.arange(1.0, 5.0).reshape(2, 2, 1), parity=0)[..., 0].tolist()
    [[1.0, 4.0], [3.0, 2.0]]
    """
    height, half = corners.shape[-3:-1]
    _require_size(2 * half, height, parity)
    column, row = _corner_of_texel(height, parity, corners.device)
    is_sample = column < 2 * half
    found = corners[..., row, torch.where(is_sample, column // 2, torch.zeros_like(column)), :]
    return torch.where(is_sample[..., None], found, torch.zeros_like(found))


def unpack(texture: Float[Tensor, "*batch height height channels"], *, width: int, parity: int) -> Float[Tensor, "..."]:
    """Lit corners (*batch, height, width / 2, channels) of a texture, row by row; the inverse of `pack`, to the bit.

    Raises:
        ValueError: when the width is odd, below the height or above twice of it, or the parity is neither 0 nor 1.
    """
    height = texture.shape[-2]
    _require_size(width, height, parity)
    row = torch.arange(height, device=texture.device)[:, None]
    column = 2 * torch.arange(width // 2, device=texture.device) + (row + parity) % 2
    return texture[(..., *_texel_of_corner(column, row, height, parity), slice(None))]


def lit(
    grid: Float[Tensor, "*batch height width channels"], *, parity: int
) -> Float[Tensor, "*batch height half channels"]:
    """Lit corners, row by row, of a grid of all of them, width even."""
    row = torch.arange(grid.shape[-3], device=grid.device)[:, None]
    return grid[..., row, 2 * torch.arange(grid.shape[-2] // 2, device=grid.device) + (row + parity) % 2, :]


def pack_all(grid: Float[Tensor, "*batch rows columns channels"], *, parity: int) -> Float[Tensor, "..."]:
    """Texture (*batch, rows, rows, channels) of all lit corners of a grid of any size up to two by one.

    For a picture of any size W x H, odd ones too, whose (W + 1) (H + 1) corners are all kept, the last column and row
    among them: rows = H + 1, columns = W + 1. Entries of the grid that are not lit are not read.

    Raises:
        ValueError: when there are more than twice as many columns as rows, or the parity is neither 0 nor 1.
    """
    rows, columns = grid.shape[-3:-1]
    _require_grid(rows, columns, parity)
    column, row = _corner_of_texel(rows, parity, grid.device)
    is_sample = column < columns
    found = grid[..., row, torch.where(is_sample, column, torch.zeros_like(column)), :]
    return torch.where(is_sample[..., None], found, torch.zeros_like(found))


def unpack_all(
    texture: Float[Tensor, "*batch rows rows channels"], *, columns: int, parity: int
) -> Float[Tensor, "..."]:
    """Grid (*batch, rows, columns, channels) of a texture, 0 where a corner is not lit; the inverse of `pack_all`.

    Raises:
        ValueError: when there are more than twice as many columns as rows, or the parity is neither 0 nor 1.
    """
    rows = texture.shape[-2]
    _require_grid(rows, columns, parity)
    row = torch.arange(rows, device=texture.device)[:, None]
    column = torch.arange(columns, device=texture.device)
    found = texture[(..., *_texel_of_corner(column, row, rows, parity), slice(None))]
    return torch.where(((column + row) % 2 == parity)[..., None], found, torch.zeros_like(found))


def filled(texture: Float[Tensor, "*batch height height channels"], *, width: int, parity: int) -> Float[Tensor, "..."]:
    """Texture whose padding repeats the nearest sample of its row, so that filters may reach beyond left and right."""
    height = texture.shape[-2]
    column, row = _corner_of_texel(height, parity, texture.device)
    first, last = (row + parity) % 2, width - 2 + (row + parity) % 2
    nearest = torch.where(column - last <= first + 2 * height - column, last, first)
    source = torch.where(column < width, column, nearest)
    return texture[(..., *_texel_of_corner(source, row, height, parity), slice(None))]


def texels(place: Float[Tensor, "*batch 2"], parity: int) -> Float[Tensor, "*batch 2"]:
    """Place in a texture of one in the picture: x and y in texels with centres at +0.5, not wrapped yet.

    A place in the picture is x and y in pixels from its upper left corner. The picture turned by 45 degrees and scaled
    by 1 / sqrt(2), plus an offset that is constant for a frame.
    """
    x, y = place.unbind(-1)
    return torch.stack([(x - y + parity) / 2 + 0.5, (x + y + parity) / 2 + 0.5], -1)


def sample(
    texture: Float[Tensor, "*batch height height channels"],
    place: Float[Tensor, "*#batch h w 2"],
    *,
    width: int,
    parity: int,
) -> Float[Tensor, "*batch h w channels"]:
    """Bilinear sample of a texture at places of the picture, x and y in pixels from its upper left corner.

    At a pixel's centre one of u and v is whole and the other half-way, so that one tap is the mean of the two lit
    corners of the pixel: a linear ramp is exact. Places are held within the centres of pixels whose corners there are:
    the last column and row, which lack some, repeat the last but one. Between centres less than a pixel from the upper
    or lower border, up to a quarter of the value wraps in from the other one.
    """
    height = texture.shape[-2]
    furthest = place.new_tensor([width - 1.5, height - 1.5])
    inside = torch.minimum(place.clamp(min=0.5), furthest)
    return bilinear(texture, texels(inside, parity), wrapped)


def quads(width: int, height: int, *, parity: int) -> tuple[Float[Tensor, "3 4 2"], Float[Tensor, "4 2"]]:
    """Three quads whose blit, clipped to the texture, packs a checkerboard: their vertices, and what these show.

    Vertices are x and y in texels, from the texture's upper left corner; what they show is x and y in the buffer of
    W/2 x H lit corners, to be read at the nearest entry: its own four corners. The middle of every texel that holds a
    sample lies in exactly one quad. The three are the buffer turned, as it is, and moved by a whole texture to the
    right (what had v < 0) and up (what had u >= S).

    Raises:
        ValueError: as `pack`, and at width = 2 height with parity 1, which needs a fourth quad.
    """
    _require_size(width, height, parity)
    if width == 2 * height and parity == 1:
        raise ValueError(f"parity 1 of a picture {width} x {height} needs a fourth quad; use pack")
    corner = torch.tensor([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    moves = height * torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    # Entries of the buffer are as wide as two corners and as high as one, with the corner in their middle.
    return texels(corner - 0.5, parity) + moves[:, None], corner * torch.tensor([0.5, 1.0])


def _corner_of_texel(size: int, parity: int, device: torch.device) -> tuple[Int[Tensor, "s s"], Int[Tensor, "s s"]]:
    """Column, from 0 to 2 S - 1, and row of the corner that each texel holds."""
    down = torch.arange(size, device=device)[:, None]
    across = torch.arange(size, device=device)
    row = (down - across) % size
    turns = (row - down + across) // size  # whole textures between u - v and the row, 0 or 1
    return (down + across + turns * size - parity) % (2 * size), row


def _texel_of_corner(
    column: Int[Tensor, "*#batch"], row: Int[Tensor, "*#batch"], size: int, parity: int
) -> tuple[Int[Tensor, "..."], Int[Tensor, "..."]]:
    """Row and column of the texel that holds a lit corner; for one that is not lit, of a neighbour."""
    return (column + row + parity) // 2 % size, (column - row + parity) // 2 % size


def _require_size(width: int, height: int, parity: int) -> None:
    if width % 2 or not height <= width <= 2 * height:
        raise ValueError(
            f"a picture {width} x {height} has no tangram: the width must be even and from 1 to 2 times the height; "
            "pack_all takes all corners of others"
        )
    _require_grid(height, width, parity)


def _require_grid(rows: int, columns: int, parity: int) -> None:
    if columns > 2 * rows:
        raise ValueError(
            f"{columns} columns of corners on {rows} rows would meet in the texture; at most {2 * rows} fit: "
            "cut the picture into parts"
        )
    if parity not in (0, 1):
        raise ValueError(f"parity is {parity}; frames are 0 and 1 in turn")
