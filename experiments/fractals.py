"""Fractals in the sun: pictures, how far their distances can be trusted, and how even directions at random are.

A distance that is more than the way to the surface lets rays pass through it. Of the sponge and of the tetrahedron it
is set beside the least way to any of their pieces, at points all around and inside; of the Mandelbulb, steps as long as
the distance, and as shares of it, go from points outside in directions drawn at random, and those that end inside are
counted. Derivatives of the way to the hit, forward and backward, are set beside differences.

Pictures: the Mandelbulb at rising powers and turning in phase; the sponge and the tetrahedron. And the measured density
of directions in units of an even one, red where denser and blue where less: the blog's, the same weighed, and even
ones, on a sphere whose pole of x shows.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender import sampling
from diffrender.geometry import fractals, fractals_reference
from diffrender.geometry.fractal_shapes import Fractal, Mandelbulb, Menger, Shape, Sierpinski
from diffrender.geometry.fractals import FractalView
from diffrender.geometry.sphere_tracing import within_ball
from diffrender.parameters import defaults
from diffrender.rays import Perspective, Rays, from_angles, pixel_centres
from experiments import fractal_distances, records
from fit import png

GAP = 4  # pixels between panels
COLUMNS = 4
RAYS = 2**14  # at once, so that they stay in the processor's cache
SUN, EYE = (35.0, 265.0), (24.0, 215.0)  # elevation and azimuth [degrees]
STEP, SMOOTH = 1e-6, 1e-9  # of differences that derivatives are set beside, and how far they may bend
TRACED = 48  # steps of rays whose derivatives are judged
SHARES = (1.0, 0.5, 0.25)
CELLS = (24, 48)  # of measured densities, by height along x and round it


@dataclass(frozen=True)
class Size:
    """Pixels of a panel's side, samples along a pixel's, points and rays along a side to judge by, directions drawn."""

    panel: int = 360
    samples: int = 2
    points: int = 20_000
    rays: int = 24
    directions: int = 10_000_000


SMALL = Size(panel=6, samples=1, points=300, rays=6, directions=20_000)


@dataclass(frozen=True)
class Passed:
    """How a distance stands to the truth.

    Attributes:
        share: of points outside from which it is too long.
        most: by how much at most [size]; None where the truth is not known, only whether a step ends inside.
        median: of the distance in the true one.
        wrong_side: share of all points where its sign is not that of the point.
    """

    shape: str
    depth: int
    times: float
    points: int
    share: float
    most: float | None
    median: float | None
    wrong_side: float


@dataclass(frozen=True)
class Slope:
    """Derivatives of the way to a hit by one parameter, over rays: largest differences, in the largest derivative.

    `smooth` are the hits beside which a ray with another parameter meets the same part of the surface.
    """

    shape: str
    parameter: str
    hits: int
    smooth: int
    largest: float
    from_differences: float
    backward_from_forward: float


@dataclass(frozen=True)
class Evenness:
    """Directions: mean square of x, 1/3 if even, and least and greatest density of a cell in an even one."""

    name: str
    count: int
    square_of_x: float
    least: float
    greatest: float


def painted(**changed: float) -> Fractal:
    """A fractal of some values, the others the defaults."""
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in changed.items()}
    return replace(defaults(Fractal, torch.float64), **values)


def passed(points: int) -> Iterator[Passed]:
    """How distances stand to the truth, for all shapes."""
    draw = torch.Generator().manual_seed(0)
    fractal = painted()
    for shape in (Menger(1), Menger(2), Menger(3), Sierpinski(2), Sierpinski(4)):
        place = 3.0 * torch.rand(points, 3, generator=draw, dtype=torch.float64) - 1.5
        found, truth = shape.orbit(fractal, place).distance, fractal_distances.distance(shape, place)
        outside = truth > 0.0
        over = (found - truth)[outside]
        yield Passed(
            type(shape).__name__, shape.iterations, 1.0, points,
            share=float((over > 1e-12).double().mean()), most=max(float(over.max()), 0.0),
            median=float((found / truth)[outside].median()),
            wrong_side=float(((found > 0.0) != outside).double().mean()),
        )  # fmt: skip
    for power, depth in ((2.0, 6), (3.5, 5), (8.0, 3), (8.0, 4), (16.0, 3)):
        yield from _passed_bulb(points, power, Mandelbulb(depth), draw)


def _passed_bulb(points: int, power: float, shape: Mandelbulb, draw: torch.Generator) -> Iterator[Passed]:
    fractal = painted(power=power)
    place = 2.6 * torch.rand(points, 3, generator=draw, dtype=torch.float64) - 1.3
    found = shape.orbit(fractal, place).distance
    outside = ~fractals_reference.holds(shape, fractal, place)
    for times in SHARES:
        ends = fractal_distances.reached(shape, fractal, place[outside], times * found[outside].clamp(min=0.0), draw)
        yield Passed(
            f"Mandelbulb, power {power:g}", shape.iterations, times, int(outside.sum()),
            share=float(ends.double().mean()), most=None, median=None,
            wrong_side=float(((found > 0.0) != outside).double().mean()),
        )  # fmt: skip


def slopes(side: int) -> Iterator[Slope]:
    """Derivatives of the way to the hit beside differences, in float64."""
    rays = camera_rays(side, 45.0, 3.2)
    for shape, names in (
        (Mandelbulb(2), ("power", "phase", "size")),
        (Menger(3), ("size",)),
        (Sierpinski(4), ("size",)),
    ):
        for name in names:
            yield _slope(shape, name, rays)


def _slope(shape: Shape, name: str, rays: Rays) -> Slope:
    fractal = painted()

    def way(value: Tensor) -> Tensor:
        hit = fractals.found(replace(fractal, **{name: value}), rays, shape, TRACED)
        return torch.where(hit.is_hit, hit.length, torch.zeros_like(hit.length))

    value = getattr(fractal, name).clone().requires_grad_()
    weight = torch.cos(torch.arange(rays.direction[..., 0].numel(), dtype=torch.float64)).reshape(
        rays.direction.shape[:-1]
    )
    at, forward = torch.func.jvp(way, (value.detach(),), (torch.ones_like(value.detach()),))[:2]
    above, below = (way(value.detach() + sign * STEP) for sign in (1.0, -1.0))
    # Rays that meet another part, or none, on one side of the difference have no derivative to be set beside.
    same = (at > 0.0) & ((above - 2.0 * at + below).abs() < SMOOTH)
    backward = torch.autograd.grad((way(value) * weight * same).sum(), value)[0]
    largest = forward[same].abs().max()
    apart = ((above - below) / (2.0 * STEP) - forward)[same].abs().max()
    summed = (forward * weight * same).sum()
    return Slope(
        f"{type(shape).__name__}({shape.iterations})", name, int((at > 0.0).sum()), int(same.sum()),
        float(largest), float(apart / largest), float((backward - summed).abs() / (forward * same).abs().sum()),
    )  # fmt: skip


def camera_rays(side: int, field_of_view: float, away: float, dtype: torch.dtype = torch.float64) -> Rays:
    """Rays of a square picture from an eye that looks at the origin."""
    elevation, azimuth = (torch.tensor(math.radians(angle), dtype=torch.float64) for angle in EYE)
    camera = Perspective(side, side, math.radians(field_of_view), -float(elevation))
    ahead = camera.direction(*pixel_centres(camera, slice(None), elevation))
    # The camera looks along +x; the eye stands on the other side of the origin.
    c, s = torch.cos(azimuth + math.pi), torch.sin(azimuth + math.pi)
    turn = torch.stack([c, s, c * 0.0, -s, c, c * 0.0, c * 0.0, c * 0.0, c * 0.0 + 1.0]).reshape(3, 3)
    origin = away * from_angles(elevation, azimuth)
    return Rays(origin.to(dtype), (ahead @ turn).to(dtype), torch.tensor(math.inf, dtype=dtype))


def picture(fractal: Fractal, shape: Shape, side: int, away: float) -> Float[Tensor, "side side 3"]:
    """Radiance of a fractal before an evening sky."""
    rays = camera_rays(side, 42.0, away, torch.float32)
    view = FractalView(
        rays=rays,
        background=_evening(side),
        to_light=from_angles(*torch.deg2rad(torch.tensor(SUN))),
        irradiance=torch.tensor([4.2, 3.4, 2.5]),
        sky=torch.tensor([0.14, 0.21, 0.36]),
        shape=shape,
    )
    single = Fractal(**{name: value.float() for name, value in vars(fractal).items()})
    span = within_ball(rays, single.size * shape.radius)
    near = (span.far > span.near).flatten().nonzero()[:, 0]
    drawn = view.background.flatten(0, 1).clone()
    direction = rays.direction.flatten(0, 1)
    for part in torch.split(near, RAYS):
        seen = replace(view, rays=replace(rays, direction=direction[part]), background=drawn[part])
        drawn[part] = fractals.render(single, seen)
    return drawn.reshape(side, side, 3)


def _evening(side: int) -> Tensor:
    down = torch.linspace(0.0, 1.0, side)[:, None, None]
    sky = torch.lerp(torch.tensor([0.02, 0.04, 0.09]), torch.tensor([0.22, 0.20, 0.22]), down)
    return sky.expand(side, side, 3).contiguous()


def panels(side: int) -> Iterator[Float[Tensor, "side side 3"]]:
    """All pictures of the sheet, row by row."""
    for power in (2.0, 3.5, 5.0, 8.0):
        yield picture(
            painted(power=power, size=0.8 if power < 3.0 else 1.0), Mandelbulb(6 if power < 3.0 else 4), side, 3.6
        )
    for phase in (0.5, 1.5):
        yield picture(painted(phase=phase), Mandelbulb(4), side, 3.6)
    yield picture(painted(light_spread=0.06), Menger(4), side, 5.2)
    yield picture(painted(light_spread=0.06), Sierpinski(5), side, 3.6)


def sheet(side: int, samples: int) -> np.ndarray:
    """All pictures as a screen shows them, side by side."""
    seen = []
    for panel in panels(side * samples):
        shown = (1.0 - torch.exp(-1.3 * panel)).clamp(min=0.0) ** (1.0 / 2.2)
        mean = (shown**2.2).reshape(side, samples, side, samples, 3).mean((1, 3)) ** (1.0 / 2.2)
        seen.append(_framed(mean))
    return _in_rows(seen)


def _framed(shown: Tensor) -> np.ndarray:
    pixels = np.rint(255.0 * shown.clamp(0.0, 1.0).numpy()).astype(np.uint8)
    return np.pad(pixels, ((0, GAP), (0, GAP), (0, 0)), constant_values=255)


def _in_rows(seen: Sequence[np.ndarray]) -> np.ndarray:
    rows = [np.concatenate(seen[start : start + COLUMNS], 1) for start in range(0, len(seen), COLUMNS)]
    return np.concatenate(rows, 0)


def _three_angles(count: int, draw: torch.Generator) -> tuple[Tensor, Tensor]:
    direction = sampling.from_three_angles(sampling.random_three_angles(count, draw, torch.float32))
    return direction, torch.ones(count)


def _weighed(count: int, draw: torch.Generator) -> tuple[Tensor, Tensor]:
    direction, _ = _three_angles(count, draw)
    return direction, sampling.evenness(direction)


def _even(count: int, draw: torch.Generator) -> tuple[Tensor, Tensor]:
    return sampling.on_sphere(sampling.random_pairs(count, draw, torch.float32)), torch.ones(count)


DIRECTIONS: dict[str, Callable[[int, torch.Generator], tuple[Tensor, Tensor]]] = {
    "three angles": _three_angles, "three angles, weighed": _weighed, "even": _even
}  # fmt: skip


def density(direction: Float[Tensor, "n 3"], weight: Float[Tensor, " n"]) -> Float[Tensor, "rows columns"]:
    """Measured density of directions in an even one's, over cells of the same solid angle."""
    held = torch.bincount(_cell(direction), weight.double(), minlength=CELLS[0] * CELLS[1])
    return held.reshape(CELLS) * (CELLS[0] * CELLS[1] / len(direction))


def _cell(direction: Tensor) -> Tensor:
    x, y, z = direction.unbind(-1)
    row = ((x + 1.0) / 2.0 * CELLS[0]).long().clamp(0, CELLS[0] - 1)
    column = ((torch.atan2(z, y) / (2.0 * math.pi) + 0.5) * CELLS[1]).long().clamp(0, CELLS[1] - 1)
    return row * CELLS[1] + column


def directions(count: int, side: int) -> tuple[list[Evenness], np.ndarray]:
    """How even each kind of direction is, and their densities on spheres side by side."""
    rows, seen = [], []
    for name, drawn in DIRECTIONS.items():
        direction, weight = drawn(count, torch.Generator().manual_seed(0))
        found = density(direction, weight)
        square = float((weight.double() * direction[:, 0].double().square()).mean())
        rows.append(Evenness(name, count, square, float(found.min()), float(found.max())))
        seen.append(_framed(_on_ball(found, side)))
    return rows, _in_rows(seen)


def _on_ball(found: Tensor, side: int) -> Tensor:
    """A sphere whose pole of x faces the upper right, coloured by a density."""
    place = (2.0 * (torch.arange(side) + 0.5) / side - 1.0) * 1.05
    right, down = place[None, :].expand(side, side), place[:, None].expand(side, side)
    square = right.square() + down.square()
    ahead = (1.0 - square).clamp(min=0.0).sqrt()
    pole = torch.nn.functional.normalize(torch.tensor([0.45, 0.5, 0.74]), dim=0)
    beside = torch.nn.functional.normalize(torch.linalg.cross(pole, torch.tensor([0.0, 1.0, 0.0])), dim=0)
    axes = torch.stack([pole, beside, torch.linalg.cross(pole, beside)])
    towards = torch.stack([right, -down, ahead], -1) @ axes.mT
    excess = ((found.flatten()[_cell(towards)] - 1.0) / 0.3).clamp(-1.0, 1.0).float()[..., None]
    ends = torch.where(excess > 0.0, torch.tensor([0.80, 0.16, 0.12]), torch.tensor([0.13, 0.30, 0.75]))
    shade = torch.lerp(torch.full((3,), 0.95), ends, excess.abs()) * (0.55 + 0.45 * ahead[..., None])
    return torch.where((square < 1.0)[..., None], shade, torch.ones(3))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures, and write them as JSON and the sheets as pictures."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=["small", "full"], default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    size = SMALL if given.size == "small" else Size()
    estimates, derivatives = list(passed(size.points)), list(slopes(size.rays))
    evenness, balls = directions(size.directions, size.panel)
    for rows in (estimates, derivatives, evenness):
        named = [asdict(row) for row in rows]
        print(records.table(list(named[0]), [[_shown(value) for value in row.values()] for row in named]))
    content = {
        "size": asdict(size),
        "estimates": [asdict(row) for row in estimates],
        "slopes": [asdict(row) for row in derivatives],
        "directions": [asdict(row) for row in evenness],
    }
    records.write(given.out / "fractals.json", content)
    (given.out / "fractals.png").write_bytes(png.encoded(sheet(size.panel, size.samples)))
    (given.out / "directions.png").write_bytes(png.encoded(balls))


def _shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)


if __name__ == "__main__":
    main()
