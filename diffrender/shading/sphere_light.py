"""Highlights of a light that is a sphere, as of one point of it [1, 2] or all, and the ground that it lights.

All but the last renderer look at one point. Facets are counted at the place of the sphere that `light_bending` finds;
shadows and the light's cosine are those of its centre. The highlight of one point is the same peak all over the
sphere's mirror picture, and has to be dimmed by what the sphere is wider than a point: Karis does as if the facets were
spread by half the sphere's sine more. The talk asks for two corrections [2], whose formulas are not public; ours are
compared with sums over the sphere (`experiments.sphere_light`):

    sine of the bent light = sine (sine / (sine + spread))²
    mean of GGX at the peak = 1 / (pi (spread² + (1 - spread²) sin²(angular radius / 2) / V·H))

By the first the even middle shrinks with roughness, and the highlight falls off as it should. The second is exact for
an eye along the normal in the middle of the picture, and for mirrors all over it, as V·H and Fresnel are then those of
the point and not of the centre. Where the horizon cuts the sphere, that renderer takes the mean cosine of what is
above; those before go dark as soon as the centre sets, which the talk prefers to acne of shadows. What stays wrong is
the faint glow far from a smooth surface's highlight, which is too dark, and rough highlights that graze.

The last renderer has neither fault: it counts all facets that mirror the sphere, exactly, and takes what they reflect
of their mean (`facets_of_sphere`). Light that crosses to the diffuse ground is taken of the sphere's mean cosine.

The sphere is even, throws no shadow, and is shadowed by nothing. Surfaces inside it are taken as just outside.

Gradient: as of `light_bending` and `risen_sphere`; 0 in radius and distance for surfaces inside the sphere, and 0 for a
sphere that has set.

[1] B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013 course "Physically Based Shading".
[2] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games", slides 4 to 15 and notes to the code.
"""

import math
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.parameters import record
from diffrender.shading import brdf
from diffrender.shading.brdf import Cosines, Geometry
from diffrender.shading.facets_of_sphere import facets_of
from diffrender.shading.light_bending import Step, bent, guarded_step, no_step, talk_step
from diffrender.shading.microfacet import LEAST_COSINE, ggx, spread_squared, visible_smith
from diffrender.shading.risen_sphere import cosine, mean_cosine, risen
from diffrender.shading.sphere_light_reference import summed
from diffrender.shading.sphere_surface import SphereLight, SphereView, example_inputs

_WIDEST = 0.9999  # sine of a sphere that one is nearly inside of


@record
class Sphere:
    """The light over a surface: directions with that of its centre, its sine, the facets' spread, and all cosines."""

    geometry: Geometry
    sine: Float[Tensor, "*#batch"]
    spread: Float[Tensor, "*#batch"]  # its square
    cosines: Cosines


def render(light: SphereLight, view: SphereView, visible: brdf.Visible = visible_smith) -> Float[Tensor, "*batch 3"]:
    """Radiance of a surface towards the eye [W/(m² sr)], of all its facets that mirror the sphere."""
    disc, seen, cosines = _of_mean(sphere_over(light, view), visible)
    made = brdf.material(view.base, view.roughness, view.metallic)
    return light.radiance * disc[..., None] * brdf.sent(made, seen, cosines)


def render_mean(
    light: SphereLight, view: SphereView, visible: brdf.Visible = visible_smith
) -> Float[Tensor, "*batch 3"]:
    """The same by one point, whose peak is as bright as the sphere's mean."""
    over = sphere_over(light, view)
    half = _half(over, reduced_sine(over), guarded_step)
    cos_half = (0.5 * torch.linalg.vector_norm(half, dim=-1)).clamp(max=1.0)
    over = replace(over, cosines=Cosines(over.cosines.eye, risen_cosine(over), cos_half))
    # Solid angles, of which those of the plane are a share.
    wider = 2.0 / (1.0 + cosine(over.sine))
    dimmed = math.pi * over.spread * mean_facets(over) * wider
    return _lit(light, view, over, ggx(half, view.normal, over.spread) * dimmed, visible)


def render_reduced(
    light: SphereLight, view: SphereView, visible: brdf.Visible = visible_smith
) -> Float[Tensor, "*batch 3"]:
    """The same as bright as Karis has it."""
    over = sphere_over(light, view)
    half = _half(over, reduced_sine(over), guarded_step)
    return _lit(light, view, over, ggx(half, view.normal, over.spread) * _dimmed_by_karis(over), visible)


def render_edge(
    light: SphereLight, view: SphereView, step: Step, visible: brdf.Visible = visible_smith
) -> Float[Tensor, "*batch 3"]:
    """The same as wide as the sphere on all surfaces, the point moved by a step round the sphere's edge."""
    over = sphere_over(light, view)
    half = _half(over, over.sine, step)
    return _lit(light, view, over, ggx(half, view.normal, over.spread) * _dimmed_by_karis(over), visible)


def skip(light: SphereLight, view: SphereView) -> Float[Tensor, "*batch 3"]:
    """No light: black."""
    return torch.zeros_like(view.position + view.normal + view.to_eye) * light.radiance


def sphere_over(light: SphereLight, view: SphereView) -> Sphere:
    """The light as each surface sees it."""
    away = view.centre - view.position
    distance = torch.linalg.vector_norm(away, dim=-1)
    geometry = Geometry(view.normal, view.to_eye, away / distance[..., None])
    sine = (light.radius / distance).clamp(max=_WIDEST)
    return Sphere(geometry, sine, spread_squared(view.roughness), brdf.cosines(geometry))


def reduced_sine(over: Sphere) -> Float[Tensor, "*batch"]:
    """Sine of the sphere that the light is bent to, the whole one's for a mirror and next to none on rough ground."""
    share = over.sine / (over.sine + over.spread.sqrt())
    return over.sine * share * share


def mean_facets(over: Sphere) -> Float[Tensor, "*batch"]:
    """Mean of GGX over the sphere's directions where its centre stands in the mirror's [1/sr]."""
    half_sine_square = 0.5 * over.sine * over.sine / (1.0 + cosine(over.sine))
    wider = half_sine_square / over.cosines.half.clamp(min=LEAST_COSINE)
    return 1.0 / (math.pi * (over.spread + (1.0 - over.spread) * wider))


def risen_cosine(over: Sphere) -> Float[Tensor, "*batch"]:
    """Mean cosine of the sphere's light at a surface, of what is above its horizon."""
    return mean_cosine((over.geometry.normal * over.geometry.to_light).sum(-1), over.sine)


def _half(over: Sphere, sine: Tensor, step: Step) -> Tensor:
    """Half vector, of any length, with the one point that a sphere of that sine is bent to."""
    return bent(over.geometry, sine, step) + over.geometry.to_eye


def _dimmed_by_karis(over: Sphere) -> Tensor:
    widened = (over.spread.sqrt() + 0.5 * over.sine).clamp(max=1.0)
    return over.spread / widened.square()


def _lit(light: SphereLight, view: SphereView, over: Sphere, facets: Tensor, visible: brdf.Visible) -> Tensor:
    """Radiance of a surface with so many facets that mirror the light, whose irradiance is that of a point's."""
    seen = facets * visible(over.cosines.eye, over.cosines.light, over.spread)
    irradiance = light.radiance * (math.pi * over.sine.square())[..., None]
    return irradiance * brdf.sent(brdf.material(view.base, view.roughness, view.metallic), seen, over.cosines)


def _of_mean(over: Sphere, visible: brdf.Visible) -> tuple[Tensor, Tensor, Cosines]:
    """Irradiance of the sphere over radiance and mean cosine, facets that both see, and cosines at their mean."""
    above = risen(over.geometry, over.sine, over.spread)
    facets = facets_of(over.geometry, above, over.spread)
    seen = facets.density * visible(over.cosines.eye, facets.cos_light.clamp(0.0, 1.0), over.spread)
    disc = math.pi * above.sine.square() * above.wider * above.brighter
    return disc, seen, Cosines(over.cosines.eye, above.mean_cosine, facets.cos_half)


def largest_change(light: SphereLight, view: SphereView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all surfaces [W/(m² sr)]: of facets that mirror all, on white ground."""
    disc, seen, cosines = _of_mean(sphere_over(light, view), visible_smith)
    return ((disc * (seen + cosines.light / math.pi))[..., None] * light.radiance).amax()


EFFECT = Effect(
    parameters=SphereLight,
    prefix="SPHERE_LIGHT",
    rungs={
        "skip": Rung(skip),
        "Karis' point": Rung(partial(render_edge, step=no_step)),
        "Newton's step": Rung(partial(render_edge, step=talk_step)),
        "guarded step": Rung(partial(render_edge, step=guarded_step)),
        "smaller when rough": Rung(render_reduced),
        "mean brightness": Rung(render_mean),
        "mean facet": Rung(render),
    },
    reference=summed,
    # A grazing highlight on metal, whose facets hide each other otherwise all over it than at their mean.
    tolerance=0.025,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
