"""Which pixels are sky: painted by the user, or found in the picture.

The automatic mask takes cells of a coarse picture that are quiet, that is, whose luminance differs little from that of
their neighbours, and of those the largest connected patch that reaches the top of the picture. Other quiet patches, cut
off by clouds or seen through trees, join it where they look like one smooth sky with it. Clouds with hard edges stay
outside.
"""

import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO
import torch
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import binary_erosion, median
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from diffrender.rays import Camera, Cubemap, Equirectangular
from fit.input_error import InputError
from fit.path_text import path_text
from fit.photo import Photo
from fit.smooth_sky import smooth_sky
from fit.solution import SunPlace
from fit.sun import Reduced, reduced, to_sun

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
WHITE = 128  # of 255, and brighter

LOWEST = math.radians(4.0)  # elevation below which haze and far hills are not told apart from sky
SUN_GLARE = math.radians(8.0)  # round the sun, where a lens adds light of its own
LARGEST_STEP = 0.12  # of log luminance between neighbouring cells of sky, 0.7 degrees wide in a panorama
LEAST_KNOWN = 0.5  # share of a cell's pixels
TOP = 0.1  # share of the elevations above LOWEST, from the highest down, where sky is sure to be
LEAST_SKY = 0.002  # share of what the picture shows above the horizon
ROOF = 20.0  # times as bright as the patch at the top another must be to show that there is a roof: clouds reach 6, day
# outside a barn 66


@dataclass(frozen=True, eq=False)
class Mask:
    """Which pixels are used, not yet without the invalid ones, and how that is known."""

    used: Bool[np.ndarray, "height width"]
    how: str


# Painted


def read(path: Path, photo: Photo) -> Mask:
    """Mask painted on the photo: used where every colour channel is white, or nearer to white than to black.

    What is transparent counts as black.

    Raises:
        InputError: when the file is no PNG of the photo's size, or black everywhere.
    """
    width, height = _size(path)
    wanted = photo.camera.width, photo.camera.height
    if (width, height) != wanted:
        raise InputError(
            f"{path} is {width} x {height}, but the photo is {wanted[0]} x {wanted[1]}; give a mask of the photo's size"
        )
    colours = _pixels(path)
    if colours.shape[2] in (2, 4):
        colours = colours[..., :-1]  # alpha is multiplied in
    used: Bool[np.ndarray, "height width"] = np.all(colours >= WHITE, axis=-1)
    if not used.any():
        raise InputError(f"{path} is black everywhere, so no pixel would be used; paint the sky white")
    return Mask(used, f"painted in {path.name}")


def _size(path: Path) -> tuple[int, int]:
    """Width and height that a PNG's header names."""
    try:
        if not path.is_file():
            raise InputError(f"{path} is no file; give a mask as PNG, white where there is sky")
        with path.open("rb") as file:
            first = file.read(24)
    except OSError as error:
        raise InputError(f"{path} cannot be opened ({error.strerror}); give a mask as PNG") from error
    if not first.startswith(PNG_MAGIC):
        raise InputError(f"{path} is no PNG; give a mask of the photo's size as PNG, white where there is sky")
    if len(first) < 24:
        raise _damaged(path)
    width, height = struct.unpack(">II", first[16:24])
    return width, height


def _pixels(path: Path) -> UInt8[np.ndarray, "height width channels"]:
    # What is damaged is refused here already, because libpng prints a line of its own.
    if not _is_whole(path.read_bytes()):
        raise _damaged(path)
    reader = OpenImageIO.ImageInput.open(path_text(path))
    if reader is None:
        OpenImageIO.geterror()  # an error that nobody fetched is printed when the program ends
        raise _damaged(path)
    pixels = reader.read_image(OpenImageIO.UINT8)
    reader.geterror()
    reader.close()
    if pixels is None:
        raise _damaged(path)
    colours: UInt8[np.ndarray, "height width channels"] = pixels
    return colours


def _is_whole(png: bytes) -> bool:
    """Whether the chunks of a PNG have their checksums, up to its end."""
    start = len(PNG_MAGIC)
    while start + 12 <= len(png):
        length, kind = struct.unpack_from(">I4s", png, start)
        end = start + 8 + length
        if png[end : end + 4] != struct.pack(">I", zlib.crc32(png[start + 4 : end])):
            return False
        if kind == b"IEND":
            return True
        start = end + 4
    return False


def _damaged(path: Path) -> InputError:
    return InputError(f"{path} cannot be read as a PNG; it is damaged or cut off: save it again")


# Found


def find(photo: Photo, sun: SunPlace) -> Mask:
    """Mask of the quiet sky, without what is low or near a sun that is seen.

    Where no quiet patch reaches the top of the picture, or one that does is a roof, it is the largest one that is sky.

    Raises:
        InputError: when there is no such sky.
    """
    cells = reduced(photo)
    elevation = torch.asin(cells.direction[..., 2].clamp(-1.0, 1.0)).numpy()
    known = (cells.usable > LEAST_KNOWN) & (cells.luminance > 0.0)
    may_be_sky = (elevation > LOWEST) & known.numpy()
    patch = _patches(cells, photo.camera, may_be_sky)
    inside = _eroded(patch > 0, photo.camera)
    if sun.visible:
        from_sun = torch.linalg.vector_norm(cells.direction - to_sun(sun), dim=-1).numpy()
        inside &= from_sun > 2.0 * math.sin(SUN_GLARE / 2.0)
    patch[~inside] = 0
    highest = elevation.max(where=may_be_sky, initial=LOWEST)
    sure, how = _surest(cells, patch, elevation >= highest - TOP * (highest - LOWEST))
    if not sure:
        raise InputError(f"no sky found in {photo.path}; give --mask PNG, of the photo's size and white where sky is")
    joined = _joined(photo, cells, patch, sure, to_sun(sun).numpy() if sun.visible else None)
    return Mask(_enlarged(np.isin(patch, joined), cells.side, photo.camera), f"sky found: {how}")


def _surest(
    cells: Reduced, patch: Int[np.ndarray, "rows columns"], is_top: Bool[np.ndarray, "rows columns"]
) -> tuple[int, str]:
    """Number of the patch that is most surely sky, and how that is known; 0 where none is large enough."""
    size = np.bincount(patch.ravel(), cells.solid_angle.numpy().ravel())
    size[0] = 0.0
    size[size <= LEAST_SKY * float(cells.solid_angle[cells.direction[..., 2] > 0.0].sum())] = 0.0
    if not size.any():
        return 0, ""
    at_top = np.append(patch[is_top], 0)
    chosen = at_top[size[at_top].argmax()]
    if not size[chosen]:
        return int(size.argmax()), "the largest quiet patch, as none reaches the top of the picture; look at it"
    bright = np.append(0.0, median(cells.luminance.numpy(), patch, np.arange(1, len(size))))
    outside = np.where(bright > ROOF * bright[chosen], size, 0.0)
    if outside.any():
        return int(outside.argmax()), "the largest quiet patch far brighter than the one at the top; look at it"
    return int(chosen), "quiet, and connected to the top of the picture"


def _joined(
    photo: Photo,
    cells: Reduced,
    patch: Int[np.ndarray, "rows columns"],
    sure: int,
    sunward: Float[np.ndarray, "3"] | None,
) -> list[int]:
    """Numbers of the patches that look like one smooth sky with a sure one, in luminance and colour."""
    chosen = patch > 0
    if (patch[chosen] == sure).all():
        return [sure]
    rows, columns = (
        np.minimum(np.arange(count) * cells.side + cells.side // 2, length - 1)
        for count, length in zip(patch.shape, (photo.camera.height, photo.camera.width), strict=True)
    )
    # One pixel of each cell is enough for a patch's colour.
    colour = np.maximum(photo.radiance[rows][:, columns][chosen].astype(np.float64), np.finfo(np.float32).tiny)
    seen = np.log(np.stack([cells.luminance.numpy()[chosen], *colour[:, [0, 2]].T / colour[:, 1]], -1))
    number = patch[chosen]
    sky = smooth_sky(cells.direction.numpy()[chosen].astype(np.float64), seen, number == sure, sunward)
    return [other for other in np.unique(number) if other == sure or sky.looks_like_sky(number == other)]


def _patches(
    cells: Reduced, camera: Camera, may_be_sky: Bool[np.ndarray, "rows columns"]
) -> Int[np.ndarray, "rows columns"]:
    """Number of the patch of connected quiet cells that a cell belongs to; 0 for none."""
    bright = cells.luminance.numpy().ravel()
    links = _links(cells, camera, may_be_sky)
    steps = np.abs(np.diff(np.log(bright[links])))[:, 0]
    quiet = may_be_sky.ravel().copy()
    quiet[links[steps >= LARGEST_STEP]] = False
    one, other = links[quiet[links].all(-1)].T
    graph = coo_array((np.ones(len(one), bool), (one, other)), shape=(bright.size, bright.size))
    _, patch = connected_components(graph, directed=False)
    return np.where(quiet, patch + 1, 0).reshape(may_be_sky.shape)


def _links(cells: Reduced, camera: Camera, chosen: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, "n 2"]:
    """Pairs of neighbouring cells, by their number row by row, both of them chosen."""
    number = np.arange(chosen.size).reshape(chosen.shape)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    if isinstance(camera, Equirectangular):
        pairs.append((number[:, -1], number[:, 0]))
    links = np.concatenate([np.stack([one.ravel(), other.ravel()], -1) for one, other in pairs])
    links = links[chosen.ravel()[links].all(-1)]
    return _on_sphere(links, cells, chosen) if isinstance(camera, Cubemap) else links


def _on_sphere(
    links: Int[np.ndarray, "n 2"], cells: Reduced, chosen: Bool[np.ndarray, "rows columns"]
) -> Int[np.ndarray, "m 2"]:
    """Pairs without those that are neighbours in the picture alone, and with those across the edges of faces."""
    direction = cells.direction.reshape(-1, 3).numpy()
    reach = 1.5 * cells.width
    links = links[np.linalg.norm(direction[links[:, 0]] - direction[links[:, 1]], axis=-1) < reach]
    on_edge = np.flatnonzero(chosen.ravel() & (np.bincount(links.ravel(), minlength=chosen.size) < 4))
    across = cKDTree(direction[on_edge]).query_pairs(reach, output_type="ndarray")
    return np.concatenate([links, on_edge[across]])


def _eroded(inside: Bool[np.ndarray, "rows columns"], camera: Camera) -> Bool[np.ndarray, "rows columns"]:
    """Cells all of whose eight neighbours are inside too; beyond an edge of the picture there is none."""
    wrap = 1 if isinstance(camera, Equirectangular) else 0
    wide = np.pad(inside, ((0, 0), (wrap, wrap)), mode="wrap")
    eroded: Bool[np.ndarray, "rows columns"] = binary_erosion(wide, np.ones((3, 3)), border_value=1)
    return eroded[:, wrap : wide.shape[1] - wrap]


def _enlarged(cells: Bool[np.ndarray, "rows columns"], side: int, camera: Camera) -> Bool[np.ndarray, "height width"]:
    """Every pixel as its cell."""
    return cells.repeat(side, 0)[: camera.height].repeat(side, 1)[:, : camera.width]
