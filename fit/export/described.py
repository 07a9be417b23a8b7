"""The weather of one hour as exporters need it: its scene, and what that looks like from the ground."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import height_fog, sky
from diffrender.atmosphere.celestial import pre_exposed, to_sun
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.atmosphere.sky import Sky, TabledView
from diffrender.numerics import opacity
from diffrender.rays import Rays, from_angles
from diffrender.scene import EYE_ALTITUDE, Scene, sky_view, skylight, sunlight
from fit.picture import scene_sky

_ROWS, _COLUMNS = 16, 32  # of the directions at which targets are compared
_DENSITIES = 1e-9, 1e3  # [1/m]


@dataclass(frozen=True, eq=False)
class Described:
    """What is exported; radiance is exposed, as in the picture.

    Attributes:
        name: of the weather file.
        hour: of the day.
        scene: with a sky, and with fog or without.
        to_sun: unit direction, z up, +x under the picture's middle column, +y to its left.
        irradiance: of the sun above the air, which fog is lit by.
        sunlight: the same of what reaches the eye through air and clouds, which surfaces are lit by.
        skylight: mean radiance of the sky, which fog is lit by.
        tables: of the sky.
    """

    name: str
    hour: float
    scene: Scene
    to_sun: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]
    sunlight: Float[Tensor, "3"]
    skylight: Float[Tensor, "3"]
    tables: sky.SkyTables

    @property
    def sky(self) -> Sky:
        """Sky of the scene."""
        return scene_sky(self.scene)

    @property
    def elevation_degrees(self) -> float:
        """Of the sun above the horizon."""
        return math.degrees(float(self.scene.sun.elevation))

    @property
    def azimuth_degrees(self) -> float:
        """Of the sun, to the right of the picture's middle column."""
        return -math.degrees(float(self.scene.sun.azimuth))


def described(scene: Scene, name: str, hour: float) -> Described:
    """A scene that has a sky, with its tables and lights."""
    exposed = pre_exposed(scene.sun, scene.exposure.exposure)
    return Described(
        name=name,
        hour=hour,
        scene=scene,
        to_sun=to_sun(scene.sun),
        irradiance=exposed.irradiance,
        sunlight=exposed.irradiance * sunlight(scene),
        skylight=skylight(scene),
        tables=sky.prepare(scene_sky(scene), sky_view(scene, torch.zeros(1, 3))).tables,
    )


def upper_half() -> Float[Tensor, "n 3"]:
    """Directions over the whole sky, of equal solid angles; the lowest is 1.8 degrees above the horizon."""
    height = (torch.arange(_ROWS) + 0.5) / _ROWS
    turn = (torch.arange(_COLUMNS) + 0.5) * (2.0 * math.pi / _COLUMNS)
    return from_angles(*torch.meshgrid(torch.asin(height), turn, indexing="ij")).flatten(0, 1)


def sky_radiance(weather: Described, direction: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Radiance of the sky as `fit render` draws it, without the sun's disc."""
    return sky.render_tables(weather.sky, TabledView(sky_view(weather.scene, direction), weather.tables))


def fogged(weather: Described, fog: HeightFog, rays: Rays, background: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """A background seen through fog, as fits of fog draw it."""
    view = FogView(rays, background, weather.to_sun, weather.irradiance, weather.skylight)
    return height_fog.render(fog, view)


def air_mass(weather: Described, fog: HeightFog) -> float:
    """Air mass of a fog from the eye towards the sun."""
    eye = Rays(torch.tensor([0.0, 0.0, EYE_ALTITUDE]), weather.to_sun, torch.tensor(math.inf))
    return float(height_fog.air_mass(fog, eye, weather.to_sun))


def level_opacity(fog: HeightFog) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Distances along a level ray from the eye [m], up to an optical depth of 5, and the fog's mean opacity there."""
    eye = torch.tensor([0.0, 0.0, EYE_ALTITUDE])
    ahead = torch.tensor([1.0, 0.0, 0.0])
    # Held where distances are neither 0 nor endless, for fog that ends far below the eye or begins far above.
    per_metre = height_fog.optical_depth(fog, Rays(eye, ahead, eye.new_ones(()))).mean().clamp(*_DENSITIES)
    distance = torch.linspace(0.02, 5.0, 100) / per_metre
    depth = height_fog.optical_depth(fog, Rays(eye, ahead.expand(len(distance), 3), distance))
    return distance, opacity(depth).mean(-1)


def endless_fog(weather: Described, fog: HeightFog) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """Level directions all round the horizon from the sun on, and the radiance of the fog along them, without end."""
    turn = torch.arange(_COLUMNS) * (2.0 * math.pi / _COLUMNS)
    level = from_angles(torch.zeros_like(turn), turn + weather.scene.sun.azimuth)
    eye = torch.tensor([0.0, 0.0, EYE_ALTITUDE])
    rays = Rays(eye, level, torch.full_like(turn, math.inf))
    return level, fogged(weather, fog, rays, torch.zeros_like(level))
