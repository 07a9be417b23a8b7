"""Eyes of Final Fantasy XV [1]: the iris and the white as diffuse ground, deferred, and forward a second specular, wet.

The slides give no formulas. The iris lies on a plane behind the cornea and is seen where the ray, bent by Snell's law
at the cornea, meets it, as in [2] and [3]. Lit straight it would look like a sticker: a cornea throws the light of one
side to the iris' other side. As in [3] its normal is that of a bowl, which is an artist's means and not optics; light
is not traced to the iris, there are no caustics. The iris ends in a dark rim, the limbus. The tears are a clear coat
of index `TEARS` with the cornea's own normal; what they mirror of the lights and of the eye's direction is taken from
what is below, of the lights in the mean by what each gives the ground (ours: the forward pass has all lights' sum).

Gradient: exact; of the iris' picture the slope of its cell; 0 of its angle in the very middle, where the pupil is, and
of the depth for rays that descend too flatly to meet it.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Tricks for special
    materials".
[2] G. Francois et al., "Image-Based Modeling of the Human Eye", IEEE TVCG 15(5), 2009.
[3] J. Jimenez, J. von der Pahlen, "Next-Generation Character Rendering", GDC 2013.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.numerics import lookup, safe_sqrt, smooth_rise
from diffrender.rays import unit
from diffrender.shading import brdf, clear_coat
from diffrender.shading.brdf import Geometry
from diffrender.shading.eye_ball import LEAST_DESCENT, PUPIL_EDGE, RIM_LEFT, TEARS, Eye, EyeView, example_inputs
from diffrender.shading.eye_reference import reference
from diffrender.surfaces import Surface


def deferred(eye: Eye, view: EyeView) -> Surface:
    """Iris, as it is seen through the cornea, and white as the basic material, as rough as can be."""
    seen = on_iris(eye, view)
    bowl = view.gaze - eye.iris_bowl * seen / torch.maximum(_length(seen), eye.iris_radius)[..., None]
    normal = torch.lerp(unit(view.place), unit(bowl), iris_share(eye, view)[..., None])
    return _matt(unit(normal), _colour(eye, view, seen))


def forward(eye: Eye, view: EyeView, lit: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Radiance towards the eye of a lit iris and white under tears [W/(m² sr)]."""
    return _wet(eye, view, lit, deferred(eye, view))


def render(eye: Eye, view: EyeView) -> Float[Tensor, "*batch 3"]:
    """Radiance of an eye towards the one who sees it [W/(m² sr)], both passes."""
    ground = deferred(eye, view)
    return _wet(eye, view, brdf.lit(ground, view.to_eye, view.lights), ground)


def render_flat(eye: Eye, view: EyeView) -> Float[Tensor, "*batch 3"]:
    """The same of an iris that is painted on the ball: nothing is bent, no bowl."""
    return _wet(eye, view, skip(eye, view), painted(eye, view))


def skip(eye: Eye, view: EyeView) -> Float[Tensor, "*batch 3"]:
    """A dry ball with a painted iris, in its light."""
    return brdf.lit(painted(eye, view), view.to_eye, view.lights)


def painted(eye: Eye, view: EyeView) -> Surface:
    """A ball with a painted iris as the basic material."""
    return _matt(unit(view.place), _colour(eye, view, _across(view)))


def _wet(eye: Eye, view: EyeView, lit: Tensor, ground: Surface) -> Tensor:
    return tears(eye, view) + lit * transmitted(eye, view, ground.normal)


def tears(eye: Eye, view: EyeView) -> Float[Tensor, "*batch 3"]:
    """Radiance that the wet surface mirrors [W/(m² sr)]: the second specular."""
    total = clear_coat.mirrored_sky(TEARS, eye.wet_roughness, _towards(view, view.normal), view.lights.sky)
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        share = clear_coat.mirrored(TEARS, eye.wet_roughness, _towards(view, to_light))
        total = total + irradiance * share[..., None]
    return total


def transmitted(eye: Eye, view: EyeView, ground: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Share that crosses the tears twice, from all lights to a ground of a normal and to the one who sees it.

    Weighed by what each light gives the ground; of the sky by what it would if the ground lay along the tears.
    """
    cosine, weight = (one.to(view.normal) for one in clear_coat.to_ground_nodes())
    through = clear_coat.crossed(TEARS, eye.wet_roughness, cosine)
    sky = view.lights.sky.mean * torch.ones_like(ground)
    given, passed = sky * weight.sum(), sky * (through * weight).sum()
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        lit = irradiance * clear_coat.to_ground(ground, to_light)[..., None]
        given = given + lit
        passed = (
            passed + lit * clear_coat.crossed(TEARS, eye.wet_roughness, (view.normal * to_light).sum(-1))[..., None]
        )
    is_dark = given <= 0.0
    entered = torch.where(is_dark, torch.ones_like(given), passed / torch.where(is_dark, torch.ones_like(given), given))
    return entered * clear_coat.crossed(TEARS, eye.wet_roughness, (view.normal * view.to_eye).sum(-1))[..., None]


def on_iris(eye: Eye, view: EyeView) -> Float[Tensor, "*batch 3"]:
    """Place on the iris' plane, from its middle, that is seen through a place of the surface [eyeball radii]."""
    inside = clear_coat.refracted(eye.refraction, view.normal, view.to_eye)
    height = (view.place * view.gaze).sum(-1) - torch.sqrt(1.0 - eye.iris_radius.square()) + eye.iris_depth
    descent = (inside * view.gaze).sum(-1)
    run = height / descent.clamp(min=LEAST_DESCENT)
    return _across(view) - run[..., None] * (inside - descent[..., None] * view.gaze)


def iris_share(eye: Eye, view: EyeView) -> Float[Tensor, "*batch"]:
    """How much of the iris and how little of the white is at a place of the surface, from 0 to 1."""
    beyond = _length(_across(view)) - eye.iris_radius + 0.5 * eye.limbus_width
    is_front = (view.place * view.gaze).sum(-1) > 0.0
    return is_front.to(beyond) * (1.0 - smooth_rise(beyond, eye.limbus_width))


def _colour(eye: Eye, view: EyeView, seen: Tensor) -> Tensor:
    """Base colour where a place on the iris' plane is seen."""
    far = _length(seen)
    rings, turns = view.iris.shape
    # In the middle there is no angle; the pupil hides it.
    aside, along = (torch.linalg.cross(view.gaze, view.up) * seen).sum(-1), (view.up * seen).sum(-1)
    turn = torch.atan2(aside, torch.where(far > 0.0, along, torch.ones_like(along)))
    column = torch.remainder(turn / (2.0 * math.pi), 1.0) * (turns - 1.0)
    picture = lookup(view.iris, far / eye.iris_radius * (rings - 1.0), column)
    rim = smooth_rise(far - eye.iris_radius + eye.limbus_width, eye.limbus_width)
    edge = far.new_tensor(PUPIL_EDGE)
    shade = picture * (1.0 - (1.0 - RIM_LEFT) * rim) * smooth_rise(far - eye.pupil_radius + 0.5 * edge, edge)
    return torch.lerp(eye.sclera_colour, eye.iris_colour * shade[..., None], iris_share(eye, view)[..., None])


def _matt(normal: Tensor, base: Tensor) -> Surface:
    one = torch.ones_like(normal[..., 0])
    return Surface(normal, base, one, torch.zeros_like(one))


def _across(view: EyeView) -> Tensor:
    """Place beside the line of gaze."""
    return view.place - (view.place * view.gaze).sum(-1, keepdim=True) * view.gaze


def _length(across: Tensor) -> Tensor:
    return safe_sqrt(across.square().sum(-1))


def _towards(view: EyeView, to_light: Tensor) -> Geometry:
    return Geometry(view.normal, view.to_eye, to_light.expand_as(view.normal))


def largest_change(eye: Eye, view: EyeView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all places [W/(m² sr)]: the tears' picture and the brighter of both grounds'."""
    ground = brdf.lit(deferred(eye, view), view.to_eye, view.lights)
    return (tears(eye, view) + torch.maximum(ground, skip(eye, view))).amax()


EFFECT = Effect(
    parameters=Eye,
    prefix="EYE",
    rungs={"skip": Rung(skip), "second specular": Rung(render_flat), "refracted": Rung(render)},
    reference=reference,
    # What crosses the tears from the sky where the iris is turned otherwise than the cornea.
    tolerance=6e-2,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
