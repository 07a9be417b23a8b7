"""Documented names of engines that cannot be run here: class, property, unit and range, from the sources below.

What an exporter writes for them is taken through `allowed`, so that it emits no name that is not in this table and no
value out of range. Ranges are those that the engine or its editor holds values to; None where there is none.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Known:
    """A property of an engine.

    Attributes:
        unit: of its numbers; for others what they are.
        low: least number or channel.
        high: largest.
    """

    unit: str
    low: float | None = None
    high: float | None = None


Names = Mapping[str, Mapping[str, Known]]
Number = float | tuple[float, ...] | str | bool
Settings = Mapping[str, Mapping[str, Number]]

_COLOUR = Known("linear colour", 0.0)
_SRGB = Known("sRGB colour, 0 to 255", 0.0, 255.0)
_SHARE = Known("1", 0.0, 1.0)
_SWITCH = Known("yes or no")
_CHOICE = Known("name of an enumeration")

# Unreal Engine 5.1 to 5.7, Python API of the editor:
# https://dev.epicgames.com/documentation/en-us/unreal-engine/python-api/class/SkyAtmosphereComponent
# and, beside it, ExponentialHeightFogComponent, DirectionalLightComponent, TentDistribution. Ranges: C++ headers of
# the components (UIMin, UIMax, ClampMin, ClampMax). What FogDensity and FogHeightFalloff mean: the engine's scene
# proxy of the fog, which divides both by 1000, and its shader's line integral in powers of 2 over centimetres.
UNREAL: Names = {
    "SkyAtmosphereComponent": {
        "transform_mode": _CHOICE,
        "bottom_radius": Known("km", 0.1, 7000.0),
        "atmosphere_height": Known("km", 0.1, 200.0),
        "ground_albedo": _SRGB,
        "multi_scattering_factor": Known("1", 0.0, 2.0),
        "rayleigh_scattering_scale": Known("1/km", 0.0, 2.0),
        "rayleigh_scattering": _COLOUR,
        "rayleigh_exponential_distribution": Known("km", 0.01, 20.0),
        "mie_scattering_scale": Known("1/km", 0.0, 5.0),
        "mie_scattering": _COLOUR,
        "mie_absorption_scale": Known("1/km", 0.0, 5.0),
        "mie_absorption": _COLOUR,
        "mie_anisotropy": Known("1", 0.0, 0.999),
        "mie_exponential_distribution": Known("km", 0.01, 10.0),
        "other_absorption_scale": Known("1/km", 0.0, 0.2),
        "other_absorption": _COLOUR,
        "other_tent_distribution": Known("TentDistribution"),
        "sky_luminance_factor": _COLOUR,
        "height_fog_contribution": Known("1", 0.0, 1.0),
    },
    "TentDistribution": {
        "tip_altitude": Known("km", 0.0, 60.0),
        "tip_value": _SHARE,
        "width": Known("km", 0.01, 20.0),
    },
    "ExponentialHeightFogComponent": {
        "fog_density": Known("extinction of 0.048/m", 0.0),
        "fog_height_falloff": Known("14.4 over the scale height in m", 0.0),
        "fog_inscattering_luminance": _COLOUR,
        "fog_max_opacity": _SHARE,
        "start_distance": Known("cm", 0.0),
        "directional_inscattering_exponent": Known("1", 2.0, 64.0),
        "directional_inscattering_start_distance": Known("cm", 0.0),
        "directional_inscattering_luminance": _COLOUR,
    },
    "DirectionalLightComponent": {
        "intensity": Known("lux", 0.0),
        "light_color": _SRGB,
        "light_source_angle": Known("degrees", 0.0, 5.0),
        "atmosphere_sun_light": _SWITCH,
        "use_temperature": _SWITCH,
    },
}

# Unity 6, HDRP 17: Fog.cs, HDRISky.cs, VisualEnvironment.cs in
# https://github.com/Unity-Technologies/Graphics/tree/master/Packages/com.unity.render-pipelines.high-definition
# and https://docs.unity3d.com/ScriptReference/Light.html
UNITY: Names = {
    "VisualEnvironment": {"skyType": _CHOICE},
    "HDRISky": {
        "rotation": Known("degrees", 0.0, 360.0),
        "skyIntensityMode": _CHOICE,
        "multiplier": Known("1", 0.0),
    },
    "Fog": {
        "enabled": _SWITCH,
        "colorMode": _CHOICE,
        "color": _COLOUR,
        "meanFreePath": Known("m", 1.0),
        "baseHeight": Known("m"),
        "maximumHeight": Known("m"),
        "maxFogDistance": Known("m", 0.0),
        "albedo": Known("linear colour", 0.0, 1.0),
        "anisotropy": Known("1", -1.0, 1.0),
        "enableVolumetricFog": _SWITCH,
    },
    "Light": {"type": _CHOICE, "intensity": Known("lux", 0.0), "color": Known("linear colour", 0.0, 1.0)},
}

# Godot 4.3: doc/classes/Environment.xml, Sky.xml, PanoramaSkyMaterial.xml, PhysicalSkyMaterial.xml,
# DirectionalLight3D.xml in https://github.com/godotengine/godot; ranges from their ADD_PROPERTY lines. Colours in
# files are encoded in sRGB.
_ENCODED = Known("sRGB colour", 0.0, 1.0)
GODOT: Names = {
    "Environment": {
        "background_mode": Known("2 is the sky", 0.0, 6.0),
        "sky": Known("resource"),
        "sky_rotation": Known("rad"),
        "fog_enabled": _SWITCH,
        "fog_light_color": _ENCODED,
        "fog_light_energy": Known("1", 0.0, 16.0),
        "fog_sun_scatter": Known("1", 0.0),
        "fog_density": Known("1/m", 0.0, 1.0),
        "fog_sky_affect": _SHARE,
        "fog_height": Known("m"),
        "fog_height_density": Known("1/m", -16.0, 16.0),
        "tonemap_mode": Known("0 is linear", 0.0, 4.0),
    },
    "Sky": {"sky_material": Known("resource")},
    "PanoramaSkyMaterial": {
        "panorama": Known("resource"),
        "filter": _SWITCH,
        "energy_multiplier": Known("1", 0.0, 128.0),
    },
    "PhysicalSkyMaterial": {
        "rayleigh_coefficient": Known("1", 0.0, 64.0),
        "rayleigh_color": _ENCODED,
        "mie_coefficient": Known("1", 0.0, 1.0),
        "mie_eccentricity": Known("1", -1.0, 1.0),
        "mie_color": _ENCODED,
        "turbidity": Known("1", 0.0, 1000.0),
        "energy_multiplier": Known("1", 0.0, 128.0),
    },
    "DirectionalLight3D": {
        "transform": Known("Transform3D"),
        "light_color": _ENCODED,
        "light_energy": Known("irradiance over pi", 0.0),
        "light_angular_distance": Known("degrees", 0.0, 90.0),
    },
    "WorldEnvironment": {"environment": Known("resource")},
}


def allowed(names: Names, settings: Settings) -> tuple[dict[str, dict[str, Number]], list[str]]:
    """Settings held to their ranges, and a sentence on each that was not within.

    A name that is not in the table is a KeyError: an exporter's fault, not the user's.

    >>> allowed(GODOT, {"Environment": {"fog_density": 2.0}})
    ({'Environment': {'fog_density': 1.0}}, ['Environment.fog_density would be 2, held to 1'])
    """
    found: dict[str, dict[str, Number]] = {}
    notes = []
    for owner, properties in settings.items():
        found[owner] = {}
        for name, value in properties.items():
            held = _held(names[owner][name], value)
            found[owner][name] = held
            if held != value:
                notes.append(f"{owner}.{name} would be {_told(value)}, held to {_told(held)}")
    return found, notes


def _held(known: Known, value: Number) -> Number:
    if isinstance(value, bool | str):
        return value
    if isinstance(value, tuple):
        return tuple(_between(known, one) for one in value)
    return _between(known, value)


def _between(known: Known, value: float) -> float:
    above = value if known.low is None else max(value, known.low)
    return above if known.high is None else min(above, known.high)


def _told(value: Number) -> str:
    return ", ".join(f"{one:.3g}" for one in value) if isinstance(value, tuple) else f"{value:.3g}"
