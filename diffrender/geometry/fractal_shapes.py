"""Three fractals as distances: the Mandelbulb of any power [1], Menger's sponge and Sierpinski's tetrahedron [2].

Each is taken to a finite depth, at which its surface is a plain one: of the Mandelbulb |z| = 2 after so many steps
z -> z^p + c, of the sponge that of 20^n cubes, of the tetrahedron that of 4^n tetrahedra. On that surface the distances
are 0. Those of the sponge and of the tetrahedron are never more than the way to it. That of the Mandelbulb is Hubbard
and Douady's estimate for complex numbers, which in three dimensions nobody has proved: `experiments.fractals` counts
where it fails.

Gradient: of the Mandelbulb exact, but for its axis, where the longitude has none, and, of powers that are no whole
numbers, where an orbit crosses the half plane y = 0 < -x, which tears the shape. Of the other two, exact inside the
pieces in which their distance is linear, or round an edge; power and phase do nothing there.

[1] D. White, P. Nylander, "The unravelling of the real 3D Mandelbulb", skytopia.com, 2009.
[2] I. Quilez, "Menger fractal" and "Mandelbulb", iquilezles.org, 2009 and 2011.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import safe_sqrt
from diffrender.parameters import parameter, record

ESCAPED = 2.0  # |z| beyond which orbits of powers from 2 up never come back
FARTHEST = 20.0  # log of |z|^p from which on an orbit is held: its fourth power fits float32, more steps change nothing
_LEAST = 1e-18  # squared |z| that stands for the origin's, whose logarithm is endless
_BESIDE = 1e-6  # x of points on the axis: nearer, float32's sine of pi would have a slope
_CORNER = math.sqrt(3.0)


@record
class Fractal:
    """A fractal and its paint."""

    power: Float[Tensor, ""] = parameter(
        8.0, bounds=(2.0, 16.0), unit="1", about="of the Mandelbulb's steps: turned up, more and smaller bulbs"
    )
    phase: Float[Tensor, ""] = parameter(
        0.0, bounds=(-math.pi, math.pi), unit="rad", in_files=("degrees", math.degrees(1.0)),
        about="turn of both angles in every step: animated round the circle, the bulbs flow and come back",
    )  # fmt: skip
    size: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.01, 100.0), unit="m", scale="log", about="half the edge of its cube: turned up, larger"
    )
    colour: Float[Tensor, "3"] = parameter(
        (0.88, 0.70, 0.46), bounds=(0.0, 1.0), unit="1", about="share of light that its outer parts send on"
    )
    accent: Float[Tensor, "3"] = parameter(
        (0.55, 0.10, 0.05), bounds=(0.0, 1.0), unit="1", about="the same of parts whose orbits come near the origin"
    )
    light_spread: Float[Tensor, ""] = parameter(
        0.1, bounds=(0.01, 1.0), unit="1", scale="log",
        about="tangent of the light's angular radius: turned up, softer shadows",
    )  # fmt: skip


@record
class Orbit:
    """What becomes of points of a fractal of size 1: its distance, and how far from 0 the orbit stayed, from 0 to 1."""

    distance: Float[Tensor, "*batch"]
    trap: Float[Tensor, "*batch"]


@dataclass(frozen=True)
class Mandelbulb:
    """Points that stay within 2 for so many steps z -> z^p + c: latitude and longitude times p, their radius to p."""

    iterations: int
    radius: ClassVar = ESCAPED  # of a ball round the origin that holds it

    def orbit(self, fractal: Fractal, position: Float[Tensor, "*batch 3"]) -> Orbit:
        """Distance r ln(r / 2) / (2 r'), and the cube of the least r; r' is how differences grow, if all align."""
        z, log_power, far = position, torch.log(fractal.power), FARTHEST / fractal.power
        log_radius = least = _log_length(z)
        log_growth = torch.zeros_like(log_radius)
        for _ in range(self.iterations):
            is_free = log_radius < far
            growth = log_power + (fractal.power - 1.0) * log_radius + log_growth
            # As log(exp(growth) + 1) is for what may be far above 88.
            log_growth = torch.where(is_free, torch.nn.functional.softplus(growth, threshold=40.0), log_growth)
            z = torch.where(is_free[..., None], _raised(fractal, z, log_radius) + position, z)
            log_radius = _log_length(z)
            least = torch.minimum(least, log_radius)
        outside = log_radius - math.log(ESCAPED)
        return Orbit(0.5 * outside * torch.exp(log_radius - log_growth), torch.exp(3.0 * least.clamp(max=0.0)))


def _log_length(z: Tensor) -> Tensor:
    return 0.5 * torch.log(z.square().sum(-1).clamp(min=_LEAST))


def _raised(fractal: Fractal, z: Tensor, log_radius: Tensor) -> Tensor:
    """z^p; of what is held anyway, that of the farthest which is not."""
    x, y, up = z.unbind(-1)
    # The axis has no longitude; beside it, it has one.
    x = torch.where((x.abs() < _BESIDE) & (y.abs() < _BESIDE), torch.full_like(x, _BESIDE), x)
    level = torch.sqrt(x * x + y * y)
    angles = fractal.power * torch.stack([torch.atan2(level, up), torch.atan2(y, x)]) + fractal.phase
    (flat, across), (upright, along) = torch.sin(angles).unbind(), torch.cos(angles).unbind()
    towards = torch.stack([flat * along, flat * across, upright], -1)
    return torch.exp((fractal.power * log_radius).clamp(max=FARTHEST))[..., None] * towards


@dataclass(frozen=True)
class Menger:
    """The cube from -1 to 1, without the middle third of every face and of itself, so many times over."""

    iterations: int
    radius: ClassVar = _CORNER

    def orbit(self, fractal: Fractal, position: Float[Tensor, "*batch 3"]) -> Orbit:  # noqa: ARG002 - of all shapes
        """Distance: of the cube or, where that is more, of the crosses cut out of it."""
        distance, scale, rounding = _box(position), 1.0, 4.0 * torch.finfo(position.dtype).eps
        for _ in range(self.iterations):
            cell = torch.remainder(position * scale, 2.0) - 1.0  # 0 at the cell's corners
            scale *= 3.0
            arm = (1.0 - 3.0 * cell.abs()).abs()
            x, y, z = arm.unbind(-1)
            cross = torch.minimum(torch.maximum(x, y), torch.minimum(torch.maximum(y, z), torch.maximum(z, x)))
            # On a face both are 0 up to rounding: the coarser one has the face's slope, the cut half of it or none.
            cut = (cross - 1.0) / scale
            distance = torch.where(cut > distance + rounding, cut, distance)
        return Orbit(distance, (1.5 * position.abs().amax(-1) - 0.5).clamp(0.0, 1.0))


def _box(position: Tensor) -> Tensor:
    """Distance of the cube from -1 to 1."""
    beyond = position.abs() - 1.0
    return safe_sqrt(torch.relu(beyond).square().sum(-1)) + beyond.amax(-1).clamp(max=0.0)


@dataclass(frozen=True)
class Sierpinski:
    """The tetrahedron on four corners of the cube from -1 to 1, halved towards its corners so many times over."""

    iterations: int
    radius: ClassVar = _CORNER

    def orbit(self, fractal: Fractal, position: Float[Tensor, "*batch 3"]) -> Orbit:  # noqa: ARG002 - of all shapes
        """Distance: mirrored to the nearest corner and enlarged, it is that of the planes of one tetrahedron."""
        place, trap = position, torch.ones_like(position[..., 0])
        for _ in range(self.iterations):
            for first, second in ((0, 1), (0, 2), (1, 2)):
                place = _mirrored(place, first, second)
            place = 2.0 * place - 1.0
            trap = torch.minimum(trap, torch.linalg.vector_norm(place, dim=-1) / _CORNER)
        x, y, z = place.unbind(-1)
        planes = torch.maximum((x + y).abs() - z, (x - y).abs() + z)
        return Orbit((planes - 1.0) / _CORNER * 0.5**self.iterations, trap)


def _mirrored(place: Tensor, first: int, second: int) -> Tensor:
    """Points of one side of the plane where two coordinates cancel, the others mirrored there."""
    beyond = (place[..., first] + place[..., second]).clamp(max=0.0)
    axes = torch.zeros(3).to(place).index_fill(0, torch.tensor([first, second], device=place.device), 1.0)
    return place - beyond[..., None] * axes


Shape = Mandelbulb | Menger | Sierpinski  # to a depth: turned up, finer
