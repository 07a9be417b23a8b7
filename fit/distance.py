"""How far what a photo shows is from the camera: a channel of the photo itself, a second file, or level ground."""

from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float

from diffrender.atmosphere.scattering import PLANET_RADIUS
from diffrender.rays import Camera, Perspective, pixel_centres
from fit import exr
from fit.exr import bands
from fit.input_error import InputError
from fit.photo import Photo

Kind = Literal["euclidean", "depth"]
KINDS: tuple[str, ...] = get_args(Kind)
LEVEL = Path("level")  # given for a file: there is none, but what is seen is the ground or the sea
SKY = 1e8  # taken for infinite [m]; some programs write 10^9 or 10^10 where there is nothing

Distance = Float[np.ndarray, "height width"]


def of(photo: Photo, path: Path | None, kind: str, eye_height: float) -> Distance | None:
    """Distance from the eye [m], infinite for the sky and NaN where it is not known; None without a file or channel.

    Args:
        photo: whose channel Z is used where there is no file.
        path: OpenEXR file with a channel Z, Y or R; of a picture in grey. `LEVEL` for a round earth at altitude 0.
        kind: "euclidean", along each pixel's ray, or "depth", along the camera's axis.
        eye_height: above level ground [m].

    Raises:
        InputError: for an unknown kind, or a file that cannot be read, has another size or no distance above 0.
    """
    if kind not in KINDS:
        raise InputError(f"--distance-kind {kind} is unknown; allowed are {', '.join(KINDS)}")
    if path == LEVEL:
        return _of_level_ground(photo.camera, eye_height)
    given = _read(path) if path is not None else photo.distance
    if given is None:
        return None
    source = path or photo.path
    camera = photo.camera
    if given.shape != (camera.height, camera.width):
        raise InputError(
            f"{source} has distances for {given.shape[1]} x {given.shape[0]} pixels, but the photo is "
            f"{camera.width} x {camera.height}; give one for each pixel"
        )
    far = np.where(given >= SKY, np.float32(np.inf), given)
    far[~(far > 0.0)] = np.nan
    if not np.isfinite(far).any():
        raise InputError(f"{source} holds no distance between 0 and {SKY:g} m; give metres, larger ones for the sky")
    return _along_rays(far, camera, source) if kind == "depth" else far


def _of_level_ground(camera: Camera, eye_height: float) -> Distance:
    if not eye_height > 0.0:
        raise InputError(f"--distance {LEVEL} looks down on the ground; give an --eye-height above 0")
    distance = np.full((camera.height, camera.width), np.inf, np.float32)
    tangent = eye_height * (2.0 * PLANET_RADIUS + eye_height)  # square of the distance to the horizon
    for rows in bands(camera.height):
        up = camera.direction(*pixel_centres(camera, rows, torch.zeros((), dtype=torch.float64)))[..., 2].numpy()
        down = -(PLANET_RADIUS + eye_height) * up
        meets = (down > 0.0) & (down * down >= tangent)
        # The nearer root as a quotient: as a difference it would lose its digits to the planet's size.
        distance[rows][meets] = tangent / (down[meets] + np.sqrt(down[meets] ** 2 - tangent))
    return distance


def _read(path: Path) -> Distance:
    distance = exr.read_channel(path, ("Z", "Y", "R"))
    # Some programs write distances as a picture in grey; one in colour is something else.
    if not np.array_equal(distance, exr.read_channel(path, ("Z", "Y", "G", "R")), equal_nan=True):
        raise InputError(f"{path} is a picture in colour; give an OpenEXR of distances in metres, in a channel Z")
    return distance


def _along_rays(depth: Distance, camera: Camera, source: Path) -> Distance:
    if not isinstance(camera, Perspective):
        raise InputError(f"{source}: only a perspective picture has a depth; give --distance-kind euclidean")
    ahead = camera.direction(torch.tensor(camera.width / 2.0), torch.tensor(camera.height / 2.0))
    for rows in bands(camera.height):
        x = torch.arange(camera.width) + 0.5
        y = torch.arange(*rows.indices(camera.height)) + 0.5
        columns, lines = torch.meshgrid(x, y, indexing="xy")
        depth[rows] /= (camera.direction(columns, lines) @ ahead).numpy()
    return depth
