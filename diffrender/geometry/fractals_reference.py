"""Fractals by brute force: rays in thousands of small steps, and whether a point belongs by the definition of the set.

Of the Mandelbulb a point belongs whose orbit stays within 2, the powers taken as those of complex numbers; of the
sponge one that in no place of its coordinates to base 3 has two middle digits; of the tetrahedron one whose barycentric
coordinates lie in a corner at every halving. The way to the border is halved to the last digit. Normals are differences
of the distance, shadows its least share of the way in small steps: the distance itself is not under test here, but
against brute force in `experiments.fractals`.

Gradient: of the border none; this is for values.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.geometry.fractal_shapes import Fractal, Mandelbulb, Menger, Shape, Sierpinski

STEPS, HALVINGS = 4000, 60  # along a ray, and then of the step that enters
SHADOW_STEPS = 250
NEAR = 1e-6  # of differences that give normals, in sizes


def holds(shape: Shape, fractal: Fractal, position: Float[Tensor, "*batch 3"]) -> Bool[Tensor, "*batch"]:
    """Whether points, in units of the fractal's size, belong to a shape."""
    match shape:
        case Mandelbulb():
            return _stays(shape.iterations, fractal, position)
        case Menger():
            return _has_no_two_middles(shape.iterations, position)
        case Sierpinski():
            return _is_in_corners(shape.iterations, position)


def _stays(iterations: int, fractal: Fractal, position: Tensor) -> Tensor:
    turn = torch.polar(torch.ones_like(fractal.phase), fractal.phase)
    x, y, z = position.unbind(-1)
    stays: Tensor = torch.linalg.vector_norm(position, dim=-1) <= 2.0
    for _ in range(iterations):
        radius, level = torch.hypot(torch.hypot(x, y), z), torch.hypot(x, y)
        around = _turned(x, y) ** fractal.power * turn
        upright = _turned(z, level) ** fractal.power * turn
        grown = radius**fractal.power
        flat = grown * upright.imag
        x, y, z = flat * around.real, flat * around.imag, grown * upright.real
        x, y, z = x + position[..., 0], y + position[..., 1], z + position[..., 2]
        stays = stays & (x * x + y * y + z * z <= 4.0)
        held = torch.where(stays[..., None], torch.stack([x, y, z], -1), torch.ones_like(position))
        x, y, z = held.unbind(-1)
    return stays


def _turned(along: Tensor, across: Tensor) -> Tensor:
    """Complex number of length 1 towards a place; 1 at the origin."""
    place = torch.complex(along, across)
    length = place.abs()
    unit: Tensor = torch.where(length == 0.0, torch.ones_like(place), place / torch.where(length == 0.0, 1.0, length))
    return unit


def _has_no_two_middles(iterations: int, position: Tensor) -> Tensor:
    found = (position.abs() <= 1.0).all(-1)
    place = (position + 1.0) / 2.0
    for _ in range(iterations):
        place = place * 3.0
        digit = place.floor()
        place = place - digit
        found = found & ((digit == 1.0).sum(-1) < 2)
    return found


def _is_in_corners(iterations: int, position: Tensor) -> Tensor:
    x, y, z = position.unbind(-1)
    shares = torch.stack([1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z], -1) / 4.0
    found = (shares >= 0.0).all(-1)
    for _ in range(iterations):
        largest, corner = shares.max(-1, keepdim=True)
        found = found & (largest[..., 0] >= 0.5)
        shares = 2.0 * shares - torch.zeros_like(shares).scatter(-1, corner, 1.0)
    return found


def border(
    belongs: Callable[[Tensor], Tensor], origin: Tensor, direction: Tensor, reach: tuple[Tensor, Tensor]
) -> tuple[Float[Tensor, "*batch"], Bool[Tensor, "*batch"]]:
    """Where rays that begin outside first enter a set, between two lengths, and whether they do."""
    near, far = reach
    share = torch.linspace(0.0, 1.0, STEPS + 1).to(near)
    lengths = near[..., None] + (far - near)[..., None] * share
    inside = belongs(origin[..., None, :] + lengths[..., None] * direction[..., None, :])
    first = inside.to(torch.int64).argmax(-1, keepdim=True)
    enters = inside.any(-1) & ~inside[..., 0]
    low = lengths.gather(-1, (first - 1).clamp(min=0))[..., 0]
    high = lengths.gather(-1, first)[..., 0]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        is_in = belongs(origin + middle[..., None] * direction)
        low, high = torch.where(is_in, low, middle), torch.where(is_in, middle, high)
    return high, enters


def slopes(distance: Callable[[Tensor], Tensor], position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Gradient of a distance by differences."""
    axes = NEAR * torch.eye(3).to(position)
    ends = [distance(position[..., None, :] + sign * axes) for sign in (1.0, -1.0)]
    return (ends[0] - ends[1]) / (2.0 * NEAR)


def least_share(
    distance: Callable[[Tensor], Tensor], origin: Tensor, direction: Tensor, reach: tuple[float, float]
) -> Float[Tensor, "*batch"]:
    """Least distance in proportion to the way, along rays between two lengths, in steps of equal proportion."""
    near, far = reach
    lengths = near * (far / near) ** torch.linspace(0.0, 1.0, SHADOW_STEPS + 1).to(origin)
    places = origin[..., None, :] + lengths[:, None] * direction[..., None, :]
    return (distance(places) / lengths).amin(-1)
