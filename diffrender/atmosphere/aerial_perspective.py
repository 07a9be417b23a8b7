"""Aerial perspective of Final Fantasy XV: what the air between the eye and an object adds to it and takes away [1].

    seen = inscatter + exp(-a distance) × object
    inscatter = (w1 Mid1 + ... + wn Midn + w Background) phase, for air and for haze each

The tables of the middle ground and of the background, which is the horizon of the sky's, hold light that is scattered
on level rays; B-splines over distance combine them. As of `two_tables`, haziness alone acts on them afterwards, and
azimuths round the sun differ by the phase functions alone. Light that is scattered more than once comes from all around
and fits neither function, so the dearer rung has a third table for it.

How the talk spreads its splines over distance is not public. Here they are even in 1 - exp(-optical depth), the mean of
the channels: of even air that is what an object's light loses, so that few splines follow it, the first is the eye and
the last is the sky behind all objects.

What it does not draw: shadows of objects and clouds in the air. The sky behind is not its own: a ray of infinite length
is drawn to the end of the air, over a background that has none.

Gradient: exact in every parameter and input, at no distance too; at the length where a ray leaves the air or meets the
ground of the planet the mean of both sides. Which cubic piece a distance lies in has no part in it.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slides "Atmospheric
    Scattering (Aerial perspective)".
"""

import math
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import multiple_scattering as multiple
from diffrender.atmosphere import scattering, sky, sky_reference, sky_tables, two_tables
from diffrender.atmosphere.scattering import Lines, Medium
from diffrender.atmosphere.sky_view import SkyView, chord_square
from diffrender.effect import Effect, Rung
from diffrender.numerics import b_splines, mean_decay, opacity, safe_sqrt
from diffrender.parameters import defaults, parameter, record
from diffrender.rays import from_angles

SPLINES = 7  # the eye's, those of the middle ground, and the background's
_MARCH = 32  # steps of a ray
_FARTHEST = 1e9  # length of rays into the sky, which may be given as infinite [m]
_AZIMUTHS, _DISTANCES, _STEPS = 7, 16, 24  # from which the tables are made


@record
class AerialPerspective:
    """What an artist may tune of it; the air itself is the sky's."""

    distance_scale: Float[Tensor, ""] = parameter(
        1.0, bounds=(1e-2, 1e2), unit="1", scale="log",
        about="by what distances are multiplied: turned up, the middle ground turns pale sooner",
    )  # fmt: skip
    haziness: Float[Tensor, ""] = parameter(
        0.76, bounds=(0.0, 0.99), unit="1",
        about="asymmetry g of the haze: turned up, its glow gathers under the sun",
    )  # fmt: skip
    tint: Float[Tensor, "3"] = parameter(
        (1.0, 1.0, 1.0), bounds=(0.0, 16.0), unit="1",
        about="colour that artists multiply the light of the middle ground with",
    )  # fmt: skip


@record
class AerialView:
    """Objects, and the air in front of them."""

    view: SkyView
    length: Float[Tensor, "*#batch"]  # of each ray to its object [m]; infinite for the sky
    background: Float[Tensor, "*#batch 3"]  # radiance of the object [W/(m^2 sr)]
    air: Medium
    around: Float[Tensor, "heights suns 3"]  # mean radiance round every point of the air, as of `through`


@record
class Tables:
    """Light per irradiance of the sun before phase functions [1], by B-splines over distance, the nearest first."""

    air: Float[Tensor, "splines 3"]
    haze: Float[Tensor, "splines 3"]
    higher: Float[Tensor, "splines 3"]  # radiance [1/sr] of light scattered more than once, where air and haze lack it


@record
class TabledView:
    """A view with its tables."""

    seen: AerialView
    tables: Tables


def through(air: Medium, view: SkyView, length: Float[Tensor, "*#batch"], background: Tensor) -> AerialView:
    """Objects at distances [m] with their radiance [W/(m² sr)], and the table of higher orders of an air round them."""
    return AerialView(
        view, length, background, air, multiple.mean_radiance(air, multiple.table_paths(sky_tables.suns(view)))
    )


def render(perspective: AerialPerspective, seen: AerialView) -> Float[Tensor, "*batch 3"]:
    """Radiance of objects through the air [W/(m² sr)], each ray marched as far as its object."""
    along = scattering.stretches(_lines(seen.view), _distance(perspective, seen), _MARCH)
    weights, passed = scattering.step_weights(seen.air, along)
    found = sky_tables.gathered(seen.air, along, weights, seen.around, sky_tables.suns(seen.view))
    return _compose(perspective, seen, found, passed)


def render_two_tables(perspective: AerialPerspective, prepared: TabledView) -> Float[Tensor, "*batch 3"]:
    """The same from tables of level rays [1]: splines of one distance, two phase functions and one exponential.

    The tint leaves the background's table as it is. All rays count as level, in air as dense as at the eye.
    """
    distance = _distance(perspective, prepared.seen)
    even = torch.ones_like(distance)[..., None].expand(*distance.shape, 2)
    return _from_tables(perspective, prepared, distance, even)


def render_tables(perspective: AerialPerspective, prepared: TabledView) -> Float[Tensor, "*batch 3"]:
    """The same for rays that rise into thinner air too, over flat ground.

    They count as level ones of the same optical depth, with as much air and haze in it as they meet themselves.
    """
    distance, eye = _distance(perspective, prepared.seen), prepared.seen.view.eye_altitude
    # Not below the ground, where the density of a ray that should have ended would overflow.
    rise = torch.maximum(distance * prepared.seen.view.direction[..., 2], -eye)
    heights = (scattering.RAYLEIGH_HEIGHT, scattering.HAZE_HEIGHT)
    return _from_tables(perspective, prepared, distance, torch.stack([mean_decay(rise / h) for h in heights], -1))


def _from_tables(
    perspective: AerialPerspective, prepared: TabledView, distance: Tensor, dense: Float[Tensor, "*batch 2"]
) -> Float[Tensor, "*batch 3"]:
    """Radiance of objects behind air and haze, whose mean densities are given in those at the eye."""
    seen, tables = prepared.seen, prepared.tables
    at_eye = _extinctions(seen)
    depth = distance[..., None] * (dense @ at_eye)
    weights = b_splines(opacity(depth.mean(-1)), SPLINES)
    tint = torch.cat([perspective.tint.expand(SPLINES - 1, 3), torch.ones_like(tables.air[-1:])])
    by_air, by_haze, higher = (weights @ (tint * table) for table in (tables.air, tables.haze, tables.higher))
    air_phase, haze_phase = phases(perspective, seen.view)
    share = dense * (at_eye.sum() / (dense @ at_eye).sum(-1, keepdim=True))
    once = by_air * air_phase * share[..., :1] + by_haze * haze_phase * share[..., 1:]
    added = (once + higher) * seen.view.irradiance
    return added + torch.exp(-depth) * seen.background


def prepare_two_tables(_perspective: AerialPerspective, seen: AerialView) -> TabledView:
    """Tables of air and of haze alone [1], for one eye, sun and air: higher orders are in both, as well as they fit.

    By least squares relative to the light, over azimuths and amounts of haziness, as `two_tables` are for the sky.
    """
    air, haze = (splined(factor) for factor in _two_factors(_sampled(seen)).unbind(-1))
    return TabledView(seen, Tables(air, haze, torch.zeros_like(air)))


def prepare(_perspective: AerialPerspective, seen: AerialView) -> TabledView:
    """Tables for one eye, sun and air, from which any number of pictures is drawn; higher orders in one of their own.

    They are means over all azimuths, which light scattered once leaves to the phase functions but for a low sun.
    """
    return TabledView(seen, Tables(*(splined(light) for light in _sampled(seen).light.mean(1).unbind(1))))


@record
class _Sampled:
    """In-scatter on level rays, without phase functions: at `places`, and at last to the end of the air."""

    light: Float[Tensor, "distances azimuths 3 3"]  # as of `sky_tables.in_scatter`
    chord_square: Float[Tensor, " azimuths"]


def _sampled(seen: AerialView) -> _Sampled:
    cos_sun, eye = seen.view.to_sun[2], seen.view.eye_altitude
    azimuth = torch.linspace(0.0, math.pi, _AZIMUTHS).to(cos_sun)
    cos_angle = torch.cos(azimuth) * safe_sqrt(1.0 - cos_sun * cos_sun)
    place = places().to(cos_sun)
    distance = -torch.log1p(-place) / _extinctions(seen).sum(0).mean()
    distance = torch.cat([distance, torch.full_like(place[:1], _FARTHEST)])[:, None]
    level = torch.zeros_like(cos_angle * distance)
    along = scattering.stretches(
        Lines(eye + level, level, cos_sun + level, cos_angle + level), distance + level, _STEPS
    )
    light = sky_tables.in_scatter(seen.air, along, seen.around, sky_tables.suns(seen.view))
    return _Sampled(light, 2.0 - 2.0 * cos_angle)


def _two_factors(sampled: _Sampled) -> Float[Tensor, "distances 3 2"]:
    """What the phase functions of air and of haze are to be multiplied by."""
    functions, wanted, chord = [], [], sampled.chord_square
    for haziness in two_tables.HAZINESSES:
        haze = scattering.cornette_shanks(chord, chord.new_tensor(haziness))
        phase = torch.stack([scattering.rayleigh_phase(chord), haze], -1)
        light = (sampled.light[..., :2, :] * phase[..., None]).sum(-2) + sampled.light[..., 2, :]
        functions.append(phase[:, None] / (light + two_tables.DARK)[..., None])
        wanted.append(light / (light + two_tables.DARK))
    return two_tables.least_positive(torch.cat(functions, 1), torch.cat(wanted, 1))


def splined(light: Float[Tensor, "distances 3"]) -> Float[Tensor, "splines 3"]:
    """Coefficients of the splines that follow light over the places, from 0 to what it is at the end, given last."""
    background = light[-1:]
    of_background, solver = (constant.to(light) for constant in _solver())
    middle = solver @ (light[:-1] - of_background * background)
    return torch.cat([torch.zeros_like(background), middle, background])


@cache
def _solver() -> tuple[Float[Tensor, "distances 1"], Float[Tensor, "middle distances"]]:
    """Spline of the background at each place, and what takes light less that to the middle ground's coefficients."""
    place = places()
    splines = b_splines(place, SPLINES)
    return splines[:, -1:], torch.linalg.pinv(splines[:, 1:-1] / place[:, None]) / place


def places() -> Float[Tensor, " distances"]:
    """Places among the splines at which tables are fitted, from 0, the eye, to 1, the end of the air."""
    return (torch.arange(_DISTANCES, dtype=torch.float64) + 0.5) / _DISTANCES


def _extinctions(seen: AerialView) -> Float[Tensor, "2 3"]:
    """Of air and of haze at the eye [1/m]."""
    return scattering.density(seen.view.eye_altitude)[:2, None] * seen.air.extinction()[:2]


def _distance(perspective: AerialPerspective, seen: AerialView) -> Float[Tensor, "*batch"]:
    near = torch.clamp(seen.length, max=_FARTHEST)  # before the product, whose gradient would be infinite
    return perspective.distance_scale * near + torch.zeros_like(seen.view.direction[..., 2])


def _lines(view: SkyView) -> Lines:
    flat = torch.zeros_like(view.direction[..., 2])
    cos_angle = 1.0 - 0.5 * chord_square(view)
    return Lines(view.eye_altitude + flat, view.direction[..., 2], view.to_sun[2] + flat, cos_angle)


def phases(
    perspective: AerialPerspective, view: SkyView
) -> tuple[Float[Tensor, "*batch 1"], Float[Tensor, "*batch 1"]]:
    """Phase functions of air and of haze between the sun and each direction [1/sr]."""
    chord = chord_square(view)
    haze = scattering.cornette_shanks(chord, perspective.haziness)
    return scattering.rayleigh_phase(chord)[..., None], haze[..., None]


def _compose(perspective: AerialPerspective, seen: AerialView, found: Tensor, passed: Tensor) -> Tensor:
    by_air, by_haze, higher = found.unbind(-2)
    air_phase, haze_phase = phases(perspective, seen.view)
    tint = _tint(perspective, seen)
    added = (by_air * air_phase + by_haze * haze_phase + higher) * tint * seen.view.irradiance
    return added + passed * seen.background


def _tint(perspective: AerialPerspective, seen: AerialView) -> Float[Tensor, "*batch 3"]:
    """The tint as far as the splines of the middle ground reach; none where the background's is all."""
    place = opacity(_distance(perspective, seen) * _extinctions(seen).sum(0).mean())
    background = b_splines(place, SPLINES)[..., -1:]
    return torch.lerp(perspective.tint, torch.ones_like(perspective.tint), background)


def skip(perspective: AerialPerspective, seen: AerialView) -> Float[Tensor, "*batch 3"]:
    """No air: the object."""
    return seen.background + torch.zeros_like(seen.view.direction) * perspective.distance_scale


def quadrature(perspective: AerialPerspective, seen: AerialView) -> Float[Tensor, "*batch 3"]:
    """The same as `render` with every integral by `sky_reference`; float64 only."""
    found, passed = sky_reference.in_scatter(seen.air, seen.view, _distance(perspective, seen))
    return _compose(perspective, seen, found, passed)


def largest_change(perspective: AerialPerspective, seen: AerialView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all rays [W/(m² sr)]: as if all air were as dense as on the ground.

    All light that a ray loses comes back as sunlight that met air or haze once, or as the largest mean radiance.
    """
    air_phase, haze_phase = phases(perspective, seen.view)
    once = torch.maximum(air_phase, haze_phase) + seen.around.amax((0, 1))
    added = once * torch.clamp(perspective.tint, min=1.0) * seen.view.irradiance
    lost = opacity(_distance(perspective, seen)[..., None] * seen.air.extinction().sum(0))
    return (lost * torch.maximum(added, seen.background.abs())).amax()


# Elevation of the ray, azimuth from the sun's [degrees], length [m].
_EXAMPLES = (
    (0.0, 0.0, 1e3),
    (0.0, 60.0, 1e4),
    (0.001, 120.0, 5e4),
    (-0.05, 180.0, 1e4),
    (2.0, 30.0, 3e4),
    (5.0, 200.0, 1.5e5),
    (-5.0, 90.0, 3e2),
    (10.0, 10.0, 2e4),
    (0.0, 90.0, 0.0),
    (0.0, 45.0, torch.inf),
    (0.5, 359.0, 2e5),
)


def example_inputs(dtype: torch.dtype) -> AerialView:
    """From a hill under a sun at 10 degrees: level, nearly level, up, down, to the end of the air and of no length."""
    elevation, azimuth, length = torch.tensor(_EXAMPLES, dtype=torch.float64).unbind(-1)
    to_sun = from_angles(*torch.deg2rad(torch.tensor([10.0, 0.0], dtype=torch.float64)))
    shade = torch.linspace(0.02, 0.3, len(_EXAMPLES), dtype=torch.float64)[:, None]
    view = SkyView(
        from_angles(elevation.deg2rad(), azimuth.deg2rad()).to(dtype),
        to_sun.to(dtype),
        irradiance=torch.tensor([1.474, 1.8504, 1.91198], dtype=dtype),
        eye_altitude=torch.tensor(30.0, dtype=dtype),
    )
    background = (shade * torch.tensor([1.2, 1.0, 0.6], dtype=torch.float64)).to(dtype)
    return through(sky.medium(defaults(sky.Sky, dtype)), view, length.to(dtype), background)


EFFECT = Effect(
    parameters=AerialPerspective,
    prefix="AERIAL_PERSPECTIVE",
    rungs={
        "skip": Rung(skip),
        "two tables": Rung(render_two_tables, prepare_two_tables),
        "three tables": Rung(render_tables, prepare),
        "march": Rung(render),
    },
    reference=quadrature,
    # Mean radiance and its table of few cells, as of the sky; at short distances a tenth of this.
    tolerance=1.5e-3,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
