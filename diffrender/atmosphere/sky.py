"""The sky: air, haze and ozone lit by the sun, with an overcast layer mixed in.

Tables of in-scatter without phase functions, applied when they are looked up, follow [1]; the haziness and the mixture
of clear and overcast sky follow [2]; the series over orders of scattering is [3].

Gradient: exact in every parameter and in the sun's place. The ground's edge, below which the sky is black, is not
differentiated.

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: advances in lighting and AA", SIGGRAPH 2017, slides 17-27.
[2] M. Miyamoto, R. Driancourt, "Rendering techniques of Final Fantasy XV", SIGGRAPH 2016.
[3] S. Hillaire, "A scalable and production ready sky and atmosphere rendering technique", EGSR, 2020.
"""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import multiple_scattering as multiple
from diffrender.atmosphere import (
    overcast,
    scattering,
    sky_reference,
    sky_tables,
    sky_view,
    stored_tables,
    two_tables,
)
from diffrender.atmosphere.scattering import Medium, Paths
from diffrender.atmosphere.sky_reference import USUAL, Fineness
from diffrender.atmosphere.sky_tables import Geometry, Size, SkyTables, TabledView, geometry
from diffrender.atmosphere.sky_view import SkyView, chord_square, elevation, horizon
from diffrender.atmosphere.stored_tables import Daylight
from diffrender.atmosphere.two_tables import TwoTabledView
from diffrender.effect import Effect, Rung
from diffrender.parameters import parameter, record
from diffrender.rays import from_angles

__all__ = ["EFFECT", "Geometry", "Size", "Sky", "SkyTables", "SkyView", "TabledView", "geometry", "medium"]
__all__ += ["overcast_share", "prepare", "quadrature", "render", "render_tables", "tables"]

_MARCH = 48  # steps of a ray
# Haze of the two weather types of "two weathers", in units of a clear day's: below what may be asked for, where the
# slope would hang on rounding, and above what blends well.
CLEAR, HAZY = 0.009, 10.0
WEATHER_SIZE = Size(rows=16, columns=6, steps=12, heights=5, suns=8, steps_around=5)  # of their tables
_HAZE_ALBEDO = 0.9  # share of the haze's extinction that is scattering, Bruneton and Neyret 2008


@record
class Sky:
    """Air and clouds of a whole sky; scalars, and colours with three channels."""

    haziness: Float[Tensor, ""] = parameter(
        0.76, bounds=(0.0, 0.99), unit="1",
        about="asymmetry g of the haze: turned up, its glow gathers round the sun",
    )  # fmt: skip
    mie_scale: Float[Tensor, ""] = parameter(
        1.0, bounds=(1e-2, 1e2), unit="1", scale="log",
        about="haze in units of a clear day's: turned up, the sky turns pale from the horizon up",
    )  # fmt: skip
    mie_colour_exponent: Float[Tensor, ""] = parameter(
        1.3, bounds=(-2.0, 4.0), unit="1",
        about="Angstrom exponent of the haze: 0 white, 2 blue smoke, negative browns the light that passes",
    )  # fmt: skip
    coarse_scale: Float[Tensor, ""] = parameter(
        0.05, bounds=(1e-3, 1e2), unit="1", scale="log",
        about="large particles (dust, sea salt, ice) in units of a clear day's haze: a white aureole",
    )  # fmt: skip
    coarse_haziness: Float[Tensor, ""] = parameter(
        0.9, bounds=(0.3, 0.99), unit="1", about="asymmetry g of the large particles: width of the aureole",
    )  # fmt: skip
    rayleigh_scale: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.1, 10.0), unit="1", scale="log",
        about="air in units of the earth's at sea level: turned up, a deeper sky and a redder low sun",
    )  # fmt: skip
    rayleigh_colour_exponent: Float[Tensor, ""] = parameter(
        4.0, bounds=(2.0, 6.5), unit="1",
        about="power of the wavelength in the air's scattering: 4, or as the camera separates colours",
    )  # fmt: skip
    ozone: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 6.0), unit="1", about="ozone in units of the earth's: bluer twilight",
    )  # fmt: skip
    ground_albedo: Float[Tensor, ""] = parameter(
        0.2, bounds=(0.0, 1.0), unit="1", about="share of light that the ground returns: brightens the sky from below",
    )  # fmt: skip
    overcast: Float[Tensor, ""] = parameter(
        0.0, bounds=(0.0, 1.0), unit="1",
        about="share of the light that comes from an even cloud layer, on the side where it is densest",
    )  # fmt: skip
    overcast_transmittance: Float[Tensor, "3"] = parameter(
        (0.35, 0.35, 0.35), bounds=(1e-3, 4.0), unit="1", scale="log",
        about="share of the light from above that the cloud layer lets through: its brightness and colour",
    )  # fmt: skip
    overcast_ahead: Float[Tensor, ""] = parameter(
        0.0, bounds=(-8.0, 8.0), unit="1", about="growth of the log odds of the overcast share towards +x",
    )  # fmt: skip
    overcast_left: Float[Tensor, ""] = parameter(
        0.0, bounds=(-8.0, 8.0), unit="1", about="growth of the log odds of the overcast share towards +y",
    )  # fmt: skip


def medium(sky: Sky) -> Medium:
    """Coefficients of the shell [1/m] under a sky's parameters."""
    like = sky.haziness
    ratio = torch.log(like.new_tensor(scattering.WAVELENGTH) / scattering.WAVELENGTH[1])
    fine, coarse = _haze_parts(sky, ratio)
    haze = fine + coarse
    return Medium(
        rayleigh=sky.rayleigh_scale
        * torch.exp((4.0 - sky.rayleigh_colour_exponent) * ratio)
        * like.new_tensor(scattering.RAYLEIGH),
        haze=haze,
        haze_scattering=_HAZE_ALBEDO * haze,
        ozone=sky.ozone * like.new_tensor(scattering.OZONE),
        ground_albedo=sky.ground_albedo,
    )


def _haze_parts(sky: Sky, log_wavelength: Tensor) -> tuple[Tensor, Tensor]:
    fine = scattering.HAZE * sky.mie_scale * torch.exp(-sky.mie_colour_exponent * log_wavelength)
    return fine, scattering.HAZE * sky.coarse_scale * torch.ones_like(log_wavelength)


def tables(sky: Sky, fixed: Geometry) -> SkyTables:
    """Tables of a sky: its in-scatter in every direction from the eye, phase functions left out."""
    return sky_tables.tables(medium(sky), fixed)


def daylight(sky: Sky, view: SkyView, fixed: Geometry) -> Daylight:
    """All that a sky gives a scene under the sun of a view; the overcast layer counts in none of it but `cloud`."""
    made = tables(sky, fixed)
    around, share = sky_view.upper_half(view)
    falling = _clear(sky, around, sky_tables.look_up(TabledView(around, made))) * share
    return Daylight(
        in_scatter=made.in_scatter,
        cloud=made.cloud,
        sunlight=sunlight(sky, view),
        skylight=falling.sum((0, 1)),
        amount=stored_tables.amount(medium(sky)),
    )


def sunlight(sky: Sky, view: SkyView) -> Float[Tensor, "3"]:
    """Share of the sun's irradiance that reaches the eye through the clear air."""
    eye, cosine = view.eye_altitude, view.to_sun[2]
    column = scattering.column(eye, scattering.to_visible_sun(eye, cosine))
    return scattering.transmittance(medium(sky), column) * scattering.sunlit(eye, cosine)


def prepare_two_tables(_sky: Sky, view: SkyView) -> TwoTabledView:
    """Tables that come with the package, at the elevation of a view's sun."""
    return TwoTabledView(view, two_tables.at_sun(two_tables.packaged(), view.to_sun))


def render_two_tables(sky: Sky, prepared: TwoTabledView) -> Float[Tensor, "*batch 3"]:
    """Radiance of the sky [W/(m² sr)] in Final Fantasy XV's form: two tables times the phase functions [2].

    Follows `haziness`, `coarse_haziness`, the overcast share, its lean and its transmittance. Its tables are made for
    given air (the default's, unless they are read from elsewhere), so of `mie_scale`, `mie_colour_exponent` and
    `coarse_scale` only what they do to the haze's phase function shows, and the other parameters nothing.

    At the defaults the root of the mean square of its relative error against `render` is 4 % for a sun at 60 degrees,
    6 % at 10, 18 % at 1, and 43 % at -4: of twilight it draws the brightness, but no earth's shadow.
    """
    by_air, by_haze = two_tables.look_up(prepared)
    found = torch.stack([by_air, by_haze, torch.zeros_like(by_air)], -2)
    return _compose(sky, prepared.view, found, prepared.tables.cloud)


def prepare_two_weathers(sky: Sky, view: SkyView) -> TabledView:
    """Tables blended between those of a clear and of a hazy weather, smaller ones than `prepare` makes [1].

    Every parameter but `mie_scale` enters both; above the haze of the hazy one it has no effect. The
    root of the mean square of its error against fresh tables is 1 to 5 % by day, from a tenth to eight times a clear
    day's haze, and 5 to 6 % at -4 degrees.
    """
    fixed = geometry(view, WEATHER_SIZE)
    weathers = [replace(sky, mie_scale=torch.full_like(sky.mie_scale, haze)) for haze in (CLEAR, HAZY)]
    amounts = torch.stack([stored_tables.amount(medium(one)) for one in weathers])
    clear, hazy = (tables(one, fixed) for one in weathers)
    # With an axis: torch's forward mode gives a tensor without one a tangent in double precision, whatever its own is.
    share = torch.clamp((sky.mie_scale[None] - CLEAR) / (HAZY - CLEAR), 0.0, 1.0)
    return TabledView(view, stored_tables.sky_blended(clear, hazy, amounts, share[0]))


def prepare(sky: Sky, view: SkyView) -> TabledView:
    """Tables for one eye and sun, from which any number of pictures is drawn."""
    return TabledView(view, tables(sky, geometry(view)))


def render_tables(sky: Sky, prepared: TabledView) -> Float[Tensor, "*batch 3"]:
    """Radiance of the sky [W/(m² sr)] from tables: a lookup, two phase functions and the overcast share for each pixel.

    Black below the ground's edge. Within 2 % of `render` for a sun above 10 degrees and 3 % at 1; after sunset by 4 %
    in the mean, and by up to a third along the edge of the earth's shadow, which eight columns do not draw.
    """
    return _compose(sky, prepared.view, sky_tables.look_up(prepared), prepared.tables.cloud)


def render(sky: Sky, marched: "MarchedView") -> Float[Tensor, "*batch 3"]:
    """Radiance of the sky [W/(m² sr)], each ray marched through the shell; light scattered more than once included.

    Black below the ground's edge.
    """
    view = marched.view
    found = sky_tables.in_scatter(medium(sky), _rays(view, _MARCH), marched.mean, sky_tables.suns(view))
    return _compose(sky, view, found, marched.cloud)


def render_single(sky: Sky, view: SkyView) -> Float[Tensor, "*batch 3"]:
    """The same with light scattered once only: too dark and too blue, by half at low sun."""
    air, rays = medium(sky), _rays(view, _MARCH)
    weights, _ = scattering.step_weights(air, rays)
    once = sky_tables.scattered_once(air, rays, weights)
    cloud = overcast.zenith_radiance(overcast.sunlight(air, overcast.cloud_top(view.to_sun[2])))
    return _compose(sky, view, torch.stack([*once, torch.zeros_like(once[0])], -2), cloud)


@record
class MarchedView:
    """A view with the mean radiance round every point of the shell."""

    view: SkyView
    mean: Float[Tensor, "heights suns 3"]
    cloud: Float[Tensor, "3"]


def prepare_march(sky: Sky, view: SkyView) -> MarchedView:
    """Table of higher orders, from which rays are marched."""
    air, suns = medium(sky), sky_tables.suns(view)
    mean = multiple.mean_radiance(air, multiple.table_paths(suns))
    top = overcast.cloud_top(view.to_sun[2])
    light = overcast.sunlight(air, top) + overcast.skylight(top, mean, suns)
    return MarchedView(view, mean, overcast.zenith_radiance(light))


def skip(sky: Sky, view: SkyView) -> Float[Tensor, "*batch 3"]:
    """No sky: black."""
    return torch.zeros_like(view.direction) * sky.haziness


def _rays(view: SkyView, steps: int) -> Paths:
    flat = torch.zeros_like(view.direction[..., 2])
    cos_angle = 1.0 - 0.5 * chord_square(view)
    return scattering.paths(view.eye_altitude + flat, view.direction[..., 2], view.to_sun[2] + flat, cos_angle, steps)


def _compose(sky: Sky, view: SkyView, found: Tensor, cloud: Tensor) -> Float[Tensor, "*batch 3"]:
    clear = _clear(sky, view, found)
    clouded = cloud * sky.overcast_transmittance * overcast.gradation(view.direction)
    share = overcast_share(sky, view.direction)[..., None]
    seen = (elevation(view.direction) >= horizon(view.eye_altitude))[..., None]
    return torch.lerp(clear, clouded, share) * view.irradiance * seen


def _clear(sky: Sky, view: SkyView, found: Tensor) -> Float[Tensor, "*batch 3"]:
    """Radiance of the sky without its overcast layer, per irradiance of the sun [1/sr]."""
    by_air, by_haze, higher = found.unbind(-2)
    air_phase, haze_phase = phases(sky, view)
    return by_air * air_phase + by_haze * haze_phase + higher


def phases(sky: Sky, view: SkyView) -> tuple[Float[Tensor, "*batch 1"], Float[Tensor, "*batch 3"]]:
    """Phase functions of air and of haze, fine and coarse mixed, between the sun and each direction [1/sr]."""
    chord = chord_square(view)
    fine_phase = scattering.cornette_shanks(chord, sky.haziness)
    coarse_phase = scattering.cornette_shanks(chord, sky.coarse_haziness)
    haze_phase = torch.lerp(fine_phase[..., None], coarse_phase[..., None], coarse_share(sky))
    return scattering.rayleigh_phase(chord)[..., None], haze_phase


def coarse_share(sky: Sky) -> Float[Tensor, "3"]:
    """Share of the haze's extinction that is the large particles', by channel."""
    ratio = torch.log(sky.haziness.new_tensor(scattering.WAVELENGTH) / scattering.WAVELENGTH[1])
    fine, coarse = _haze_parts(sky, ratio)
    return coarse / (fine + coarse)


def overcast_share(sky: Sky, direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Share of the light from a direction that comes from the cloud layer, in [0, 1]."""
    # Log odds that grow linearly over the ground plane, from about 0 on the side they lean to, so that the share and
    # the lean are told apart; written so that shares of 0 and 1 stay exactly that.
    lean = torch.sqrt(1.0 + sky.overcast_ahead * sky.overcast_ahead + sky.overcast_left * sky.overcast_left) - 1.0
    odds = torch.exp(sky.overcast_ahead * direction[..., 0] + sky.overcast_left * direction[..., 1] - lean)
    return sky.overcast * odds / (1.0 - sky.overcast + sky.overcast * odds)


def quadrature(sky: Sky, view: SkyView, fineness: Fineness = USUAL) -> Float[Tensor, "*batch 3"]:
    """Radiance of the sky [W/(m² sr)] from light scattered along straight rays, by `sky_reference`; float64 only."""
    air, cos_sun = medium(sky), view.to_sun[2]
    found, _ = sky_reference.in_scatter(air, view, torch.full_like(cos_sun, math.inf), fineness)
    top = torch.full_like(cos_sun, overcast.TOP)
    mean = sky_reference.mean_radiance(air, top[None], cos_sun[None], fineness)[0, 0]
    direct = sky_reference.sunlight(air, top, cos_sun) * torch.relu(cos_sun)
    return _compose(sky, view, found, overcast.zenith_radiance(direct + math.pi * mean))


def largest_change(sky: Sky, view: SkyView) -> Float[Tensor, ""]:
    """Bound on the radiance of any ray [W/(m² sr)], as if all sunlight within the shell met air or haze once.

    Higher orders are at most the largest mean radiance round any point; the overcast layer is brightest at the zenith.
    """
    table, (air_phase, haze_phase) = prepare_march(sky, view), phases(sky, view)
    sunlit = scattering.sunlit(torch.full_like(view.eye_altitude, scattering.TOP), sky_tables.suns(view)[1])
    clear = torch.maximum(air_phase, _HAZE_ALBEDO * haze_phase) * sunlit + table.mean.amax((0, 1))
    share = overcast_share(sky, view.direction)[..., None]
    return (torch.lerp(clear, table.cloud * sky.overcast_transmittance, share) * view.irradiance).amax()


def example_inputs(dtype: torch.dtype) -> SkyView:
    """All round a low sun: up, grazing, level and a thousandth of a degree off, at the ground's edge and below it."""
    places = [(90, 0), (60, 200), (45, 90), (30, 30), (15, 330), (5, 30), (5.5, 30), (6, 32), (5, 210), (5, 120)]
    places += [(1, 30), (1, 210), (0.1, 100), (0.001, 30), (0, 30), (0, 120), (-0.001, 210), (-0.04, 20), (-0.06, 20)]
    elevation, azimuth = torch.deg2rad(torch.tensor([*places, (-10, 0), (5, 30)], dtype=torch.float64)).unbind(-1)
    direction = from_angles(elevation, azimuth).to(dtype)
    irradiance = torch.tensor([1.474, 1.8504, 1.91198], dtype=dtype)
    return SkyView(direction[:-1], direction[-1], irradiance, torch.tensor(2.0, dtype=dtype))


EFFECT = Effect(
    parameters=Sky,
    prefix="SKY",
    rungs={
        "skip": Rung(skip),
        "two tables": Rung(render_two_tables, prepare_two_tables),
        "two weathers": Rung(render_tables, prepare_two_weathers),
        "tables": Rung(render_tables, prepare),
        "march single": Rung(render_single),
        "march": Rung(render, prepare_march),
    },
    reference=quadrature,
    # Mean radiance and its table of few cells; single scattering alone is within a tenth of this.
    tolerance=1.5e-3,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
