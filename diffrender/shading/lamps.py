"""Lamps, the places that they light, and which lamps are looked at for which place: inputs of `local_lights`."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.shading.lamp_shadow import Shadows
from diffrender.shading.light_profile import Profiles

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
class Group:
    """Lamps and the lists of them: all with a shadow, or all without."""

    lamps: Lamps
    lists: Lists
    shadows: Shadows | None = None


@record
class LitView:
    """What lamps shine on, and which of them on which tile.

    Those with a shadow are a group of their own, so that the others cost no more for it.
    """

    places: Places
    lamps: Lamps
    lists: Lists
    profiles: Profiles | None = None
    shadowed: Group | None = None

    @property
    def groups(self) -> list[Group]:
        """All lamps: those without a shadow, and those with one where there are any."""
        plain = Group(self.lamps, self.lists)
        return [plain] if self.shadowed is None else [plain, self.shadowed]


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


def in_frame(lamps: Lamps, away: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Parts of vectors across, aside (across × axis) and along the axis of lamps."""
    aside = torch.linalg.cross(lamps.across, lamps.axis)
    return torch.stack([(part * away).sum(-1) for part in (lamps.across, aside, lamps.axis)], -1)


def most_in_slices(places: Places, first: Int[Tensor, "tiles slices"], last: Int[Tensor, "tiles slices"]) -> int:
    """Most lamps that any pixel's slice of any tile holds."""
    held = (last - first + 1).clamp(min=0).gather(-1, places.slice)
    return int(held.max()) if held.numel() else 0
