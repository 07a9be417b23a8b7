"""What a photometric file says of its lamp: symmetry, peak, flux, and how wide its light is.

The beam's angle is that between the outermost directions of a vertical plane in which the plane has at least half of
its own greatest intensity, the field's that of a tenth; both are measured round the end of the axis, nadir or zenith,
that is nearer to the lamp's peak. So of a lamp that is brightest to the sides, the darker middle counts too.
"""

import math
import textwrap
from dataclasses import dataclass

import torch
from jaxtyping import Float64
from torch import Tensor

from diffrender.shading.light_profile import flux, intensity_towards
from fit.ies import Luminaire

PLANES = (0, 90)  # horizontal angles of the two planes that are shown, each with the half opposite [degrees]
BEAM, FIELD = 0.5, 0.1  # shares of a plane's greatest intensity
STEPS = 7200  # directions round a plane


@dataclass(frozen=True, eq=False)
class Plane:
    """Intensity round a vertical plane.

    Attributes:
        horizontal: angle of its first half [degrees].
        intensity: of even angles from -180 to 180 degrees from the nadir, positive towards the first half [cd].
        beam, field: angles [degrees]; None where the plane is dark.
    """

    horizontal: int
    intensity: Float64[Tensor, " angles"]
    beam: float | None
    field: float | None


@dataclass(frozen=True)
class Sheet:
    """A lamp's figures: intensities in candela, flux in lumens, angles in degrees."""

    facts: dict[str, str]
    peak: float
    planes: tuple[Plane, ...]


def sheet(lamp: Luminaire) -> Sheet:
    """Figures of a lamp, and what its file says in words, in the order of telling."""
    profile = lamp.profile
    place = int(profile.intensity.argmax())
    down, turn = divmod(place, len(profile.horizontal))
    at_down, at_turn = (math.degrees(float(one)) for one in (profile.vertical[down], profile.horizontal[turn]))
    peak = float(profile.intensity.max())
    planes = tuple(_plane(lamp, horizontal, at_down) for horizontal in PLANES)
    first, last = (math.degrees(float(profile.vertical[end])) for end in (0, -1))
    figures = {
        "symmetry": lamp.symmetry,
        "vertical angles": f"{len(profile.vertical)}, from {first:g} to {last:g} degrees; 0 is down",
        "horizontal angles": f"{len(profile.horizontal)} once it is whole, from 0 to 360 degrees",
        "peak": f"{peak:.4g} cd at vertical {at_down:g}, horizontal {at_turn:g} degrees"
        if peak
        else "0 cd: it is dark",
        "flux": _flux(lamp),
        "beam angle": _angles([(plane.horizontal, plane.beam) for plane in planes], "half"),
        "field angle": _angles([(plane.horizontal, plane.field) for plane in planes], "a tenth"),
    }
    # What the file says under a figure's name stands beside the figure, in its brackets.
    words = {
        name.lower() if name.lower() not in figures else f"[{name}]": said
        for name, said in lamp.keywords.items()
        if said
    }
    return Sheet(words | figures, peak, planes)


def text(sheet: Sheet, width: int) -> str:
    """The figures for a terminal so many letters wide."""
    names = max(map(len, sheet.facts)) + 2
    lines = []
    for name, said in sheet.facts.items():
        room = max(width - names, 20)
        wrapped = textwrap.wrap(said, room) or [""]
        lines += [name.ljust(names) + wrapped[0], *(" " * names + line for line in wrapped[1:])]
    return "\n".join(line.rstrip() for line in lines)


def _flux(lamp: Luminaire) -> str:
    found = float(flux(lamp.profile))
    if lamp.lumens is None:
        return f"{found:.4g} lm; the file states none, its intensities are absolute"
    if lamp.lumens == 0.0:
        return f"{found:.4g} lm; the file states 0 lm"
    share = found / lamp.lumens
    return f"{found:.4g} lm; the file states {lamp.lumens:.4g} lm of bare lamps, of which this is {share:.1%}"


def _angles(found: list[tuple[int, float | None]], share: str) -> str:
    told = [
        f"{'none, it is dark' if angle is None else f'{angle:.1f} degrees'} in the plane of {horizontal}"
        for horizontal, angle in found
    ]
    return f"{', '.join(told)}; at {share} of the plane's peak"


def _plane(lamp: Luminaire, horizontal: int, peak_angle: float) -> Plane:
    """Plane of a horizontal angle, of a lamp that is brightest at a vertical one [degrees]."""
    angle = torch.linspace(-math.pi, math.pi, STEPS + 1, dtype=torch.float64)
    turn = math.radians(horizontal)
    along = torch.stack([angle.sin() * math.cos(turn), angle.sin() * math.sin(turn), angle.cos()], -1)
    intensity = intensity_towards(lamp.profile, along)
    # Angles from the end of the axis that the light goes to.
    centred = torch.roll(intensity[:-1], STEPS // 2) if peak_angle > 90.0 else intensity[:-1]
    return Plane(horizontal, intensity, *(_width(centred, share) for share in (BEAM, FIELD)))


def _width(intensity: Tensor, share: float) -> float | None:
    """Angle between the outermost of even directions round a circle that have a share of the greatest [degrees]."""
    if float(intensity.max()) <= 0.0:
        return None
    is_bright = intensity >= share * intensity.max()
    if bool(is_bright.all()):
        return 360.0
    bright = is_bright.nonzero()
    return float(bright[-1] - bright[0]) * 360.0 / STEPS
