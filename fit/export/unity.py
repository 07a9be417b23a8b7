"""The weather for Unity's High Definition pipeline: an editor script that makes a volume profile and a sun.

The sky is our picture in an HDRISky. The pipeline's fog has our optical depth above its base height, written by the
height where a thousandth is left, and the same density everywhere below it; its colour is one, or the sky's.
"""

from diffrender.atmosphere.height_fog import HeightFog, extinction
from fit.export.account import Account, Difference
from fit.export.described import Described
from fit.export.engine_names import UNITY, Number, Settings, allowed
from fit.export.exported import PANORAMA, Exported, panorama
from fit.export.fog_colour import even
from fit.export.stored_colour import split
from fit.export.template import one_line, rendered

VERIFIED = "not verified in the engine; names and ranges as in the sources of Unity 6, HDRP 17"
LAYER = 0.144765  # scale height of a layer a metre deep, in the pipeline's own digits: 1 / ln(1000)
_FARTHEST = 1e6  # where fog is drawn to [m]

# Class of the volume's component -> its name in the script.
_VOLUME = {"VisualEnvironment": "environment", "HDRISky": "sky", "Fog": "fog"}


def export(weather: Described) -> Exported:
    """`Weather.cs` for an Editor folder, `sky.exr`, and what they keep."""
    strength, colour = split(weather.sunlight.tolist())
    fog: dict[str, Number] = {"enabled": False}
    keeps = ["the sun as a light, dimmed by air and clouds"]
    approximates = [f"the sky by a picture of {PANORAMA.width} x {PANORAMA.height} pixels without the sun's disc"]
    drops = ["the sun's disc, unless the light is given an angular diameter", "anti-aliasing (AA_*)", "other hours"]
    if weather.scene.height_fog is not None:
        fog, apart = _fog(weather, weather.scene.height_fog)
        keeps.append("the fog's optical depth above its base height, mean of the channels")
        approximates.append(f"the colour of endless level fog by one colour: {apart}")
        drops.append("fog denser below its base height than at it; its extinction by channel; its glow round the sun")
    settings: Settings = {
        "VisualEnvironment": {"skyType": "SkyType.HDRI"},
        "HDRISky": {"rotation": 0.0, "skyIntensityMode": "SkyIntensityMode.Multiplier", "multiplier": 1.0},
        "Fog": fog,
        "Light": {"type": "LightType.Directional", "intensity": strength, "color": colour},
    }
    held, notes = allowed(UNITY, settings)
    script = rendered(
        "unity.cs.jinja",
        title=f"Weather of {one_line(weather.name)} at {weather.hour:g} h, by `fit export --to unity`.",
        verified=VERIFIED,
        volume=[
            (variable, owner, {name: literal(value) for name, value in held[owner].items()})
            for owner, variable in _VOLUME.items()
        ],
        light={name: literal(value) for name, value in held["Light"].items()},
        shines=literal(_shines(weather)).replace("Color", "Vector3"),
    )
    account = Account("Unity HDRP", VERIFIED, keeps, [*approximates, *notes], drops)
    return Exported({"Weather.cs": script}, {"sky.exr": panorama(weather)}, account)


def _fog(weather: Described, fog: HeightFog) -> tuple[dict[str, Number], Difference]:
    colour, apart = even(weather, fog)
    base = float(fog.base_height)
    return {
        "enabled": True,
        "colorMode": "FogColorMode.ConstantColor",
        "color": colour,
        "meanFreePath": 1.0 / float(extinction(fog).mean()),
        "baseHeight": base,
        "maximumHeight": base + float(fog.scale_height) / LAYER,
        "maxFogDistance": _FARTHEST,
        "albedo": tuple(fog.albedo.tolist()),
        "anisotropy": float(fog.asymmetry),
        "enableVolumetricFog": False,
    }, apart


def _shines(weather: Described) -> tuple[float, ...]:
    """Direction of the sun's light; Unity's x points right, y up and z ahead."""
    ahead, left, up = (-weather.to_sun).tolist()
    return -left, up, ahead


def literal(value: Number) -> str:
    """A value in C#.

    >>> literal(0.5), literal(True), literal((1.0, 0.5, 0.0))
    ('0.5f', 'true', 'new Color(1f, 0.5f, 0f)')
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"new Color({', '.join(literal(one) for one in value)})"
    return value if isinstance(value, str) else f"{value:.7g}f"
