"""Lamps, the places that they light, and which lamps are looked at for which place: inputs of `local_lights`."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.shading.light_profile import Profile, Profiles, even

EVERYWHERE = (-1.0, -2.0)  # cosines of a cone without an edge
NO_PROFILE = -1


@record
class LocalLights:
    """What is common to all lamps of a scene."""

    intensity_scale: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 16.0), unit="1", about="times the intensity of every lamp: turned up, brighter"
    )
    reach_scale: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.1, 1.0), unit="1",
        about="share of its reach at which a lamp's light ends: turned up, pools of light spread",
    )  # fmt: skip
    source_radius: Float[Tensor, ""] = parameter(
        0.05, bounds=(1e-3, 1.0), unit="m", scale="log",
        about="of the disc that a lamp is: turned up, surfaces close to it are less bright",
    )  # fmt: skip


@record
class Lamps:
    """Point lights and spots, exposed already.

    A spot is dark outside of the cone of `cos_outer` and undimmed inside that of `cos_inner`; EVERYWHERE are those of a
    point. `across` is a direction square to the axis, the horizontal angle 0 of profiles.
    """

    position: Float[Tensor, "*lamps 3"]  # [m]
    intensity: Float[Tensor, "*lamps 3"]  # where a profile is 1 [W/sr]
    reach: Float[Tensor, "*lamps"]  # where its light ends at the latest [m]
    axis: Float[Tensor, "*lamps 3"]  # to where it points
    across: Float[Tensor, "*lamps 3"]
    cos_inner: Float[Tensor, "*lamps"]
    cos_outer: Float[Tensor, "*lamps"]
    profile: Int[Tensor, "*lamps"]  # number of its profile, or NO_PROFILE


@record
class Places:
    """Surfaces seen in pixels of tiles: the last axis but that of channels is the pixel's number in its tile."""

    position: Float[Tensor, "*#batch pixels 3"]  # [m]
    normal: Float[Tensor, "*#batch pixels 3"]
    to_eye: Float[Tensor, "*#batch pixels 3"]
    base: Float[Tensor, "*#batch pixels 3"]
    roughness: Float[Tensor, "*#batch pixels"]
    metallic: Float[Tensor, "*#batch pixels"]
    slice: Int[Tensor, "*#batch pixels"]  # of depth, as of `light_grid.slice_of`


@record
class Lists:
    """Numbers of the lamps that may reach a tile, -1 beyond their end, and the part of the list for each slice of it.

    As `light_grid` makes them, of whole reaches. `longest` is the most that any pixel's slice holds: tensors' shapes
    cannot tell it, and a rung that looked at the numbers would not run on tensors without any.
    """

    listed: Int[Tensor, "*#batch listed"]
    first: Int[Tensor, "*#batch slices"]
    last: Int[Tensor, "*#batch slices"]  # before the first where there is none
    longest: int


@record
class LitView:
    """What lamps shine on, and which of them on which tile."""

    places: Places
    lamps: Lamps
    lists: Lists
    profiles: Profiles | None = None


def points(
    position: Float[Tensor, "lamps 3"], intensity: Float[Tensor, "lamps 3"], reach: Float[Tensor, " lamps"]
) -> Lamps:
    """Lamps that shine alike in all directions."""
    inner, outer = (torch.full_like(reach, cosine) for cosine in EVERYWHERE)
    down, ahead = (position.new_tensor(axis).expand_as(position) for axis in ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0)))
    none = torch.full(reach.shape, NO_PROFILE, device=reach.device)
    return Lamps(position, intensity, reach, down, ahead, inner, outer, none)


def spots(lamps: Lamps, axis: Float[Tensor, "lamps 3"], inner: float, outer: float) -> Lamps:
    """Lamps turned towards unit vectors, within cones by half of their angles [rad]; 0 < inner < outer."""
    # Square to the axis by whichever of two axes of the world is further from it.
    world = axis.new_tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    across = torch.linalg.cross(axis, world[(axis[:, 2].abs() > 0.7).long()])
    across = across / torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    cosines = {"cos_inner": math.cos(inner), "cos_outer": math.cos(outer)}
    limits = {name: torch.full_like(lamps.reach, cosine) for name, cosine in cosines.items()}
    return replace(lamps, axis=axis, across=across, **limits)


def most_in_slices(places: Places, first: Int[Tensor, "tiles slices"], last: Int[Tensor, "tiles slices"]) -> int:
    """Most lamps that any pixel's slice of any tile holds."""
    held = (last - first + 1).clamp(min=0).gather(-1, places.slice)
    return int(held.max()) if held.numel() else 0


# Height, azimuth [degrees] and distance of a lamp from its tile's middle, reach, intensity; elevation of its axis.
_LAMPS = (
    (40.0, 20.0, 2.0, 6.0, 30.0, -60.0),
    (80.0, 140.0, 0.4, 3.0, 6.0, -90.0),  # near
    (15.0, 250.0, 3.0, 3.4, 90.0, -20.0),  # where its light ends
    (50.0, 300.0, 2.5, 8.0, 60.0, -50.0),
    (0.5, 10.0, 2.0, 5.0, 60.0, 0.0),  # grazing
    (-30.0, 80.0, 1.5, 5.0, 40.0, 30.0),  # below the surface
    (60.0, 200.0, 6.0, 5.0, 99.0, -70.0),  # out of reach
    (89.0, 0.0, 1.8, 7.0, 50.0, -90.0),
    (35.0, 170.0, 1.2, 4.0, 20.0, 80.0),  # turned away
)
# Roughness, metallic, brightness of the base; elevation and azimuth of the eye [degrees].
_SURFACES = (
    (0.5, 0.0, 0.4, 40.0, 200.0),
    (1.0, 0.0, 0.8, 25.0, 100.0),
    (0.2, 1.0, 0.7, 60.0, 20.0),
    (0.0, 0.0, 0.3, 35.0, 10.0),  # a mirror
    (0.6, 1.0, 0.9, 3.0, 300.0),  # grazing
    (0.35, 0.0, 0.0, 89.9, 0.0),  # black, straight down
)
_SLICES = 4


def example_inputs(dtype: torch.dtype) -> LitView:
    """Six tiles of four places on grounds and mirrors, under points, spots and measured lamps: near, grazing, away."""
    lamp = torch.tensor(_LAMPS, dtype=torch.float64)
    surface = torch.tensor(_SURFACES, dtype=torch.float64)
    tile, pixel = torch.arange(len(surface), dtype=torch.float64), torch.arange(4, dtype=torch.float64)
    place = torch.stack(
        [0.9 * tile[:, None] + 0.0 * pixel, 0.15 * pixel + 0.0 * tile[:, None], 0.0 * tile[:, None] * pixel], -1
    )
    lean = torch.stack([0.1 * torch.sin(tile), 0.1 * torch.cos(tile), torch.ones_like(tile)], -1)
    rough, metal, bright, *eye = surface.unbind(-1)
    to_eye = from_angles(*(angle.deg2rad() for angle in eye))
    base = bright[:, None] * torch.tensor([1.0, 0.9, 0.75], dtype=torch.float64)

    def of_tile(value: Tensor) -> Tensor:
        return value[:, None].expand(len(surface), 4, *value.shape[1:]).clone()

    slices = of_tile(tile.long()) % _SLICES
    unit = torch.nn.functional.normalize(lean, dim=-1)
    places = Places(place, of_tile(unit), of_tile(to_eye), of_tile(base), of_tile(rough), of_tile(metal), slices)
    lamps = _example_lamps(lamp)
    return _cast(LitView(places, lamps, _example_lists(places, lamps), _example_profiles()), dtype)


def _example_lamps(lamp: Tensor) -> Lamps:
    rise, turn, distance, reach, strength, tilt = lamp.unbind(-1)
    number = torch.arange(len(lamp), dtype=torch.float64)
    middle = torch.stack([0.6 * number, 0.2 + 0.0 * number, 0.0 * number], -1)
    towards = from_angles(rise.deg2rad(), turn.deg2rad())
    colour = strength[:, None] * torch.tensor([1.0, 0.8, 0.6], dtype=torch.float64)
    lamps = points(middle + distance[:, None] * towards, colour, reach)
    spot = spots(lamps, from_angles(tilt.deg2rad(), turn.deg2rad() + math.pi), 0.3, 0.9)
    is_point = number % 3 == 1
    cones = {
        name: torch.where(is_point, getattr(lamps, name), getattr(spot, name)) for name in ("cos_inner", "cos_outer")
    }
    profile = torch.where(number % 3 == 2, (number // 3).long() % 2, NO_PROFILE)
    return replace(spot, profile=profile, **cones)


def _example_profiles() -> Profiles:
    """A downlight, and a lamp that shines to two sides more than to the others."""
    down, turn = (torch.linspace(0.0, end, count, dtype=torch.float64) for end, count in ((180.0, 19), (360.0, 37)))
    down, turn = down.deg2rad(), turn.deg2rad()
    batwing = 0.3 + torch.sin(down[:, None]) ** 2 * torch.cos(turn) ** 2
    below = torch.cos(down[:10, None]).clamp(min=0.0) + 0.0 * turn
    return even([Profile(down[:10], turn, below), Profile(down, turn, batwing)], len(down), len(turn))


def _example_lists(places: Places, lamps: Lamps) -> Lists:
    """Lists of what reaches any place of a tile; all of it in the slice in which the tile lies, none in others."""
    distance = torch.linalg.vector_norm(lamps.position - places.position[..., None, :], dim=-1)
    reached = (distance <= lamps.reach).any(1)
    longest = int(reached.sum(-1).max())
    # A stable sort of what is not reached leaves the others in front, in their order.
    listed = (~reached).long().argsort(dim=-1, stable=True)[:, :longest]
    listed = torch.where(reached.gather(-1, listed), listed, -1)
    first = torch.zeros(len(listed), _SLICES, dtype=torch.long)
    is_own = torch.arange(_SLICES) == places.slice[:, :1]
    last = torch.where(is_own, reached.sum(-1, keepdim=True) - 1, -1)
    return Lists(listed, first, last, most_in_slices(places, first, last))


def _cast(view: LitView, dtype: torch.dtype) -> LitView:
    """The same view in another precision."""

    def of(part: object) -> dict[str, Tensor]:
        return {name: value.to(dtype) if value.is_floating_point() else value for name, value in vars(part).items()}

    assert view.profiles is not None
    places, lamps, profiles = Places(**of(view.places)), Lamps(**of(view.lamps)), Profiles(**of(view.profiles))
    return LitView(places, lamps, view.lists, profiles)
