"""The basic material [1] under lights from afar and the sky: GGX facets above Lambert's ground, of one base colour.

Rungs: the whole base colour as matt ground; facets hidden by Schlick's function, as in the talk; by Smith's of both
directions together, as rough facets are in truth. Nothing is scattered twice between facets: rough metals are dark
where they graze. Everything that it draws is worked out in `brdf`.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Shading".
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.shading import brdf, brdf_reference
from diffrender.shading.microfacet import LEAST_COSINE, spread_squared, visible_schlick, visible_smith
from diffrender.surfaces import EvenSky, Lights, Surface


@record
class BasicMaterial:
    """What an artist sets of the basic material."""

    base: Float[Tensor, "3"] = parameter(
        (0.5, 0.42, 0.33), bounds=(0.0, 1.0), unit="1",
        about="colour of the ground, or of a metal's mirror: turned up, brighter",
    )  # fmt: skip
    roughness: Float[Tensor, ""] = parameter(
        0.45, bounds=(0.0, 1.0), unit="1", about="of the facets: turned up, wider and dimmer highlights"
    )
    metallic: Float[Tensor, ""] = parameter(
        0.2, bounds=(0.0, 1.0), unit="1", about="share of metal: turned up, less ground and coloured mirrors"
    )


@record
class MaterialView:
    """Places of one material: unit vectors along the normal and to the eye, under shared lights."""

    normal: Float[Tensor, "*#batch 3"]
    to_eye: Float[Tensor, "*#batch 3"]
    lights: Lights


def render(material: BasicMaterial, view: MaterialView, visible: brdf.Visible = visible_smith) -> Tensor:
    """Radiance of a surface towards the eye [W/(m² sr)]."""
    return brdf.lit(surface_of(material, view), view.to_eye, view.lights, visible)


def render_schlick(material: BasicMaterial, view: MaterialView) -> Float[Tensor, "*batch 3"]:
    """The same by Schlick's rational function, never brighter in lights; of the sky the same."""
    return render(material, view, visible_schlick)


def render_matt(material: BasicMaterial, view: MaterialView) -> Float[Tensor, "*batch 3"]:
    """All of the base colour as matt ground."""
    sky = view.lights.sky
    # Mean of the sky by the cosine over the half space above a surface.
    total = sky.mean + sky.gradient * (2.0 / 3.0 * view.normal[..., 2:])
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        total = total + irradiance * torch.relu((view.normal * to_light).sum(-1, keepdim=True)) / math.pi
    return material.base * total + 0.0 * view.to_eye


def skip(material: BasicMaterial, view: MaterialView) -> Float[Tensor, "*batch 3"]:
    """No light: black."""
    return torch.zeros_like(view.normal + view.to_eye) * material.base


def surface_of(material: BasicMaterial, view: MaterialView) -> Surface:
    """What a G-buffer keeps of it."""
    rough, metal = (one.expand(view.normal.shape[:-1]) for one in (material.roughness, material.metallic))
    return Surface(view.normal, material.base.expand_as(view.normal), rough, metal)


def largest_change(material: BasicMaterial, view: MaterialView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all surfaces [W/(m² sr)]: white ones with all facets in the mirror's direction.

    Of the sky no more than its brightest direction, of which no material reflects more than all.
    """
    lights = view.lights
    total = lights.sky.mean.abs() + lights.sky.gradient.abs()
    square = spread_squared(material.roughness)
    cos_eye = (view.normal * view.to_eye).sum(-1).clamp(LEAST_COSINE, 1.0)
    for to_light, irradiance in zip(lights.to_light, lights.irradiance, strict=True):
        cos_light = (view.normal * to_light).sum(-1).clamp(0.0, 1.0)
        most = visible_smith(cos_eye, cos_light, square) / (math.pi * square) + cos_light / math.pi
        total = total + irradiance * most[..., None]
    return total.amax()


# Elevations over the surface of the eye, its azimuth from the first light [degrees], and how far the surface leans from
# level and towards which azimuth.
_EXAMPLES = (
    (40.0, 180.0, 0.0, 0.0),
    (50.0, 175.0, 0.0, 0.0),
    (90.0, 0.0, 0.0, 0.0),  # straight down
    (65.0, 182.0, 25.0, 0.0),  # in the mirror's direction
    (30.0, 90.0, 25.0, 40.0),
    (15.0, 170.0, 15.0, 180.0),
    (4.0, 178.0, 0.0, 0.0),  # grazing
    (1.0, 20.0, 35.0, 100.0),
    (45.0, 180.0, 50.0, 180.0),  # the light at its horizon
    (35.0, 120.0, 80.0, 180.0),  # and below it
    (60.0, 200.0, 90.0, 0.0),  # a wall
    (20.0, 10.0, 120.0, 60.0),  # overhanging
)


def example_inputs(dtype: torch.dtype) -> MaterialView:
    """Ground, walls and overhangs under a sun, a lamp behind and a sky: straight down, mirrored, grazing, unlit."""
    height, turn, lean, towards = torch.tensor(_EXAMPLES, dtype=torch.float64).deg2rad().unbind(-1)
    normal = from_angles(math.pi / 2 - lean, towards)
    # Axes of the leant surface, the first of them in the plane in which it leans.
    first = from_angles(-lean, towards)
    second = torch.linalg.cross(normal, first)
    around = turn - towards
    flat = torch.cos(around)[:, None] * first + torch.sin(around)[:, None] * second
    to_eye = torch.cos(height)[:, None] * flat + torch.sin(height)[:, None] * normal
    return MaterialView(normal.to(dtype), to_eye.to(dtype), example_lights(dtype))


def example_lights(dtype: torch.dtype) -> Lights:
    """A sun at 40 degrees, a bluish light low behind, and a bright sky."""
    angles = torch.tensor([[40.0, 0.0], [12.0, 160.0]], dtype=torch.float64).deg2rad()
    sky = EvenSky(*(torch.tensor(of, dtype=dtype) for of in ((0.4, 0.5, 0.65), (0.2, 0.25, 0.3))))
    irradiance = torch.tensor([[3.0, 2.8, 2.4], [0.5, 0.7, 1.0]], dtype=dtype)
    return Lights(from_angles(*angles.unbind(-1)).to(dtype), irradiance, sky)


def reference(material: BasicMaterial, view: MaterialView) -> Float[Tensor, "*batch 3"]:
    """The same surfaces without tables."""
    return brdf_reference.lit(surface_of(material, view), view.to_eye, view.lights)


EFFECT = Effect(
    parameters=BasicMaterial,
    prefix="MATERIAL",
    rungs={
        "skip": Rung(skip),
        "matt": Rung(render_matt),
        "Schlick's facets": Rung(render_schlick),
        "Smith's facets": Rung(render),
    },
    reference=reference,
    # An eye at 1 degree, between the first cells of the sky's tables.
    tolerance=5e-4,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
