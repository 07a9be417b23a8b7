"""Rain on a street: what it looks like over its numbers and in a sequence, and whether its drops do as they should.

Counted are the drops alive beside rate × life, those that land below a roof, the length of streaks beside speed ×
exposure, and what a warp of the camera changes. Errors are of every rung against the reference on the examples, and of
tiles that draw few streaks against many on the street.

The sheet: a sequence on top, then wind, a fast camera and a warp, and below it the street with one number changed.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from diffrender.parameters import defaults
from diffrender.weather import rain
from diffrender.weather.rain_drops import Drops, Moment, Rain, alive, enough, falls, living, place, shifted, thrown
from diffrender.weather.rain_landing import NEVER, landing_age
from diffrender.weather.rain_tiles import NEAREST
from experiments import records
from experiments.rain_street import EYE, SHELTER, obstacles, rain_view

RATE = 15000.0  # of the sheet's rain, heavier than the default [1/s]
EXPOSURE = 1.0 / 50.0
FALLING = (1.5e-3, 1200.0)  # radius of a drop [m], and how many real ones each stands for
BEGINS = 10.0  # time of the first picture [s]
BRIGHT = 0.62  # radiance that is shown white
WARP = (14.0, 0.0, 0.0)


@dataclass(frozen=True)
class Panel:
    """A picture of the sheet: what differs from the first."""

    title: str
    changes: Mapping[str, float] = field(default_factory=dict)
    later: float = 0.0  # [s]
    wind: tuple[float, float] = (0.0, 0.0)  # [m/s]
    speed: float = 0.0  # of the camera, ahead [m/s]
    exposure: float = EXPOSURE  # [s]
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of a warp before the picture [m]


PANELS = (
    Panel("sequence: first frame"),
    Panel("1/30 s later", later=1 / 30),
    Panel("2/30 s later", later=2 / 30),
    Panel("3/30 s later", later=3 / 30),
    Panel("4/30 s later", later=4 / 30),
    Panel("5/30 s later", later=5 / 30),
    Panel("wind from the right, 12 m/s", wind=(0.0, 12.0)),
    Panel("camera at 20 m/s ahead", speed=20.0),
    Panel("warped 14 m ahead, drops shifted", move=WARP),
    Panel("exposure of 1/500 s", exposure=1 / 500),
    Panel("PARTICLE_EMIT_RATE 2000", {"particle_emit_rate": 2e3}),
    Panel("EMIT_RADIUS 10", {"emit_radius": 10.0}),
    Panel("EMIT_HEIGHT 8", {"emit_height": 8.0}),
    Panel("EMIT_SPEED 5, SPEEDRANDOM 0", {"emit_speed": 5.0, "emit_speedrandom": 0.0}),
    Panel("EMIT_SPEEDRANDOM 150", {"emit_speedrandom": 150.0}),
    Panel("EMIT_SPREAD 0.3", {"emit_spread": 0.3}),
    Panel("LIFE_SPAN 1: few arrive", {"life_span": 1.0}),
    Panel("GRAVITY 100", {"gravity": 100.0}),
    Panel("DEPTH_MAP_RADIUS 12: no houses", {"depth_map_radius": 12.0}),
    Panel("rung: hard"),
    Panel("rung: skip"),
)


def rain_of(changes: Mapping[str, float]) -> Rain:
    """Rain of the sheet with some numbers changed."""
    whole: Mapping[str, float] = {"particle_emit_rate": RATE, **changes}
    return replace(defaults(Rain), **{name: torch.tensor(value) for name, value in whole.items()})


def dice(some_rain: Rain) -> Drops:
    """As many drops as the rain needs."""
    return thrown(int(enough(some_rain)), torch.Generator().manual_seed(0), torch.float32)


def moment_of(panel: Panel) -> Moment:
    """Camera, time and wind of a panel."""
    eye, move = torch.tensor(EYE), torch.tensor(panel.move)
    return Moment(
        eye=eye + move,
        velocity=torch.tensor([panel.speed, 0.0, 0.0]),
        emitter=shifted(eye, move, torch.tensor(2.0)),
        time=torch.tensor(BEGINS + panel.later),
        exposure=torch.tensor(panel.exposure),
        wind=torch.tensor([*panel.wind, 0.0]),
    )


def drawn(panel: Panel, width: int, height: int) -> Float[Tensor, "h w 3"]:
    """Picture of a panel."""
    some_rain = rain_of(panel.changes)
    view = rain_view(some_rain, dice(some_rain), (width, height), moment_of(panel), FALLING)
    rung = panel.title.removeprefix("rung: ")
    return rain.EFFECT.rungs.get(rung, rain.EFFECT.rungs["splashes"])(some_rain, view)


def counted() -> dict[str, Any]:
    """Drops alive, within the disc round the camera, beside rate × life: mean over moments, and their spread."""
    some_rain = rain_of({})
    drops = dice(some_rain)
    found = []
    for step in range(12):
        fall = falls(some_rain, drops, moment_of(Panel("", later=0.37 * step, wind=(4.0, 2.0))))
        far = torch.linalg.vector_norm(place(fall, fall.age)[:, :2], dim=-1)
        found.append(float((living(some_rain, drops) * (far < some_rain.emit_radius)).double().sum()))
    counts = torch.tensor(found)
    return {"expected": float(alive(some_rain)), "mean": float(counts.mean()), "deviation": float(counts.std())}


def sheltered(wind: float) -> dict[str, Any]:
    """Of drops that land on the shelter and below it, how many do so below its roof."""
    some_rain = rain_of({})
    moment = moment_of(Panel("", wind=(0.0, wind)))
    ground = obstacles(some_rain.depth_map_radius)
    fall = falls(some_rain, dice(some_rain), moment)
    there = place(fall, landing_age(some_rain, fall, ground, moment.eye)) + moment.eye
    # Half a cell of the map from its edge.
    cell = 2.0 * float(some_rain.depth_map_radius) / len(ground.heights)
    low, high = (there.new_tensor(corner[:2]) for corner in (SHELTER.low, SHELTER.high))
    inside = ((there[:, :2] > low + cell) & (there[:, :2] < high - cell)).all(-1)
    below = inside & (there[:, 2] < SHELTER.low[2])
    return {"wind": wind, "over_the_shelter": int(inside.sum()), "below_the_roof": int(below.sum())}


def streak_length() -> dict[str, Any]:
    """Mean length of streaks in the air, beside the speed that gravity gives × exposure [m]."""
    some_rain, moment = rain_of({}), moment_of(Panel(""))
    view = rain_view(some_rain, dice(some_rain), (4, 3), moment, FALLING)
    fall = falls(some_rain, view.drops, moment)
    whole = fall.age > EXPOSURE
    way = rain.falling(fall, view, torch.full_like(fall.age, NEVER)).way[whole]
    fallen = some_rain.emit_height + EYE[2] - (place(fall, fall.age - 0.5 * EXPOSURE)[whole][:, 2] + EYE[2])
    # By energy: what a drop has lost in height it has gained in half the square of its speed.
    speed = torch.sqrt(fall.velocity[whole].square().sum(-1) + 2.0 * some_rain.gravity * fallen)
    return {"mean": float(torch.linalg.vector_norm(way, dim=-1).mean()), "expected": float(EXPOSURE * speed.mean())}


def warped(width: int, height: int) -> dict[str, Any]:
    """Largest change of what rain hides when camera and drops warp over even ground, and when drops stay behind."""
    some_rain = rain_of({})
    view = rain_view(some_rain, dice(some_rain), (width, height), moment_of(Panel("")), FALLING)
    even = replace(view.obstacles, heights=torch.zeros_like(view.obstacles.heights))
    view, move = replace(view, obstacles=even), torch.tensor([64.0, -32.0, 0.0])
    moved = replace(
        view,
        moment=replace(view.moment, eye=view.moment.eye + move),
        obstacles=replace(even, body=even.body + move),
    )
    shift = shifted(view.moment.emitter, move, torch.tensor(2.0))
    after = replace(moved, moment=replace(moved.moment, emitter=shift))
    before, with_shift, without = (rain.render(some_rain, one) for one in (view, after, moved))
    return {
        "shifted": float((with_shift - before).abs().max()),
        "left_behind": float((without - before).abs().max()),
    }


def errors(width: int, height: int) -> dict[str, Any]:
    """Errors of the rungs on the examples, in what rain changes at most, and of tiles with fewer streaks."""
    plain, examples = defaults(Rain, torch.float64), rain.EFFECT.example_inputs(torch.float64)
    wanted = rain.EFFECT.reference(plain, examples)
    change = (wanted - examples.background).abs().max()
    of_rungs = {
        name: float((rung(plain, examples) - wanted).abs().max() / change) for name, rung in rain.EFFECT.rungs.items()
    }
    some_rain = rain_of({})
    view = rain_view(some_rain, dice(some_rain), (width, height), moment_of(Panel("")), FALLING)
    many = rain.render(some_rain, view, nearest=4 * NEAREST)
    apart = (rain.render(some_rain, view) - many).abs()
    brightest = (many - view.background).abs().max()
    of_tiles = {"largest": float(apart.max() / brightest), "mean": float(apart.mean() / brightest)}
    return {"rungs": of_rungs, "tiles": of_tiles}


def draw(path: Path, panels: Sequence[Panel], width: int, height: int) -> None:
    """Write the sheet as PNG."""
    columns = 3
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(4.3 * columns, 2.65 * rows), layout="constrained")
    for axes, panel in zip(figure.subplots(rows, columns, squeeze=False).flat, panels, strict=False):
        shown = (drawn(panel, width, height) / BRIGHT).clamp(0.0, 1.0) ** (1.0 / 2.2)
        axes.imshow(shown.numpy(), interpolation="nearest")
        axes.set_title(panel.title, fontsize="small")
        axes.set_axis_off()
    figure.savefig(path, dpi=92)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the figures, and draw the sheet."""
    parser = argparse.ArgumentParser(description="looks and figures of rain")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    full = given.size == "full"
    size = (384, 216) if full else (16, 9)
    content = {
        "alive": counted(),
        "sheltered": [sheltered(wind) for wind in (0.0, 12.0)],
        "streak_length": streak_length(),
        "warp": warped(*size),
        "errors": errors(*size),
    }
    for name, found in content.items():
        print(f"{name}: {found}")
    records.write(given.out / "rain.json", content)
    draw(given.out / "rain.png", PANELS if full else PANELS[:3], *size)


if __name__ == "__main__":
    main()
