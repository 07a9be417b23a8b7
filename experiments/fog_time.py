"""How long height fog takes over a full picture: beside a copy of as many bytes, beside marches, and on panoramas.

All are ratios within a run; grey fog dims all channels alike, as the default tint does. Pictures are in planes (their
shape ends in the channels, their memory does not), because compiled code is several times slower along an axis of
three. The march is written as well as the closed form: channel by channel, steps exact for their own depth, compiled in
pieces of 16 steps that stay in the processor's registers.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import cycle
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffrender.atmosphere import height_fog
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.numerics import opacity
from diffrender.parameters import defaults
from diffrender.rays import Camera, Equirectangular, Perspective, Rays, from_angles, pixel_centres
from experiments import fit_command, records
from experiments.timing import THREADS, Spread, interleaved

EYE = 30.0  # above flat ground [m]
BAND = 32  # rows of a picture that are drawn at a time
PIECE = 16  # steps of a march that are compiled together
STEPS = (16, 64, 256)
FREE = ("extinction", "extinction_tint", "scale_height", "base_height", "albedo", "asymmetry")  # of the gradient
GREY = tuple(name for name in FREE if name != "extinction_tint")  # of that of grey fog
PANORAMAS = (1024, 2048, 4096, 8192)
SETS = 4  # of inputs in turn: one of 1080p stays in a cache of 105 MB, and a copy of it is then no measure of memory
MEBIBYTE = 2**20

Inputs = tuple[Tensor, Tensor, Tensor]
Draw = Callable[[Tensor, Tensor, Tensor], Tensor]
Render = Callable[[HeightFog, FogView], Tensor]


def planes(picture: Tensor) -> Tensor:
    """The same picture with one plane of memory a channel."""
    return picture.movedim(-1, 0).contiguous().movedim(0, -1)


def seen(camera: Camera, rows: slice) -> tuple[Tensor, Tensor, Tensor]:
    """Directions, distances and background of rows of a camera over flat ground."""
    direction = camera.direction(*pixel_centres(camera, rows, torch.zeros(())))
    down = -direction[..., 2]
    length = torch.where(down > 0.0, EYE / down.clamp(min=1e-6), torch.full_like(down, math.inf))
    return planes(direction), length, planes(0.3 + 0.2 * direction)


def view(direction: Tensor, length: Tensor, background: Tensor) -> FogView:
    """What is seen, under a sun of 12 degrees."""
    to_sun = from_angles(torch.tensor(0.2), torch.tensor(0.5))
    rays = Rays(torch.tensor([0.0, 0.0, EYE]), direction, length)
    return FogView(rays, background, to_sun, torch.tensor([2.4, 1.9, 1.3]), torch.tensor([0.2, 0.27, 0.4]))


def closed_form(render: Render = height_fog.render) -> Draw:
    """A rung's picture of fog that is made beforehand: torch.compile does not look into `defaults`."""
    fog = defaults(HeightFog)
    return lambda direction, length, background: render(fog, view(direction, length, background))


def in_bands(draw: Draw) -> Draw:
    """The same picture, rows by rows, so that what is in between stays in the cache."""

    def banded(direction: Tensor, length: Tensor, background: Tensor) -> Tensor:
        picture = torch.empty_like(background)
        for top in range(0, len(length), BAND):
            rows = slice(top, top + BAND)
            picture[rows] = draw(direction[rows], length[rows], background[rows])
        return picture

    return banded


def in_cache(draw: Draw) -> Draw:
    """As many pixels of the first band of rows, again and again: what arithmetic alone takes, no memory waited for."""

    def repeated(direction: Tensor, length: Tensor, background: Tensor) -> Tensor:
        band = slice(0, BAND)
        for _ in range(0, len(length), BAND):
            picture = draw(direction[band], length[band], background[band])
        return picture

    return repeated


def march(steps: int, compiled: Callable[..., Any]) -> Draw:
    """The same integral by steps of equal length, each exact for its own depth."""
    fog = defaults(HeightFog)

    def piece(up: Tensor, length: Tensor, first: Tensor, state: list[Tensor]) -> list[Tensor]:
        at_eye = view(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(1.0), torch.zeros(3))
        mass = height_fog.air_mass(fog, at_eye.rays, at_eye.to_sun)
        step = length / steps
        depth, light = state[:3], state[3:]
        for number in range(PIECE):
            altitude = EYE + up * step * (first + number + 0.5)
            dense = torch.exp(-altitude / fog.scale_height)
            for channel, extinction in enumerate(height_fog.extinction(fog).unbind()):
                passed = extinction * dense * step
                through = torch.exp(-depth[channel] - extinction * fog.scale_height * mass * dense)
                light[channel] = light[channel] + through * opacity(passed)
                depth[channel] = depth[channel] + passed
        return [*depth, *light]

    def compose(direction: Tensor, length: Tensor, background: Tensor, state: list[Tensor]) -> Tensor:
        at = view(direction, length, background)
        depth, light = (torch.stack(part).movedim(0, -1) for part in (state[:3], state[3:]))
        sun = fog.albedo * at.irradiance * height_fog.phase(fog, at) * light
        return background * torch.exp(-depth) + sun + fog.albedo * at.sky_radiance * opacity(depth)

    fast_piece, fast_compose = compiled(piece), compiled(compose)

    def draw(direction: Tensor, length: Tensor, background: Tensor) -> Tensor:
        reach = torch.clamp(length, max=20.0 * 120.0 / direction[..., 2].abs().clamp(min=1e-3))
        state = [torch.zeros_like(length) for _ in range(6)]
        for first in range(0, steps, PIECE):
            state = fast_piece(direction[..., 2], reach, torch.tensor(float(first)), state)
        picture: Tensor = fast_compose(direction, length, background, state)
        return picture

    return draw


def value_and_gradient(
    compiled: Callable[..., Any], names: Sequence[str] = FREE, render: Render = height_fog.render
) -> Draw:
    """Gradient of a loss of the whole picture by numbers of the fog; the loss is compiled, not the picture."""
    plain = vars(defaults(HeightFog))

    def loss(values: list[Tensor], direction: Tensor, length: Tensor, background: Tensor) -> Tensor:
        fog = HeightFog(**(plain | dict(zip(names, values, strict=True))))
        return (render(fog, view(direction, length, background)) - 0.3).square().mean()

    fast = compiled(loss)

    def gradient(direction: Tensor, length: Tensor, background: Tensor) -> Tensor:
        values = [plain[name].clone().requires_grad_() for name in names]
        found = torch.autograd.grad(fast(values, direction, length, background), values)
        return torch.cat([part.reshape(-1) for part in found])

    return gradient


def gradient_in_bands(direction: Tensor, length: Tensor, background: Tensor) -> Tensor:
    """The same gradient, rows by rows."""
    one = value_and_gradient(as_it_is)
    total = torch.zeros(1)
    for top in range(0, len(length), BAND):
        rows = slice(top, top + BAND)
        share = len(length[rows]) / len(length)
        total = total + share * one(direction[rows], length[rows], background[rows])
    return total


def seconds_of(draw: Draw, inputs: Inputs) -> Callable[[], float]:
    """A clock round one picture, each time of the next of some equal inputs that no cache holds all of."""
    turns = cycle([tuple(part.clone() for part in inputs) for _ in range(SETS)])

    def clock() -> float:
        given = next(turns)
        began = time.perf_counter()
        draw(*given)
        return time.perf_counter() - began

    return clock


def seconds_of_copy(count: int) -> Callable[[], float]:
    """A clock round a copy of so many numbers, from memory to memory likewise."""
    turns = cycle([(torch.rand(count), torch.zeros(count)) for _ in range(SETS)])

    def clock() -> float:
        source, target = next(turns)
        began = time.perf_counter()
        target.copy_(source)
        return time.perf_counter() - began

    return clock


def beside_copy(inputs: Inputs, rounds: int, compiled: Callable[..., Any]) -> list[dict[str, Any]]:
    """Times over that of a copy that moves as many bytes as the picture needs: seven planes in, three out."""
    copied = seconds_of_copy(5 * inputs[1].numel())
    works: dict[str, Draw] = {
        "forward, eager": closed_form(),
        "forward, eager in bands": in_bands(closed_form()),
        "forward, compiled": compiled(closed_form()),
        "forward, compiled, one band in the cache": in_cache(compiled(closed_form())),
        "forward, grey, compiled": compiled(closed_form(height_fog.render_grey)),
        "forward and backward, eager": value_and_gradient(as_it_is),
        "forward and backward, eager in bands": gradient_in_bands,
        "forward and backward, compiled": value_and_gradient(compiled),
        "forward and backward, grey, compiled": value_and_gradient(compiled, GREY, height_fog.render_grey),
    }
    found = []
    for name, work in works.items():
        timed = interleaved(copied, seconds_of(work, inputs), rounds)
        found.append({"work": name, "ratio": asdict(timed.ratio), "fastest": fastest(timed.second, timed.first)})
    return found


def beside_march(inputs: Inputs, rounds: int, compiled: Callable[..., Any]) -> list[dict[str, Any]]:
    """Times of marches over that of the closed form, all compiled, and how far their pictures are from its."""
    closed = compiled(closed_form())
    truth, found = closed(*inputs), []
    for steps in STEPS:
        work = march(steps, compiled)
        error = (work(*inputs) - truth).abs()
        timed = interleaved(seconds_of(closed, inputs), seconds_of(work, inputs), rounds)
        row = {"steps": steps, "ratio": asdict(timed.ratio), "fastest": fastest(timed.second, timed.first)}
        found.append(row | {"largest_error": float(error.max()), "mean_error": float(error.mean())})
    return found


def fastest(one: Spread, other: Spread) -> float:
    """Ratio of the shortest times: what a machine with nothing else to do comes nearest to."""
    return min(one.each) / min(other.each)


def compile_whole(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled without a break."""
    compiled: Callable[..., Any] = torch.compile(function, fullgraph=True, dynamic=False)
    return compiled


def as_it_is(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, not compiled."""
    return function


def panorama(width: int) -> float:
    """Seconds of a panorama drawn band by band, each handed on and forgotten, as a file is written."""
    camera = Equirectangular(width, width // 2)
    draw = closed_form()
    began = time.perf_counter()
    brightest = torch.zeros(())
    for top in range(0, camera.height, BAND):
        rows = slice(top, min(top + BAND, camera.height))
        brightest = torch.maximum(brightest, draw(*seen(camera, rows)).amax())
    assert brightest.isfinite()
    return time.perf_counter() - began


def streamed(widths: Sequence[int]) -> list[dict[str, Any]]:
    """Time per pixel and peak memory of panoramas, each in a process of its own, over those of the smallest."""
    found: list[dict[str, Any]] = []
    for width in widths:
        process = fit_command.run_well([sys.executable, "-m", "experiments.fog_time", "--panorama", str(width)])
        per_pixel = json.loads(process.told) / (width * width / 2)
        row = {"width": width, "seconds_per_pixel": per_pixel, "peak_mebibytes": process.peak_bytes / MEBIBYTE}
        smallest = found[0] if found else row
        row["time_per_pixel_ratio"] = row["seconds_per_pixel"] / smallest["seconds_per_pixel"]
        row["memory_ratio"] = row["peak_mebibytes"] / smallest["peak_mebibytes"]
        found.append(row)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print three tables and write them as JSON."""
    parser = argparse.ArgumentParser(description="time of height fog")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=THREADS)
    parser.add_argument("--panorama", type=int, help="draw one of this width and print its seconds, nothing else")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    if given.panorama is not None:
        print(json.dumps(panorama(given.panorama)))
        return
    torch.set_num_threads(given.threads)
    width, height = (1920, 1080) if given.size == "full" else (64, 36)
    inputs = seen(Perspective(width, height, math.radians(60.0), math.radians(2.0)), slice(0, height))
    # The smallest size compiles nothing: that alone takes a minute.
    compiled = compile_whole if given.size == "full" else as_it_is
    marched = beside_march(inputs, given.rounds, compiled)
    copied = beside_copy(inputs, given.rounds, compiled)
    wide = streamed(PANORAMAS if given.size == "full" else (64, 128))
    print(table(marched, copied, wide))
    content = {"march": marched, "copy": copied, "panoramas": wide, "width": width, "height": height}
    records.write(given.out / "fog_time.json", content | {"threads_used": given.threads})


def table(marched: Sequence[Any], copied: Sequence[Any], wide: Sequence[Any]) -> str:
    """Text of the three tables."""

    def ratios(row: Any) -> list[str]:
        return [f"{row['ratio']['median']:.3g}", f"{row['fastest']:.3g}"]

    return "\n\n".join(
        [
            records.table(
                ("steps of a march, over the closed form", "median", "fastest", "largest error"),
                [[str(row["steps"]), *ratios(row), f"{row['largest_error']:.1e}"] for row in marched],
            ),
            records.table(
                ("over a copy of as many bytes", "median", "fastest"),
                [[row["work"], *ratios(row)] for row in copied],
            ),
            records.table(
                ("panorama", "time per pixel", "memory"),
                [
                    [str(row["width"]), f"{row['time_per_pixel_ratio']:.2f}", f"{row['memory_ratio']:.2f}"]
                    for row in wide
                ],
            ),
        ]
    )


if __name__ == "__main__":
    main()
