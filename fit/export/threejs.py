"""The weather for three.js: one module with our own tables and formulas in GLSL, and its own Sky and FogExp2 fitted.

three.js' fog has no height, no sun and no colour by distance, and its sky none of our air: what keeps both is to draw
them by the formulas that `fit render` and `fit fog` use. The tables that are looked up are the same, so what differs is
float32 on another processor.
"""

import base64
import json
import math
from importlib.resources import files

import torch
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from torch import Tensor

from diffrender.atmosphere import sky, sky_view
from diffrender.atmosphere.celestial import LIMB_EXPONENTS, SOLID_ANGLE
from diffrender.atmosphere.scattering import SUN_RADIUS
from diffrender.atmosphere.sky_view import horizon
from diffrender.scene import EYE_ALTITUDE
from fit.export.account import Account
from fit.export.analytic_sky import THREE_DIALS, three_sky
from fit.export.described import Described, level_opacity, sky_radiance, upper_half
from fit.export.exported import Exported
from fit.export.fog_colour import even
from fit.export.fog_light import coefficients
from fit.export.short_fit import Match, fitted

VERIFIED = "run in three.js r187 in a headless Chromium by experiments.exports"
PLACEHOLDER = "export const weather = null;"


def export(weather: Described) -> Exported:
    """`weather.js`, and what it keeps."""
    built_in, sentences = _built_in(weather)
    content = {**data(weather), "built_in": built_in}
    template = files("fit.export").joinpath("threejs.js").read_text(encoding="utf-8")
    module = template.replace(PLACEHOLDER, f"export const weather = {json.dumps(content, indent=1)};")
    keeps = [
        "the sky: the tables and formulas of `fit render` in GLSL; overcast share and the sun's disc with its limb too",
        "the sun as a DirectionalLight dimmed by air and clouds, and the sky as light by createEnvironment",
    ]
    drops = ["anti-aliasing (AA_*), other hours"]
    if weather.scene.height_fog is not None:
        keeps.append("the fog: the closed form of `fit fog` in GLSL, by channel, before tone mapping")
        drops.append("the fog's dimming of light on surfaces, shadows within the fog")
    return Exported({"weather.js": module}, {}, Account("three.js", VERIFIED, keeps, sentences, drops))


def data(weather: Described) -> dict[str, object]:
    """What the module's formulas need, in the weather's axes."""
    of, tables = weather.sky, weather.tables.in_scatter
    rows, columns = tables.shape[:2]
    texels = torch.nn.functional.pad(tables.float(), (0, 1))  # three.js has no float texture of three channels
    return {
        "name": weather.name,
        "hour": weather.hour,
        "to_sun": weather.to_sun.tolist(),
        "irradiance": weather.irradiance.tolist(),
        "sunlight": weather.sunlight.tolist(),
        "sun": {
            "chord": 2.0 * math.sin(SUN_RADIUS / 2.0),
            "radiance": (weather.sunlight / SOLID_ANGLE).tolist(),
            "limb_exponents": list(LIMB_EXPONENTS),
        },
        "sky": {
            "rows": rows,
            "columns": columns,
            "tables": base64.b64encode(texels.numpy().astype("<f4").tobytes()).decode(),
            "row_scale": sky_view.ROW_SCALE,
            "horizon": float(horizon(tables.new_tensor(EYE_ALTITUDE))),
            "haziness": float(of.haziness),
            "coarse_haziness": float(of.coarse_haziness),
            "coarse_share": sky.coarse_share(of).tolist(),
            "cloud": (weather.tables.cloud * of.overcast_transmittance).tolist(),
            "overcast": float(of.overcast),
            "overcast_lean": [float(of.overcast_ahead), float(of.overcast_left)],
        },
        "fog": None if weather.scene.height_fog is None else coefficients(weather, weather.scene.height_fog),
    }


def built_in_sky(weather: Described) -> tuple[Match, str]:
    """three.js' own `Sky` fitted to ours, and a sentence on how near it comes."""
    direction = upper_half()
    ours = sky_radiance(weather, direction)
    match = fitted(lambda dials: three_sky(dials, direction.double(), weather.to_sun.double()), THREE_DIALS, ours)
    return match, f"three.js' own Sky (builtIn.sky), fitted: {match.difference} of the sky's radiance"


def _built_in(weather: Described) -> tuple[dict[str, object], list[str]]:
    match, sentence = built_in_sky(weather)
    found: dict[str, object] = {"sky": {**match.dials, "cloudCoverage": 0.0, "exposure": match.gain}}
    sentences = [sentence]
    if weather.scene.height_fog is not None:
        distance, opacity = level_opacity(weather.scene.height_fog)
        density, apart = _squared_exponential(distance, opacity)
        found["fog"] = {"density": density, "color": list(even(weather, weather.scene.height_fog)[0])}
        sentences.append(
            "three.js' own FogExp2 (builtIn.fog), fitted to level rays from the eye: opacity off by "
            f"{float(apart.mean()):.2g} in the mean and {float(apart.max()):.2g} at most, no height, one colour"
        )
    return found, sentences


def _squared_exponential(
    distance: Float[Tensor, " n"], opacity: Float[Tensor, " n"]
) -> tuple[float, Float[Tensor, " n"]]:
    """Density of FogExp2 nearest to an opacity over distance, and how far off it is."""

    def apart(log_density: float) -> Tensor:
        return -torch.expm1(-((math.exp(log_density) * distance) ** 2)) - opacity

    ends = -math.log(float(distance[-1])) - 3.0, -math.log(float(distance[0])) + 3.0
    best = minimize_scalar(lambda log: float(apart(log).square().mean()), bounds=ends, method="bounded").x
    return math.exp(best), apart(best).abs()
