"""The weather for Unreal Engine: an editor script that sets a sky atmosphere, an exponential height fog and a sun.

Unreal's sky atmosphere is the model that ours follows, with one haze where we have two, its phase function Henyey and
Greenstein's where ours is Cornette and Shanks', and no overcast: haze, its asymmetry and a gain are found by a short
fit of that. Its height fog has our optical depth: the engine's shader integrates a density that halves with height, so
sigma = ln(2)^2 FogDensity / 10 per metre and the scale height is 10 m / (ln(2) FogHeightFalloff). It has neither our
colour by distance nor light dimmed on its way in.
"""

import math
import pprint
from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import scattering, sky, sky_tables, sky_view
from diffrender.atmosphere.height_fog import HeightFog, extinction
from diffrender.atmosphere.scattering import Medium
from diffrender.atmosphere.sky import SkyView, TabledView
from diffrender.scene import EYE_ALTITUDE
from diffrender.scene import sky_view as seen_by
from fit import keyframes
from fit.export.account import Account
from fit.export.analytic_sky import Dial
from fit.export.described import Described, sky_radiance, upper_half
from fit.export.engine_names import UNREAL, Number, allowed
from fit.export.exported import Exported
from fit.export.fog_colour import cone
from fit.export.short_fit import Match, fitted, match
from fit.export.stored_colour import in_bytes, split
from fit.export.template import one_line, rendered
from fit.picture import scene_sky

VERIFIED = "not verified in the engine; names and ranges as documented for Unreal Engine 5.1 to 5.7"
DENSITY = 0.1 * math.log(2.0) ** 2  # extinction of a FogDensity of 1 [1/m]
FALLOFF = 10.0 / math.log(2.0)  # scale height of a FogHeightFalloff of 1 [m]
_DIALS = (Dial("haze", 1.0, 0.05, 20.0), Dial("anisotropy", 0.6, 0.0, 0.98))
_EXPONENTS = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)  # the engine's range

Settings = dict[str, dict[str, Number]]


def export(weather: Described) -> Exported:
    """`weather.py` for Unreal's Python editor scripting, and what it keeps."""
    haze = one_haze(weather)
    air = _thinned(sky.medium(weather.sky), torch.tensor(haze.dials["haze"]))
    settings: Settings = _atmosphere(air, haze) | _sun(weather, air)
    keeps = ["air and ozone: coefficients and heights; the sun's place, size and strength above the air"]
    approximates = [f"the sky by one haze without overcast, fitted to ours in a model of Unreal's: {haze.difference}"]
    drops = ["the sun behind the overcast layer: its light falls undimmed by clouds", "anti-aliasing (AA_*)"]
    if weather.scene.height_fog is not None:
        settings |= _fog(weather, weather.scene.height_fog, approximates)
        keeps.append("the fog's optical depth, mean of the channels: density, height and base height")
        drops.append("the fog's extinction by channel; its dimming of the sun's light on the way in")
    held, notes = allowed(UNREAL, settings)
    script = rendered(
        "unreal.py.jinja",
        title=f"Weather of {one_line(weather.name)} at {weather.hour:g} h, by `fit export --to unreal`.",
        verified=VERIFIED,
        settings=pprint.pformat(held, sort_dicts=False, width=100),
        rotation=rotation(weather.to_sun),
        height=0.0 if weather.scene.height_fog is None else 100.0 * float(weather.scene.height_fog.base_height),
    )
    account = Account("Unreal Engine", VERIFIED, keeps, [*approximates, *notes], [*drops, "other hours"])
    return Exported({"weather.py": script}, {}, account)


def one_haze(weather: Described) -> Match:
    """Haze, over ours, and asymmetry with which one haze by Henyey and Greenstein comes nearest to our sky."""
    exact = keyframes.scene(keyframes.values(weather.scene), torch.float64)
    view, ours = seen_by(exact, upper_half().double()), sky_radiance(weather, upper_half())
    air = sky.medium(scene_sky(exact))

    def formula(size: sky.Size) -> Callable[[Float[Tensor, " dials"]], Float[Tensor, "n 3"]]:
        fixed = sky.geometry(view, size)
        return lambda dials: _clear(view, sky_tables.tables(_thinned(air, dials[0]), fixed), dials[1])

    # Searched with small tables, a fifth of the time, and told with those that our sky is drawn from.
    found = fitted(formula(sky.WEATHER_SIZE), _DIALS, ours).dials
    return match(found, formula(sky.Size())(torch.tensor(list(found.values()), dtype=torch.float64)), ours)


def _thinned(air: Medium, share: Float[Tensor, ""]) -> Medium:
    return replace(air, haze=air.haze * share, haze_scattering=air.haze_scattering * share)


def _clear(view: SkyView, tables: sky.SkyTables, asymmetry: Float[Tensor, ""]) -> Float[Tensor, "n 3"]:
    by_air, by_haze, higher = sky_tables.look_up(TabledView(view, tables)).unbind(-2)
    chord = sky_view.chord_square(view)
    haze_phase = scattering.henyey_greenstein(chord, asymmetry)[:, None]
    return (by_air * scattering.rayleigh_phase(chord)[:, None] + by_haze * haze_phase + higher) * view.irradiance


def _atmosphere(air: Medium, haze: Match) -> Settings:
    found: dict[str, Number] = {
        "transform_mode": "PLANET_TOP_AT_ABSOLUTE_WORLD_ORIGIN",
        "bottom_radius": scattering.PLANET_RADIUS / 1e3,
        "atmosphere_height": scattering.TOP / 1e3,
        "ground_albedo": in_bytes((float(air.ground_albedo),) * 3),
        "multi_scattering_factor": 1.0,
        "rayleigh_exponential_distribution": scattering.RAYLEIGH_HEIGHT / 1e3,
        "mie_exponential_distribution": scattering.HAZE_HEIGHT / 1e3,
        "mie_anisotropy": haze.dials["anisotropy"],
        "sky_luminance_factor": (haze.gain,) * 3,
        "height_fog_contribution": 0.0,
    }
    parts = {
        "rayleigh_scattering": air.rayleigh,
        "mie_scattering": air.haze_scattering,
        "mie_absorption": air.haze - air.haze_scattering,
        "other_absorption": air.ozone,
    }
    for name, coefficients in parts.items():
        found[f"{name}_scale"], found[name] = split((1e3 * coefficients).tolist())
    tent: dict[str, Number] = {
        "tip_altitude": scattering.OZONE_MIDDLE / 1e3,
        "tip_value": 1.0,
        "width": scattering.OZONE_HALF_WIDTH / 1e3,
    }
    return {"SkyAtmosphereComponent": found, "TentDistribution": tent}


def _sun(weather: Described, air: Medium) -> Settings:
    """The sun's light; Unreal divides what it is given by the air's transmittance to the zenith."""
    eye = weather.to_sun.new_tensor(EYE_ALTITUDE)
    zenith = scattering.transmittance(air, scattering.column(eye, torch.ones_like(eye)))
    strength, colour = split((weather.irradiance * zenith).tolist())
    return {
        "DirectionalLightComponent": {
            "intensity": strength,
            "light_color": in_bytes(colour),
            "light_source_angle": math.degrees(2.0 * scattering.SUN_RADIUS),
            "atmosphere_sun_light": True,
            "use_temperature": False,
        }
    }


def _fog(weather: Described, fog: HeightFog, approximates: list[str]) -> Settings:
    light = cone(weather, fog, _EXPONENTS)
    approximates.append(f"the colour of endless level fog by a cone round the sun: {light.difference}")
    return {
        "ExponentialHeightFogComponent": {
            "fog_density": float(extinction(fog).mean()) / DENSITY,
            "fog_height_falloff": FALLOFF / float(fog.scale_height),
            "fog_inscattering_luminance": light.even,
            "fog_max_opacity": 1.0,
            "start_distance": 0.0,
            "directional_inscattering_exponent": light.exponent,
            "directional_inscattering_start_distance": 0.0,
            "directional_inscattering_luminance": light.towards_sun,
        }
    }


def rotation(to_sun: Float[Tensor, "3"]) -> dict[str, float]:
    """Pitch and yaw in degrees of a light that shines from the sun; Unreal's y points right, ours left."""
    ahead, left, up = (-to_sun).tolist()
    return {
        "pitch": math.degrees(math.atan2(up, math.hypot(ahead, left))),
        "yaw": math.degrees(math.atan2(-left, ahead)),
    }
