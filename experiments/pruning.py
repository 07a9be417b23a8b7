"""What pruning leaves of scenes, how far that is from the whole, and what it costs beside code written for it by hand.

Each scene has a tolerance, as a share of the largest value of its whole picture, and a minimum: the least code that
draws it within that tolerance, written here by hand without looking at a catalogue or a list of rungs. Whole, pruned
and minimum take turns on one thread, in processor time.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import celestial, sky
from diffrender.parameters import defaults
from diffrender.rays import Camera, Equirectangular, Perspective
from diffrender.scene import Choice, Exposure, Scene, finest, prune, render, sky_view, sun_view
from experiments import effect_pictures, effects, plots, records
from experiments.timing import Spread, in_turn, one_thread, ratio, seconds_of

SIZE, ROUNDS = (96, 48), 5
SMALL_SIZE, SMALL_ROUNDS = (16, 8), 1
DEAREST = 1.05  # pruned over minimum

Minimum = Callable[[Scene, Float[Tensor, "*batch 3"]], Float[Tensor, "*batch 3"]]


@dataclass(frozen=True)
class Task:
    """A scene by its sun [degrees] and overcast share, a camera by its size, a tolerance, and the minimum."""

    elevation: float
    overcast: float
    camera: Callable[[int, int], Camera]
    tolerance: float
    minimum: Minimum

    def scene(self) -> Scene:
        """The scene in float32."""
        sun, air = defaults(celestial.Sun), defaults(sky.Sky)
        return Scene(
            exposure=defaults(Exposure),
            sun=replace(sun, elevation=torch.tensor(math.radians(self.elevation))),
            sky=replace(air, overcast=torch.tensor(self.overcast)),
        )


@dataclass(frozen=True)
class Pruning:
    """What was left of a scene.

    Attributes:
        tolerance: largest change allowed in any pixel and channel [exposed radiance], as is `error`.
        to_minimum: times of the minimum that the pruned scene takes.
        to_whole: times of the pruned scene that the whole one takes.
    """

    scene: str
    choices: tuple[Choice, ...]
    tolerance: float
    error: float
    whole: Spread
    pruned: Spread
    minimum: Spread
    to_minimum: Spread
    to_whole: Spread


def _nothing(_scene: Scene, direction: Tensor) -> Tensor:
    return torch.zeros_like(direction)


def _marched(scene: Scene, direction: Tensor) -> Tensor:
    assert scene.sky is not None  # every task has one
    return sky.render(scene.sky, sky.prepare_march(scene.sky, sky_view(scene, direction)))


def _tabled(scene: Scene, direction: Tensor) -> Tensor:
    assert scene.sky is not None
    return sky.render_tables(scene.sky, sky.prepare(scene.sky, sky_view(scene, direction)))


def _tabled_with_disc(scene: Scene, direction: Tensor) -> Tensor:
    sun = celestial.pre_exposed(scene.sun, scene.exposure.exposure)
    return _tabled(scene, direction) + celestial.render(sun, sun_view(scene, direction))


def _disc(scene: Scene, direction: Tensor) -> Tensor:
    sun = celestial.pre_exposed(scene.sun, scene.exposure.exposure)
    return celestial.render(sun, sun_view(scene, direction))


def _upper_half(width: int, height: int) -> Camera:
    return Equirectangular(width, height, lowest=0.0)


def _at_sun(width: int, height: int) -> Camera:
    return Perspective(width, height, field_of_view=0.05, pitch=math.radians(20.0))


def _at_zenith(width: int, height: int) -> Camera:
    return Perspective(width, height, field_of_view=1.0, pitch=math.radians(90.0))


TASKS = {
    "night": Task(-40.0, 0.0, _upper_half, 0.0, _nothing),
    "no sun in view, exactly": Task(20.0, 0.0, _at_zenith, 0.0, _marched),
    "no sun in view, to 5 %": Task(20.0, 0.0, _at_zenith, 0.05, _tabled),
    "twilight, to 5 %": Task(-4.0, 0.0, _upper_half, 0.05, _tabled),
    "overcast, to 5 %": Task(50.0, 1.0, _upper_half, 0.05, _tabled),
    "sun in view, to a millionth": Task(20.0, 0.0, _at_sun, 1e-6, _tabled_with_disc),
    "sun in view, to 1 %": Task(20.0, 0.0, _at_sun, 0.01, _disc),
}


def pruning(name: str, size: tuple[int, int], rounds: int) -> Pruning:
    """What is left of one scene."""
    task = TASKS[name]
    scene, direction = task.scene(), effect_pictures.directions(task.camera(*size)).float()
    whole = render(scene, direction, finest())
    tolerance = task.tolerance * float(whole.max())
    pruned = prune(scene, direction, tolerance)
    timed = in_turn(
        {
            "minimum": partial(seconds_of, partial(task.minimum, scene, direction)),
            "pruned": partial(seconds_of, partial(render, scene, direction, pruned.renderers)),
            "whole": partial(seconds_of, partial(render, scene, direction, finest())),
        },
        rounds,
    )
    return Pruning(
        scene=name,
        choices=pruned.choices,
        tolerance=tolerance,
        error=float((render(scene, direction, pruned.renderers) - whole).abs().max()),
        to_minimum=ratio(timed["pruned"], timed["minimum"]),
        to_whole=ratio(timed["whole"], timed["pruned"]),
        **timed,
    )


def table(found: Sequence[Pruning]) -> str:
    """Text of the table, and of the reasons under it."""
    head = ["scene", "drawn by", "tolerance", "error", "pruned ms", "over minimum", "whole over pruned"]
    lines = [
        [
            one.scene,
            ", ".join(choice.rung for choice in one.choices if choice.rung != "skip") or "nothing",
            *(f"{value:.2g}" for value in (one.tolerance, one.error, 1e3 * one.pruned.median)),
            str(one.to_minimum),
            str(one.to_whole),
        ]
        for one in found
    ]
    why = [f"{one.scene}: {c.effect} by {c.rung}: {c.reason}" for one in found for c in one.choices]
    return "\n".join([records.table(head, lines), "", *why])


@torch.no_grad()
@one_thread()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it as JSON and as a bar chart."""
    given = effects.ask("what pruning leaves of scenes", arguments, TASKS)
    size, rounds = (SMALL_SIZE, SMALL_ROUNDS) if given.is_small else (SIZE, ROUNDS)
    found = [pruning(name, size, rounds) for name in given.names]
    print(table(found))
    written = given.out / "pruning.json"
    content = {"size": size, "dearest": DEAREST, "records": [asdict(one) for one in found]}
    records.write(written, content, threads=1)
    plots.pruning(written)


if __name__ == "__main__":
    main()
