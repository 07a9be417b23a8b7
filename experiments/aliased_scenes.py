"""Scenes with detail far below a pixel, as functions of place and time: what anti-aliasing is compared on.

All drift slowly, by a part of a pixel a frame, which is where aliasing flickers. Colours are what a screen is sent.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from diffrender.images import places, supersampled

WIDTH, HEIGHT = 256.0, 144.0  # pixels that scenes are drawn for; they are scaled for other pictures
DRIFT = (0.37, 0.21)  # of the scene to the right and down [pixels of that picture a frame]
ROOT_OF_SAMPLES = 16  # the truth has 256 samples in a pixel


@dataclass(frozen=True)
class Drifting:
    """A scene that drifts across a picture of a width and height."""

    shown: Callable[[Tensor, Tensor], Tensor]  # x, y -> brightness from 0 to 1
    width: int
    height: int

    @property
    def scale(self) -> Tensor:
        """Pixels of this picture in one of the scene's own, across and down."""
        return torch.tensor([self.width / WIDTH, self.height / HEIGHT])

    def at(self, time: int) -> Callable[[Tensor], Tensor]:
        """Colours at places of the picture of a frame."""

        def colours(place: Tensor) -> Tensor:
            x, y = (place / self.scale - time * place.new_tensor(DRIFT)).unbind(-1)
            return self.shown(x, y)[..., None] * place.new_tensor([1.0, 0.9, 0.75])

        return colours

    def sampled(self, time: int, offset: tuple[float, float]) -> Tensor:
        """Frame with one sample in each pixel, an offset off its centre."""
        return self.at(time)(places(self.width, self.height, torch.tensor(offset)))

    def supersampled(self, time: int, samples: int) -> Tensor:
        """Frame with samples x samples in each pixel."""
        return supersampled(self.at(time), self.width, self.height, samples, torch.zeros(1))

    def motion(self, frames: int) -> Tensor:
        """Motion of every pixel of a sequence."""
        return (-self.scale * torch.tensor(DRIFT)).expand(frames, self.height, self.width, 2)


def shapes(x: Tensor, y: Tensor) -> Tensor:
    """Stairs, discs and a slanted roof: clear edges."""
    stairs = 0.25 + 0.5 * (((y + x / 13.0) % 17.0) < 8.5)
    discs = torch.hypot((x % 48.0) - 24.0, (y % 48.0) - 24.0) < 14.3
    roof = y < 30.0 + 0.93 * (x - 128.0).abs()
    return torch.where(roof, torch.where(discs, 0.9, stairs), 0.1 + 0.6 * (((x - y) % 23.0) < 4.2))


def lines(x: Tensor, y: Tensor) -> Tensor:
    """Grass and wires: blades from a third of a pixel to two wide, that bend and cross."""
    found = torch.full_like(x, 0.35)
    for blade in range(44):
        root, lean, width = 6.1 * blade, 0.9 * ((blade * 0.618) % 1.0 - 0.5), 0.17 + 0.8 * ((blade * 0.377) % 1.0)
        up = (150.0 - y) / 150.0
        middle = root + 150.0 * lean * up * up
        tall = y > 20.0 + 90.0 * ((blade * 0.271) % 1.0)
        shade = 0.1 + 0.85 * ((blade * 0.731) % 1.0)
        found = torch.where(tall & ((x - middle).abs() < width * (1.1 - up)), shade, found)
    wires = ((y + 0.13 * x) % 11.3 < 0.35) & (y < 60.0)
    return torch.where(wires, 0.02, found)


def fractal(x: Tensor, y: Tensor) -> Tensor:
    """A Julia set: detail at every scale."""
    real, imaginary = (x - 128.0) / 92.0, (y - 72.0) / 92.0
    escaped = torch.zeros_like(x)
    for _ in range(24):
        inside = real * real + imaginary * imaginary < 16.0
        real, imaginary = (
            torch.where(inside, real * real - imaginary * imaginary - 0.7269, real),
            torch.where(inside, 2.0 * real * imaginary + 0.1889, imaginary),
        )
        escaped = escaped + inside
    return 0.1 + 0.8 * (escaped % 5.0) / 4.0


SCENES = {"shapes": shapes, "lines": lines, "fractal": fractal}
