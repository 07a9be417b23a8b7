"""Light of many lamps on surfaces [1]: of all of them, or of those alone that may reach a tile or a slice of it.

A lamp is a disc that faces whatever it shines on: at a distance d its intensity is over d² + radius², which ends well
on the lamp itself. So that leaving lamps out changes nothing, their light ends smoothly at the reach: times
(1 - (d / reach)⁴)² [2], which is darker by 12 % at half the reach already. No lamp reaches further than its own
`reach`, whatever the parameters, so that lists hold for all of them. All rungs draw the same picture but for rounding.

Surfaces are those of `brdf`. Lamps of the group with shadows are dimmed by what their maps tell of each place, soft
or as sharp as a comparison can be, in all rungs alike; the other lamps shine through everything, and cost nothing for
it. No light goes round twice.

Places come tile by tile, and lists of lamps as inputs: `geometry.light_grid` makes both. Lists of a view are as long as
its longest; `in_groups` draws tiles with others of lists as long as theirs. So many pairs of place and lamp are held
at a time as PAIRS, but for gradients by reverse mode, which hold all.

Gradient: exact of all that is not an integer, of shadows as of `lamp_shadow`; 0 in the reach where a lamp is beyond it.
Lists have none and need none.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Local Lights".
[2] B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013 course "Physically Based Shading".
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree  # torch has no public name for it

from diffrender.effect import Effect, Rung
from diffrender.numerics import smooth_rise
from diffrender.shading import brdf, lamp_shadow
from diffrender.shading.brdf import Geometry
from diffrender.shading.lamp_examples import example_inputs
from diffrender.shading.lamps import Group, Lamps, Lists, LitView, LocalLights, Places, in_frame, most_in_slices
from diffrender.shading.light_profile import Profiles, intensity_of
from diffrender.shading.local_lights_reference import reference
from diffrender.shading.microfacet import spread_squared

PAIRS = 2**17  # of places and lamps that are worked out at a time


def render(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """Radiance of all lamps' light that surfaces send to the eye [W/(m² sr)]."""
    total = _none(lights, view)
    for group in view.groups:
        for part in _parts(len(group.lamps.reach), view):
            total = total + _sent(lights, view, _picked(group, part))
    return total


def render_tiles(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """The same of the lamps in every tile's list."""
    total = _none(lights, view)
    for group in view.groups:
        for part in _parts(group.lists.listed.shape[-1], view):
            total = total + _sent(lights, view, _taken(group, group.lists.listed[..., None, part]))
    return total


def render_clusters(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """The same of the lamps from the first to the last of every pixel's slice of its tile's list."""
    total, slices = _none(lights, view), view.places.slice
    for group in view.groups:
        lists = group.lists
        first, last = (torch.take_along_dim(end, slices, -1)[..., None] for end in (lists.first, lists.last))
        for part in _parts(lists.longest, view):
            place = first + torch.arange(part.start, part.stop, device=first.device)
            held = place.clamp(max=lists.listed.shape[-1] - 1).flatten(-2)
            which = torch.take_along_dim(lists.listed, held, -1).reshape(place.shape)
            total = total + _sent(lights, view, _taken(group, torch.where(place <= last, which, -1)))
    return total


def skip(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """No light of lamps."""
    return _none(lights, view)


def in_groups(
    rung: Callable[[LocalLights, LitView], Tensor], lights: LocalLights, view: LitView, count: int
) -> Float[Tensor, "tiles pixels 3"]:
    """The picture of a rung, drawn in groups of tiles whose lists are about as long; so short ones cost less.

    Not for transforms of `torch.func` over the lists: it looks at their lengths.
    """
    lengths = sum((group.lists.listed >= 0).sum(-1) for group in view.groups)
    assert isinstance(lengths, Tensor)
    order = torch.argsort(lengths, descending=True, stable=True)
    drawn = [rung(lights, _only(view, tiles)) for tiles in torch.split(order, math.ceil(len(order) / count))]
    return torch.cat(drawn)[torch.argsort(order)]


def _only(view: LitView, tiles: Tensor) -> LitView:
    """View of some of the tiles, with lists that are no longer than these need."""
    places: Places = pytree.tree_map(lambda value: value[tiles], view.places)

    def cut(lists: Lists) -> Lists:
        listed, first, last = (whole[tiles] for whole in (lists.listed, lists.first, lists.last))
        longest = int((listed >= 0).sum(-1).amax()) if listed.numel() else 0
        return Lists(listed[:, :longest], first, last, most_in_slices(places, first, last))

    shadowed = view.shadowed
    if shadowed is not None:
        shadowed = replace(shadowed, lists=cut(shadowed.lists))
    return replace(view, places=places, lists=cut(view.lists), shadowed=shadowed)


def _none(lights: LocalLights, view: LitView) -> Tensor:
    places = view.places
    return torch.zeros_like(places.position + places.normal + places.base) * lights.intensity_scale


def _parts(count: int, view: LitView) -> Iterator[slice]:
    """Slices of so many lamps, so few at a time that with all places they are PAIRS at most, or one."""
    step = max(1, PAIRS // max(1, view.places.position[..., 0].numel()))
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


def _picked(group: Group, which: slice | Tensor) -> Group:
    """Lamps of some numbers, and their squares."""
    shadows = group.shadows
    if shadows is not None:
        shadows = replace(shadows, squares=pytree.tree_map(lambda value: value[which], shadows.squares))
    return replace(group, lamps=pytree.tree_map(lambda value: value[which], group.lamps), shadows=shadows)


def _taken(group: Group, which: Tensor) -> Group:
    """The same; those below 0 reach nothing."""
    taken = _picked(group, which.clamp(min=0))
    reach = taken.lamps.reach
    return replace(taken, lamps=replace(taken.lamps, reach=torch.where(which < 0, torch.zeros_like(reach), reach)))


def _sent(lights: LocalLights, view: LitView, group: Group) -> Tensor:
    """Radiance towards the eye of lamps, which have an axis of their own after that of pixels, or the last alone."""
    places, lamps = view.places, group.lamps
    away = places.position[..., None, :] - lamps.position
    normal = places.normal[..., None, :]
    shone = reaching(lights, view.profiles, lamps, away)
    if group.shadows is not None:
        shone = shone * lamp_shadow.share(group.shadows, in_frame(lamps, away), in_frame(lamps, normal))
    geometry = Geometry(normal, places.to_eye[..., None, :], -_unit(away))
    material = brdf.material(places.base[..., None, :], places.roughness[..., None], places.metallic[..., None])
    return (brdf.reflected(material, geometry) * (lamps.intensity * shone[..., None])).sum(-2) * lights.intensity_scale


def _unit(away: Tensor) -> Tensor:
    """Direction; nothing in a lamp."""
    square = away.square().sum(-1)
    return away / torch.sqrt(torch.where(square == 0.0, torch.ones_like(square), square))[..., None]


def reaching(
    lights: LocalLights, profiles: Profiles | None, lamps: Lamps, away: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch"]:
    """Irradiance of surfaces that face lamps, over their intensity [1/m²], at places from them [m]; shadows apart."""
    return falloff(lights, lamps.reach, away.square().sum(-1)) * _directed(profiles, lamps, _unit(away))


def falloff(
    lights: LocalLights, reach: Float[Tensor, "*#batch"], square: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch"]:
    """Irradiance of a surface that faces a lamp, over its intensity [1/m²], by the square of the distance [m²]."""
    is_dark = reach <= 0.0
    end = torch.where(is_dark, torch.ones_like(reach), reach) * lights.reach_scale
    left = torch.relu(1.0 - (square / (end * end)).square())
    shone = left * left / (square + lights.source_radius * lights.source_radius)
    return torch.where(is_dark, torch.zeros_like(shone), shone)


def _directed(profiles: Profiles | None, lamps: Lamps, away: Tensor) -> Tensor:
    """Share of their intensity that lamps send into directions."""
    if profiles is None:
        return _cone(lamps, (lamps.axis * away).sum(-1))
    parts = in_frame(lamps, away)
    return _cone(lamps, parts[..., 2]) * intensity_of(profiles, lamps.profile, parts)


def _cone(lamps: Lamps, along: Tensor) -> Tensor:
    return smooth_rise(along - lamps.cos_outer, lamps.cos_inner - lamps.cos_outer)


def largest_change(lights: LocalLights, view: LitView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all places [W/(m² sr)]: every lamp as near as it is to any, in a glint."""
    position = view.places.position.flatten(0, -2)
    total = torch.zeros_like(position[0])
    for lamps in (group.lamps for group in view.groups):
        nearest = torch.minimum(torch.maximum(lamps.position, position.amin(0)), position.amax(0))
        shone = falloff(lights, lamps.reach, (lamps.position - nearest).square().sum(-1))
        total = total + (shone[:, None] * lamps.intensity).sum(0)
    if view.profiles is not None:
        total = total * torch.clamp(view.profiles.intensity.amax(), min=1.0)
    spread = torch.sqrt(spread_squared(view.places.roughness.amin()))
    brightest = 1.0 / torch.pi + 0.5 / (torch.pi * spread**3)  # of white ground, and of GGX at its peak
    return lights.intensity_scale * brightest * total.amax()


EFFECT = Effect(
    parameters=LocalLights,
    prefix="LOCAL_LIGHTS",
    rungs={
        "skip": Rung(skip),
        "tiles": Rung(render_tiles),
        "clusters": Rung(render_clusters),
        "all lights": Rung(render),
    },
    reference=reference,
    # All of it the reference's, whose rings are coarse on a lamp that is near.
    tolerance=1e-6,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
