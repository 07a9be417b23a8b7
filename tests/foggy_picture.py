"""Photos of known fog, drawn over a made-up view of plain and boxes, with a little noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from diffrender.atmosphere import height_fog
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.parameters import defaults
from diffrender.rays import Perspective, Rays, from_angles, pixel_centres
from fit.photo import Photo
from fit.solution import SunPlace

CAMERA = Perspective(64, 40, np.radians(60.0), np.radians(-3.0))
EYE = 25.0
SUN = SunPlace(20.0, 40.0, "given by --sun", visible=False)  # to the right of the picture's middle
TRUTH = {
    "HEIGHT_FOG_EXTINCTION": 2e-3,
    "HEIGHT_FOG_SCALE_HEIGHT": 60.0,
    "HEIGHT_FOG_EXTINCTION_TINT_R": 0.9,
    "HEIGHT_FOG_EXTINCTION_TINT_B": 1.1,
    "HEIGHT_FOG_ASYMMETRY": 0.5,
}
SUNLIGHT, SKYLIGHT, BEHIND = (3.0, 2.6, 2.0), (0.3, 0.36, 0.5), (0.35, 0.42, 0.6)
FOG = replace(
    defaults(HeightFog, torch.float64),
    extinction=torch.tensor(TRUTH["HEIGHT_FOG_EXTINCTION"], dtype=torch.float64),
    scale_height=torch.tensor(TRUTH["HEIGHT_FOG_SCALE_HEIGHT"], dtype=torch.float64),
    extinction_tint=torch.tensor([0.9, 1.0, 1.1], dtype=torch.float64),
    asymmetry=torch.tensor(TRUTH["HEIGHT_FOG_ASYMMETRY"], dtype=torch.float64),
)


def view(camera=CAMERA):
    """Rays of a picture's pixels that end on a plain and on boxes of brightness by chance, and what they show."""
    direction = camera.direction(*pixel_centres(camera, slice(0, camera.height), torch.zeros((), dtype=torch.float64)))
    up = direction[..., 2]
    length = torch.where(up < 0.0, EYE / up.abs().clamp(min=1e-9), torch.inf)
    box = np.random.default_rng(0).uniform(40.0, 2500.0, (4, 16))  # each a column of boxes, up to 3 degrees high
    shown = np.kron(box, np.ones((camera.height // 4, camera.width // 16)))
    far = torch.minimum(length, torch.where(up < 0.05, torch.from_numpy(shown), torch.inf))
    shade = np.kron(np.random.default_rng(1).uniform(0.05, 0.6, (8, 16, 3)), np.ones((5, 4, 1)))
    is_sky = far.isinf()[..., None]
    clear = torch.where(is_sky, torch.tensor(BEHIND, dtype=torch.float64), torch.from_numpy(shade))
    return Rays(torch.tensor([0.0, 0.0, EYE], dtype=torch.float64).expand_as(direction), direction, far), clear


def drawn(fog=FOG, noise=0.01, sun=SUN):
    """Radiance with fog, that without, and distances; as arrays of a picture."""
    rays, clear = view()
    towards = from_angles(
        *(torch.tensor(np.radians(angle), dtype=torch.float64) for angle in (sun.elevation, -sun.azimuth))
    )
    lights = (torch.tensor(light, dtype=torch.float64) for light in (SUNLIGHT, SKYLIGHT))
    seen = height_fog.render(fog, FogView(rays, clear, towards, *lights)).numpy()
    noisy = seen * np.random.default_rng(2).lognormal(0.0, noise, seen.shape)
    return noisy.astype(np.float32), clear.numpy().astype(np.float32), rays.length.numpy().astype(np.float32)


def photo(radiance, distance=None, camera=CAMERA, **header):
    """Photo in memory."""
    known = {"time": None, "latitude": None, "longitude": None, "altitude": None, **header}
    return Photo(Path("foggy.exr"), radiance, camera, known, ("synthetic",), distance)
