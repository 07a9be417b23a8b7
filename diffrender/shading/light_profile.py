"""Measured lamps: intensity over directions, as photometric files give it, linear in both angles between theirs.

Angles are those of type C [1]: the vertical one from 0 at the lamp's axis (its nadir) to pi opposite to it, the
horizontal one round the axis from 0 to 2 pi, from the lamp's `across` direction towards across × axis. Where a lamp was
not measured, as the upper half of downlights, it is dark.

Gradient: exact in the intensities; of the direction the slope of the cell, 0 along the axis, and no sign of the edge
beyond which a lamp is dark.

[1] IES LM-63-2002, "Standard File Format for the Electronic Transfer of Photometric Data".
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from diffrender.numerics import safe_sqrt
from diffrender.parameters import record


@record
class Profile:
    """Intensity of one lamp at rising angles [rad]; the horizontal ones go all the way round, from 0 to 2 pi."""

    vertical: Float[Tensor, " rows"]
    horizontal: Float[Tensor, " columns"]
    intensity: Float[Tensor, "rows columns"]  # [cd], or whatever is sought


@record
class Profiles:
    """Intensities of several lamps at even steps of both angles, and the vertical angles that were measured [rad]."""

    intensity: Float[Tensor, "profiles rows columns"]
    first: Float[Tensor, " profiles"]
    last: Float[Tensor, " profiles"]


def angles(along: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Vertical and horizontal angle of a direction [rad], given by its parts across, across × axis and along the axis.

    It need not be of unit length. Along the axis the horizontal angle is 0.
    """
    across, aside, ahead = along.unbind(-1)
    square = across * across + aside * aside
    is_axis = square == 0.0
    turn = torch.atan2(aside, torch.where(is_axis, torch.ones_like(across), across))
    return torch.atan2(safe_sqrt(square), ahead), turn.remainder(2.0 * math.pi)


def intensity_towards(profile: Profile, along: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Intensity of a lamp towards directions in its own frame, as of `angles`."""
    return _at(profile, *angles(along))


def flux(profile: Profile) -> Float[Tensor, ""]:
    """Flux of a lamp [lm, or 4 pi of the intensity's unit]: the exact integral of the intensity over all directions."""
    low, high = profile.vertical[:-1], profile.vertical[1:]
    # Of sin(angle) times what is 1 at one end of a cell and 0 at the other.
    slope = (torch.sin(high) - torch.sin(low)) / (high - low)
    rows = _joined(torch.cos(low) - slope, slope - torch.cos(high))
    half = 0.5 * (profile.horizontal[1:] - profile.horizontal[:-1])
    return rows @ profile.intensity @ _joined(half, half)


def even(profiles: Sequence[Profile], rows: int, columns: int) -> Profiles:
    """Profiles at even steps: the same wherever their angles are multiples of the steps, else cut at their corners."""
    like = profiles[0].intensity
    turn = torch.linspace(0.0, 2.0 * math.pi, columns, dtype=like.dtype)

    def stepped(profile: Profile) -> Tensor:
        # Where nothing was measured the border's value, so that no step is smoothed into a slope.
        measured = torch.linspace(0.0, math.pi, rows, dtype=like.dtype).clamp(profile.vertical[0], profile.vertical[-1])
        return _at(profile, *torch.meshgrid(measured, turn, indexing="ij"))

    return Profiles(
        torch.stack([stepped(profile) for profile in profiles]),
        torch.stack([profile.vertical[0] for profile in profiles]),
        torch.stack([profile.vertical[-1] for profile in profiles]),
    )


def intensity_of(
    profiles: Profiles, which: Int[Tensor, "*#batch"], along: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch"]:
    """Intensity of one of several lamps towards directions in its own frame; 1 where its number is below 0."""
    count, rows, columns = profiles.intensity.shape
    vertical, horizontal = angles(along)
    lamp = which.clamp(0, count - 1)
    down, across = vertical * ((rows - 1) / math.pi), horizontal * ((columns - 1) / (2.0 * math.pi))
    top = down.detach().long().clamp(0, rows - 2)
    left = across.detach().long().clamp(0, columns - 2)
    corner = (lamp * rows + top) * columns + left
    flat = profiles.intensity.reshape(-1)
    found = _bilinear(flat, (corner, corner + columns), (down - top, across - left))
    is_dark = (vertical < profiles.first[lamp]) | (vertical > profiles.last[lamp])
    found = torch.where(is_dark, torch.zeros_like(found), found)
    return torch.where(which < 0, torch.ones_like(found), found)


def _joined(of_low: Tensor, of_high: Tensor) -> Tensor:
    """Weight of every angle from those that it has in the cell after it and in the one before."""
    nothing = of_low.new_zeros(1)
    return torch.cat([of_low, nothing]) + torch.cat([nothing, of_high])


def _at(profile: Profile, vertical: Tensor, horizontal: Tensor) -> Tensor:
    row, down = _cell(profile.vertical, vertical)
    column, across = _cell(profile.horizontal, horizontal)
    columns = len(profile.horizontal)
    corner = row * columns + column
    found = _bilinear(profile.intensity.reshape(-1), (corner, corner + columns), (down, across))
    is_dark = (vertical < profile.vertical[0]) | (vertical > profile.vertical[-1])
    return torch.where(is_dark, torch.zeros_like(found), found)


def _cell(edges: Tensor, place: Tensor) -> tuple[Tensor, Tensor]:
    """Cell in which a place lies, and where in it, from 0 to 1."""
    cell = (torch.searchsorted(edges, place.detach().contiguous(), right=True) - 1).clamp(0, len(edges) - 2)
    start, end = edges[cell], edges[cell + 1]
    return cell, ((place - start) / (end - start)).clamp(0.0, 1.0)


def _bilinear(flat: Tensor, rows: tuple[Tensor, Tensor], place: tuple[Tensor, Tensor]) -> Tensor:
    """Between four entries of a flat table, by the left ones of two rows and the place in the cell."""
    down, across = place
    upper, lower = (torch.lerp(flat[left], flat[left + 1], across) for left in rows)
    return torch.lerp(upper, lower, down)
