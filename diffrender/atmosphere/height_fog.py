"""Height fog: fog that thins exponentially with altitude, lit by the sun and by an even sky, in closed form.

Single scattering in one species with one scale height, blended as in [1]: background times transmittance, plus
sunlight, plus skylight. With sun and fog at one scale height the sun's optical depth falls linearly with that of the
ray, so its dimming within the fog has a closed form too. Every sum is taken from the end of the ray where the fog is
densest, which neither overflows nor cancels.

What it does not draw: light scattered twice, shadows in the fog, the fog's effect on the light of surfaces. The ground
under a ray is flat; under the sun's rays it is flat or round, by rung.

Gradient: exact in every parameter, also along level rays and where the ray rises as steeply as the sun.

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: advances in lighting and AA", SIGGRAPH 2017, slides 18-25.
[2] S. Chapman, "The absorption and dissociative or ionizing effect of monochromatic radiation in an atmosphere on a
    rotating earth", Proceedings of the Physical Society 43, 1931.
"""

import math
from collections.abc import Callable, Iterable
from functools import partial
from itertools import cycle

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import height_fog_reference, scattering
from diffrender.atmosphere.scattering import PLANET_RADIUS
from diffrender.effect import Effect, Rung
from diffrender.numerics import decayed_between, opacity, safe_sqrt
from diffrender.parameters import parameter, record
from diffrender.rays import Rays, from_angles

FARTHEST = 1e9  # length of rays into the sky, which may be given as infinite [m]
OPAQUE = 1e4  # optical depth from which on nothing is seen, neither in float32 nor in float64
_DENSEST = 82.0  # e-folds above the density at the base height: beyond, products of gradients end in float32
_DEEPEST = 60.0  # e-folds by which a sun's ray dips below its end: beyond, fog that is not black is not there
_LOWEST_SUN = 1e-3  # cosine to the zenith at which the flat earth's sun stays when it sets


@record
class HeightFog:
    """Fog of a whole scene; scalars, and colours with three channels."""

    extinction: Float[Tensor, ""] = parameter(
        1e-3, bounds=(1e-7, 1.0), unit="1/m", scale="log",
        about="mean of the channels at the base height: turned up, the fog comes nearer",
    )  # fmt: skip
    extinction_tint: Float[Tensor, "3"] = parameter(
        (1.0, 1.0, 1.0), bounds=(0.05, 20.0), unit="1", scale="log",
        about="extinction by channel, over its mean: a channel turned up fades sooner with distance",
    )  # fmt: skip
    scale_height: Float[Tensor, ""] = parameter(
        120.0, bounds=(1.0, 2e4), unit="m", scale="log",
        about="climb over which the fog thins e-fold: turned down, a sharper top",
    )  # fmt: skip
    base_height: Float[Tensor, ""] = parameter(
        0.0, bounds=(-1e3, 5e3), unit="m", about="altitude of the given extinction: turned up, the fog rises",
    )  # fmt: skip
    albedo: Float[Tensor, "3"] = parameter(
        (0.97, 0.97, 0.97), bounds=(0.0, 1.0), unit="1",
        about="share of the extinction that is scattering: the colour of thick fog",
    )  # fmt: skip
    rayleigh_share: Float[Tensor, "3"] = parameter(
        (0.2, 0.2, 0.2), bounds=(0.0, 1.0), unit="1",
        about="share of the scattering with the phase function of molecules: turned up, fog away from the sun",
    )  # fmt: skip
    asymmetry: Float[Tensor, ""] = parameter(
        0.7, bounds=(-0.5, 0.99), unit="1",
        about="mean cosine g of the rest's scattering: turned up, its glow gathers round the sun",
    )  # fmt: skip
    sun_tint: Float[Tensor, "3"] = parameter(
        (1.0, 1.0, 1.0), bounds=(0.0, 16.0), unit="1", about="colour that artists multiply the sun's light with",
    )  # fmt: skip
    ambient_tint: Float[Tensor, "3"] = parameter(
        (1.0, 1.0, 1.0), bounds=(0.0, 16.0), unit="1", about="colour that artists multiply the sky's light with",
    )  # fmt: skip


@record
class FogView:
    """What is seen without fog, along which rays, and the light above the fog, exposed already."""

    rays: Rays  # infinite length for the sky
    background: Float[Tensor, "*#batch 3"]  # radiance [W/(m^2 sr)]
    to_sun: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]  # of a surface that faces the sun [W/m^2]
    sky_radiance: Float[Tensor, "3"]  # mean over all directions from which light falls on the fog [W/(m^2 sr)]


def render(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """Radiance behind and within the fog [W/(m² sr)], the sun's rays dimmed over a round earth.

    Holds with the sun at and below the horizon, whose air mass [2] is taken at the eye. The shadow that the ground
    itself casts is the irradiance's to tell.
    """
    mass = air_mass(fog, view.rays, view.to_sun)
    return _compose(fog, view, extinction(fog), partial(_sun_share, mass=mass))


def render_grey(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """The same for fog that dims all channels alike, whatever its tint: three exponentials a pixel instead of seven."""
    mass = air_mass(fog, view.rays, view.to_sun)
    return _compose(fog, view, fog.extinction[..., None], partial(_sun_share, mass=mass))


def render_flat(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """The same over a flat earth: as good down to a sun a few degrees high, and wrong below 1 degree."""
    return _compose(fog, view, extinction(fog), partial(_sun_share, mass=flat_air_mass(view.to_sun)))


def render_blend(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """Radiance by the talk's alpha blend [1]: all fog is lit by the sunlight that is given, dimmed by none of it."""
    return _compose(fog, view, extinction(fog), lambda _through, _zenith, depth: opacity(depth))


def skip(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """No fog: the background."""
    return view.background + torch.zeros_like(view.rays.direction) * fog.extinction


@record
class Through:
    """Where rays run in the fog, whatever its extinction."""

    up: Float[Tensor, "*batch"]  # climb per length
    eye: Float[Tensor, "*#batch"]  # density at the eye over that at the base height
    end: Float[Tensor, "*batch"]  # and at the far end
    mean: Float[Tensor, "*batch"]  # of the density over the ray
    length: Float[Tensor, "*batch"]  # [m]


def _compose(
    fog: HeightFog,
    view: FogView,
    extinctions: Float[Tensor, " extinctions"],
    sun_share: Callable[[Through, Tensor, Tensor], Tensor],
) -> Float[Tensor, "*batch 3"]:
    """Picture of fog with an extinction for each channel, or with one for all."""
    through = _through(fog, view.rays)
    molecules, droplets = _phases(fog, view)
    sun = fog.albedo * fog.sun_tint * view.irradiance
    sky = fog.albedo * fog.ambient_tint * view.sky_radiance
    dimmed = []
    for one in extinctions.unbind():
        depth = _depth(through, one)
        dimmed.append((torch.exp(-depth), sun_share(through, one * fog.scale_height, depth), opacity(depth)))
    colours = (colour.unbind(-1) for colour in (view.background, fog.rayleigh_share, sun, sky))
    return _from_planes(
        background * passed + sunlight * (droplets + share * (molecules - droplets)) * sunlit + skylight * dense
        for (passed, sunlit, dense), background, share, sunlight, skylight in zip(cycle(dimmed), *colours, strict=False)
    )


def _by_channel(draw: Callable[..., Tensor], *colours: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Picture of a function of one channel."""
    return _from_planes(draw(*channel) for channel in zip(*(c.unbind(-1) for c in colours), strict=True))


def _from_planes(planes: Iterable[Tensor]) -> Float[Tensor, "*batch 3"]:
    """Picture of planes, in which all is worked out: torch is several times slower along an axis of three."""
    return torch.stack(list(planes)).movedim(0, -1)


def phase(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """Share of scattered sunlight per solid angle that goes to the eye [1/sr], by channel."""
    molecules, droplets = _phases(fog, view)
    return torch.lerp(droplets[..., None], molecules[..., None], fog.rayleigh_share)


def _phases(fog: HeightFog, view: FogView) -> tuple[Tensor, Tensor]:
    x, y, z = (view.rays.direction[..., axis] - view.to_sun[axis] for axis in range(3))
    chord_square = x * x + y * y + z * z
    return scattering.rayleigh_phase(chord_square), scattering.henyey_greenstein(chord_square, fog.asymmetry)


def extinction(fog: HeightFog) -> Float[Tensor, "3"]:
    """Extinction at the base height by channel [1/m]; its mean is the record's, whatever the tint's."""
    return fog.extinction * fog.extinction_tint / fog.extinction_tint.mean()


def optical_depth(fog: HeightFog, rays: Rays) -> Float[Tensor, "*batch 3"]:
    """Optical depth of the fog along rays, by channel; at most 3e38.

    extinction × length × mean density, by decayed_between(density's exponent at the eye and at the end). A level ray is
    no special case, nor is one to infinity unless it is level, which counts as 10^9 m long. An eye more than 82 scale
    heights below the base height is taken to be there. In float32 its gradients end where it exceeds 1e25.
    """
    return _by_channel(partial(_depth, _through(fog, rays), most=3e38), extinction(fog))


def _through(fog: HeightFog, rays: Rays) -> Through:
    per_height = 1.0 / fog.scale_height
    up = rays.direction[..., 2]
    length = torch.clamp(rays.length, max=FARTHEST)
    eye = torch.clamp((rays.origin[..., 2] - fog.base_height) * per_height, min=-_DENSEST)
    climb = up * per_height * length
    # So much denser than the eye an end is opaque; both ends at one limit would be no fog at all.
    end = torch.clamp(eye + climb, min=-_DENSEST - 4.0)
    mean = decayed_between(eye, end, torch.ones_like(climb), climb)
    return Through(up, torch.exp(-eye), torch.exp(-end), mean, length)


def _depth(through: Through, extinction: Tensor, most: float = OPAQUE) -> Tensor:
    # The densest fog last: with it, the length alone may overflow where the optical depth does not.
    return torch.clamp(extinction * through.length * through.mean, max=most)


def sun_share(fog: HeightFog, rays: Rays, mass: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """Sunlight that the fog of a ray sends to the eye, over albedo, phase function and irradiance; in [0, opacity].

    Integral of exp(-depth - depth towards the sun) over the ray's optical depth, for a sun's air mass: its optical
    depth over that to the zenith. Falls to the opacity where the fog dims no sunlight, and smoothly through rays as
    steep as the sun's.
    """
    through = _through(fog, rays)

    def share(extinction: Tensor) -> Tensor:
        # Capped where it no longer changes what is seen, so that huge depths have no gradient.
        depth = _depth(through, extinction)
        return _sun_share(through, extinction * fog.scale_height, depth, mass)

    return _by_channel(share, extinction(fog))


def _sun_share(through: Through, zenith: Tensor, depth: Tensor, mass: Tensor) -> Tensor:
    """`sun_share` of one channel, whose optical depth from the base height to the zenith is given."""
    at_eye = torch.clamp(zenith * mass * through.eye, max=OPAQUE)
    at_end = depth + torch.clamp(zenith * mass * through.end, max=OPAQUE)
    # The growth of the whole path's depth, ray and sun, per depth of the ray is negative where a ray climbs steeply.
    return decayed_between(at_eye, at_end, depth, 1.0 - through.up * mass)


def flat_air_mass(to_sun: Float[Tensor, "3"]) -> Float[Tensor, ""]:
    """Air mass towards the sun over a flat earth; from 0.06 degrees down it no longer grows."""
    return 1.0 / torch.clamp(to_sun[2], min=_LOWEST_SUN)


def air_mass(fog: HeightFog, rays: Rays, to_sun: Float[Tensor, "3"]) -> Float[Tensor, "*#batch"]:
    """Air mass from the eye towards the sun over a round earth, in units of the scale height [2].

    Within 0.1 % above the horizon and 0.5 % below, where it is twice that of the ray's lowest point less that of the
    way back up.
    """
    radius = (PLANET_RADIUS + rays.origin[..., 2]) / fog.scale_height
    cosine = to_sun[2]
    sets = cosine < 0.0
    up = scattering.chapman(radius, torch.where(sets, -cosine, cosine).expand_as(radius))
    dip = radius * cosine * cosine / (1.0 + safe_sqrt(1.0 - cosine * cosine))
    level = torch.sqrt(math.pi / 2.0 * torch.relu(radius - dip))
    through = 2.0 * level * torch.exp(torch.clamp(torch.where(sets, dip, torch.zeros_like(dip)), max=_DEEPEST))
    return torch.where(sets, through - up, up)


def largest_change(fog: HeightFog, view: FogView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all rays [W/(m² sr)]: as if no sunlight were dimmed before it is scattered."""
    light = phase(fog, view) * fog.sun_tint * view.irradiance + fog.ambient_tint * view.sky_radiance
    return (opacity(optical_depth(fog, view.rays)) * torch.maximum(view.background.abs(), fog.albedo * light)).amax()


# Eye [m], elevation and azimuth of the ray [degrees], length [m].
_EXAMPLES = (
    (30.0, 0.0, 0.0, 800.0),
    (30.0, 0.001, 10.0, 5e3),
    (30.0, -0.001, -10.0, 5e3),
    (30.0, 1.0, 0.0, math.inf),  # as steep as the sun
    (30.0, 1.0, 90.0, 900.0),
    (30.0, 90.0, 0.0, math.inf),
    (30.0, -90.0, 0.0, 30.0),
    (30.0, 20.0, 180.0, 1e7),
    (2.0, 1.0, 3.0, 0.0),
    (2.0, -0.5, 160.0, 200.0),
    (600.0, -20.0, 30.0, 1.7e3),  # from above the fog
    (600.0, 5.0, 0.0, math.inf),
    (-100.0, 8.0, 60.0, 2e3),  # from a valley
)


def example_inputs(dtype: torch.dtype) -> FogView:
    """From within, above and below fog under a low sun: level, nearly level, up, down, to infinity, of no length."""
    eye, elevation, azimuth, length = torch.tensor(_EXAMPLES, dtype=torch.float64).unbind(-1)
    origin = torch.stack([torch.zeros_like(eye), torch.zeros_like(eye), eye], -1)
    rays = Rays(origin.to(dtype), from_angles(elevation.deg2rad(), azimuth.deg2rad()).to(dtype), length.to(dtype))
    shade = torch.linspace(0.02, 0.4, len(_EXAMPLES), dtype=torch.float64)[:, None]
    return FogView(
        rays=rays,
        background=(shade * torch.tensor([0.8, 1.0, 1.2], dtype=torch.float64)).to(dtype),
        to_sun=from_angles(torch.tensor(math.radians(1.0)), torch.tensor(0.1)).to(dtype),
        irradiance=torch.tensor([2.4, 1.9, 1.3], dtype=dtype),
        sky_radiance=torch.tensor([0.2, 0.27, 0.4], dtype=dtype),
    )


def quadrature(fog: HeightFog, view: FogView) -> Float[Tensor, "*batch 3"]:
    """The same as `render` with every integral by `height_fog_reference`; float64 only."""
    medium = height_fog_reference.Fog(extinction(fog), fog.scale_height, fog.base_height)
    found = height_fog_reference.light(medium, view.rays, view.to_sun)
    sun = fog.albedo * phase(fog, view) * fog.sun_tint * view.irradiance * found.sun_share
    ambient = fog.albedo * fog.ambient_tint * view.sky_radiance * (1.0 - found.transmittance)
    return view.background * found.transmittance + sun + ambient


EFFECT = Effect(
    parameters=HeightFog,
    prefix="HEIGHT_FOG",
    rungs={
        "skip": Rung(skip),
        "grey": Rung(render_grey),
        "alpha blend": Rung(render_blend),
        "flat earth": Rung(render_flat),
        "round earth": Rung(render),
    },
    reference=quadrature,
    # One air mass for a whole ray, and by a parabola; 1e-4 with a scale height of 2 km, 5e-4 with 10 km.
    tolerance=3e-6,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
