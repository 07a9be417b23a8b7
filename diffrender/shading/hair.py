"""Hair by the light that strands mirror, let through, and mirror inside: Kajiya's and Kay's, two lobes, Marschner's.

The talk draws hair's depth and normal deferred, and shades it forward [1]; it gives no formulas. In the G-buffer the
slot of the normal holds the strand's tangent, which is all that the last renderer asks of a direction; the picture of
the deferred lights is not looked at.

A strand's brightness is its radiance in the mean across its width. Of a light it is the irradiance of a surface that
faces the light, times the sum over the ways of light of

    M(along) × mean of A N(around) over the strand's width        [1/sr]

which over all directions of light is 1 for a white strand [2, 3, 4]. `hair_fibre` has the parts. Shares A and angles
round are those of the eye's angle along the strand, as with [4, 5]; Marschner takes the mean of eye's and light's [2].
So energy is kept exactly, but eye and light may be exchanged only where they are equally steep.

Where eye or light look along the strand there is no angle round it: within a thousandth of that N is evened out.

Of the sky, one radiance and a gradient with height, it is the share of all light, exact, and the lobes' mean directions
by few steps of equal shares of each lobe.

Strands are single: what many of them scatter to each other is not drawn, and shadows are the view's.

Gradient: exact. 0 of the eye's angle along the strand within a thousandth of 90 degrees.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Shading".
[2] S. Marschner et al., "Light Scattering from Human Hair Fibers", SIGGRAPH 2003.
[3] E. d'Eon et al., "An Energy-Conserving Hair Reflectance Model", EGSR 2011.
[4] M. Chiang et al., "A Practical and Controllable Hair and Fur Model for Production Path Tracing", EGSR 2016.
[5] M. Pharr, "The Implementation of a Hair Scattering Model", pbrt.org, 2016.
[6] J. Kajiya, T. Kay, "Rendering Fur with Three Dimensional Textures", SIGGRAPH 1989, equations 14 and 16.
[7] T. Scheuermann, "Practical Real-Time Hair Rendering and Shading", SIGGRAPH 2004 sketches.
"""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.numerics import safe_sqrt, smooth_rise
from diffrender.parameters import record
from diffrender.rays import unit
from diffrender.shading import hair_fibre
from diffrender.shading.hair_fibre import LEANS, Round, Ways
from diffrender.shading.hair_reference import traced
from diffrender.shading.hair_sky import sky_moments
from diffrender.shading.hair_view import Hair, HairView, example_inputs
from diffrender.shading.microfacet import LEAST_COSINE
from diffrender.surfaces import Surface

# Of light across a clear strand: mirrored outside, and mirrored once inside before it leaves.
MIRRORED, WITHIN = 0.0753, 0.0556
_WRAP = 0.25  # of the light on what faces away from it [7]


@record
class Angle:
    """Of a direction to a strand: along it, from the plane across it [rad], and the cosine and sine of that."""

    along: Float[Tensor, "*batch"]
    cosine: Float[Tensor, "*batch"]
    sine: Float[Tensor, "*batch"]


@record
class Strand:
    """Strands as an eye sees them: the ways of light through them, and the lobes' middles and squared widths."""

    ways: Ways
    mirror_angle: Float[Tensor, "*batch 4"]
    variance: Float[Tensor, "*#batch 4"]
    scale: Float[Tensor, "*#batch"]


def deferred(_hair: Hair, view: HairView) -> Surface:
    """What goes into the G-buffer: the tangent as normal of a black surface."""
    none = torch.zeros_like(view.tangent[..., 0] + view.to_eye[..., 0])
    return Surface(view.tangent, torch.zeros_like(view.tangent + view.to_eye), none + 1.0, none)


def seen_in_buffer(view: HairView, surface: Surface) -> HairView:
    """The view whose strands run as a G-buffer says."""
    return replace(view, tangent=surface.normal)


def forward(hair: Hair, view: HairView, _lit: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Radiance of strands towards the eye, whatever their pixels show of the deferred lights [W/(m² sr)]."""
    return render(hair, view)


def render(hair: Hair, view: HairView) -> Float[Tensor, "*batch 3"]:
    """Radiance of strands towards the eye [W/(m² sr)], all ways of light by Marschner's lobes."""
    eye = angle(view.tangent, view.to_eye)
    seen = strand(hair, view, eye)
    total = view.open[..., None] * _of_sky(seen, view, eye)
    eye_has_side = smooth_rise(eye.cosine, eye.cosine.new_tensor(LEAST_COSINE))
    for place, (to_light, irradiance) in enumerate(zip(view.lights.to_light, view.lights.irradiance, strict=True)):
        light = angle(view.tangent, to_light)
        along = hair_fibre.along(light.along, seen.mirror_angle, seen.variance)
        has_side = eye_has_side * smooth_rise(light.cosine, eye_has_side.new_tensor(LEAST_COSINE))
        around = hair_fibre.around(seen.ways, Round(azimuth(view, to_light), has_side), seen.scale)
        total = total + view.reaching[..., place, None] * irradiance * (along[..., None] * around).sum(-2)
    return total


def strand(hair: Hair, view: HairView, eye: Angle) -> Strand:
    """Strands of a view."""
    variance, scale = hair_fibre.variances(hair), hair_fibre.azimuthal_scale(hair)
    found = hair_fibre.ways(eye.cosine, hair_fibre.absorption(hair))
    return Strand(found, hair_fibre.mirror_angles(eye.along, hair.tilt + view.shift), variance, scale)


def angle(tangent: Float[Tensor, "*#batch 3"], direction: Float[Tensor, "*#batch 3"]) -> Angle:
    """Angle of a direction along a strand, with its digits at 90 degrees too."""
    sine = (tangent * direction).sum(-1)
    cosine = safe_sqrt(torch.linalg.cross(*_together(tangent, direction)).square().sum(-1))
    return Angle(torch.atan2(sine, cosine), cosine, sine)


def azimuth(view: HairView, to_light: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch"]:
    """Angle round the strand from the eye to a light [rad]; any where one of them is along it."""
    tangent, to_eye, light = _together(view.tangent, view.to_eye, to_light)
    turned = (tangent * torch.linalg.cross(to_eye, light)).sum(-1)
    ahead = (torch.linalg.cross(tangent, to_eye) * torch.linalg.cross(tangent, light)).sum(-1)
    is_none = (turned == 0.0) & (ahead == 0.0)
    return torch.atan2(turned, torch.where(is_none, torch.ones_like(ahead), ahead))


def _together(*vectors: Tensor) -> list[Tensor]:
    """Vectors in the batch that they have together."""
    total = sum(vectors[1:], vectors[0])
    return [one.expand_as(total) for one in vectors]


def _of_sky(seen: Strand, view: HairView, eye: Angle) -> Tensor:
    # Nothing is across for an eye that looks along the strand.
    across = (view.to_eye - eye.sine[..., None] * view.tangent) / eye.cosine.clamp(min=LEAST_COSINE)[..., None]
    share, along, aside = sky_moments(seen.ways, seen.mirror_angle, seen.variance, seen.scale)
    height = along * view.tangent[..., 2:] + aside * across[..., 2:]
    return share * view.lights.sky.mean + height * view.lights.sky.gradient


def render_two_lobes(hair: Hair, view: HairView) -> Float[Tensor, "*batch 3"]:
    """The same by two highlights, the white one to the root and the coloured one to the tip, over wrapped light [7].

    Tangents lean along the normal by what moves the middles of R and TRT. Shares of light are those across the strand;
    none passes through. How bright Scheuermann's lobes are is the artist's; here they are of about the lobes' energy.
    """
    tilt = hair.tilt + view.shift
    widths = hair_fibre.variances(hair)
    ground = (1.0 - MIRRORED - WITHIN) * hair.colour
    matt = torch.zeros_like(view.tangent * view.to_eye)
    white, coloured = matt, matt
    # Half vectors turn by half of what directions do.
    first, second = (_leant(view, 0.5 * LEANS[lobe] * tilt) for lobe in (0, 2))
    for place, (to_light, irradiance) in enumerate(zip(view.lights.to_light, view.lights.irradiance, strict=True)):
        arrived = view.reaching[..., place, None] * irradiance
        facing = (view.normal * to_light).sum(-1)
        wrapped = torch.relu(_WRAP + (1.0 - _WRAP) * facing) * (3.0 / (4.0 * math.pi))
        matt = matt + arrived * wrapped[..., None]
        white = white + arrived * _half_highlight(first, view, to_light, widths[..., 0])[..., None]
        coloured = coloured + arrived * _half_highlight(second, view, to_light, widths[..., 2])[..., None]
    sky = view.open[..., None] * (view.lights.sky.mean + view.normal[..., 2:] * view.lights.sky.gradient * 0.5)
    return ground * (matt + sky) + MIRRORED * (white + sky) + WITHIN * hair.colour * (coloured + sky)


def render_kajiya_kay(hair: Hair, view: HairView) -> Float[Tensor, "*batch 3"]:
    """The same by a matt cylinder, whose light is the sine to the strand, and one white highlight [6]."""
    ground = (1.0 - MIRRORED) * hair.colour
    width = hair_fibre.variances(hair)[..., 0]
    eye = angle(view.tangent, view.to_eye)
    sky = view.lights.sky
    height = (-eye.sine * view.tangent[..., 2])[..., None]  # of the highlight's mean direction
    lit = ground * sky.mean + MIRRORED * (sky.mean + height * sky.gradient)
    total = view.open[..., None] * lit
    for place, (to_light, irradiance) in enumerate(zip(view.lights.to_light, view.lights.irradiance, strict=True)):
        light = angle(view.tangent, to_light)
        facing = light.cosine * eye.cosine - light.sine * eye.sine
        highlight = MIRRORED * _peak(facing, 1.0 / width) / _lobe_angle(width)
        matt = light.cosine / (math.pi * math.pi)
        arrived = view.reaching[..., place, None] * irradiance
        total = total + arrived * (ground * matt[..., None] + highlight[..., None])
    return total


def skip(hair: Hair, view: HairView) -> Float[Tensor, "*batch 3"]:
    """No light: black."""
    return torch.zeros_like(view.tangent + view.to_eye) * hair.colour


def _leant(view: HairView, tilt: Tensor) -> Tensor:
    """Tangents turned towards the normal by an angle."""
    return unit(torch.cos(tilt)[..., None] * view.tangent + torch.sin(tilt)[..., None] * view.normal)


def _half_highlight(tangent: Tensor, view: HairView, to_light: Tensor, variance: Tensor) -> Tensor:
    """Highlight by the sine of a tangent and the half vector, over its lobe's solid angle [1/sr]."""
    half = view.to_eye + to_light
    square, along = half.square().sum(-1), (tangent * half).sum(-1)
    is_none = square == 0.0
    cos_half = along / torch.where(is_none, 1.0, safe_sqrt(square))
    sine = safe_sqrt((1.0 - cos_half) * (1.0 + cos_half))
    return _peak(sine, 4.0 / variance) / _lobe_angle(variance)


def _peak(cosine: Tensor, exponent: Tensor) -> Tensor:
    """Power of a cosine, 0 below 0."""
    is_off = cosine <= 0.0
    lobe = torch.exp(exponent * torch.log(torch.where(is_off, 1.0, cosine)))
    return torch.where(is_off, torch.zeros_like(lobe), lobe)


def _lobe_angle(variance: Tensor) -> Tensor:
    """Solid angle of a lobe right round the strand: of a Gaussian of that width, and at most of the sphere [sr]."""
    return 2.0 * math.pi / torch.sqrt(0.25 + 1.0 / (2.0 * math.pi * variance))


def largest_change(hair: Hair, view: HairView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all strands [W/(m² sr)]: every light by the most that each lobe may hold.

    Round the strand R is nowhere denser than a mirror's 1/4, TT than 0.71 straight on, and TRT, whose light gathers at
    its bow, than the logistic's peak; of TRT and further ways the shares are at most 4/27 each.
    """
    eye = angle(view.tangent, view.to_eye)
    scale = hair_fibre.azimuthal_scale(hair)
    width = scale.new_tensor(2.0 * math.pi / hair_fibre.SEGMENTS)
    peak = 0.25 / (scale * hair_fibre.kept(width, scale))
    inner = 4.0 / 27.0
    around = torch.stack([peak.clamp(max=0.26), peak.clamp(max=0.72), inner * peak, 0.0 * peak + inner / 6.0])
    middle = hair_fibre.mirror_angles(eye.along, hair.tilt + view.shift)
    sky = view.lights.sky.mean.abs() + view.lights.sky.gradient.abs()
    total = view.open[..., None] * sky
    for place, (to_light, irradiance) in enumerate(zip(view.lights.to_light, view.lights.irradiance, strict=True)):
        along = hair_fibre.along(angle(view.tangent, to_light).along, middle, hair_fibre.variances(hair))
        total = total + view.reaching[..., place, None] * irradiance * (along * around).sum(-1)[..., None]
    return total.amax()


EFFECT = Effect(
    parameters=Hair,
    prefix="HAIR",
    rungs={
        "skip": Rung(skip),
        "Kajiya-Kay": Rung(render_kajiya_kay),
        "two lobes": Rung(render_two_lobes),
        "Marschner": Rung(render),
    },
    reference=traced,
    # Segments: within one a cylinder's light is not quite even, nor what is absorbed of it.
    tolerance=3e-3,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
