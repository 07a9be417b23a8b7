"""All effects by name, in drawing order: the only file that knows them all."""

from diffrender.antialiasing import checkerboard, edge_taa, fxaa
from diffrender.atmosphere import aerial_perspective, celestial, far_fog, froxel_fog, height_fog, sky
from diffrender.effect import Effect
from diffrender.geometry import fractals
from diffrender.shading import (
    basic_material,
    car_paint,
    eye,
    hair,
    local_lights,
    skin,
    sphere_light,
    transparent,
    wetness,
)
from diffrender.weather import rain

EFFECTS: dict[str, Effect] = {
    "sky": sky.EFFECT,
    "sun disc": celestial.EFFECT,
    "aerial perspective": aerial_perspective.EFFECT,
    "height fog": height_fog.EFFECT,
    "far fog": far_fog.EFFECT,
    "froxel fog": froxel_fog.EFFECT,
    "basic material": basic_material.EFFECT,
    "wetness": wetness.EFFECT,
    "car paint": car_paint.EFFECT,
    "eye": eye.EFFECT,
    "skin": skin.EFFECT,
    "hair": hair.EFFECT,
    "transparent": transparent.EFFECT,
    "fractal": fractals.EFFECT,
    "sphere light": sphere_light.EFFECT,
    "local lights": local_lights.EFFECT,
    "rain": rain.EFFECT,
    "fxaa": fxaa.EFFECT,
    "edge taa": edge_taa.EFFECT,
    "checkerboard": checkerboard.EFFECT,
}
