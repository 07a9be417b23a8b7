"""What experiments ask of effects: which ones, at which points of their boxes, and what they are shown.

The tables below hold what an effect's own `example_inputs` cannot: pictures to time it on, and the hard places of its
inputs, where its box is swept. An effect that has no entry is shown its examples.
"""

import argparse
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.atmosphere import froxel_examples, froxel_grid
from diffrender.atmosphere.celestial import Sun, SunView
from diffrender.atmosphere.froxel_grid import Eye, Grid
from diffrender.atmosphere.froxel_lights import Lights
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.atmosphere.scattering import SUN_RADIUS
from diffrender.atmosphere.sky import SkyView
from diffrender.catalogue import EFFECTS
from diffrender.geometry import fractals
from diffrender.geometry.fractal_shapes import Mandelbulb, Menger, Shape, Sierpinski
from diffrender.geometry.fractals import FractalView
from diffrender.parameters import defaults, names, specifications, to_cube
from diffrender.rays import Camera, Equirectangular, Perspective, Rays, angles, from_angles, pixel_centres
from diffrender.shading import basic_material
from diffrender.shading.basic_material import MaterialView
from diffrender.shading.eye_ball import EyeView
from diffrender.shading.eye_ball import example_inputs as eye_examples
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
    ball,
    car_paint_scene,
    eye_scene,
    lamp_plain,
    lamp_scenes,
    rain_street,
    skin_scene,
    transparent_scene,
    wet_scenes,
)
from experiments.records import RESULTS

IRRADIANCE = specifications(Sun)["irradiance"].default


@dataclass(frozen=True)
class Given:
    """What an experiment was asked for: names of effects, or of what else it is about."""

    names: tuple[str, ...]
    is_small: bool
    out: Path


def ask(about: str, arguments: Sequence[str] | None, known: Iterable[str] = EFFECTS) -> Given:
    """Names and size from a command line; `known` are the names that the experiment knows."""
    known = tuple(known)
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(known)}; all where none is given")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the results")
    asked = parser.parse_args(arguments)
    unknown = sorted(set(asked.names) - set(known))
    if unknown:
        parser.error(f"{', '.join(unknown)} is not known here; known: {', '.join(known)}")
    chosen = tuple(name for name in known if not asked.names or name in asked.names)
    return Given(chosen, asked.size == "small", asked.out)


def in_dtype(inputs: Any, dtype: torch.dtype) -> Any:
    """The same numbers in another dtype; whole numbers and truth values stay what they are."""
    return pytree.tree_map_only(torch.Tensor, lambda t: t.to(dtype) if t.is_floating_point() else t, inputs)


def corners(kind: type[Any]) -> dict[str, Float[Tensor, " n"]]:
    """Points of a record's cube by name: defaults, all low, all high, and each scalar alone at either bound."""
    middle = to_cube(defaults(kind, torch.float64))
    found = {"defaults": middle, "all low": torch.zeros_like(middle), "all high": torch.ones_like(middle)}
    for place, name in enumerate(names(kind, "")):
        for side, bound in (("low", 0.0), ("high", 1.0)):
            found[f"{name} {side}"] = middle.index_fill(0, torch.tensor(place), bound)
    return found


def scattered(kind: type[Any], count: int) -> dict[str, Float[Tensor, " n"]]:
    """So many corners of a record's cube in which every scalar is at either bound, and as many points inside it."""
    dimensions, draw = len(names(kind, "")), torch.Generator().manual_seed(0)
    at_bounds = torch.randint(0, 2, (count, dimensions), generator=draw).double()
    inside = torch.rand(count, dimensions, generator=draw, dtype=torch.float64)
    found = {f"corner {place}": point for place, point in enumerate(at_bounds)}
    return found | {f"inside {place}": point for place, point in enumerate(inside)}


def directions(camera: Camera) -> Float[Tensor, "height width 3"]:
    """Of every pixel of a camera."""
    return camera.direction(*pixel_centres(camera, slice(None), torch.zeros((), dtype=torch.float64)))


def _sky_picture(width: int, height: int) -> SkyView:
    """The upper half of a panorama with a sun at 20 degrees."""
    return _sky_view(directions(Equirectangular(width, height, lowest=0.0)), elevation=20.0)


def _sky_view(direction: Tensor, elevation: float) -> SkyView:
    to_sun = from_angles(*torch.deg2rad(torch.tensor([elevation, 30.0], dtype=torch.float64)))
    return SkyView(direction, to_sun, direction.new_tensor(IRRADIANCE), direction.new_tensor(2.0))


def _disc_picture(width: int, height: int) -> SunView:
    """A sun that a quarter of the picture is as wide as."""
    sun = defaults(Sun, torch.float64)
    return _disc_view(Perspective(width, height, field_of_view=4.0 * 2.0 * SUN_RADIUS, pitch=float(sun.elevation)))


def _disc_view(camera: Camera) -> SunView:
    direction = directions(camera)
    rays = Rays(direction.new_zeros(3), direction, direction.new_tensor(math.inf))
    return SunView(rays, direction.new_tensor((0.9, 0.8, 0.6)))


def _froxel_picture(width: int, height: int) -> FroxelView:
    """The walk of the examples in a picture with a column of froxels for every 2 x 2 pixels, on ground before a sky."""
    view = froxel_examples.example_inputs(torch.float64)
    grid = Grid(max(1, width // 2), max(1, height // 2), 32, view.grid.near, view.grid.far)
    distance = torch.stack([_to_ground(frame.eye, width, height) for frame in view.in_order()])
    grey = torch.where(distance.isinf(), 0.5, 0.2)[..., None]
    return replace(view, grid=grid, distance=distance, background=grey * grey.new_tensor([0.8, 1.0, 1.2]))


def _to_ground(eye: Eye, width: int, height: int) -> Float[Tensor, "{height} {width}"]:
    down = -froxel_grid.directions(eye, height, width)[0][..., 2]
    return torch.where(down > 0.0, eye.position[2] / down.clamp(min=1e-6), torch.full_like(down, math.inf))


def _wet_picture(width: int, height: int) -> WetView:
    """Cobbles at one's feet, in rain."""
    return wet_scenes.street(wet_scenes.puddle_camera(width, height), wet_scenes.Weather())


def _material_picture(width: int, height: int) -> MaterialView:
    """A ball repeated until its pixels are as many as the picture's."""
    shown = ball.ball(width, height)
    place = torch.arange(width * height) % len(shown.normal)
    return MaterialView(shown.normal[place], shown.to_eye[place], ball.studio())


def _lit_picture(width: int, height: int) -> LitView:
    """A hall of 200 lamps."""
    draw = torch.Generator().manual_seed(0)
    shown = lamp_scenes.seen(lamp_scenes.camera(width, height), draw)
    return lamp_scenes.view(shown, lamp_scenes.lamps(200, draw), tile=16)


def _sphere_picture(width: int, height: int) -> SphereView:
    """A plain that mirrors a low lamp."""
    return lamp_plain.plain(width, height, roughness=0.3)


def _bulb_picture(width: int, height: int) -> FractalView:
    """A Mandelbulb that fills most of the picture."""
    examples = fractals.example_inputs(torch.float64)
    direction = directions(Perspective(width, height, field_of_view=0.9))
    rays = Rays(direction.new_tensor((-3.0, 0.0, 0.0)), direction, direction.new_tensor(math.inf))
    return replace(examples, rays=rays, background=torch.full_like(direction, 0.2), shape=Mandelbulb(iterations=3))


# Effect -> inputs of a picture so wide and high, in float64.
PICTURES: Mapping[str, Callable[[int, int], Any]] = {
    "sky": _sky_picture,
    "sun disc": _disc_picture,
    "froxel fog": _froxel_picture,
    "basic material": _material_picture,
    "wetness": _wet_picture,
    "skin": skin_scene.picture_view,
    "transparent": transparent_scene.picture_view,
    "car paint": car_paint_scene.picture_view,
    "eye": eye_scene.picture_view,
    "local lights": _lit_picture,
    "sphere light": _sphere_picture,
    "fractal": _bulb_picture,
}


def picture_inputs(name: str, width: int, height: int) -> Any:
    """Inputs of an effect for a picture; of one without an entry its examples, repeated until they are as many."""
    if name in PICTURES:
        return PICTURES[name](width, height)
    effect = EFFECTS[name]
    examples = effect.example_inputs(torch.float64)
    *_, last = effect.rungs.values()
    drawn = last(defaults(effect.parameters, torch.float64), examples)
    times = math.ceil(3 * width * height / drawn.numel())

    def repeated(tensor: Tensor) -> Tensor:
        # As in the contract's tests: what is as long as the picture is one of its elements.
        is_shared = tensor.shape[:1] != drawn.shape[:1]
        return tensor if is_shared else torch.cat([tensor] * times)

    return pytree.tree_map_only(torch.Tensor, repeated, examples)


SUNS = (90.0, 1.0, 0.0, -0.1, -6.0, -12.0)  # elevations in degrees


def _hard_skies() -> dict[str, SkyView]:
    """A sun from the zenith to night, seen from the ground; and from a mountain and an aeroplane a low one."""
    found = {f"sun {sun:g}": _sky_view(_hard_directions(sun), sun) for sun in SUNS}
    for altitude in (0.0, 3e3, 12e3):
        low = _sky_view(_hard_directions(1.0), 1.0)
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
    return {name: _disc_view(Perspective(12, 12, across, math.radians(pitch))) for name, pitch in pitches.items()}


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
