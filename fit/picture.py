"""A scene drawn as a whole picture, band by band: what `fit render` writes and a fit's `fitted.exr` holds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from diffrender.atmosphere import celestial, scattering, sky
from diffrender.rays import Camera, pixel_centres
from diffrender.scene import Scene, render, sky_view
from fit import exr

PIXELS_AT_ONCE = 1 << 17  # so many keep their intermediate results in a few dozen MB
BELOW_HORIZON = -0.01  # sine of an elevation below the ground's edge, which is at -0.0008 for an eye at 2 m


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawn scene: its sky, black below the horizon, and the sun's disc alone, which is to be added."""

    sky: Float[np.ndarray, "height width 3"]
    disc: Float[np.ndarray, "height width 3"]


def draw(scene: Scene, camera: Camera) -> Picture:
    """Picture of a scene in float32."""
    picture = Picture(*(np.zeros((camera.height, camera.width, 3), np.float32) for _ in range(2)))
    assert scene.sky is not None  # weather files without a sky are refused before
    tables = sky.prepare(scene.sky, sky_view(scene, torch.zeros(1, 3))).tables
    by_tables = {"sky": lambda parameters, view: sky.render_tables(parameters, sky.TabledView(view, tables))}
    to_sun = celestial.to_sun(scene.sun)
    lines = max(1, PIXELS_AT_ONCE // camera.width)
    for top in range(0, camera.height, lines):
        rows = slice(top, min(top + lines, camera.height))
        x, y = pixel_centres(camera, rows, torch.zeros(()))
        direction = camera.direction(x, y)
        # Half of a panorama is ground, and the disc is a few pixels: they are black, and not worth a formula.
        above = (camera.solid_angle(x, y) > 0.0) & (direction[..., 2] > BELOW_HORIZON)
        picture.sky[rows][above.numpy()] = render(scene, direction[above], by_tables).numpy()
        near = above & (direction @ to_sun > math.cos(2.0 * scattering.SUN_RADIUS))
        picture.disc[rows][near.numpy()] = render(scene, direction[near], {"sun disc": celestial.render}).numpy()
    return picture


def write(path: Path, picture: Picture, metadata: Mapping[str, object]) -> None:
    """Write a picture as OpenEXR: the sky first, the sun's disc as a second part."""
    exr.write(path, {"sky": {"RGB": picture.sky}, "sun": {"RGB": picture.disc}}, metadata)
