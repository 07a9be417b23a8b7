"""The far fog of Final Fantasy XV's weather files: fog between two distances, in the thirteen numbers of the talk [1].

The talk shows the numbers, one column for each hour, and no formula. What they mean here is ours, so chosen that its
own columns are fog that one can look at. An extinction [1/m] times a thickness [m] is an optical depth: 2 by night in
the talk's file and 2.5 by day, though either factor changes thousandfold. So a level ray at the standard height
gathers that depth on its way from ZNEAR to ZFAR, however far apart they are, but for what the decays take away:

    density = THICKNESS EXTINCTION / (ZFAR - ZNEAR) exp(-DISTANCE_DECAY (distance - ZNEAR))
              × exp(-HEIGHT_DECAY rise) above the standard height, exp(-DEPTH_DECAY drop) below it

A drop ends at the bottom height, under which the fog is even. Files count all three decays over 100 m: at the talk's
0.3, 0.02 and 0.3 the fog thins e-fold in 333 m of height and in 5 km of distance. The two heights are altitudes, or at
a PLAYER_RELATIVE of 1 heights over the player. Where ZNEAR reaches ZFAR the fog is a curtain at ZNEAR. TINT colours the
light that is sent on, whatever its angle: fog of this kind has no glow round the sun.

Both decays with height end where the other begins, so that the density is continuous and every ray is at most three
exponentials, each with its closed form. The ground under a ray is flat; no shadows, no light scattered twice.

Gradient: exact in every parameter and input; of what lies exactly at the standard or the bottom height, at ZNEAR or at
ZFAR, that to one side or a mean of both. A curtain has none in ZNEAR, ZFAR and distance. Second derivatives miss what
comes from the places where a ray crosses the two heights.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Weather System".
"""

import math
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.numerics import decayed_between, decayed_length, opacity
from diffrender.parameters import parameter, record
from diffrender.rays import Rays, from_angles

OPAQUE = 1e4  # optical depth from which on nothing is seen
_FARTHEST = 1e9  # length of rays into the sky, which may be given as infinite [m]
_PER_HUNDRED_METRES = ("1/(100 m)", 100.0)
_LEVEL = 1e-30  # climb of a level ray, which meets no height but the one that it runs at


@record
class FarFog:
    """The far fog of a whole scene, by the names of the talk; defaults are those of its midnight [1]."""

    thickness: Float[Tensor, ""] = parameter(
        2000.0, bounds=(1e-2, 1e5), unit="m", scale="log",
        about="length of dense fog that is spread from ZNEAR to ZFAR: turned up, less shines through",
    )  # fmt: skip
    znear: Float[Tensor, ""] = parameter(
        200.0, bounds=(0.0, 1e4), unit="m", about="distance where the fog begins: turned up, the near stays clear"
    )
    zfar: Float[Tensor, ""] = parameter(
        8000.0, bounds=(1.0, 1e5), unit="m", scale="log",
        about="distance where the fog ends, the same fog spread further: turned up, it comes on more slowly",
    )  # fmt: skip
    height_decay: Float[Tensor, ""] = parameter(
        0.003, bounds=(0.0, 0.1), unit="1/m", in_files=_PER_HUNDRED_METRES,
        about="how fast the fog thins above the standard height: turned up, a sharper top",
    )  # fmt: skip
    distance_decay: Float[Tensor, ""] = parameter(
        0.0002, bounds=(0.0, 0.1), unit="1/m", in_files=_PER_HUNDRED_METRES,
        about="how fast it thins beyond ZNEAR: turned up, less fog, and what is left of it nearer",
    )  # fmt: skip
    depth_decay: Float[Tensor, ""] = parameter(
        0.003, bounds=(0.0, 0.1), unit="1/m", in_files=_PER_HUNDRED_METRES,
        about="how fast it thins below the standard height: turned up, a layer that floats",
    )  # fmt: skip
    extinction: Float[Tensor, ""] = parameter(
        0.001, bounds=(1e-6, 1e2), unit="1/m", scale="log", about="of dense fog: turned up, less shines through"
    )
    tint: Float[Tensor, "3"] = parameter(
        (0.5, 0.5, 0.5), bounds=(0.0, 16.0), unit="1", about="share of the light that the fog sends on: its colour"
    )
    standard_height: Float[Tensor, ""] = parameter(
        0.0, bounds=(-1e3, 5e3), unit="m", about="height where the fog is densest: turned up, the layer rises"
    )
    bottom_height: Float[Tensor, ""] = parameter(
        -100.0, bounds=(-1e3, 5e3), unit="m",
        about="height under which it thins no more; the standard height where that is lower",
    )  # fmt: skip
    player_relative: Float[Tensor, ""] = parameter(
        0.0, bounds=(0.0, 1.0), unit="1", about="0: both heights are altitudes, 1: they follow the player"
    )


@record
class FarFogView:
    """What is seen without fog, along which rays, and the light on the fog, exposed already."""

    rays: Rays  # infinite length for the sky
    background: Float[Tensor, "*#batch 3"]  # radiance [W/(m^2 sr)]
    light: Float[Tensor, "*#batch 3"]  # mean radiance that falls on the fog [W/(m^2 sr)]
    player_altitude: Float[Tensor, ""]  # [m]


def render(fog: FarFog, view: FarFogView) -> Float[Tensor, "*batch 3"]:
    """Radiance behind and within the fog [W/(m² sr)], its optical depth in closed form."""
    return _blended(fog, view, optical_depth(fog, view))


def render_ramp(fog: FarFog, view: FarFogView) -> Float[Tensor, "*batch 3"]:
    """The same for fog as dense at every height as at the standard one: one exponential a ray."""
    near, span = _span(fog)
    reached = _reached(view.rays.length, near, span) + torch.zeros_like(view.rays.direction[..., 2])
    even = decayed_length(reached, (span * fog.distance_decay).expand_as(reached))
    return _blended(fog, view, _dimmed(fog, even))


def skip(fog: FarFog, view: FarFogView) -> Float[Tensor, "*batch 3"]:
    """No fog: the background."""
    return view.background + torch.zeros_like(view.rays.direction) * fog.thickness


def _blended(fog: FarFog, view: FarFogView, depth: Tensor) -> Float[Tensor, "*batch 3"]:
    dense = opacity(depth)[..., None]
    return view.background * torch.exp(-depth)[..., None] + fog.tint * view.light * dense


def optical_depth(fog: FarFog, view: FarFogView) -> Float[Tensor, "*batch"]:
    """Optical depth of the fog along rays, alike for all channels; at most 10^4."""
    near, span = _span(fog)
    up = view.rays.direction[..., 2]
    begin = view.rays.origin[..., 2] + up * near
    standard, bottom = _heights(fog, view)
    reached = _reached(view.rays.length, near, span) + torch.zeros_like(begin)
    # Without a gradient: the integral does not change with the place where two densities that are equal meet.
    steep = torch.where(up == 0.0, torch.full_like(up, _LEVEL), up).detach()
    climb = torch.where(span == 0.0, torch.ones_like(span), span).detach() * steep
    to_standard, to_bottom = ((height - begin).detach() / climb for height in (standard, bottom))
    above, below = steep.sign() * math.inf, -steep.sign() * math.inf
    # Of each stretch of heights: where a ray enters and leaves it, the exponent at ZNEAR, and its growth with height.
    stretches = (
        (to_standard, above, fog.height_decay * (begin - standard), fog.height_decay),
        (to_bottom, to_standard, fog.depth_decay * (standard - begin), -fog.depth_decay),
        (below, to_bottom, fog.depth_decay * (standard - bottom), torch.zeros_like(bottom)),
    )
    total = torch.zeros_like(reached)
    for one, other, exponent, growth in stretches:
        first, last = (_between(place, reached) for place in (torch.minimum(one, other), torch.maximum(one, other)))
        rate = (growth * up + fog.distance_decay) * span
        # No fog is denser than at the standard height: below that the stretch is none, and exp() would overflow.
        start, end = (torch.clamp(exponent + rate * place, min=-1.0) for place in (first, last))
        total = total + decayed_between(start, end, last - first, rate)
    return _dimmed(fog, total)


def _between(place: Tensor, reached: Tensor) -> Tensor:
    return torch.minimum(torch.clamp(place, min=0.0), reached)


def _span(fog: FarFog) -> tuple[Tensor, Tensor]:
    """Where the fog begins, and over what distance it spreads; 0 for a curtain."""
    return fog.znear, torch.relu(fog.zfar - fog.znear)


def _reached(length: Tensor, near: Tensor, span: Tensor) -> Tensor:
    """Share of the way from ZNEAR to ZFAR that rays cross; of a curtain all from ZNEAR on."""
    beyond = torch.clamp(length, max=_FARTHEST) - near
    curtain = span == 0.0
    share = torch.clamp(beyond / torch.where(curtain, torch.ones_like(span), span), 0.0, 1.0)
    return torch.where(curtain, (beyond >= 0.0).to(share), share)


def _heights(fog: FarFog, view: FarFogView) -> tuple[Tensor, Tensor]:
    """Altitudes of the densest fog, and of that below which it is even."""
    player = fog.player_relative * view.player_altitude
    return fog.standard_height + player, torch.minimum(fog.bottom_height, fog.standard_height) + player


def _dimmed(fog: FarFog, share: Tensor) -> Tensor:
    return torch.clamp(fog.thickness * fog.extinction * share, max=OPAQUE)


def march(fog: FarFog, view: FarFogView, steps: int) -> Float[Tensor, "*batch 3"]:
    """The same as `render` by the midpoint rule over so many steps."""
    rays = view.rays
    end = torch.maximum(fog.znear, torch.minimum(rays.length, fog.zfar))[..., None]
    distance = fog.znear + (end - fog.znear) * (torch.arange(steps).to(end) + 0.5) / steps
    height = rays.origin[..., 2, None] + rays.direction[..., 2, None] * distance
    height = height - fog.player_relative * view.player_altitude
    rise, bottom = height - fog.standard_height, torch.minimum(fog.bottom_height, fog.standard_height)
    drop = torch.minimum(-rise, fog.standard_height - bottom)
    thinned = fog.height_decay * torch.relu(rise) + fog.depth_decay * torch.relu(drop)
    dense = torch.exp(-thinned - fog.distance_decay * (distance - fog.znear)).mean(-1)
    depth = fog.thickness * fog.extinction * dense * (end[..., 0] - fog.znear) / (fog.zfar - fog.znear)
    passed = torch.exp(-depth)[..., None]
    return view.background * passed + fog.tint * view.light * (1.0 - passed)


def largest_change(fog: FarFog, view: FarFogView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all rays [W/(m² sr)]: as if the fog thinned nowhere."""
    depth = _dimmed(fog, _reached(view.rays.length, *_span(fog)))
    brightest = torch.maximum(view.background.abs(), fog.tint * view.light)
    return (opacity(depth)[..., None] * brightest).amax()


# Eye [m], elevation of the ray [degrees], length [m].
_EXAMPLES = (
    (30.0, 0.0, 7.9e3),
    (30.0, 0.001, 5e3),
    (30.0, -0.001, 5e3),
    (30.0, -1.0, 4e3),  # through the standard height
    (30.0, -2.0, 9e3),  # and the bottom
    (-150.0, 3.0, 1e4),  # through both from below
    (-50.0, 0.0, 3e3),
    (-300.0, -0.5, 7e3),
    (30.0, 10.0, math.inf),
    (30.0, 90.0, math.inf),
    (900.0, -15.0, 3e3),
    (30.0, 0.5, 0.0),
    (30.0, 0.5, 150.0),  # ends before the fog begins
)


def example_inputs(dtype: torch.dtype) -> FarFogView:
    """From below, within and above the fog: level, nearly level, through its heights, to the sky, and of no length."""
    eye, elevation, length = torch.tensor(_EXAMPLES, dtype=torch.float64).unbind(-1)
    origin = torch.stack([torch.zeros_like(eye), torch.zeros_like(eye), eye], -1)
    direction = from_angles(elevation.deg2rad(), torch.zeros_like(elevation))
    shade = torch.linspace(0.02, 0.4, len(_EXAMPLES), dtype=torch.float64)[:, None]
    return FarFogView(
        rays=Rays(origin.to(dtype), direction.to(dtype), length.to(dtype)),
        background=(shade * torch.tensor([0.8, 1.0, 1.2], dtype=torch.float64)).to(dtype),
        light=torch.tensor([0.5, 0.6, 0.8], dtype=dtype),
        player_altitude=torch.tensor(12.0, dtype=dtype),
    )


EFFECT = Effect(
    parameters=FarFog,
    prefix="VOLLIGHT_FARFOG",
    rungs={"skip": Rung(skip), "ramp": Rung(render_ramp), "closed form": Rung(render)},
    reference=partial(march, steps=1000),
    # All of it the reference's, whose steps see the two heights only to their own length.
    tolerance=1e-7,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
