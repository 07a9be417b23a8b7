"""Sequences of frames for the tests of anti-aliasing over time."""

import math
from dataclasses import replace

import torch

from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames, places
from diffrender.parameters import defaults


def settings(**values):
    """Defaults with FXAA and the response to contrast switched off, and other values."""
    linear = {"edge_threshold_minimum": 1.0, "subpixel": 0.0, "contrast_response": 0.0}
    known = defaults(AntiAliasing, torch.float64)
    return replace(known, **{n: torch.tensor(v, dtype=torch.float64) for n, v in (linear | values).items()})


def frames(scene, offsets, size, motion=None):
    """Frames of a scene, a function of place and time, one for each offset [pixels]."""
    width, height = size
    every = [scene(places(width, height, torch.tensor(o, dtype=torch.float64)), t) for t, o in enumerate(offsets)]
    return Frames(torch.stack(every)[..., None].expand(-1, -1, -1, 3), motion, None)


def still(count, size):
    """Motion of scenes at rest."""
    return torch.zeros(count, size[1], size[0], 2, dtype=torch.float64)


def wave(across, down):
    """Scene of one spatial frequency [1/pixel] in the middle of the range."""

    def shown(place, _time):
        return 0.5 + 0.25 * torch.cos(2.0 * math.pi * (across * place[..., 0] + down * place[..., 1]))

    return shown


def noise(seed, *shape):
    """Colours of a seed, evenly spread from 0 to 1."""
    return torch.rand(*shape, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def amplitude(picture, across, down):
    """By how much the wave of a frequency is stronger in a picture than in the scene, away from its borders."""
    height, width = picture.shape[:2]
    centres = places(width, height, torch.zeros(2, dtype=torch.float64))
    inner = (slice(4, -4), slice(4, -4))
    scene = wave(across, down)(centres, 0)[inner] - 0.5
    return float((scene * (picture[..., 0][inner] - 0.5)).sum() / (scene * scene).sum())


def awkward(*shape):
    """Sequences of three frames: black, a lamp of 400 000, a checker of one pixel, noise over ten decades."""
    lamp = torch.zeros(3, *shape, 3)
    lamp[:, 2, 2] = 4e5
    row, column = (torch.arange(size) for size in shape)
    checker = ((row[:, None] + column) % 2).float()[..., None].expand(3, *shape, 3)
    decades = 10.0 ** (10.0 * noise(9, 3, *shape).float() - 5.0)
    return torch.stack([torch.zeros_like(lamp), lamp, checker, decades])
