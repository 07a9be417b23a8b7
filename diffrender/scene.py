"""A scene: the exposure and one optional record per effect; how it is drawn, and how little of it need be.

What is left out or drawn by a cheaper rung is only a choice of renderers: a scene keeps all its records, because some
serve other effects too, as a sky that is too dark to be drawn still dims the sun's disc.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType, NoneType
from typing import Any, get_args, get_type_hints

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.antialiasing.settings import AntiAliasing
from diffrender.atmosphere import sky
from diffrender.atmosphere.aerial_perspective import AerialPerspective
from diffrender.atmosphere.celestial import Sun, SunView, pre_exposed, to_sun
from diffrender.atmosphere.far_fog import FarFog
from diffrender.atmosphere.froxel_fog import FroxelFog
from diffrender.atmosphere.height_fog import HeightFog
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.catalogue import EFFECTS
from diffrender.effect import Render
from diffrender.geometry.fractal_shapes import Fractal
from diffrender.parameters import Specification, names, parameter, record, specifications
from diffrender.rays import Rays, from_angles
from diffrender.shading.basic_material import BasicMaterial
from diffrender.shading.eye_ball import Eye
from diffrender.shading.hair_view import Hair
from diffrender.shading.lamps import LocalLights
from diffrender.shading.painted_surface import CarPaint
from diffrender.shading.skin_view import Skin
from diffrender.shading.sphere_surface import SphereLight
from diffrender.shading.transparent_view import Transparent
from diffrender.shading.wet_surface import Wetness
from diffrender.weather.rain_drops import Rain


@record
class Exposure:
    """How a picture was exposed."""

    exposure: Float[Tensor, ""] = parameter(
        1.0, bounds=(1e-12, 1e12), unit="1", about="picture value of a radiance of 1", scale="log"
    )


@record
class Scene:
    """Everything that draws a picture; an effect that is None is not there."""

    exposure: Exposure
    sun: Sun
    sky: Sky | None
    height_fog: HeightFog | None = None  # of the ground, which whole-sky pictures do not show
    aerial_perspective: AerialPerspective | None = None  # likewise
    far_fog: FarFog | None = None
    froxel_fog: FroxelFog | None = None
    basic_material: BasicMaterial | None = None  # of surfaces, which whole-sky pictures do not show either
    wetness: Wetness | None = None
    car_paint: CarPaint | None = None
    eye: Eye | None = None
    skin: Skin | None = None
    hair: Hair | None = None
    transparent: Transparent | None = None
    rain: Rain | None = None
    local_lights: LocalLights | None = None
    sphere_light: SphereLight | None = None
    fractal: Fractal | None = None
    antialiasing: AntiAliasing | None = None


# Prefix of its names in weather files -> record, in drawing order; effects that share a record share its prefix.
RECORDS: dict[str, type[Any]] = {"": Exposure} | {e.prefix: e.parameters for e in EFFECTS.values()}


@dataclass(frozen=True)
class Place:
    """Where a name of weather files stands in a scene."""

    part: str  # field of Scene
    field: str  # of the part's record
    channel: int | None
    specification: Specification


@cache
def places() -> Mapping[str, Place]:
    """Every name that a weather file may hold, with where it stands and what is known of it, in drawing order."""
    found = {}
    for part, hint in get_type_hints(Scene).items():
        kind = next(one for one in get_args(hint) or (hint,) if one is not NoneType)
        prefix = next(prefix for prefix, record_type in RECORDS.items() if record_type is kind)
        known = specifications(kind)
        found.update({n: Place(part, field, c, known[field]) for n, (field, c) in names(kind, prefix).items()})
    return found


@cache
def weather_names() -> Mapping[str, Specification]:
    """What is known of every name that a weather file may hold, in drawing order. Made once: every value is checked."""
    found = {}
    for prefix, kind in RECORDS.items():
        known = specifications(kind)
        found.update({name: known[field] for name, (field, _) in names(kind, prefix).items()})
    return MappingProxyType(found)


_SKYLIGHT_ROWS = 16
EYE_ALTITUDE = 2.0  # of a photographer who stands on the ground [m]


def sky_view(scene: Scene, direction: Float[Tensor, "*batch 3"]) -> SkyView:
    """What the sky of a scene is drawn from: the sun's irradiance is multiplied by the exposure before, not after."""
    sun = pre_exposed(scene.sun, scene.exposure.exposure)
    return SkyView(direction, to_sun(sun), sun.irradiance, direction.new_tensor(EYE_ALTITUDE))


def sun_view(scene: Scene, direction: Float[Tensor, "*batch 3"]) -> SunView:
    """What the disc of a scene's sun is drawn from."""
    rays = Rays(direction.new_zeros(3), direction, direction.new_tensor(torch.inf))
    return SunView(rays, sunlight(scene))


def sunlight(scene: Scene) -> Float[Tensor, "3"]:
    """Share of sunlight that reaches the eye through air and clouds; all of it where there is no sky."""
    if scene.sky is None:
        return torch.ones_like(scene.sun.irradiance)
    towards = to_sun(scene.sun)
    clear = 1.0 - sky.overcast_share(scene.sky, towards)
    return sky.sunlight(scene.sky, sky_view(scene, towards)) * clear


def skylight(scene: Scene) -> Float[Tensor, "3"]:
    """Mean exposed radiance of the sky over the directions above the horizon: what shines on fog from all around.

    Without a sky it is 1 before exposure, for the fog's ambient tint to colour.
    """
    if scene.sky is None:
        return scene.exposure.exposure * torch.ones_like(scene.sun.irradiance)
    height = (torch.arange(_SKYLIGHT_ROWS) + 0.5).to(scene.sun.irradiance) / _SKYLIGHT_ROWS
    turn = torch.arange(2 * _SKYLIGHT_ROWS).to(height) * (math.pi / _SKYLIGHT_ROWS)
    # Rows of equal height hold equal solid angles.
    directions = from_angles(*torch.meshgrid(torch.asin(height), turn, indexing="ij"))
    return EFFECTS["sky"].rungs["tables"](scene.sky, sky_view(scene, directions)).mean((0, 1))


def finest() -> dict[str, Render]:
    """The last rung of every effect."""
    return {name: list(effect.rungs.values())[-1] for name, effect in EFFECTS.items()}


def render(scene: Scene, direction: Float[Tensor, "*batch 3"], renderers: Mapping[str, Render]) -> Tensor:
    """Exposed radiance from directions, each effect by its renderer; one that has none is not drawn.

    A renderer is a rung of the effect, or anything with the same arguments, as one that has its tables already.
    """
    picture = torch.zeros_like(direction)
    if scene.sky is not None and "sky" in renderers:
        picture = picture + renderers["sky"](scene.sky, sky_view(scene, direction))
    if "sun disc" in renderers:
        sun = pre_exposed(scene.sun, scene.exposure.exposure)
        picture = picture + renderers["sun disc"](sun, sun_view(scene, direction))
    return picture


@dataclass(frozen=True)
class Choice:
    """By which rung an effect of a scene is drawn, and why.

    Attributes:
        change: largest difference from the last rung in any pixel and channel [exposed radiance], or a bound on it.
    """

    effect: str
    rung: str
    change: float
    reason: str


@dataclass(frozen=True)
class Pruned:
    """The cheapest renderers that draw a scene within a tolerance, and one choice for each effect that it has."""

    renderers: Mapping[str, Render]
    choices: tuple[Choice, ...]


@dataclass(frozen=True)
class _Drawn:
    """An effect as it was drawn in a scene, by its last rung."""

    parameters: Any
    inputs: Any
    picture: Tensor


@torch.no_grad()
def prune(scene: Scene, direction: Float[Tensor, "*batch 3"], tolerance: float) -> Pruned:
    """Cheapest renderers whose picture differs from that of `finest` by at most a tolerance [exposed radiance].

    `direction` are all rays that will be drawn: a disc that no ray of a sample meets would be left out. First go the
    effects whose own bound on what they change fits, the least first; then each of the others, in drawing order, gets
    the first rung that by measurement fits what is left. An effect's change reaches the picture undiminished at most,
    so the changes add up. Costs about a frame by the last rungs and, where a bound is too wide, one by each cheaper.

    Raises:
        ValueError: when the tolerance is negative or NaN.
    """
    if not tolerance >= 0.0:
        raise ValueError(f"tolerance is {tolerance}; give the largest allowed change of a pixel, 0 or more")
    drawn = _drawn(scene, direction)
    bounds = {
        name: float(EFFECTS[name].largest_change(one.parameters, one.inputs))
        for name, one in drawn.items()
        if "skip" in EFFECTS[name].rungs
    }
    found: dict[str, Choice] = {}
    left = tolerance
    for name in sorted(bounds, key=bounds.__getitem__):
        if bounds[name] <= left:
            reason = f"changes no pixel by more than {bounds[name]:.2g} by its bound, {left:.2g} allowed"
            found[name] = Choice(name, "skip", bounds[name], reason)
            left -= bounds[name]
    for name in [name for name in drawn if name not in found]:
        found[name] = _cheapest(name, drawn[name], left)
        left -= found[name].change
    choices = tuple(found[name] for name in drawn)
    return Pruned({c.effect: EFFECTS[c.effect].rungs[c.rung] for c in choices if c.rung != "skip"}, choices)


def _drawn(scene: Scene, direction: Tensor) -> dict[str, _Drawn]:
    """Every effect that a scene has, in drawing order."""
    found = {}

    def kept(name: str, rung: Render) -> Render:
        def draw(parameters: Any, inputs: Any) -> Tensor:
            found[name] = _Drawn(parameters, inputs, rung(parameters, inputs))
            return found[name].picture

        return draw

    render(scene, direction, {name: kept(name, rung) for name, rung in finest().items()})
    return found


def _cheapest(name: str, drawn: _Drawn, allowed: float) -> Choice:
    """First rung of an effect within what is allowed, by measurement; the last rung where no other is."""
    *cheaper, last = EFFECTS[name].rungs.items()
    for rung, renderer in cheaper:
        change = float((renderer(drawn.parameters, drawn.inputs) - drawn.picture).abs().max())
        if change <= allowed:
            return Choice(name, rung, change, f"changes a pixel by {change:.2g} as measured, {allowed:.2g} allowed")
    return Choice(name, last[0], 0.0, f"every cheaper rung changes a pixel by more than {allowed:.2g}")
