"""Falling drops round a camera: the nine numbers of Final Fantasy XV's weather files, and where every drop is when.

The talk [1] shows the numbers, and no formula. What they mean here is ours: a flat disc of EMIT_RADIUS, EMIT_HEIGHT
over the camera, lets PARTICLE_EMIT_RATE drops fall in a second. Each leaves downwards at EMIT_SPEED and up to
EMIT_SPEEDRANDOM more, sideways at up to EMIT_SPREAD of that, is drawn down by GRAVITY and sideways by the wind at once,
without drag, and is forgotten after LIFE_SPAN. Real rain falls at 2 to 9 m/s, the talk's at 40 to 80: its streaks are
as long as those of an exposure several times longer.

Nothing is simulated. A drop's place is a closed form of its dice, the time and the camera, so that any picture may be
drawn without those before. Drops stand still in the world: sideways they repeat every 2 EMIT_RADIUS, and those of the
square round the camera are drawn, fainter towards the edge of the disc. Each lives again and again, at another place.

A drop has a rank: it lives fully where three quarters of the number alive, rate × life, exceed the rank, and not where
five quarters do not, with a linear share between. All shares together are the number alive. Drops that have landed
count among it.

Gradient: exact in all numbers, time, wind and camera while no drop begins anew, wraps round, or reaches either end of
its share. That by the rate is the picture of the drops whose shares change, half as many as live.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slides "Rain", "Rain:
    Problems" and "Weather System".
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import smooth_rise
from diffrender.parameters import parameter, record

_EDGE = 0.2  # outer part of the disc over which drops fade [of its radius]
_DISC = math.pi / 4.0  # share of the square that the disc covers
# How far each die moves on from life to life: fractions of roots of primes, so that no drop soon repeats itself.
_MOVES = (0.41421356, 0.73205081, 0.23606798, 0.64575131, 0.31662479)


@record
class Rain:
    """Rain, by the names of the talk; defaults are its numbers but for the rate, which is 0 there [1]."""

    particle_emit_rate: Float[Tensor, ""] = parameter(
        4000.0, bounds=(0.0, 1e5), unit="1/s", about="drops that leave the disc: turned up, denser rain; 0 is none"
    )
    depth_map_radius: Float[Tensor, ""] = parameter(
        100.0, bounds=(1.0, 1e3), unit="m", scale="log",
        about="half the side of the square whose heights are known from above: beyond it, those of its border",
    )  # fmt: skip
    emit_radius: Float[Tensor, ""] = parameter(
        30.0, bounds=(1.0, 300.0), unit="m", scale="log", about="of the disc: turned up, as many drops spread wider"
    )
    emit_height: Float[Tensor, ""] = parameter(
        50.0, bounds=(0.0, 500.0), unit="m", about="of the disc over the camera: turned up, drops arrive faster"
    )
    emit_speed: Float[Tensor, ""] = parameter(
        40.0, bounds=(0.0, 200.0), unit="m/s", about="of drops that leave the disc: turned up, longer streaks"
    )
    emit_speedrandom: Float[Tensor, ""] = parameter(
        10.0,
        bounds=(0.0, 200.0),
        unit="m/s",
        about="by how much the fastest drop leaves faster: streaks of all lengths",
    )
    emit_spread: Float[Tensor, ""] = parameter(
        0.003, bounds=(0.0, 1.0), unit="1",
        about="sideways speed of a drop, at most, as a share of its speed: turned up, streaks cross",
    )  # fmt: skip
    life_span: Float[Tensor, ""] = parameter(
        3.0, bounds=(0.1, 30.0), unit="s", scale="log", about="of a drop: too short, and none arrives"
    )
    gravity: Float[Tensor, ""] = parameter(
        10.0,
        bounds=(0.0, 100.0),
        unit="m/s^2",
        about="of drops and of what splashes: turned up, streaks grow downwards",
    )


@record
class Drops:
    """Dice of drops, uniform in [0, 1) - when, place on the disc (2), speed, side, how far to that side - and ranks."""

    chance: Float[Tensor, "drops 6"]
    rank: Float[Tensor, " drops"]  # half a drop for the first, one more for each other


@record
class Moment:
    """Camera, time and wind of a picture."""

    eye: Float[Tensor, "*batch 3"]  # when the shutter closes [m]
    velocity: Float[Tensor, "*#batch 3"]  # of the eye [m/s]
    emitter: Float[Tensor, "*#batch 3"]  # what the disc stands over and drops count from: see `shifted` [m]
    time: Float[Tensor, "*#batch"]  # when the shutter closes [s]
    exposure: Float[Tensor, "*#batch"]  # how long it was open [s]
    wind: Float[Tensor, "*#batch 3"]  # velocity; its upward part moves no drop [m/s]


@record
class Falls:
    """Paths of drops, relative to the eye as the shutter closes: straight but for gravity."""

    start: Float[Tensor, "*batch drops 3"]  # [m]
    velocity: Float[Tensor, "*batch drops 3"]  # at the start [m/s]
    age: Float[Tensor, "*batch drops"]  # as the shutter closes [s]
    weight: Float[Tensor, "*batch drops"]  # share of the drop that is there, in [0, 1]
    gravity: Float[Tensor, ""]  # [m/s^2]


def thrown(count: int, generator: torch.Generator, dtype: torch.dtype) -> Drops:
    """So many drops. Of rain with more than four fifths of them alive some are missing: see `enough`."""
    chance = torch.rand(count, len(_MOVES) + 1, generator=generator, dtype=dtype, device=generator.device)
    return Drops(chance, torch.arange(count, device=generator.device).to(chance) + 0.5)


def enough(rain: Rain) -> Float[Tensor, ""]:
    """Number of drops that rain needs to be drawn whole.

    >>> from diffrender.parameters import defaults
    >>> enough(defaults(Rain))
    tensor(19100.)
    """
    return torch.ceil(1.25 * _in_square(rain) + 1.0)


def alive(rain: Rain) -> Float[Tensor, ""]:
    """Number of drops that live at any time over or under the disc, landed ones too."""
    return rain.particle_emit_rate * rain.life_span


def living(rain: Rain, drops: Drops) -> Float[Tensor, " drops"]:
    """Share of each drop of the square that lives, by its rank."""
    number = _in_square(rain)
    # One drop more keeps the division finite where there is none.
    return torch.clamp(0.5 + (number - drops.rank) / (0.5 * number + 1.0), 0.0, 1.0)


def shifted(
    emitter: Float[Tensor, "*#batch 3"], move: Float[Tensor, "*batch 3"], farthest: Float[Tensor, ""]
) -> Float[Tensor, "*batch 3"]:
    """What the disc stands over, after the eye has moved [m]: itself, or moved along where the eye warped.

    A move longer than `farthest` is a warp: all drops move by it, so that the picture stays the same [1].

    Gradient: of the warp, exact; whether it is one is not differentiated.

    >>> still = torch.zeros(3)
    >>> shifted(still, torch.tensor([[0.3, 0.0, 0.0], [50.0, 0.0, 4.0]]), torch.tensor(5.0))
    tensor([[ 0.,  0.,  0.],
            [50.,  0.,  4.]])
    """
    is_warp = torch.linalg.vector_norm(move, dim=-1, keepdim=True) > farthest
    return torch.where(is_warp, emitter + move, emitter + torch.zeros_like(move))


def falls(rain: Rain, drops: Drops, moment: Moment) -> Falls:
    """Where drops fall."""
    when = moment.time[..., None]
    began, lives = drops.chance[:, 0], when / rain.life_span + drops.chance[:, 0]
    life = lives.detach().floor()
    age = (when + (began - life) * rain.life_span).clamp(min=0.0)
    # In double precision, for after many lives float32 would hold the sum, and so the place, to a millimetre only.
    moves = torch.tensor(_MOVES, dtype=torch.float64, device=life.device)
    dice = drops.chance[:, 1:] + (life[..., None].double() * moves % 1.0).to(drops.chance)
    x, y, faster, side, aside = (dice - dice.detach().floor()).unbind(-1)

    speed = rain.emit_speed + rain.emit_speedrandom * faster
    # The root spreads drops evenly over the cone's base.
    sideways = rain.emit_spread * torch.sqrt(aside) * speed
    wind, turn = moment.wind[..., None, :2], 2.0 * math.pi * side
    along = torch.stack([torch.cos(turn), torch.sin(turn)], -1) * sideways[..., None] + wind

    from_eye = (moment.emitter - moment.eye)[..., None, :]
    square = 2.0 * rain.emit_radius
    now = square * (torch.stack([x, y], -1) - 0.5) + along * age[..., None] + from_eye[..., :2]
    now = now - square * torch.round((now / square).detach())
    height = from_eye[..., 2:] + rain.emit_height
    start = now - along * age[..., None]
    down = -speed[..., None]
    return Falls(
        start=torch.cat([start, height.expand_as(start[..., :1])], -1),
        velocity=torch.cat([along, down.expand_as(along[..., :1])], -1),
        age=age,
        weight=living(rain, drops) * _in_disc(rain, now),
        gravity=rain.gravity,
    )


def place(fall: Falls, age: Float[Tensor, "*batch drops"]) -> Float[Tensor, "*batch drops 3"]:
    """Where drops of an age are, relative to the eye as the shutter closes [m]."""
    down = 0.5 * fall.gravity * age * age
    straight = fall.start + fall.velocity * age[..., None]
    return torch.cat([straight[..., :2], straight[..., 2:] - down[..., None]], -1)


def _in_square(rain: Rain) -> Tensor:
    return alive(rain) / _DISC


def _in_disc(rain: Rain, now: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch"]:
    """1 in the middle of the disc, 0 beyond it; without a kink, for drops that wrap round must not be seen to."""
    inside = rain.emit_radius - torch.linalg.vector_norm(now, dim=-1)
    return smooth_rise(inside, _EDGE * rain.emit_radius)
