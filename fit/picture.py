"""A scene drawn as a whole picture, band by band: what `fit render` writes and a fit's `fitted.exr` holds."""

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

PIXELS_AT_ONCE = 1 << 18


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawn scene: its sky, black below the horizon, and the sun's disc alone, which is to be added."""

    sky: Float[np.ndarray, "height width 3"]
    disc: Float[np.ndarray, "height width 3"]


def draw(scene: Scene, camera: Camera) -> Picture:
    """Picture of a scene in float32."""
    picture = Picture(*(np.zeros((camera.height, camera.width, 3), np.float32) for _ in range(2)))
    zero = torch.zeros(())
    view = sky_view(scene, torch.zeros(1, 3))
    assert scene.sky is not None  # weather files without a sky are refused before
    tables = sky.prepare(scene.sky, view).tables
    sun = celestial.pre_exposed(scene.sun, scene.exposure.exposure)
    seen = sunlight(scene)
    lines = max(1, PIXELS_AT_ONCE // camera.width)
    for top in range(0, camera.height, lines):
        rows = slice(top, min(top + lines, camera.height))
        x, y = pixel_centres(camera, rows, zero)
        direction = camera.direction(x, y)
        shown = (camera.solid_angle(x, y) > 0.0)[..., None]
        here = sky.TabledView(sky_view(scene, direction), tables)
        picture.sky[rows] = (sky.render_tables(scene.sky, here) * shown).numpy()
        rays = Rays(torch.zeros(3), direction, torch.tensor(torch.inf))
        picture.disc[rows] = (celestial.render(sun, celestial.SunView(rays, seen)) * shown).numpy()
    return picture


def sunlight(scene: Scene) -> Float[torch.Tensor, "3"]:
    """Share of sunlight that reaches the eye through air and clouds."""
    assert scene.sky is not None
    towards = celestial.to_sun(scene.sun)
    view = sky_view(scene, towards)
    through = scattering.column(view.eye_altitude, towards[2])
    clear = 1.0 - sky.overcast_share(scene.sky, towards)
    return (
        scattering.transmittance(sky.medium(scene.sky), through)
        * clear
        * scattering.sunlit(view.eye_altitude, towards[2])
    )


def write(path: Path, picture: Picture, metadata: Mapping[str, object]) -> None:
    """Write a picture as OpenEXR: the sky first, the sun's disc as a second part."""
    exr.write(path, {"sky": {"RGB": picture.sky}, "sun": {"RGB": picture.disc}}, metadata)
