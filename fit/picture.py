"""A scene drawn as a whole picture, band by band: what `fit render` writes and a fit's `fitted.exr` holds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import celestial, scattering, sky
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.rays import Camera, pixel_centres
from diffrender.scene import Scene, render, sky_view, sunlight
from fit import exr

PIXELS_AT_ONCE = 1 << 17  # so many keep their intermediate results in a few dozen MB
BELOW_HORIZON = -0.01  # sine of an elevation below the ground's edge, which is at -0.0008 for an eye at 2 m


Drawn = dict[str, exr.Radiance]


@dataclass(frozen=True, eq=False)
class Light:
    """What a picture's sky and sun are drawn from.

    Attributes:
        paint: radiance of the sky of a view.
        sunlight: share of the sun's light that reaches the eye through air and clouds.
    """

    paint: Callable[[SkyView], Tensor]
    sunlight: Float[Tensor, "3"]


def fresh(scene: Scene) -> Light:
    """Light from tables made for the scene."""
    of, view = scene_sky(scene), sky_view(scene, torch.zeros(1, 3))
    tables = sky.prepare(of, view).tables
    return Light(lambda seen: sky.render_tables(of, sky.TabledView(seen, tables)), sunlight(scene))


def scene_sky(scene: Scene) -> Sky:
    """Sky of a scene; weather files without one are refused before."""
    assert scene.sky is not None
    return scene.sky


def draw(scene: Scene, camera: Camera, light: Light | None = None) -> Drawn:
    """A scene's "sky" in float32, black below the horizon, and the "sun"'s disc alone, which is to be added.

    From fresh tables, or from the light given.
    """
    light = light or fresh(scene)
    seen, disc = (np.zeros((camera.height, camera.width, 3), np.float32) for _ in range(2))
    to_sun = celestial.to_sun(scene.sun)
    sky_alone = {"sky": lambda _, view: light.paint(view)}
    disc_alone = {"sun disc": lambda sun, view: celestial.render(sun, replace(view, transmittance=light.sunlight))}
    lines = max(1, PIXELS_AT_ONCE // camera.width)
    for top in range(0, camera.height, lines):
        rows = slice(top, min(top + lines, camera.height))
        x, y = pixel_centres(camera, rows, torch.zeros(()))
        direction = camera.direction(x, y)
        # Half of a panorama is ground, and the disc is a few pixels: they are black, and not worth a formula.
        above = (camera.solid_angle(x, y) > 0.0) & (direction[..., 2] > BELOW_HORIZON)
        seen[rows][above.numpy()] = render(scene, direction[above], sky_alone).numpy()
        near = above & (direction @ to_sun > math.cos(2.0 * scattering.SUN_RADIUS))
        disc[rows][near.numpy()] = render(scene, direction[near], disc_alone).numpy()
    return {"sky": seen, "sun": disc}


def write(path: Path, drawn: Mapping[str, exr.Radiance], metadata: Mapping[str, object]) -> None:
    """Write pictures as the parts of one OpenEXR file, in their order."""
    exr.write(path, {name: {"RGB": radiance} for name, radiance in drawn.items()}, metadata)
