"""Skin's two passes: the deferred one writes two targets, the forward one combines them.

What is wide and what is narrow are kept apart: light that has entered the skin, which a blur spreads in between, and
what the surface mirrors. Light is coloured by half, by the root of the texture, as it enters and by half as it leaves:
so light and eye may be exchanged, which neither a texture laid on before the blur nor one after it allows.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import safe_sqrt
from diffrender.parameters import record
from diffrender.shading import brdf
from diffrender.shading.brdf import Geometry, Material
from diffrender.shading.microfacet import LEAST_COSINE
from diffrender.shading.skin_view import Skin, SkinView


@record
class Targets:
    """Pictures that the deferred pass writes [W/(m² sr)].

    Attributes:
        diffuse: light that has entered, as white ground under the surface would send it out.
        specular: what the surface mirrors to the eye.
    """

    diffuse: Float[Tensor, "*batch height width 3"]
    specular: Float[Tensor, "*batch height width 3"]


def deferred(skin: Skin, view: SkinView) -> Targets:
    """Both targets, of all lights and the sky."""
    shine = _material(skin, torch.zeros_like(skin.colour))
    at_eye = Geometry(view.normal, view.to_eye, view.normal)
    diffuse, specular = (
        brdf.entered_sky(view.normal, view.lights.sky),
        brdf.reflected_sky(shine, at_eye, view.lights.sky),
    )
    for light, (to_light, irradiance) in enumerate(zip(view.lights.to_light, view.lights.irradiance, strict=True)):
        falls = irradiance * view.unshadowed[..., light, None]
        geometry = Geometry(view.normal, view.to_eye, to_light.expand_as(view.normal))
        specular = specular + falls * brdf.reflected(shine, geometry)
        diffuse = diffuse + falls * brdf.entered(brdf.cosines(geometry).light)[..., None]
    return Targets(diffuse * safe_sqrt(view.texture), specular)


def forward(skin: Skin, view: SkinView, targets: Targets) -> Float[Tensor, "*batch height width 3"]:
    """Radiance of skin towards the eye [W/(m² sr)], black where there is none, of both targets."""
    return view.mask[..., None] * (targets.specular + leaving(skin, view) * targets.diffuse)


def leaving(skin: Skin, view: SkinView) -> Float[Tensor, "*batch height width 3"]:
    """Share of the light inside that leaves towards the eye."""
    cos_eye = (view.normal * view.to_eye).sum(-1).clamp(LEAST_COSINE, 1.0)
    return brdf.ground(_material(skin, skin.colour * safe_sqrt(view.texture)), cos_eye)


def _material(skin: Skin, diffuse: Tensor) -> Material:
    return Material(diffuse, skin.specular.expand(3), skin.roughness)
