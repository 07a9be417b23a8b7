"""Highlights of a light that is a sphere, as of one point of it [1, 2], and the ground that it lights.

Facets are counted at the place of the sphere that `light_bending` finds; shadows and the light's cosine are those of
its centre. The highlight of one point is the same peak all over the sphere's mirror picture, and has to be dimmed by
what the sphere is wider than a point: Karis does as if the facets were spread by half the sphere's sine more. The talk
asks for two corrections [2], whose formulas are not public; ours are compared with sums over the sphere
(`experiments.sphere_light`):

    sine of the bent light = sine (sine / (sine + spread))²
    mean of GGX at the peak = 1 / (pi (spread² + (1 - spread²) sin²(angular radius / 2) / V·H))

By the first the even middle shrinks with roughness, and the highlight falls off as it should. The second is exact for
an eye along the normal in the middle of the picture, and for mirrors all over it, as V·H and Fresnel are then those of
the point and not of the centre. Where the horizon cuts the sphere, the last renderer takes the mean cosine of what is
above; the others go dark as soon as the centre sets, which the talk prefers to acne of shadows. What stays wrong is the
faint glow far from a smooth surface's highlight, which is too dark, and rough highlights that graze.

The sphere is even, throws no shadow, and is shadowed by nothing. Surfaces inside it are taken as just outside.

Gradient: as of `light_bending`; 0 in radius and distance for surfaces inside the sphere, and 0 for a sphere that has
set.

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
from diffrender.shading.light_bending import Step, bent, guarded_step, no_step, talk_step
from diffrender.shading.microfacet import LEAST_COSINE, ggx, spread_squared, visible_smith
from diffrender.shading.sphere_light_reference import summed
from diffrender.shading.sphere_surface import SphereLight, SphereView, example_inputs

_WIDEST = 0.9999  # sine of a sphere that one is nearly inside of
_HALF_RISEN = 2.0 / (3.0 * math.pi)  # mean cosine of a small disc whose middle is on the horizon, in its sine


@record
class Sphere:
    """The light over a surface: directions with that of its centre, its sine, the facets' spread, and all cosines."""

    geometry: Geometry
    sine: Float[Tensor, "*#batch"]
    spread: Float[Tensor, "*#batch"]  # its square
    cosines: Cosines


def render(light: SphereLight, view: SphereView, visible: brdf.Visible = visible_smith) -> Float[Tensor, "*batch 3"]:
    """Radiance of a surface towards the eye [W/(m² sr)], the peak as bright as the sphere's mean."""
    over = sphere_over(light, view)
    half = _half(over, reduced_sine(over), guarded_step)
    cos_half = (0.5 * torch.linalg.vector_norm(half, dim=-1)).clamp(max=1.0)
    over = replace(over, cosines=Cosines(over.cosines.eye, risen_cosine(over), cos_half))
    # Solid angles, of which those of the plane are a share.
    wider = 2.0 / (1.0 + _cosine(over.sine))
    dimmed = math.pi * over.spread * mean_facets(over) * wider
    return _lit(light, view, over, ggx(half, view.normal, over.spread) * dimmed, visible)


def render_reduced(
    light: SphereLight, view: SphereView, visible: brdf.Visible = visible_smith
) -> Float[Tensor, "*batch 3"]:
    """The same by Karis' normalisation."""
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
    half_sine_square = 0.5 * over.sine * over.sine / (1.0 + _cosine(over.sine))
    wider = half_sine_square / over.cosines.half.clamp(min=LEAST_COSINE)
    return 1.0 / (math.pi * (over.spread + (1.0 - over.spread) * wider))


def risen_cosine(over: Sphere) -> Float[Tensor, "*batch"]:
    """Mean cosine of the sphere's light at a surface, of what is above its horizon; that of the centre when all is.

    Between, by the polynomial with the right values and slopes at both ends and the right value in the middle: within
    0.002 of the sine for small spheres, within a hundredth at a sine of 0.5.
    """
    height = (over.geometry.normal * over.geometry.to_light).sum(-1)
    place = (height / over.sine).clamp(-1.0, 1.0)
    middle = _HALF_RISEN * (1.0 + 0.3 * over.sine.square())
    share = (1.0 + place).square() * (middle + (0.25 - middle) * place * (2.0 - place))
    return (over.sine * share + torch.relu(height - over.sine)).clamp(max=1.0)


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


def _cosine(sine: Tensor) -> Tensor:
    return torch.sqrt((1.0 - sine) * (1.0 + sine))


def largest_change(light: SphereLight, view: SphereView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all surfaces [W/(m² sr)]: white ones in the middle of their highlights."""
    over = sphere_over(light, view)
    risen = risen_cosine(over)
    solid_angle = 2.0 * math.pi * over.sine.square() / (1.0 + _cosine(over.sine))
    # The point is off the centre by no more than the sphere's edge.
    nearest = (over.cosines.half + 0.5 * over.sine / (0.5 + 0.5 * _cosine(over.sine)).sqrt()).clamp(max=1.0)
    over = replace(over, cosines=replace(over.cosines, half=nearest))
    # The peak of facets is a little higher than at the normal where the spread is over 1.
    peak = mean_facets(over) * over.spread.clamp(min=1.0).square()
    mirrored = solid_angle * peak * visible_smith(over.cosines.eye, risen, over.spread)
    return ((mirrored + over.sine.square() * risen)[..., None] * light.radiance).amax()


EFFECT = Effect(
    parameters=SphereLight,
    prefix="SPHERE_LIGHT",
    rungs={
        "skip": Rung(skip),
        "Karis' point": Rung(partial(render_edge, step=no_step)),
        "Newton's step": Rung(partial(render_edge, step=talk_step)),
        "guarded step": Rung(partial(render_edge, step=guarded_step)),
        "smaller when rough": Rung(render_reduced),
        "mean brightness": Rung(render),
    },
    reference=summed,
    # A grazing highlight on rough metal, of whose peak the mean is taken as along the normal.
    tolerance=0.13,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
