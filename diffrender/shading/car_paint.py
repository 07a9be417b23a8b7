"""Car paint of Final Fantasy XV [1]: a matt base coat, drawn deferred, and forward over it flakes and a clear coat.

The slides give no formulas; this is a paint of layers as in [2] and [3], of what the literature agrees on. The clear
coat is varnish of index `VARNISH`; what crosses its surface twice, Fresnel's and the depth's share of it, is what is
seen of the layers below. In the varnish lies a sheet of flakes, which hide a share of the base coat; each is a mirror
that is met by light and eye as varnish bends them, so that flakes are seen spread by half more than they are:

    radiance = T(eye) T(light) colour D(half) / (4 cos(eye') cos(light') (half' along the normal)⁴ index²) × irradiance

with ' for what is inside, D per unit of slope, and T what crosses the surface times what the depth leaves along the
bent path. The forward pass has only the sum of all lights' pictures of the base coat. It dims it by the mean of what
crosses, weighed by what each light gives the base coat's diffuse ground: exact for the ground (ours).

Left out: the sky in single flakes, which is drawn as in even ones; shine of the base coat under the varnish, which is
the basic material's of roughness 1, though its index is the varnish's own; light that the coat sends down again, for
want of which white paint sends 0.85 to 0.91 of an even sky straight up and not all; and that a rough coat blurs what
lies below.

Gradient: exact but for which flake is seen, as of `flakes` and `clear_coat`.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Tricks for special
    materials".
[2] S. Ershov, K. Kolchin, K. Myszkowski, "Rendering Pearlescent Appearance Based On Paint-Composition Modelling",
    Eurographics 2001.
[3] J. Guenther et al., "Efficient Acquisition and Realistic Rendering of Car Paint", VMV 2005.
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.shading import brdf, clear_coat, flakes
from diffrender.shading.brdf import Geometry
from diffrender.shading.car_paint_reference import reference
from diffrender.shading.painted_surface import VARNISH, CarPaint, CarPaintView, example_inputs
from diffrender.surfaces import Surface

Density = Callable[[CarPaint, CarPaintView, Tensor], Tensor]  # of flakes about a slope


def deferred(paint: CarPaint, view: CarPaintView) -> Surface:
    """The base coat as the basic material, as rough as can be."""
    matt = torch.ones_like(view.normal[..., 0])
    return Surface(view.normal, paint.base.expand_as(view.normal), matt, torch.zeros_like(matt))


def forward(paint: CarPaint, view: CarPaintView, lit: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Radiance towards the eye of a lit base coat under flakes, one by one, and the clear coat [W/(m² sr)]."""
    return _layered(paint, view, lit, counted_flakes)


def render(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """Radiance of the paint towards the eye [W/(m² sr)], both passes."""
    return forward(paint, view, skip(paint, view))


def render_smooth(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """The same with all flakes together, as from far away."""
    return _layered(paint, view, skip(paint, view), even_flakes)


def render_coat(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """The base coat under the clear coat, without flakes."""
    return coat(paint, view) + skip(paint, view) * entered(paint, view) * transmitted(paint, view, view.to_eye)


def skip(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """The deferred picture: the base coat alone, dull."""
    return brdf.lit(deferred(paint, view), view.to_eye, view.lights)


def _layered(paint: CarPaint, view: CarPaintView, lit: Tensor, density: Density) -> Tensor:
    below = (1.0 - paint.flake_amount) * entered(paint, view) * lit + paint.flake_amount * flaked(paint, view, density)
    return coat(paint, view) + transmitted(paint, view, view.to_eye) * below


def coat(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """Radiance that the clear coat's surface mirrors [W/(m² sr)]."""
    total = clear_coat.mirrored_sky(VARNISH, paint.coat_roughness, _towards(view, view.normal), view.lights.sky)
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        share = clear_coat.mirrored(VARNISH, paint.coat_roughness, _towards(view, to_light))
        total = total + irradiance * share[..., None]
    return total


def transmitted(paint: CarPaint, view: CarPaintView, towards: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Share of light from or to a direction that gets through the clear coat's surface and its depth."""
    cosine = (view.normal * towards).sum(-1).clamp(0.0, 1.0)
    through = clear_coat.crossed(VARNISH, paint.coat_roughness, cosine)
    return through[..., None] * torch.exp(-paint.coat_depth / within(cosine)[..., None])


def within(cosine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Cosine of a direction inside the varnish by that of the one outside, from 0.745 to 1."""
    return torch.sqrt((VARNISH * VARNISH - 1.0) + cosine * cosine) / VARNISH


def entered(paint: CarPaint, view: CarPaintView) -> Float[Tensor, "*batch 3"]:
    """Mean share `transmitted` of lights and sky, weighed by what each gives the ground; 1 where all is dark."""
    cosine, weight = (one.to(view.normal) for one in clear_coat.to_ground_nodes())
    through = clear_coat.crossed(VARNISH, paint.coat_roughness, cosine)[:, None]
    through = through * torch.exp(-paint.coat_depth / within(cosine)[:, None])
    sky, up = view.lights.sky, view.normal[..., 2:]
    even, along = (weight[:, None] * one for one in (torch.ones_like(cosine)[:, None], cosine[:, None]))
    given = even.sum(0) * sky.mean + along.sum(0) * up * sky.gradient
    passed = (even * through).sum(0) * sky.mean + (along * through).sum(0) * up * sky.gradient
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        ground = irradiance * clear_coat.to_ground(view.normal, to_light)[..., None]
        given, passed = given + ground, passed + ground * transmitted(paint, view, to_light)
    is_dark = given <= 0.0
    return torch.where(is_dark, torch.ones_like(given), passed / torch.where(is_dark, torch.ones_like(given), given))


def flaked(paint: CarPaint, view: CarPaintView, density: Density) -> Float[Tensor, "*batch 3"]:
    """Radiance of a whole sheet of flakes [W/(m² sr)], before it crosses the clear coat to the eye."""
    eye = clear_coat.refracted(VARNISH, view.normal, view.to_eye)
    cos_eye = (view.normal * eye).sum(-1)
    outside = (view.normal * view.to_eye).sum(-1)
    share = flakes.moments(VARNISH, paint.flake_spread, outside)
    sky = clear_coat.of_sky(share, _towards(view, view.normal), view.lights.sky)
    # The sky's mean path is about as long as the eye's.
    total = sky * torch.exp(-paint.coat_depth / cos_eye[..., None])
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        light = clear_coat.refracted(VARNISH, view.normal, to_light)
        half = eye + light
        along = (half * view.normal).sum(-1)
        slope = torch.stack([(half * one).sum(-1) / along for one in (view.tangent, _beside(view))], -1)
        # Of unit length half / length: its height to the fourth, and the product of both cosines.
        tilt = (half.square().sum(-1) / along.square()).square()
        facets = density(paint, view, slope) * tilt / (4.0 * VARNISH**2 * cos_eye * (light * view.normal).sum(-1))
        lit = facets * (view.normal * to_light).sum(-1).clamp(0.0, 1.0)
        total = total + irradiance * lit[..., None] * transmitted(paint, view, to_light)
    return paint.flake_colour * total


def even_flakes(paint: CarPaint, _view: CarPaintView, slope: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch"]:
    """Share of all flakes per unit of slope."""
    return flakes.even(slope, paint.flake_spread)


def counted_flakes(paint: CarPaint, view: CarPaintView, slope: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch"]:
    """The same of the flakes that a pixel sees."""
    place, footprint = view.place / paint.flake_size, view.footprint / paint.flake_size
    return flakes.counted(slope, paint.flake_spread, place, footprint)


def _towards(view: CarPaintView, to_light: Tensor) -> Geometry:
    return Geometry(view.normal, view.to_eye, to_light.expand_as(view.normal))


def _beside(view: CarPaintView) -> Tensor:
    beside: Tensor = torch.linalg.cross(view.normal, view.tangent)
    return beside


def largest_change(paint: CarPaint, view: CarPaintView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all places [W/(m² sr)].

    The dull picture, or the coat and the brightest that flakes can be: one that mirrors each light straight at the eye.
    """
    sky = view.lights.sky.mean.abs() + view.lights.sky.gradient.abs()
    steepest = 1.0 / VARNISH**2
    # Of a flake's density at its mean slope, tilt at most that of 42 degrees, cosines at least theirs.
    brightest = 1.0 / (math.pi * flakes.WAVY**2) / (4.0 * VARNISH**2 * (1.0 - steepest) ** 3)
    glints = paint.flake_amount * (brightest * view.lights.irradiance.sum(0) + sky) * paint.flake_colour
    return (skip(paint, view) + coat(paint, view) + glints).amax()


EFFECT = Effect(
    parameters=CarPaint,
    prefix="CAR_PAINT",
    rungs={
        "skip": Rung(skip),
        "clear coat": Rung(render_coat),
        "smooth flakes": Rung(render_smooth),
        "flakes": Rung(render),
    },
    reference=reference,
    # The base coat's shine, dimmed by the mean of what crosses to its ground.
    tolerance=4e-3,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
