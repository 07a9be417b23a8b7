"""Wet surfaces of Final Fantasy XV [1] by Lagarde's model [2]: darker, smoother, with puddles, rings and rivulets.

Of the wetness w, from 0 to 1, porous ground soaks: rough surfaces that are no metal, from a roughness of 0.5 to all of
it at 0.9. Its diffuse colour falls towards SOAKED_ALBEDO of what it was, its roughness by half as much. What lies low
is flooded: holes of the height map up to HOLE_FLOOD, and the dips of the terrain up to PUDDLE_FLOOD. Where the water's
share is A, the surface is by that share a mirror of water that reflects 2 % at normal incidence, level but for the
rings of raindrops. Steep walls, on which no water stands, have rivulets instead, which are ours and not in [2]. Roofs,
"non-wet" boxes and the time that things take to soak and to dry scale all of it.

Soaked ground is taken to be dark whatever its albedo; by optics [3] pale ground loses less of it than dark ground does
(`experiments.wetness` has the table). Nothing is refracted, and no caustics are drawn.

Gradient: exact away from the clamps that the published model is made of; 0 where one stands at its bound, such as of
HOLE_FLOOD where all holes are full, and of one of two floods where the other is higher. RAIN as of `ripples`.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slides "Wet Materials".
[2] S. Lagarde, "Water drop 2b - Dynamic rain and its effects" and "Water drop 3b - Physically based wet surfaces",
    seblagarde.wordpress.com, 2013.
[3] J. Lekner, M. Dorf, "Why some things are darker when wet", Applied Optics 27(7), 1988.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.numerics import opacity, smooth_rise
from diffrender.parameters import record
from diffrender.rays import unit
from diffrender.shading import brdf, drying, ripples, trickles
from diffrender.shading.brdf import Geometry, Material
from diffrender.shading.microfacet import MIRROR_SPREAD, visible_schlick, visible_smith
from diffrender.shading.wet_surface import (
    LEVEL,
    POROUS_FROM,
    POROUS_OVER,
    SHORE,
    STEEP,
    WATER,
    Wetness,
    WetView,
    example_inputs,
)
from diffrender.shading.wetness_reference import reference

SIMPLE_ALBEDO, SIMPLE_GLOSS = 0.3, 2.5  # factors of the published model without porosity


@record
class Water:
    """Water on a surface.

    Attributes:
        held: share of what it could hold, as rain goes on.
        soaked: how wet it is.
        flooded: share that lies under level water.
        mirror: share that water covers, level or running down.
        lean: what running water adds to the normal.
    """

    held: Float[Tensor, "*batch"]
    soaked: Float[Tensor, "*batch"]
    flooded: Float[Tensor, "*batch"]
    mirror: Float[Tensor, "*batch"]
    lean: Float[Tensor, "*batch 3"]


def water(wetness: Wetness, view: WetView) -> Water:
    """Water that soaks and stands on a surface now: what it held has followed the rain for the time that has passed."""
    towards = view.open * drying.open_to_rain(view.boxes, view.position)
    times = wetness.soaking_time, wetness.drying_time
    held = drying.followed(view.held, towards, view.elapsed, times)
    hole = torch.minimum(wetness.hole_flood * held, 1.0 - view.height)
    puddle = ((wetness.puddle_flood * held - view.terrain) / SHORE).clamp(0.0, 1.0)
    stays = smooth_rise(view.normal[..., 2] - STEEP, view.height.new_tensor(LEVEL - STEEP))
    flooded = torch.maximum(hole, puddle) * stays
    soaked = (wetness.amount * held + flooded).clamp(max=1.0)
    return Water(held, soaked, flooded, flooded, torch.zeros_like(view.normal + held[..., None]))


def running(wetness: Wetness, view: WetView) -> Water:
    """The same, and what runs down steep surfaces: where a rivulet's film is thick it is a mirror too."""
    still = water(wetness, view)
    found = trickles.rivulets(view.waves, view.position, view.normal, view.time)
    strength = wetness.trickle_strength * wetness.amount * still.held
    covered = opacity(strength * found.film)
    return replace(
        still,
        soaked=still.soaked + (1.0 - still.soaked) * covered,
        mirror=still.flooded + (1.0 - still.flooded) * covered,
        lean=strength[..., None] * found.lean,
    )


def step(
    wetness: Wetness, frame: WetView, state: Float[Tensor, "*batch"]
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch"]]:
    """Picture of things that move, and the water that they hold now, from what they held in the frame before.

    The state is a share from 0, dry, to 1; the frame's `elapsed` is the time since. What the frame holds is not looked
    at. Splitting a stretch of time in which nothing moves into frames changes nothing.
    """
    now = replace(frame, held=state)
    return render(wetness, now), water(wetness, now).held


def wet_material(wetness: Wetness, view: WetView, found: Water) -> Material:
    """What the material of a surface becomes in its water."""
    dry = brdf.material(view.base, view.roughness, view.metallic)
    porous = porosity(view.roughness) * (1.0 - view.metallic)
    diffuse, smoothed = (kept(wetness, porous, share) for share in (found.soaked, 0.5 * found.soaked))
    straight = torch.lerp(dry.straight, torch.full_like(dry.straight, WATER), found.mirror[..., None])
    return Material(dry.diffuse * diffuse[..., None], straight, dry.roughness * smoothed * (1.0 - found.mirror))


def render(wetness: Wetness, view: WetView) -> Float[Tensor, "*batch 3"]:
    """Radiance of a wet surface towards the eye [W/(m² sr)], with rings on puddles and rivulets on walls."""
    found = running(wetness, view)
    return _lit(wet_material(wetness, view, found), wet_normal(wetness, view, found), view)


def porosity(roughness: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of ground that soaks, where it is no metal."""
    return ((roughness - POROUS_FROM) / POROUS_OVER).clamp(0.0, 1.0)


def kept(
    wetness: Wetness, porous: Float[Tensor, "*#batch"], soaked: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch"]:
    """Share of its diffuse colour that ground keeps, by how porous it is and how wet, both from 0 to 1."""
    return 1.0 - soaked * porous * (1.0 - wetness.soaked_albedo)


def wet_normal(wetness: Wetness, view: WetView, found: Water) -> Float[Tensor, "*batch 3"]:
    """Unit normal of a surface in its water: with rivulets, and level by the share that is flooded but for rings."""
    return _over(view.normal + found.lean, _ringed(wetness, view), found)


def render_still(wetness: Wetness, view: WetView) -> Float[Tensor, "*batch 3"]:
    """The same without what moves: puddles are level, walls as they are."""
    found = water(wetness, view)
    up = torch.zeros_like(view.normal) + view.normal.new_tensor((0.0, 0.0, 1.0))
    return _lit(wet_material(wetness, view, found), _over(view.normal, up, found), view)


def render_simple(wetness: Wetness, view: WetView) -> Float[Tensor, "*batch 3"]:
    """The surface darker and smoother, whatever it is, by Lagarde's first model; no water stands, no normal bends."""
    held = water(wetness, view).held
    wet = wetness.amount * held
    dry = brdf.material(view.base, view.roughness, view.metallic)
    gloss = ((1.0 - dry.roughness) * (1.0 + wet * (SIMPLE_GLOSS - 1.0))).clamp(max=1.0)
    diffuse = dry.diffuse * (1.0 - wet * (1.0 - SIMPLE_ALBEDO))[..., None]
    geometry = Geometry(unit(view.normal), view.to_eye, view.to_light)
    found = Material(diffuse, dry.straight, 1.0 - gloss)
    return view.irradiance * brdf.reflected(found, geometry, visible_schlick) + brdf.reflected_sky(
        found, geometry, view.sky
    )


def skip(wetness: Wetness, view: WetView) -> Float[Tensor, "*batch 3"]:
    """The surface as if it were dry."""
    dry = brdf.material(view.base, view.roughness, view.metallic)
    return _lit(dry, unit(view.normal), view) + 0.0 * wetness.amount


def _lit(found: Material, normal: Tensor, view: WetView) -> Tensor:
    geometry = Geometry(normal, view.to_eye, view.to_light)
    of_light = view.irradiance * brdf.reflected(found, geometry, visible_smith)
    return of_light + brdf.reflected_sky(found, geometry, view.sky)


def _ringed(wetness: Wetness, view: WetView) -> Tensor:
    """Normal of water that rain falls on; not where roofs or boxes are, though water may still stand there."""
    rain = wetness.rain * view.open * drying.open_to_rain(view.boxes, view.position)
    lean = wetness.ripple_strength * ripples.slope(view.drops, view.position[..., :2], view.time, rain)
    return unit(torch.cat([lean, torch.ones_like(lean[..., :1])], -1))


def _over(normal: Tensor, of_water: Tensor, found: Water) -> Tensor:
    """Unit normal of ground and water together."""
    return unit(torch.lerp(normal, of_water, found.flooded[..., None]))


def largest_change(wetness: Wetness, view: WetView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all places [W/(m² sr)]: the brightest glint of a mirror, or 0 where all is dry.

    No tight one is known: how bright a glint is hangs on every normal.
    """
    found = running(wetness, view)
    glint = 0.5 / (torch.pi * MIRROR_SPREAD**3)  # GGX at its peak, seen and lit as well as can be
    sky = view.sky.mean.abs() + view.sky.gradient.abs()
    brightest = (view.irradiance * (1.0 / torch.pi + glint)).amax() + 2.0 * sky.amax()
    return torch.where(torch.maximum(found.soaked, found.mirror).amax() > 0.0, brightest, torch.zeros_like(brightest))


EFFECT = Effect(
    parameters=Wetness,
    prefix="WETNESS",
    rungs={
        "skip": Rung(skip),
        "darker and smoother": Rung(render_simple),
        "still water": Rung(render_still),
        "moving water": Rung(render),
    },
    reference=reference,
    # The table of what facets reflect of the sky: its cells, at a grazing eye.
    tolerance=1e-4,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
