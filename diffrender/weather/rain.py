"""Rain: streaks of drops that fall round the camera, and crowns where they splash [1].

`rain_drops` says where drops are, `rain_landing` where they land, `rain_splashes` what leaps from there, `rain_streaks`
what all of it hides of a pixel and `rain_tiles` of a picture. A drop is a streak for as long as the shutter was open
and it had not landed. All drops of a pixel send on the same light, so that their order does not matter: a drop shows
nearly all that is round it, and hides what is behind it. Drops land on characters as they do on the ground.

Not drawn: water that runs down what was hit, rings on puddles, the veil of rain further away than the disc (a fog does
that), and the end of a life whose slot begins anew while the shutter is open.

Gradient: exact in all numbers and inputs, but for what `rain_drops`, `rain_landing` and `rain_tiles` say is decided.
"hard" decides moreover whether a drop has landed, by the height under the place it is at; "soft" lets it fade over
`FADING`; "splashes" needs neither, because a streak ends where its drop landed. By an exposure of 0 there is none.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slides "Rain" and "Rain:
    Problems".
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.weather.rain_drops import Falls, Rain, alive, falls, place
from diffrender.weather.rain_examples import example_inputs
from diffrender.weather.rain_landing import height_under, landing_age, level_share
from diffrender.weather.rain_reference import instants
from diffrender.weather.rain_splashes import SPLASH, leaps, shrunk, sides
from diffrender.weather.rain_streaks import Streaks
from diffrender.weather.rain_tiles import NEAREST, unhidden
from diffrender.weather.rain_view import RainView

FADING = 0.1  # height over which a soft drop fades where it lands [m]

Share = Callable[[Tensor], Tensor]  # height of drops over what is under them [m] -> share of them that is drawn


def render(rain: Rain, view: RainView, nearest: int = NEAREST) -> Float[Tensor, "*batch height width 3"]:
    """Radiance behind and of the rain [W/(m² sr)]: streaks that end where drops land, and their splashes."""
    fall = falls(rain, view.drops, view.moment)
    landed = landing_age(rain, fall, view.obstacles, view.moment.eye)
    drops, droplets = falling(fall, view, landed), splashing(rain, fall, view, landed)
    every = Streaks(
        start=torch.cat([drops.start, droplets.start], -2),
        way=torch.cat([drops.way, droplets.way], -2),
        radius=torch.cat([drops.radius, droplets.radius], -1),
        weight=torch.cat([drops.weight, droplets.weight], -1),
        number=view.drop_number,
    )
    return _lit(view, unhidden(every, view.screen, nearest))


def render_streaks(rain: Rain, view: RainView, share: Share) -> Float[Tensor, "*batch height width 3"]:
    """The same without splashes and bodies, each streak as a whole by its drop's height over the map under it."""
    fall = falls(rain, view.drops, view.moment)
    now = place(fall, fall.age)
    over = now[..., 2] - height_under(rain, view.obstacles, view.moment.eye, now)
    whole = falling(fall, view, fall.age)
    drawn = replace(whole, weight=whole.weight * share(over))
    return _lit(view, unhidden(drawn, view.screen))


def hard(over: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """All of a drop from the ground up, nothing below."""
    return (over >= 0.0).to(over)


def soft(over: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """All of a drop far over the ground, half where it lands, nothing far below."""
    return torch.sigmoid(over / FADING)


def skip(rain: Rain, view: RainView) -> Float[Tensor, "*batch height width 3"]:
    """No rain: the background."""
    return view.background + torch.zeros_like(view.background) * rain.gravity


def falling(fall: Falls, view: RainView, landed: Float[Tensor, "*batch drops"]) -> Streaks:
    """Streaks of drops up to the age at which they land."""
    exposure = view.moment.exposure[..., None]
    opened = torch.clamp(fall.age - exposure, min=0.0)
    closed = torch.maximum(torch.minimum(fall.age, landed), opened)
    eye, lasted = view.moment.velocity[..., None, :], closed - opened
    start = place(fall, opened) + eye * (fall.age - opened)[..., None]
    # Not a difference of places, whose rounding is longer than the streaks of a drop at rest.
    way = lasted[..., None] * (fall.velocity - _down(fall.gravity * 0.5 * (opened + closed)) - eye)
    weight = fall.weight * _exposed(lasted, exposure, fall.age <= landed)
    radius = view.drop_radius[..., None].expand_as(weight)
    return Streaks(start, way, radius, weight, view.drop_number)


def splashing(rain: Rain, fall: Falls, view: RainView, landed: Float[Tensor, "*batch drops"]) -> Streaks:
    """Streaks of the droplets of all drops that have landed where it is not steep."""
    exposure = view.moment.exposure[..., None]
    here = torch.minimum(landed, fall.age)
    ground = place(fall, here)
    opened = torch.maximum(here, fall.age - exposure)
    closed = torch.maximum(torch.minimum(fall.age, here + SPLASH), opened)
    is_there = (fall.age > landed) & (fall.age <= landed + SPLASH)
    level = level_share(rain, view.obstacles, view.moment.eye, ground)
    rim, leap = view.drop_radius[..., None, None, None] * sides(view.drops), leaps(view.drops)
    eye, lasted = view.moment.velocity[..., None, :], closed - opened
    since, half = opened - here, 0.5 * (opened + closed) - here
    moved = ground - _down(0.5 * fall.gravity * since * since) + eye * (fall.age - opened)[..., None]
    start = moved[..., None, :] + rim + leap * since[..., None, None]
    way = lasted[..., None, None] * (leap - (_down(fall.gravity * half) + eye)[..., None, :])
    weight = fall.weight * level * _exposed(lasted, exposure, is_there)
    radius = view.drop_radius[..., None] * shrunk(half)
    radius, weight = (one[..., None].expand(start.shape[:-1]).flatten(-2) for one in (radius, weight))
    return Streaks(start.flatten(-3, -2), way.flatten(-3, -2), radius, weight, view.drop_number)


def _down(size: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
    return torch.stack([torch.zeros_like(size), torch.zeros_like(size), size], -1)


def _exposed(lasted: Tensor, exposure: Tensor, is_there: Tensor) -> Tensor:
    """Share of an exposure that something lasted; of none, whether it was there."""
    none = exposure <= 0.0
    share = lasted / torch.where(none, torch.ones_like(exposure), exposure)
    return torch.where(none, is_there.to(share), share)


def _lit(view: RainView, passed: Float[Tensor, "*batch height width"]) -> Float[Tensor, "*batch height width 3"]:
    return torch.lerp(view.light.expand_as(view.background), view.background, passed[..., None])


def largest_change(rain: Rain, view: RainView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) of any pixel [W/(m² sr)]: all of its light is replaced; nothing where none lives."""
    return (view.light - view.background).abs().amax() * (alive(rain) > 0.0)


EFFECT = Effect(
    parameters=Rain,
    prefix="RAIN",
    rungs={
        "skip": Rung(skip),
        "hard": Rung(partial(render_streaks, share=hard)),
        "soft": Rung(partial(render_streaks, share=soft)),
        "splashes": Rung(render),
    },
    reference=instants,
    # In part the reference's own, of 16 instants; the rest of a streak that is seen nearly along its way, from very
    # uneven distances. Up to 0.08 where a drop and the droplets of its own young crown hide each other.
    tolerance=0.03,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
