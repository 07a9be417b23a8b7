"""One square texture for the shadow maps of many local lights, each as large as its light is on the screen [1].

Sizes are powers of two. Packed from the largest on along a curve that fills squares before it leaves them, they leave
no gap between them: whatever fits by its area fits.

Gradient: none, all of it is whole numbers.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Local Lights":
    "dynamic resizing of local shadow map, texture atlas"; how is not told.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

KEPT = 1.0  # octaves of the wanted size on either side within which a map keeps its own


@dataclass(frozen=True)
class Square:
    """Place of a map in the atlas [texels]; a size of 0 is no map."""

    x: int
    y: int
    size: int


def wanted_size(radius: float, depth: float, tangent: float, height: int) -> float:
    """Height on the screen of a light's sphere [pixels], by the tangent of half of the angle that the screen shows.

    The whole screen's where the eye is inside.

    >>> wanted_size(1.0, 10.0, 1.0, 1000)
    100.0
    """
    return float(height) if depth <= radius else min(radius / (depth * tangent), 1.0) * height


def map_size(wanted: float, before: int, least: int, most: int) -> int:
    """Side of a map [texels]: the nearest power of two, or what it was as long as that is within an octave.

    `before` is 0 for a light without a map. So a light at a border between two sizes does not change with each frame.

    >>> [map_size(wanted, 256, 16, 1024) for wanted in (140.0, 500.0, 120.0, 520.0, 1.0, 9e9)]
    [256, 256, 128, 512, 16, 1024]
    """
    exact = min(max(wanted, least), most)
    if least <= before <= most and abs(math.log2(exact / before)) < KEPT:
        return before
    return int(min(max(2 ** round(math.log2(exact)), least), most))


def packed(sizes: Sequence[int], atlas: int, least: int) -> tuple[Square, ...]:
    """Squares of an atlas for maps of sizes that are powers of two, or 0, the most important first.

    Where they do not fit the largest is halved, of equals the least important, again and again until they do; where
    all are smallest the least important is left out.

    Raises:
        ValueError: for a size that is neither 0 nor a power of two up to the atlas's.
    """
    for size in (atlas, *sizes):
        if size < 0 or size & (size - 1) or size > atlas:
            raise ValueError(f"a map has size {size}; allowed are 0 and powers of two up to {atlas}: use map_size")
    fitting = _fitting(list(sizes), atlas, least)
    found = [Square(0, 0, 0)] * len(fitting)
    used = 0
    # A stable sort, so that maps stay where they are while sizes do.
    for number in sorted(range(len(fitting)), key=lambda number: -fitting[number]):
        if size := fitting[number]:
            found[number] = Square(*_on_curve(used), size)
            used += size * size
    return tuple(found)


def _fitting(sizes: list[int], atlas: int, least: int) -> list[int]:
    while sum(size * size for size in sizes) > atlas * atlas:
        pays = max(range(len(sizes)), key=lambda number: (sizes[number], number))
        sizes[pays] = sizes[pays] // 2 if sizes[pays] > least else 0
    return sizes


def _on_curve(place: int) -> tuple[int, int]:
    """Texel at a place of Morton's curve: even bits are of x, odd ones of y."""
    x = y = 0
    for bit in range((place.bit_length() + 1) // 2):
        x |= (place >> (2 * bit) & 1) << bit
        y |= (place >> (2 * bit + 1) & 1) << bit
    return x, y
