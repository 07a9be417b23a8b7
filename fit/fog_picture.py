"""Pictures of a fog fit: the photo as its fog explains it, and the photo without that fog."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import height_fog
from diffrender.atmosphere.celestial import pre_exposed, to_sun
from diffrender.atmosphere.height_fog import FogView
from diffrender.scene import Scene, skylight
from fit.exr import bands
from fit.fog import Fogged
from fit.fog_objective import IN_FOG, FogPixels, Lights, surfaces

LEAST_SEEN = 0.1  # share of the light behind fog that has to come through, for it to be told from noise

Radiance = Float[np.ndarray, "height width 3"]


def draw(fogged: Fogged, scene: Scene) -> dict[str, Radiance]:
    """A photo as a scene's fog explains it, and as it would be without that fog; in float32, band by band.

    Behind the fog is the given picture or, where there is none, a sky and surfaces of one brightness. Without fog it is
    NaN where less than 10 % come through; both are NaN where the distance is not known.
    """
    shape = fogged.seen.photo.radiance.shape
    fitted, bare = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    point = torch.from_numpy(fogged.solution.minimum.point)
    lights = fogged.objective.lights(point)
    ambient = skylight(scene)  # tables of a whole sky: not once for every band
    for rows in bands(shape[0]):
        line, column = np.nonzero(fogged.seen.known[rows])
        if line.size:
            line = line + rows.start
            pixels = fogged.seen.at(line, column)
            seen_fog, through = _fog(scene, pixels, ambient)
            fitted[line, column] = (seen_fog + through * _background(scene, pixels, lights, point)).numpy()
            without = (pixels.radiance - seen_fog).clamp(min=0.0) / through
            bare[line, column] = torch.where(through > LEAST_SEEN, without, torch.nan).numpy()
    return {"fog": fitted, "without fog": bare}


def _fog(
    scene: Scene, pixels: FogPixels, ambient: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """Radiance of a scene's fog alone, and the share of the light behind it that comes through."""
    assert scene.height_fog is not None  # a fog fit's scene has one
    sun = pre_exposed(scene.sun, scene.exposure.exposure)
    black = torch.zeros_like(pixels.radiance)
    view = FogView(pixels.rays, black, to_sun(sun), sun.irradiance, ambient)
    through = torch.exp(-torch.clamp(height_fog.optical_depth(scene.height_fog, pixels.rays), max=height_fog.OPAQUE))
    return height_fog.render(scene.height_fog, view), through


def _background(scene: Scene, pixels: FogPixels, lights: Lights, point: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
    if pixels.clear is not None:
        return surfaces(scene, pixels, point[-1])
    bright, behind = lights.strength[IN_FOG:]
    return torch.where(pixels.rays.length.isinf()[:, None], pixels.behind * behind, bright)
