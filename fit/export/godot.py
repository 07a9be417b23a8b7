"""The weather for Godot 4: a scene with an environment and a sun, and the engine's own sky fitted beside it.

The sky of the scene is our picture. Godot's fog is not a path through a layer: its opacity is the larger of one by
distance and one by the height of what is seen, so both are fitted to ours over distances and heights.
"""

import math

import numpy as np
import torch
from scipy.optimize import least_squares

from diffrender.atmosphere.height_fog import HeightFog, optical_depth
from diffrender.atmosphere.scattering import SUN_RADIUS
from diffrender.numerics import opacity
from diffrender.rays import Rays
from diffrender.scene import EYE_ALTITUDE
from fit.export.account import Account
from fit.export.analytic_sky import GODOT_DIALS, GODOT_TURBIDITY, godot_sky
from fit.export.described import Described, level_opacity, sky_radiance, upper_half
from fit.export.engine_names import GODOT, Number, allowed
from fit.export.exported import PANORAMA, Exported, panorama
from fit.export.fog_colour import cone
from fit.export.short_fit import fitted
from fit.export.stored_colour import encoded, split
from fit.export.template import one_line, rendered

VERIFIED = "not verified in the engine; names and ranges as in the sources of Godot 4.3"
_SUN_EXPONENT = 8.0  # of the cosine in the fog's light towards the sun, in the engine's shader

Properties = dict[str, Number]


def export(weather: Described) -> Exported:
    """`weather.tscn`, `sky.exr` and `physical_sky.tres`, and what they keep."""
    physical, sky_sentence = _physical_sky(weather)
    strength, colour = split((weather.sunlight / math.pi).tolist())
    environment: Properties = {"background_mode": 2.0, "sky_rotation": (0.0, math.pi, 0.0), "tonemap_mode": 0.0}
    approximates = [
        f"the sky by a picture of {PANORAMA.width} x {PANORAMA.height} pixels without the sun's disc",
        sky_sentence,
    ]
    drops = ["the sun's disc", "anti-aliasing (AA_*)", "other hours"]
    if weather.scene.height_fog is not None:
        fog, sentences = _fog(weather, weather.scene.height_fog, strength)
        environment |= fog
        approximates += sentences
        drops.append("the fog's path through its layer; its extinction and its glow by channel")
    held, notes = allowed(
        GODOT,
        {
            "Environment": environment,
            "PanoramaSkyMaterial": {"filter": True, "energy_multiplier": 1.0},
            "PhysicalSkyMaterial": physical,
            "DirectionalLight3D": {
                "light_color": encoded(colour),
                "light_energy": strength,
                "light_angular_distance": math.degrees(2.0 * SUN_RADIUS),
            },
        },
    )
    title = f"Weather of {one_line(weather.name)} at {weather.hour:g} h, by `fit export --to godot`"
    written = {owner: {name: literal(name, value) for name, value in of.items()} for owner, of in held.items()}
    texts = {
        "weather.tscn": rendered(
            "godot.tscn.jinja", title=title, verified=VERIFIED, settings=written, transform=_transform(weather)
        ),
        "physical_sky.tres": rendered("godot_sky.tres.jinja", title=title, verified=VERIFIED, settings=written),
    }
    keeps = ["the sun as a light, dimmed by air and clouds"]
    account = Account("Godot", VERIFIED, keeps, [*approximates, *notes], drops)
    return Exported(texts, {"sky.exr": panorama(weather)}, account)


def _physical_sky(weather: Described) -> tuple[Properties, str]:
    direction = upper_half()
    ours = sky_radiance(weather, direction)
    match = fitted(lambda dials: godot_sky(dials, direction.double(), weather.to_sun.double()), GODOT_DIALS, ours)
    colours = {
        f"{part}_color": encoded([match.dials[f"{part}_color_{channel}"] for channel in "rgb"])
        for part in ("rayleigh", "mie")
    }
    found: Properties = {
        name: match.dials[name] for name in ("rayleigh_coefficient", "mie_coefficient", "mie_eccentricity")
    }
    sentence = (
        f"Godot's own PhysicalSkyMaterial (physical_sky.tres), for a light of energy 1, fitted: {match.difference}"
    )
    return found | colours | {"turbidity": GODOT_TURBIDITY, "energy_multiplier": match.gain}, sentence


def _fog(weather: Described, fog: HeightFog, light_energy: float) -> tuple[Properties, list[str]]:
    colour = cone(weather, fog, (_SUN_EXPONENT,))
    strength, even = split(colour.even)
    (density, height, per_height), apart = _opacity(fog)
    up = upper_half()
    endless = torch.full_like(up[:, 0], math.inf)
    sky = optical_depth(fog, Rays(torch.tensor([0.0, 0.0, EYE_ALTITUDE]), up, endless))
    found: Properties = {
        "fog_enabled": True,
        "fog_light_color": encoded(even),
        "fog_light_energy": strength,
        "fog_sun_scatter": float(np.mean(colour.towards_sun)) / max(math.pi * light_energy, 1e-30),
        "fog_density": density,
        "fog_height": height,
        "fog_height_density": per_height,
        "fog_sky_affect": float(opacity(sky).mean()),
    }
    return found, [
        f"the fog's opacity by distance and by height, fitted: off by {apart.mean():.2g} in the mean and "
        f"{apart.max():.2g} at most; before the sky by one share",
        f"the colour of endless level fog by a cone round the sun: {colour.difference}, its light that of the sun",
    ]


def _opacity(fog: HeightFog) -> tuple[tuple[float, float, float], np.ndarray]:
    """Density, height and density by height whose opacity comes nearest to ours, and how far off it is."""
    farthest = float(level_opacity(fog)[0][-1])
    distance, climb = torch.meshgrid(
        torch.logspace(-2.0, 0.0, 12) * farthest, torch.linspace(0.0, 4.0, 9) * fog.scale_height, indexing="ij"
    )
    distance, climb = distance.flatten(), torch.minimum(climb.flatten(), distance.flatten())
    level = torch.sqrt(distance * distance - climb * climb)
    towards = torch.stack([level, torch.zeros_like(level), climb], -1) / distance[:, None]
    rays = Rays(torch.tensor([0.0, 0.0, EYE_ALTITUDE]), towards, distance)
    ours = opacity(optical_depth(fog, rays)).mean(-1).double().numpy()
    far, high = distance.double().numpy(), climb.double().numpy() + EYE_ALTITUDE

    def apart(dials: np.ndarray) -> np.ndarray:
        by_height = -np.expm1(np.minimum((high - dials[1]) * np.exp(dials[2]), 0.0))
        return np.asarray(np.maximum(-np.expm1(-far * np.exp(dials[0])), by_height) - ours)

    steep = -math.log(float(fog.scale_height))
    thin, scale_height = math.log(2.5 / farthest), float(fog.scale_height)
    ends = np.array([thin - 6.0, -1e4, steep - 8.0]), np.array([thin + 3.0, 1e5, steep + 4.0])
    # From below the eye, where height does nothing, and from above, where it does all.
    found = [
        least_squares(
            apart, [thin, height * scale_height, steep], bounds=ends, x_scale=[1.0, scale_height, 1.0], max_nfev=60
        )
        for height in (0.0, 1.0, 3.0)
    ]
    best = min(found, key=lambda one: float(one.cost)).x
    # The shader multiplies the height above `fog_height`: thicker below by a density from 0 up.
    return (math.exp(best[0]), float(best[1]), math.exp(best[2])), np.abs(apart(best))


def _transform(weather: Described) -> str:
    """Of a light whose -z points away from the sun; Godot's x points right, y up and z back."""
    ahead, left, up = weather.to_sun.tolist()
    back = np.array([-left, up, -ahead])
    right = np.cross([0.0, 1.0, 0.0] if abs(up) < 0.999 else [0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    rows = np.stack([right, np.cross(back, right), back], -1)
    return ", ".join(f"{one:.7g}" for one in [*rows.flatten(), 0.0, 0.0, 0.0])


def literal(name: str, value: Number) -> str:
    """A value as Godot's text files hold it.

    >>> literal("fog_enabled", True), literal("sky_rotation", (0.0, 1.5, 0.0)), literal("mie_color", (1.0, 0.5, 0.0))
    ('true', 'Vector3(0, 1.5, 0)', 'Color(1, 0.5, 0, 1)')
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        numbers = ", ".join(f"{one:.7g}" for one in value)
        return f"Vector3({numbers})" if name == "sky_rotation" else f"Color({numbers}, 1)"
    return str(value) if isinstance(value, str) else f"{value:.7g}"
