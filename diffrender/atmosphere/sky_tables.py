"""Tables of the sky for one eye and one sun: in-scatter without phase functions, applied when they are looked up [1].

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: advances in lighting and AA", SIGGRAPH 2017, slides 17-27.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import multiple_scattering as multiple
from diffrender.atmosphere import overcast, scattering, sky_view
from diffrender.atmosphere.scattering import Medium, Paths
from diffrender.atmosphere.sky_view import SkyView
from diffrender.numerics import lookup, safe_sqrt
from diffrender.parameters import record


@dataclass(frozen=True)
class Size:
    """How finely the tables are cut: what a search spends, and what a picture does."""

    rows: int = 24
    columns: int = 8
    steps: int = 24
    heights: int = multiple.HEIGHTS
    suns: int = multiple.SUNS
    steps_around: int = multiple.STEPS


@record
class Geometry:
    """Rays of the tables, which depend on the eye and the sun but on no parameter of the sky."""

    rays: Paths  # (rows, columns)
    around: Paths  # of the table of mean radiance
    suns: Float[Tensor, "2"]  # over which it reaches
    cloud_top: overcast.CloudTop


@record
class SkyTables:
    """Sky per irradiance of the sun [1/sr], before phase functions; what a fit evaluates again and again."""

    in_scatter: Float[Tensor, "rows columns 3 3"]  # by air, by haze, and of higher orders
    cloud: Float[Tensor, "3"]  # radiance at the zenith of an overcast layer that lets all light through


@record
class TabledView:
    """A view with its tables."""

    view: SkyView
    tables: SkyTables


def geometry(view: SkyView, size: Size = Size()) -> Geometry:
    """Rays of the tables for an eye and a sun; kept by fits, where neither moves."""
    like = view.direction
    cos_sun = view.to_sun[2]
    elevation = sky_view.row_elevations(view.eye_altitude, size.rows)
    cos_view = torch.sin(elevation)[:, None]
    level = torch.cos(elevation)[:, None] * safe_sqrt(1.0 - cos_sun * cos_sun)
    cos_angle = cos_view * cos_sun + level * torch.linspace(-1.0, 1.0, size.columns).to(like)
    ground = torch.zeros_like(cos_view)
    reach = suns(view)
    return Geometry(
        rays=scattering.paths(view.eye_altitude + ground, cos_view, cos_sun + ground, cos_angle, size.steps),
        around=multiple.table_paths(reach, size.heights, size.suns, size.steps_around),
        suns=reach,
        cloud_top=overcast.cloud_top(cos_sun),
    )


def suns(view: SkyView) -> Float[Tensor, "2"]:
    """Lowest and highest cosine of the sun's local zenith angle over all points of an eye's rays."""
    return multiple.sun_range(view.to_sun[2], view.eye_altitude)


def tables(air: Medium, fixed: Geometry) -> SkyTables:
    """Tables of a medium: its in-scatter in every direction from the eye, phase functions left out."""
    mean = multiple.mean_radiance(air, fixed.around)
    light = overcast.sunlight(air, fixed.cloud_top) + overcast.skylight(fixed.cloud_top, mean, fixed.suns)
    return SkyTables(in_scatter(air, fixed.rays, mean, fixed.suns), overcast.zenith_radiance(light))


def look_up(prepared: TabledView) -> Float[Tensor, "*batch 3 3"]:
    """In-scatter by air, by haze and of higher orders along each view [1/sr]."""
    view, table = prepared.view, prepared.tables.in_scatter
    column = (0.5 + 0.5 * sky_view.cos_azimuth(view)) * (table.shape[1] - 1)
    return lookup(table, sky_view.row(view, table.shape[0]), column)


def in_scatter(
    air: Medium, rays: Paths, mean: Float[Tensor, "heights suns 3"], reach: Float[Tensor, "2"]
) -> Float[Tensor, "*batch 3 3"]:
    """Light per irradiance [1/sr] scattered by air and by haze, without phase functions, and of higher orders."""
    weights, _ = scattering.step_weights(air, rays)
    return gathered(air, rays, weights, mean, reach)


def gathered(
    air: Medium,
    rays: Paths,
    weights: Float[Tensor, "*rays n 3"],
    mean: Float[Tensor, "heights suns 3"],
    reach: Float[Tensor, "2"],
) -> Float[Tensor, "*batch 3 3"]:
    """The same by weights of each step that are known already."""
    around = multiple.look_up(mean, reach, rays.height, rays.cos_sun)
    higher = (weights * (rays.density @ air.scattering()) * around).sum(-2)
    return torch.stack([*scattered_once(air, rays, weights), higher], -2)


def scattered_once(
    air: Medium, rays: Paths, weights: Float[Tensor, "*rays n 3"]
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Light per irradiance [1] scattered once by air and by haze, without phase functions."""
    direct = weights * scattering.transmittance(air, rays.sun_column) * rays.sunlit
    by_haze = (direct * rays.density[..., 1:2]).sum(-2) * air.haze_scattering
    return (direct * rays.density[..., :1]).sum(-2) * air.rayleigh, by_haze
