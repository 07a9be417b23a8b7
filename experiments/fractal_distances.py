"""How far points truly are from fractals of a finite depth: the least way to any of their cubes or tetrahedra."""

import itertools
import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.geometry import fractals_reference
from diffrender.geometry.fractal_shapes import Fractal, Mandelbulb, Menger, Sierpinski

CORNERS = ((1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0))
AT_ONCE = 2**21  # pairs of a point and a piece


def distance(shape: Menger | Sierpinski, position: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Way from points to a shape; 0 inside."""
    pieces = _cubes(shape.iterations) if isinstance(shape, Menger) else _tetrahedra(shape.iterations)
    half = (1.0 / 3.0 if isinstance(shape, Menger) else 0.5) ** shape.iterations
    to_piece = _to_cubes if isinstance(shape, Menger) else _to_tetrahedra
    step = max(1, AT_ONCE // len(pieces))
    return torch.cat([to_piece(part[:, None] - pieces, half).amin(1) for part in torch.split(position, step)])


def _cubes(depth: int) -> Float[Tensor, "pieces 3"]:
    """Middles of the 20^n cubes of a sponge."""
    kept = [place for place in itertools.product((-1, 0, 1), repeat=3) if place.count(0) < 2]
    offsets, middles = torch.tensor(kept, dtype=torch.float64), torch.zeros(1, 3, dtype=torch.float64)
    for level in range(1, depth + 1):
        middles = (middles[:, None] + offsets * (2.0 / 3.0**level)).flatten(0, 1)
    return middles


def _to_cubes(offset: Tensor, half: float) -> Tensor:
    way: Tensor = torch.linalg.vector_norm(torch.relu(offset.abs() - half), dim=-1)
    return way


def _tetrahedra(depth: int) -> Float[Tensor, "pieces 3"]:
    """Middles of the 4^n tetrahedra."""
    corners, middles = torch.tensor(CORNERS, dtype=torch.float64), torch.zeros(1, 3, dtype=torch.float64)
    for level in range(1, depth + 1):
        middles = (middles[:, None] + corners * 0.5**level).flatten(0, 1)
    return middles


def _to_tetrahedra(offset: Tensor, half: float) -> Tensor:
    corners = half * torch.tensor(CORNERS, dtype=torch.float64)
    outside = torch.stack([-(offset @ corner) > half * half for corner in corners]).any(0)
    edges = [_to_segment(offset, a, b) for a, b in itertools.combinations(corners, 2)]
    faces = [_to_face(offset, *three) for three in itertools.combinations(corners, 3)]
    nearest = torch.stack([*edges, *faces]).amin(0)
    return torch.where(outside, nearest, torch.zeros_like(nearest))


def _to_segment(place: Tensor, start: Tensor, end: Tensor) -> Tensor:
    along = end - start
    share = (((place - start) @ along) / (along @ along)).clamp(0.0, 1.0)
    way: Tensor = torch.linalg.vector_norm(place - start - share[..., None] * along, dim=-1)
    return way


def _to_face(place: Tensor, first: Tensor, second: Tensor, third: Tensor) -> Tensor:
    """Way to a triangle's plane where its foot lies in the triangle, else endless."""
    normal = torch.linalg.cross(second - first, third - first)
    sides = [((place - a) @ torch.linalg.cross(normal, b - a)) for a, b in
             ((first, second), (second, third), (third, first))]  # fmt: skip
    is_over = (torch.stack(sides) >= 0.0).all(0)
    return torch.where(is_over, ((place - first) @ normal).abs() / normal.norm(), math.inf)


def reached(
    shape: Mandelbulb, fractal: Fractal, position: Float[Tensor, "n 3"], way: Float[Tensor, " n"], draw: torch.Generator
) -> Bool[Tensor, " n"]:
    """Whether a step of a length from each point, in a direction drawn at random, ends inside a Mandelbulb."""
    direction = torch.nn.functional.normalize(
        torch.randn(len(position), 3, generator=draw, dtype=torch.float64), dim=-1
    )
    return fractals_reference.holds(shape, fractal, position + way[:, None] * direction)
