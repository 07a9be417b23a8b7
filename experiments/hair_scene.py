"""A head of wavy hair from behind, lit from above and against the eye: strands that part, wave in locks and end ragged.

The head is half a ball over a cylinder. Strands run from its crown along both, moved to their sides by waves; each has
its own shift, length and direction, and each lock its own round side and its own shadow at the edges. Nothing is traced
through the hair: what lights reach is by the side of the head.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import smooth_rise
from diffrender.parameters import record
from diffrender.rays import from_angles, unit
from diffrender.shading.hair_view import HairView
from diffrender.surfaces import EvenSky, Lights

STRANDS, LOCKS = 420, 42  # round the head
TALL = 2.9  # of the picture, in radii of the head
LOWEST = -1.35  # mean height of the strands' ends, over the ball's middle
WAVE, WAVES = 0.13, 6.0  # to the side [rad], and per radius of the strand
LIGHTS = ((42.0, 140.0), (25.0, -12.0), (25.0, -110.0))  # elevation and azimuth in degrees; the eye looks along +x
IRRADIANCES = ((7.0, 6.6, 6.0), (1.6, 1.5, 1.3), (1.0, 1.2, 1.6))
SKY, SKY_GRADIENT = (0.30, 0.32, 0.35), (0.15, 0.15, 0.16)


@record
class _Place:
    """Where a ray meets the head.

    Attributes:
        normal: of the head.
        down: along its surface, away from the crown.
        around: across both, level.
        run: of a strand from the crown [radii].
        azimuth: round the crown [rad].
        is_hit: whether it meets it.
    """

    normal: Float[Tensor, "*batch 3"]
    down: Float[Tensor, "*batch 3"]
    around: Float[Tensor, "*batch 3"]
    run: Float[Tensor, "*batch"]
    azimuth: Float[Tensor, "*batch"]
    is_hit: Float[Tensor, "*batch"]


def picture_view(width: int, height: int) -> HairView:
    """The head in a picture so wide and high, in float64; all round it strands that no light reaches."""
    seen = _met(width, height)
    wave = WAVES * seen.run + 2.0 * torch.sin(2.0 * seen.azimuth)
    root = seen.azimuth - WAVE * torch.sin(wave)
    lock, strand = (torch.floor(root * (count / (2.0 * math.pi))).long() for count in (LOCKS, STRANDS))
    side = 2.0 * (root * (LOCKS / (2.0 * math.pi)) - lock) - 1.0  # from one edge of the lock to the other
    dice = torch.rand(STRANDS, 5, generator=torch.Generator().manual_seed(3), dtype=torch.float64)[strand % STRANDS]
    lean = WAVE * WAVES * torch.cos(wave) + 0.25 * (dice[..., 0] - 0.5) - 0.2 * side
    level = seen.normal[..., :2].norm(dim=-1)
    tangent = unit(seen.down + (lean * level)[..., None] * seen.around + 0.2 * (dice[..., 1:2] - 0.5) * seen.normal)
    normal = seen.normal + (0.7 * side)[..., None] * seen.around
    normal = unit(normal - (normal * tangent).sum(-1, keepdim=True) * tangent)
    length = 0.5 * math.pi - LOWEST + 0.35 * (dice[..., 2] - 0.5) + 0.2 * torch.cos(1.7 * lock)
    shown = (
        seen.is_hit
        * (seen.run < length).to(level)
        * (1.0 - 0.6 * side.square() * side.square())
        * (0.5 + 0.5 * dice[..., 4])
    )
    lights = _lights()
    facing = (seen.normal[..., None, :] * lights.to_light).sum(-1)
    reaching = smooth_rise(facing + 0.1, facing.new_tensor(0.6)) * shown[..., None]
    to_eye = torch.zeros_like(tangent) + tangent.new_tensor((-1.0, 0.0, 0.0))
    shift = 0.07 * (dice[..., 3] - 0.5)
    return HairView(tangent, normal, to_eye, shift, reaching, shown * (0.5 + 0.3 * seen.normal[..., 2]), lights)


def _met(width: int, height: int) -> _Place:
    """Where parallel rays along +x meet half a ball of radius 1 over a cylinder."""
    axes = (
        (torch.arange(count, dtype=torch.float64) + 0.5 - 0.5 * count) * (TALL / height) for count in (height, width)
    )
    row, column = torch.meshgrid(*axes, indexing="ij")
    up, left = -row - 0.25, -column
    dome = up.clamp(min=0.0)
    square = 1.0 - left * left - dome * dome
    normal = torch.stack([-square.clamp(min=0.0).sqrt(), left, dome], -1)
    normal = unit(torch.where((square > 0.0)[..., None], normal, normal.new_tensor((-1.0, 0.0, 0.0))))
    around = unit(torch.linalg.cross(normal.new_tensor((0.0, 0.0, 1.0)).expand_as(normal), normal))
    down = torch.linalg.cross(around, normal)
    run = torch.acos(normal[..., 2].clamp(-1.0, 1.0)) + (-up).clamp(min=0.0)
    azimuth = torch.atan2(normal[..., 1], normal[..., 0])
    return _Place(normal, down, around, run, torch.remainder(azimuth, 2.0 * math.pi), (square > 0.0).to(run))


def _lights() -> Lights:
    up, turn = torch.tensor(LIGHTS, dtype=torch.float64).deg2rad().unbind(-1)
    irradiance, mean, gradient = (torch.tensor(one, dtype=torch.float64) for one in (IRRADIANCES, SKY, SKY_GRADIENT))
    return Lights(from_angles(up, turn), irradiance, EvenSky(mean, gradient))
