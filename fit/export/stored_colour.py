"""Light as engines store it: a strength, and a colour whose largest channel is 1, perhaps encoded in sRGB."""

from collections.abc import Sequence

import torch

from diffrender.colour import srgb_encode


def split(light: Sequence[float]) -> tuple[float, tuple[float, ...]]:
    """Largest channel, and the light over it; white where there is none.

    >>> split((2.0, 1.0, 0.0))
    (2.0, (1.0, 0.5, 0.0))
    """
    strength = max(light)
    return strength, tuple(one / strength if strength > 0.0 else 1.0 for one in light)


def encoded(colour: Sequence[float]) -> tuple[float, ...]:
    """SRGB values from 0 to 1 of linear ones."""
    return tuple(srgb_encode(torch.tensor(colour, dtype=torch.float64)).tolist())


def in_bytes(colour: Sequence[float]) -> tuple[float, ...]:
    """SRGB values from 0 to 255 of linear ones, whole."""
    return tuple(float(round(255.0 * one)) for one in encoded(colour))
