"""Pictures to draw effects on, so wide and high as is asked, where their own examples are none."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.atmosphere import froxel_examples, froxel_grid
from diffrender.atmosphere.celestial import Sun, SunView
from diffrender.atmosphere.froxel_grid import Eye, Grid
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.atmosphere.scattering import SUN_RADIUS
from diffrender.atmosphere.sky import SkyView
from diffrender.catalogue import EFFECTS
from diffrender.geometry import fractals
from diffrender.geometry.fractal_shapes import Mandelbulb
from diffrender.geometry.fractals import FractalView
from diffrender.parameters import defaults, specifications
from diffrender.rays import Camera, Equirectangular, Perspective, Rays, from_angles, pixel_centres
from diffrender.shading.basic_material import MaterialView
from diffrender.shading.lamps import LitView
from diffrender.shading.sphere_surface import SphereView
from diffrender.shading.wet_surface import WetView
from experiments import (
    ball,
    car_paint_scene,
    eye_scene,
    hair_scene,
    lamp_plain,
    lamp_scenes,
    skin_scene,
    transparent_scene,
    wet_scenes,
)

IRRADIANCE = specifications(Sun)["irradiance"].default


def directions(camera: Camera) -> Float[Tensor, "height width 3"]:
    """Of every pixel of a camera."""
    return camera.direction(*pixel_centres(camera, slice(None), torch.zeros((), dtype=torch.float64)))


def _sky_picture(width: int, height: int) -> SkyView:
    """The upper half of a panorama with a sun at 20 degrees."""
    return sky_view(directions(Equirectangular(width, height, lowest=0.0)), elevation=20.0)


def sky_view(direction: Tensor, elevation: float) -> SkyView:
    """Directions from the ground under a sun at an elevation [degrees]."""
    to_sun = from_angles(*torch.deg2rad(torch.tensor([elevation, 30.0], dtype=torch.float64)))
    return SkyView(direction, to_sun, direction.new_tensor(IRRADIANCE), direction.new_tensor(2.0))


def _disc_picture(width: int, height: int) -> SunView:
    """A sun that a quarter of the picture is as wide as."""
    sun = defaults(Sun, torch.float64)
    return disc_view(Perspective(width, height, field_of_view=4.0 * 2.0 * SUN_RADIUS, pitch=float(sun.elevation)))


def disc_view(camera: Camera) -> SunView:
    """A camera's pixels through yellowish air."""
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
    "hair": hair_scene.picture_view,
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
