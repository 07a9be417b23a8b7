"""Hard places of effects' inputs, where their boxes are swept beside their own examples."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import froxel_examples, froxel_grid
from diffrender.atmosphere.celestial import SunView
from diffrender.atmosphere.froxel_lights import Lights
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.atmosphere.scattering import SUN_RADIUS
from diffrender.atmosphere.sky import SkyView
from diffrender.catalogue import EFFECTS
from diffrender.geometry import fractals
from diffrender.geometry.fractal_shapes import Mandelbulb, Menger, Shape, Sierpinski
from diffrender.geometry.fractals import FractalView
from diffrender.rays import Perspective, angles, from_angles
from diffrender.shading import basic_material
from diffrender.shading.basic_material import MaterialView
from diffrender.shading.eye_ball import EyeView
from diffrender.shading.eye_ball import example_inputs as eye_examples
from diffrender.shading.hair_view import HairView
from diffrender.shading.hair_view import example_inputs as hair_examples
from diffrender.shading.lamp_examples import example_inputs as lit_examples
from diffrender.shading.lamps import LitView
from diffrender.shading.painted_surface import CarPaintView
from diffrender.shading.painted_surface import example_inputs as painted_examples
from diffrender.shading.skin_view import SkinView
from diffrender.shading.skin_view import example_inputs as skin_examples
from diffrender.shading.sphere_surface import SphereView
from diffrender.shading.sphere_surface import example_inputs as sphere_examples
from diffrender.shading.transparent_view import TransparentView
from diffrender.shading.transparent_view import example_inputs as layer_examples
from diffrender.shading.wet_surface import WetView
from diffrender.shading.wet_surface import example_inputs as wet_examples
from experiments import (
    rain_street,
)
from experiments.effect_pictures import disc_view, sky_view
from experiments.effects import in_dtype

SUNS = (90.0, 1.0, 0.0, -0.1, -6.0, -12.0)  # elevations in degrees


def _hard_skies() -> dict[str, SkyView]:
    """A sun from the zenith to night, seen from the ground; and from a mountain and an aeroplane a low one."""
    found = {f"sun {sun:g}": sky_view(_hard_directions(sun), sun) for sun in SUNS}
    for altitude in (0.0, 3e3, 12e3):
        low = sky_view(_hard_directions(1.0), 1.0)
        found[f"sun 1 from {altitude:g} m"] = SkyView(
            low.direction, low.to_sun, low.irradiance, low.direction.new_tensor(altitude)
        )
    return found


def _hard_directions(sun: float) -> Float[Tensor, "n 3"]:
    """Round the zenith, the horizon, the ground's edge and the sun, and away from all of them."""
    places = [(90.0, 0.0), (89.999, 200.0), (60.0, 200.0), (45.0, 90.0), (30.0, 30.0), (15.0, 330.0), (5.0, 120.0)]
    places += [(elevation, azimuth) for elevation in (1.0, 0.001, 0.0, -0.001) for azimuth in (30.0, 120.0, 210.0)]
    places += [(-0.04, 20.0), (-0.05, 20.0), (-10.0, 0.0)]
    places += [(sun, 30.0), (sun - 0.01, 30.0), (sun, 30.5), (sun - 2.0, 29.0), (-sun, 210.0)]
    elevation, azimuth = torch.deg2rad(torch.tensor(places, dtype=torch.float64)).unbind(-1)
    return from_angles(elevation, azimuth)


def _hard_discs() -> dict[str, SunView]:
    """Across the whole disc of a sun at the defaults, and at the zenith and the nadir."""
    across = 2.5 * SUN_RADIUS
    pitches = {"disc at 45": 45.0, "disc at 90": 90.0, "disc at -90": -90.0}
    return {name: disc_view(Perspective(12, 12, across, math.radians(pitch))) for name, pitch in pitches.items()}


def _hard_froxels() -> dict[str, FroxelView]:
    """With the eye in a lamp, straight into the sun, on a mountain above the fog, and without noise or any light."""
    view = froxel_examples.example_inputs(torch.float64)
    lights, eye = view.lights, view.eye
    assert lights.local is not None
    assert lights.sun is not None
    at_eye = eye.position[:, None].expand_as(lights.local.position)
    lamp = replace(lights, local=replace(lights.local, position=at_eye))
    turned = froxel_grid.eye_at(eye.position, *angles(lights.sun.to_sun), eye.spread)
    mountain = replace(eye, position=eye.position + eye.position.new_tensor([0.0, 0.0, 2e3]))
    return {
        "in a lamp": replace(view, lights=lamp),
        "into the sun": replace(view, eye=turned),
        "from 2 km": replace(view, eye=mountain),
        "even and unlit": replace(view, noise=None, lights=Lights(None, None, None)),
    }


def _hard_materials() -> dict[str, MaterialView]:
    """By a grazing eye, by one in the light, and in the mirror's direction."""
    seen = basic_material.example_inputs(torch.float64)
    up = (seen.normal * seen.to_eye).sum(-1, keepdim=True)
    level = torch.nn.functional.normalize(seen.to_eye - (up - 1e-3) * seen.normal, dim=-1)
    to_light = seen.lights.to_light[0]
    mirrored = 2.0 * (seen.normal * to_light).sum(-1, keepdim=True) * seen.normal - to_light
    return {
        "eye at the horizon": replace(seen, to_eye=level),
        "eye at the light": replace(seen, to_eye=to_light.expand_as(seen.to_eye)),
        "eye in the mirror": replace(seen, to_eye=torch.nn.functional.normalize(mirrored + 2e-3, dim=-1)),
    }


def _hard_surfaces() -> dict[str, WetView]:
    """Under a sun at the horizon, one at the eye, one near its mirror's place in level water, and by a grazing eye."""
    seen = wet_examples(torch.float64)
    across = torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    near = torch.nn.functional.normalize(seen.to_eye * across + 2e-3, dim=-1)
    level = torch.nn.functional.normalize(seen.to_eye * torch.tensor([1.0, 1.0, 1e-3], dtype=torch.float64), dim=-1)
    return {
        "sun at the horizon": replace(seen, to_light=from_angles(*torch.tensor([[1e-3], [0.3]]).double())[0]),
        "sun at the eye": replace(seen, to_light=seen.to_eye),
        "sun mirrored": replace(seen, to_light=near),
        "eye at the horizon": replace(seen, to_eye=level),
    }


def _hard_skin() -> dict[str, SkinView]:
    """Examples seen from afar, so that light stays within a pixel, and from near; by a grazing eye; and hardly any."""
    seen = skin_examples(torch.float64)
    up = (seen.normal * seen.to_eye).sum(-1, keepdim=True)
    level = torch.nn.functional.normalize(seen.to_eye - (up - 0.02) * seen.normal, dim=-1)
    single = torch.zeros_like(seen.mask)
    single[:, 3, 4] = 1e-3
    return {
        "from afar": replace(seen, position=100.0 * seen.position),
        "from near": replace(seen, position=0.05 * seen.position),
        "eye at the horizon": replace(seen, to_eye=level),
        "a thousandth of one pixel": replace(seen, mask=single),
    }


def _hard_layers() -> dict[str, TransparentView]:
    """Under a sun at the eye, behind the panes, and mirrored; with panes seen along their edge and nearly so."""
    seen = layer_examples(torch.float64)
    eye, normal, lights = seen.to_eye, seen.normal, seen.lights
    cosine = (normal * eye[:, None]).sum(-1, keepdim=True)
    mirrored = 2.0 * cosine * normal - eye[:, None]
    suns = {"sun at the eye": eye[5], "sun behind": -eye[5], "sun mirrored": mirrored[5, 0]}
    found = {
        name: replace(seen, lights=replace(lights, to_light=torch.stack([sun, lights.to_light[1]])))
        for name, sun in suns.items()
    }
    # Not of those seen straight on, which lie in no plane with the eye that could be turned.
    tilted = cosine.abs() < 0.999
    for name, left in {"edges": 0.0, "nearly edges": 0.02}.items():
        turned = torch.nn.functional.normalize(normal - (cosine - left) * eye[:, None], dim=-1)
        found[name] = replace(seen, normal=torch.where(tilted, turned, normal))
    return found


def _hard_paint() -> dict[str, CarPaintView]:
    """In a light's mirror, under lights at the horizon and below it, by a grazing eye, and from very far."""
    seen = painted_examples(torch.float64)
    normal, to_eye = seen.normal, seen.to_eye
    up = (normal * to_eye).sum(-1, keepdim=True)
    level = torch.nn.functional.normalize(to_eye - (up - 1e-3) * normal, dim=-1)
    mirrored = torch.nn.functional.normalize((2.0 * up * normal - to_eye)[:2] + 2e-3, dim=-1)
    towards = {"lights mirrored": mirrored, "lights at the horizon": level[:2], "lights below": -normal[:2]}
    found = {name: replace(seen, lights=replace(seen.lights, to_light=one)) for name, one in towards.items()}
    far = replace(seen, footprint=seen.footprint + 10.0)
    return found | {"eye at the horizon": replace(seen, to_eye=level), "from very far": far}


def _hard_eyes() -> dict[str, EyeView]:
    """By a grazing eye, straight down on every place, and under lights at the horizon and behind the ball."""
    seen = eye_examples(torch.float64)
    up = (seen.normal * seen.to_eye).sum(-1, keepdim=True)
    level = torch.nn.functional.normalize(seen.to_eye - (up - 1e-3) * seen.normal, dim=-1)
    towards = {"lights at the horizon": level[:2], "lights behind": -seen.gaze[:2]}
    found = {name: replace(seen, lights=replace(seen.lights, to_light=one)) for name, one in towards.items()}
    return found | {
        "eye at the horizon": replace(seen, to_eye=level),
        "straight down": replace(seen, to_eye=seen.normal),
    }


def _hard_strands() -> dict[str, HairView]:
    """Strands nearly along the eye and along a light, lights that all stand behind them, and scales that lean far."""
    seen = hair_examples(torch.float64)
    near = torch.nn.functional.normalize(seen.to_eye + 2e-3 * seen.normal, dim=-1)
    lights = seen.lights
    along = lights.to_light[0] + torch.linspace(0.0, 0.02, len(near), dtype=torch.float64)[:, None] * seen.normal
    behind = torch.nn.functional.normalize(lights.to_light * torch.tensor([-1.0, 1.0, 1.0]).double(), dim=-1)
    return {
        "along the eye": replace(seen, tangent=near),
        "along a light": replace(seen, tangent=torch.nn.functional.normalize(along, dim=-1)),
        "lights turned": replace(seen, lights=replace(lights, to_light=behind)),
        "scales that lean": replace(seen, shift=3.0 * seen.shift),
    }


def _hard_lamps() -> dict[str, LitView]:
    """Lamps on the surface and just above it, at the eye's mirror, and by grazing eyes."""
    seen = lit_examples(torch.float64)
    places, lamps = seen.places, seen.lamps
    across = torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    level = torch.nn.functional.normalize(places.to_eye * torch.tensor([1.0, 1.0, 1e-3], dtype=torch.float64), dim=-1)
    on, above = lamps.position.clone(), lamps.position.clone()
    on[1], above[1] = places.position[0, 0], places.position[0, 0] + 1e-4 * places.normal[0, 0]
    mirrored = lamps.position.clone()
    mirrored[1] = places.position[3, 0] + 0.5 * across * places.to_eye[3, 0]
    return {
        "lamp on the surface": replace(seen, lamps=replace(lamps, position=on)),
        "lamp just above it": replace(seen, lamps=replace(lamps, position=above)),
        "lamp mirrored": replace(seen, lamps=replace(lamps, position=mirrored)),
        "eye at the horizon": replace(seen, places=replace(places, to_eye=level)),
    }


def _hard_spheres() -> dict[str, SphereView]:
    """All of the examples as mirrors, as rough as can be, and with a grazing eye."""
    seen = sphere_examples(torch.float64)
    up = (seen.normal * seen.to_eye).sum(-1, keepdim=True)
    level = torch.nn.functional.normalize(seen.to_eye - (up - 0.02) * seen.normal, dim=-1)
    roughness = {"mirrors": 0.0, "nearly mirrors": 0.02, "roughest": 1.0}
    found = {name: replace(seen, roughness=torch.full_like(seen.roughness, of)) for name, of in roughness.items()}
    return found | {"grazing eye": replace(seen, to_eye=level)}


def _hard_fractals() -> dict[str, FractalView]:
    """Other shapes from where the examples see a Mandelbulb."""
    examples = fractals.example_inputs(torch.float64)
    shapes: dict[str, Shape] = {"deeper": Mandelbulb(3), "sponge": Menger(3), "tetrahedron": Sierpinski(4)}
    return {name: replace(examples, shape=shape) for name, shape in shapes.items()}


# Effect -> its hard inputs by name, in float64.
HARD: Mapping[str, Callable[[], Mapping[str, Any]]] = {
    "sky": _hard_skies,
    "sun disc": _hard_discs,
    "froxel fog": _hard_froxels,
    "basic material": _hard_materials,
    "wetness": _hard_surfaces,
    "skin": _hard_skin,
    "hair": _hard_strands,
    "transparent": _hard_layers,
    "car paint": _hard_paint,
    "eye": _hard_eyes,
    "local lights": _hard_lamps,
    "rain": lambda: {name: in_dtype(view, torch.float64) for name, view in rain_street.hard_views().items()},
    "sphere light": _hard_spheres,
    "fractal": _hard_fractals,
}


def hard_inputs(name: str) -> Mapping[str, Any]:
    """Inputs of an effect on which its box is swept, in float64; its examples are always among them."""
    found = {"examples": EFFECTS[name].example_inputs(torch.float64)}
    return found | dict(HARD[name]()) if name in HARD else found
