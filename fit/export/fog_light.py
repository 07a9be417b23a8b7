"""What the closed form of a fog is drawn from in other engines: coefficients, and light with albedo and tints."""

from diffrender.atmosphere import height_fog
from diffrender.atmosphere.height_fog import HeightFog
from fit.export.described import Described, air_mass


def coefficients(weather: Described, fog: HeightFog) -> dict[str, object]:
    """Numbers by name, in metres and exposed radiance."""
    return {
        "extinction": height_fog.extinction(fog).tolist(),
        "scale_height": float(fog.scale_height),
        "base_height": float(fog.base_height),
        "sun": (fog.albedo * fog.sun_tint * weather.irradiance).tolist(),
        "sky": (fog.albedo * fog.ambient_tint * weather.skylight).tolist(),
        "rayleigh_share": fog.rayleigh_share.tolist(),
        "asymmetry": float(fog.asymmetry),
        "air_mass": air_mass(weather, fog),
    }
