"""Which pixels are sky: painted by the user, or found in the picture.

The automatic mask takes cells of a coarse picture that are quiet, that is, whose luminance differs little from that of
their neighbours, and of those the largest connected patch that reaches the top of the picture. Clouds with hard edges
stay outside it; so does what they cut off.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenImageIO
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_erosion
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from diffrender.rays import Camera, Cubemap, Equirectangular
from fit import exr, sun
from fit.input_error import InputError
from fit.photo import Photo
from fit.solution import SunPlace

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
WHITE = 128  # of 255, and brighter

LOWEST = math.radians(4.0)  # elevation below which haze and far hills are not told apart from sky
SUN_GLARE = math.radians(8.0)  # round the sun, where a lens adds light of its own
LARGEST_STEP = 0.12  # of log luminance between neighbouring cells of sky, 0.7 degrees wide in a panorama
LEAST_KNOWN = 0.5  # share of a cell's pixels
TOP = 0.1  # share of the elevations above LOWEST, from the highest down, where sky is sure to be
LEAST_SKY = 0.002  # share of what the picture shows above the horizon


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
    if not exr.first_bytes(path).startswith(PNG_MAGIC):
        raise InputError(f"{path} is no PNG; give a mask of the photo's size as PNG, white where there is sky")
    size = f"{photo.camera.width} x {photo.camera.height}"
    reader = OpenImageIO.ImageInput.open(str(path))
    if reader is None:
        OpenImageIO.geterror()  # an error that nobody fetched is printed when the program ends
        raise _damaged(path)
    spec = reader.spec()
    if (spec.width, spec.height) != (photo.camera.width, photo.camera.height):
        raise InputError(f"{path} is {spec.width} x {spec.height}, but the photo is {size}; give a mask of its size")
    pixels = reader.read_image(OpenImageIO.UINT8)
    reader.geterror()
    reader.close()
    if pixels is None:
        raise _damaged(path)
    colours = pixels[..., : 1 if spec.nchannels < 3 else 3]
    used: Bool[np.ndarray, "height width"] = (colours >= WHITE).all(-1)
    if not used.any():
        raise InputError(f"{path} is black everywhere, so no pixel would be used; paint the sky white")
    return Mask(used, f"painted in {path.name}")


def _damaged(path: Path) -> InputError:
    return InputError(f"{path} cannot be read as a PNG; it is damaged or cut off: save it again")


# Found


def find(photo: Photo, place: SunPlace) -> Mask:
    """Mask of the quiet sky, without what is low or near the sun.

    Raises:
        InputError: when there is no such sky.
    """
    cells = sun.reduced(photo)
    elevation = torch.asin(cells.direction[..., 2].clamp(-1.0, 1.0)).numpy()
    from_sun = torch.linalg.vector_norm(cells.direction - sun.direction(place), dim=-1).numpy()
    may_be_sky = (elevation > LOWEST) & (cells.usable > LEAST_KNOWN).numpy() & (cells.luminance > 0.0).numpy()
    patch = _patches(cells, photo.camera, may_be_sky)
    inside = _eroded(patch, photo.camera) & (from_sun > 2.0 * math.sin(SUN_GLARE / 2.0))
    size = np.bincount(np.where(inside, patch, 0).ravel(), cells.solid_angle.numpy().ravel(), patch.max() + 1)
    size[0] = 0.0
    least = LEAST_SKY * float(cells.solid_angle[cells.direction[..., 2] > 0.0].sum())
    highest = elevation[may_be_sky].max(initial=LOWEST)
    at_top = np.unique(patch[may_be_sky & (elevation >= highest - TOP * (highest - LOWEST))])
    how = "found: quiet, and connected to the top of the picture"
    chosen = at_top[size[at_top].argmax()] if at_top.size else 0
    if size[chosen] < least:
        how = "found: the largest quiet patch, because none reaches the top of the picture; look whether it is sky"
        chosen = size.argmax()
    if size[chosen] < least:
        raise InputError(f"no sky found in {photo.path}; paint it white in a picture of its size and give --mask PNG")
    return Mask(_enlarged(inside & (patch == chosen), cells.side, photo.camera), how)


def _patches(
    cells: sun.Reduced, camera: Camera, may_be_sky: Bool[np.ndarray, "rows columns"]
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


def _links(
    cells: sun.Reduced, camera: Camera, chosen: Bool[np.ndarray, "rows columns"]
) -> Int[np.ndarray, "n 2"]:
    """Pairs of neighbouring cells, by their number row by row, both of them chosen."""
    number = np.arange(chosen.size).reshape(chosen.shape)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    if isinstance(camera, Equirectangular):
        pairs.append((number[:, -1], number[:, 0]))
    links = np.concatenate([np.stack([one.ravel(), other.ravel()], -1) for one, other in pairs])
    links = links[chosen.ravel()[links].all(-1)]
    return _on_sphere(links, cells, chosen) if isinstance(camera, Cubemap) else links


def _on_sphere(
    links: Int[np.ndarray, "n 2"], cells: sun.Reduced, chosen: Bool[np.ndarray, "rows columns"]
) -> Int[np.ndarray, "m 2"]:
    """Pairs without those that are neighbours in the picture alone, and with those across the edges of faces."""
    direction = cells.direction.reshape(-1, 3).numpy()
    reach = 1.5 * float(cells.solid_angle.max().sqrt())
    links = links[np.linalg.norm(direction[links[:, 0]] - direction[links[:, 1]], axis=-1) < reach]
    on_edge = np.flatnonzero(chosen.ravel() & (np.bincount(links.ravel(), minlength=chosen.size) < 4))
    across = cKDTree(direction[on_edge]).query_pairs(reach, output_type="ndarray")
    return np.concatenate([links, on_edge[across]])


def _eroded(patch: Int[np.ndarray, "rows columns"], camera: Camera) -> Bool[np.ndarray, "rows columns"]:
    """Cells of patches that have no cell beside a patch among their eight neighbours; an edge is no neighbour."""
    inside = patch > 0
    wrap = 1 if isinstance(camera, Equirectangular) else 0
    wide = np.pad(inside, ((0, 0), (wrap, wrap)), mode="wrap")
    eroded: Bool[np.ndarray, "rows columns"] = binary_erosion(wide, np.ones((3, 3)), border_value=1)
    return eroded[:, wrap : wide.shape[1] - wrap]


def _enlarged(cells: Bool[np.ndarray, "rows columns"], side: int, camera: Camera) -> Bool[np.ndarray, "height width"]:
    """Every pixel as its cell."""
    return cells.repeat(side, 0)[: camera.height].repeat(side, 1)[:, : camera.width]
