"""FFXV's two tables by least squares: from the march of a sky over the sun's elevations, or from photos [1].

Each entry of a table stands for all azimuths round the sun, which differ by the phase functions alone. Differences are
relative to what is fitted, so that a dark side of the sky counts as much as the glow round the sun.

[1] M. Miyamoto, R. Driancourt, "Rendering techniques of Final Fantasy XV", SIGGRAPH 2016.
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import sky, sky_view
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.atmosphere.two_tables import DARK, HAZINESSES, ROWS, TwoTables, least_positive
from diffrender.rays import from_angles
from diffrender.scene import EYE_ALTITUDE

AZIMUTHS = 25  # from the sun's to the one opposite


@dataclass(frozen=True, eq=False)
class FittedTables:
    """Tables, and how far a sky drawn from them is from what they were fitted to.

    Attributes:
        tables: in float64.
        error: for each elevation of the sun, root of the mean square of the relative difference of radiance.
    """

    tables: TwoTables
    error: Float[Tensor, " suns"]


def from_march(of: Sky, elevations: Float[Tensor, " suns"]) -> FittedTables:
    """Tables of a sky without its overcast layer, for elevations of the sun [rad]."""
    clear = replace(of, overcast=torch.zeros_like(of.overcast))
    air, haze, cloud, error = zip(*(_one_sun(clear, elevation) for elevation in elevations), strict=True)
    return FittedTables(TwoTables(torch.stack(air), torch.stack(haze), torch.stack(cloud)), torch.stack(error))


def _one_sun(of: Sky, sun_elevation: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Rows of the two tables, the cloud's radiance, and the error."""
    eye = torch.tensor(EYE_ALTITUDE, dtype=torch.float64)
    azimuth = torch.linspace(0.0, math.pi, AZIMUTHS, dtype=torch.float64)
    direction = from_angles(*torch.meshgrid(sky_view.row_elevations(eye, ROWS), azimuth, indexing="ij"))
    to_sun = from_angles(sun_elevation, torch.zeros_like(sun_elevation))
    marched = sky.prepare_march(of, SkyView(direction, to_sun, torch.ones(3, dtype=torch.float64), eye))
    hazes = [replace(of, haziness=torch.tensor(haziness, dtype=torch.float64)) for haziness in HAZINESSES]
    wanted = torch.cat([sky.render(one, marched) for one in hazes], 1)
    functions = torch.cat([_functions(one, marched.view) for one in hazes], 1)
    found = least_positive(functions / (wanted + DARK)[..., None], wanted / (wanted + DARK))
    drawn = (functions * found[:, None]).sum(-1)
    error = ((drawn - wanted) / (wanted + DARK)).square().mean().sqrt()
    return found[..., 0], found[..., 1], marched.cloud, error


def _functions(of: Sky, view: SkyView) -> Float[Tensor, "*batch 3 2"]:
    """Phase functions of air and of haze [1/sr]."""
    by_air, by_haze = sky.phases(of, view)
    return torch.stack([by_air.expand_as(by_haze), by_haze], -1)
