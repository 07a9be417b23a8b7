"""Light of many lamps on surfaces [1]: of all of them, or of those alone that may reach a tile or a slice of it.

A lamp is a disc that faces whatever it shines on: at a distance d its intensity is over d² + radius², which ends well
on the lamp itself. So that leaving lamps out changes nothing, their light ends smoothly at the reach: times
(1 - (d / reach)⁴)² [2], which is darker by 12 % at half the reach already. No lamp reaches further than its own
`reach`, whatever the parameters, so that lists hold for all of them. All rungs draw the same picture but for rounding.

Surfaces are those of `brdf`. Nothing casts a shadow here, and no light goes round twice.

Places come tile by tile, and lists of lamps as inputs: `geometry.light_grid` makes both. Lists of a view are as long as
its longest; `in_groups` draws tiles with others of lists as long as theirs. So many pairs of place and lamp are held
at a time as PAIRS, but for gradients by reverse mode, which hold all.

Gradient: exact of all that is not an integer; 0 in the reach where a lamp is beyond it. Lists have none and need none.

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
from diffrender.shading import brdf
from diffrender.shading.brdf import Geometry
from diffrender.shading.lamps import Lamps, Lists, LitView, LocalLights, example_inputs, most_in_slices
from diffrender.shading.light_profile import Profiles, intensity_of
from diffrender.shading.local_lights_reference import reference
from diffrender.shading.microfacet import spread_squared

PAIRS = 2**17  # of places and lamps that are worked out at a time


def render(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """Radiance of all lamps' light that surfaces send to the eye [W/(m² sr)]."""
    total = _none(lights, view)
    for part in _parts(len(view.lamps.reach), view):
        total = total + _sent(lights, view, Lamps(**{name: value[part] for name, value in vars(view.lamps).items()}))
    return total


def render_tiles(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """The same of the lamps in every tile's list."""
    total = _none(lights, view)
    for part in _parts(view.lists.listed.shape[-1], view):
        total = total + _sent(lights, view, _taken(view.lamps, view.lists.listed[..., None, part]))
    return total


def render_clusters(lights: LocalLights, view: LitView) -> Float[Tensor, "*batch pixels 3"]:
    """The same of the lamps from the first to the last of every pixel's slice of its tile's list."""
    total, lists = _none(lights, view), view.lists
    slices = view.places.slice
    first, last = (torch.take_along_dim(end, slices, -1)[..., None] for end in (lists.first, lists.last))
    for part in _parts(lists.longest, view):
        place = first + torch.arange(part.start, part.stop, device=first.device)
        held = place.clamp(max=lists.listed.shape[-1] - 1).flatten(-2)
        which = torch.take_along_dim(lists.listed, held, -1).reshape(place.shape)
        total = total + _sent(lights, view, _taken(view.lamps, torch.where(place <= last, which, -1)))
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
    lengths = (view.lists.listed >= 0).sum(-1)
    order = torch.argsort(lengths, descending=True, stable=True)
    drawn = [
        rung(lights, _only(view, tiles, int(lengths[tiles[0]])))
        for tiles in torch.split(order, math.ceil(len(order) / count))
    ]
    return torch.cat(drawn)[torch.argsort(order)]


def _only(view: LitView, tiles: Tensor, longest: int) -> LitView:
    """View of some of the tiles, whose lists are that long at most."""
    places = pytree.tree_map(lambda value: value[tiles], view.places)
    first, last = view.lists.first[tiles], view.lists.last[tiles]
    lists = Lists(view.lists.listed[tiles, :longest], first, last, most_in_slices(places, first, last))
    return replace(view, places=places, lists=lists)


def _none(lights: LocalLights, view: LitView) -> Tensor:
    places = view.places
    return torch.zeros_like(places.position + places.normal + places.base) * lights.intensity_scale


def _parts(count: int, view: LitView) -> Iterator[slice]:
    """Slices of so many lamps, so few at a time that with all places they are PAIRS at most, or one."""
    step = max(1, PAIRS // max(1, view.places.position[..., 0].numel()))
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


def _taken(lamps: Lamps, which: Tensor) -> Lamps:
    """Lamps of some numbers; those below 0 reach nothing."""
    taken = Lamps(**{name: value[which.clamp(min=0)] for name, value in vars(lamps).items()})
    return replace(taken, reach=torch.where(which < 0, torch.zeros_like(taken.reach), taken.reach))


def _sent(lights: LocalLights, view: LitView, lamps: Lamps) -> Tensor:
    """Radiance towards the eye of lamps, which have an axis of their own after that of pixels, or the last alone."""
    places = view.places
    towards = lamps.position - places.position[..., None, :]
    square = towards.square().sum(-1)
    is_there = square == 0.0
    to_light = towards / torch.sqrt(torch.where(is_there, torch.ones_like(square), square))[..., None]
    shone = falloff(lights, lamps.reach, square) * _directed(view.profiles, lamps, -to_light)
    geometry = Geometry(places.normal[..., None, :], places.to_eye[..., None, :], to_light)
    material = brdf.material(places.base[..., None, :], places.roughness[..., None], places.metallic[..., None])
    return (brdf.reflected(material, geometry) * (lamps.intensity * shone[..., None])).sum(-2) * lights.intensity_scale


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
    along = (lamps.axis * away).sum(-1)
    cone = smooth_rise(along - lamps.cos_outer, lamps.cos_inner - lamps.cos_outer)
    if profiles is None:
        return cone
    aside = torch.linalg.cross(lamps.across, lamps.axis)
    parts = torch.stack([(lamps.across * away).sum(-1), (aside * away).sum(-1), along], -1)
    return cone * intensity_of(profiles, lamps.profile, parts)


def largest_change(lights: LocalLights, view: LitView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all places [W/(m² sr)]: every lamp as near as it is to any, in a glint."""
    position = view.places.position.flatten(0, -2)
    nearest = torch.minimum(torch.maximum(view.lamps.position, position.amin(0)), position.amax(0))
    shone = falloff(lights, view.lamps.reach, (view.lamps.position - nearest).square().sum(-1))
    if view.profiles is not None:
        shone = shone * torch.clamp(view.profiles.intensity.amax(), min=1.0)
    spread = torch.sqrt(spread_squared(view.places.roughness.amin()))
    brightest = 1.0 / torch.pi + 0.5 / (torch.pi * spread**3)  # of white ground, and of GGX at its peak
    return lights.intensity_scale * brightest * (shone[:, None] * view.lamps.intensity).sum(0).amax()


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
