"""The weather for Blender: a script for its Python with the sky as a picture, a sun lamp, and fog as a volume.

Blender's own sky node has one haze of one colour, no overcast and a radiance of its own, so the sky is a picture. Its
volumes scatter by Henyey and Greenstein alone and light fog by the scene's lamps, so the fog absorbs and emits by our
formula and Cycles integrates it: the picture of `fit fog`, but neither shadows nor a lamp of the artist's own.
"""

import math
import pprint

from diffrender.atmosphere.celestial import SOLID_ANGLE
from diffrender.atmosphere.height_fog import HeightFog, extinction
from diffrender.atmosphere.scattering import SUN_RADIUS
from fit.export.account import Account
from fit.export.described import Described
from fit.export.exported import PANORAMA, Exported, panorama
from fit.export.fog_light import coefficients
from fit.export.template import one_line, rendered

VERIFIED = "run in Blender 4.2 Cycles (bpy) by experiments.exports"
_LARGEST = 2e5  # half the box's side [m]
_STEPS = 10.0  # of Cycles in a scale height


def export(weather: Described) -> Exported:
    """`weather.py` and `sky.exr`, and what they keep."""
    fog = weather.scene.height_fog
    content = {
        "to_sun": weather.to_sun.tolist(),
        "sun_angle": 2.0 * SUN_RADIUS,
        "sunlight": weather.sunlight.tolist(),
        "disc_radiance": (weather.sunlight / SOLID_ANGLE).tolist(),
        "fog": None if fog is None else coefficients(weather, fog) | _volume(fog),
    }
    script = rendered(
        "blender.py.jinja",
        title=f"Weather of {one_line(weather.name)} at {weather.hour:g} h, by `fit export --to blender`.",
        weather=pprint.pformat(content, sort_dicts=False, width=100),
    )
    keeps = ["the sun as a lamp and a disc of its true size, dimmed by air and clouds; the disc is for cameras alone"]
    approximates = [f"the sky by a picture of {PANORAMA.width} x {PANORAMA.height} pixels, exact between its samples"]
    if fog is not None:
        keeps.append("the fog, by channel: its single scattering, integrated by Cycles in a box round the origin")
        approximates.append("fog ends at the sides of its box, 14 optical depths away at the ground or 200 km")
    drops = ["the darker limb of the sun", "shadows and the scene's own lamps in the fog", "anti-aliasing (AA_*)"]
    account = Account("Blender", VERIFIED, keeps, approximates, [*drops, "other hours"])
    return Exported({"weather.py": script}, {"sky.exr": panorama(weather)}, account)


def _volume(fog: HeightFog) -> dict[str, object]:
    """Bottom, top and half the side of the box that holds a fog, and the step through it [m]."""
    height, base = float(fog.scale_height), float(fog.base_height)
    # At altitude 0, where cameras stand; capped because thick valleys would shrink the box to nothing.
    at_ground = float(extinction(fog).mean()) * math.exp(min(max(base / height, -20.0), 20.0))
    half = min(max(14.0 / at_ground, 30.0 * height), _LARGEST)
    return {"box": (min(base, 0.0) - 2.0 * height, max(base, 0.0) + 12.0 * height, half), "step": height / _STEPS}
