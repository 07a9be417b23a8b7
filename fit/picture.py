"""A scene drawn as a whole picture, band by band: what `fit render` writes and a fit's `fitted.exr` holds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from diffrender.atmosphere import celestial, scattering, sky
from diffrender.rays import Camera, Rays, pixel_centres
from diffrender.scene import Scene, sky_view
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
    sun = celestial.pre_exposed(scene.sun, scene.exposure.exposure)
    to_sun, through = celestial.to_sun(scene.sun), sunlight(scene)
    lines = max(1, PIXELS_AT_ONCE // camera.width)
    for top in range(0, camera.height, lines):
        rows = slice(top, min(top + lines, camera.height))
        x, y = pixel_centres(camera, rows, torch.zeros(()))
        direction = camera.direction(x, y)
        # Half of a panorama is ground, and the disc is a few pixels: they are black, and not worth a formula.
        above = (camera.solid_angle(x, y) > 0.0) & (direction[..., 2] > BELOW_HORIZON)
        here = sky.TabledView(sky_view(scene, direction[above]), tables)
        picture.sky[rows][above.numpy()] = sky.render_tables(scene.sky, here).numpy()
        near = above & (direction @ to_sun > math.cos(2.0 * scattering.SUN_RADIUS))
        rays = Rays(torch.zeros(3), direction[near], torch.tensor(torch.inf))
        picture.disc[rows][near.numpy()] = celestial.render(sun, celestial.SunView(rays, through)).numpy()
    return picture


def sunlight(scene: Scene) -> Float[torch.Tensor, "3"]:
    """Share of sunlight that reaches the eye through air and clouds."""
    assert scene.sky is not None
    towards = celestial.to_sun(scene.sun)
    view = sky_view(scene, towards)
    through = scattering.column(view.eye_altitude, scattering.to_visible_sun(view.eye_altitude, towards[2]))
    clear = 1.0 - sky.overcast_share(scene.sky, towards)
    return (
        scattering.transmittance(sky.medium(scene.sky), through)
        * clear
        * scattering.sunlit(view.eye_altitude, towards[2])
    )


def write(path: Path, picture: Picture, metadata: Mapping[str, object]) -> None:
    """Write a picture as OpenEXR: the sky first, the sun's disc as a second part."""
    exr.write(path, {"sky": {"RGB": picture.sky}, "sun": {"RGB": picture.disc}}, metadata)
