"""Bending: plants that lean and sway in the wind without growing longer.

A stem bends into an arc of a circle: turned the same angle per length all along, it keeps its length exactly, and what
stands beside it, as leaves do, is turned with it. The usual shear with renormalised length [1] keeps only the distance
of every vertex to the root, and shortens the stem.

[1] T. Sousa, "Vegetation procedural animation and shading in Crysis", GPU Gems 3, chapter 16, 2007, whose frequencies
    of branches and leaves are used here, with sines in place of its triangular waves, which have no gradient at their
    corners.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import safe_sqrt

FARTHEST_LEAN = math.pi / 2.0  # that leans can come near [rad]
_LEAF = (1.975, 0.793)  # frequencies per that of the wind's sway [1]
_BRANCH = (0.375, 0.193)


def lean(velocity: Float[Tensor, "*batch 3"], flexibility: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 2"]:
    """Angle by which the tips of stems lean along x and along y [rad] in a wind [m/s].

    Flexibility is the angle per squared speed [rad s²/m²] of a faint wind: the wind's pressure grows by the square.
    Turned up, a reed; a quarter turn is come near, but never reached.

    Gradient: exact, and 0 without wind.

    >>> lean(torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 9.0], [1e4, 0.0, 0.0]]), torch.tensor(0.01))[:, 0]
    tensor([0.0000, 0.0100, 1.5708])
    """
    level = velocity[..., :2]
    square = (level * level).sum(-1)
    pressed = flexibility * safe_sqrt(square)
    return (pressed / torch.sqrt(1.0 + pressed * pressed * square / FARTHEST_LEAN**2))[..., None] * level


def flutter(phase: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 2"]:
    """Sway of a branch and of its leaves, each from -1 to 1, at a phase [rad] that grows with time.

    Phases that differ from plant to plant keep a meadow from swaying as one. Each is the mean of two sines.
    """
    frequencies = phase.new_tensor([_BRANCH, _LEAF])
    return torch.sin(frequencies * phase[..., None, None]).mean(-1)


def bent(
    vertex: Float[Tensor, "*batch 3"], lean: Float[Tensor, "*#batch 2"], length: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch 3"]:
    """Place of a plant's vertex when its stem bends [m]; both are counted from its root, the stem upright along z.

    `lean` is the angle of the tip at a height of `length`, by direction. Lengths along the stem and across it are kept
    to rounding. Where foliage is wider than the arc's radius its inner side passes through itself.

    Gradient: exact, also of an upright stem.

    >>> bent(torch.tensor([0.0, 0.0, 1.0]), torch.tensor([torch.pi / 2.0, 0.0]), torch.tensor(1.0))
    tensor([0.6366, 0.0000, 0.6366])
    """
    height = vertex[..., 2, None]
    turned = lean * (height / length[..., None])  # angle of the stem there, by direction
    angle = safe_sqrt((turned * turned).sum(-1, keepdim=True))
    sine = torch.sinc(angle / math.pi)  # sin(x) / x
    versine = 0.5 * torch.sinc(angle / (2.0 * math.pi)).square()  # (1 - cos(x)) / x²
    across = vertex[..., :2]
    ahead = (across * turned).sum(-1, keepdim=True)
    level = across + turned * versine * (height - ahead)
    return torch.cat([level, sine * (height - ahead)], -1)
