"""A small sequence in which froxel fog has all that it may have: the hard cases of its tests and experiments."""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.atmosphere.froxel_grid import Grid, eye_at
from diffrender.atmosphere.froxel_lights import Lights, LocalLights, Shadow, Sunlight
from diffrender.atmosphere.froxel_shadow import light_box, percentage_closer
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.rays import from_angles

FRAMES = 2
_GRID = Grid(columns=14, rows=9, slices=20, near=0.5, far=60.0)
# Distances of the pixels of three layers [m]: none, in the first slice, within the grid, beyond its end, the sky.
_DISTANCES = ((0.0, 0.3, 2.0, 9.0), (26.0, 40.0, 59.0, 15.0), (75.0, 300.0, math.inf, math.inf))
_ROWS = 4


def example_inputs(dtype: torch.dtype) -> FroxelView:
    """A camera that walks and turns under a low sun behind holes, past a lamp and a spot, in drifting fog."""
    time = torch.arange(FRAMES, dtype=torch.float64)
    position = torch.stack([0.2 * time, 0.1 * time, 1.85 + 0.0 * time], -1)
    spread = torch.tensor([0.8, 0.5], dtype=torch.float64)
    distance = torch.tensor(_DISTANCES, dtype=torch.float64)[:, None, None].expand(-1, FRAMES, _ROWS, -1)
    shade = torch.linspace(0.1, 0.5, distance.numel(), dtype=torch.float64).reshape(distance.shape)[..., None]
    double = FroxelView(
        grid=_GRID,
        eye=eye_at(position, 0.05 + 0.0 * time, 0.03 * time, spread),
        background=shade * torch.tensor([0.8, 1.0, 1.2], dtype=torch.float64),
        distance=distance,
        lights=Lights(_sun(), _lamps(), _probe()),
        noise=_noise(),
        displacement=torch.stack([0.1 * time + 3.2, -0.05 * time - 1.1, 0.0 * time], -1),
    )
    view: FroxelView = pytree.tree_map_only(Tensor, lambda tensor: tensor.to(dtype), double)
    return view


def _always(tensor: Tensor) -> Tensor:
    """The same in every frame."""
    return tensor.expand(FRAMES, *tensor.shape)


def _sun() -> Sunlight:
    """Low ahead to the left, behind a layer with a hole in every fourth texel."""
    to_sun = from_angles(*torch.tensor([0.3, 0.4], dtype=torch.float64))
    row, column = torch.meshgrid(torch.arange(12), torch.arange(12), indexing="ij")
    occluder = torch.where((row + 2 * column) % 4 == 0, 2.0, 0.3).double()
    box = light_box(to_sun, torch.tensor([25.0, 0.0, 2.0], dtype=torch.float64), 45.0, 45.0)
    shadow = Shadow(_always(percentage_closer(occluder, 6, 1)), _always(box))
    return Sunlight(_always(to_sun), _always(torch.tensor([3.0, 2.5, 1.8], dtype=torch.float64)), shadow)


def _lamps() -> LocalLights:
    """A point light, and a spot that shines down, most of it for the fog."""
    numbers = torch.tensor(
        [
            # place, intensity, size, reach, axis, cosines, share
            [12.0, 3.0, 3.0, 30.0, 22.0, 12.0, 1.5, 25.0, 0.0, 0.0, 1.0, -2.0, -1.0, 1.0],
            [9.0, -4.0, 6.0, 25.0, 35.0, 50.0, 2.0, 30.0, 0.0, 0.6, -0.8, 0.5, 0.8, 0.8],
        ],
        dtype=torch.float64,
    )
    return LocalLights(
        position=_always(numbers[:, :3]),
        intensity=_always(numbers[:, 3:6]),
        size=_always(numbers[:, 6]),
        reach=_always(numbers[:, 7]),
        ahead=_always(numbers[:, 8:11]),
        cos_edge=_always(numbers[:, 11]),
        cos_full=_always(numbers[:, 12]),
        share=_always(numbers[:, 13]),
    )


def _probe() -> Float[Tensor, "time 4 3"]:
    """Blue from above, brown from below."""
    sky = torch.tensor([0.5, 0.6, 0.8], dtype=torch.float64)
    lean = torch.tensor([-0.05, 0.3, 0.1], dtype=torch.float64)[:, None] * torch.tensor([0.3, 0.4, 0.6]).double()
    return _always(torch.cat([sky[None], lean]))


def _noise() -> Float[Tensor, "8 8 8"]:
    turn = 2.0 * math.pi * (torch.arange(8, dtype=torch.float64) + 0.5) / 8.0
    x, y, z = torch.meshgrid(turn, turn, turn, indexing="ij")
    return 0.5 * torch.sin(x + 2.0 * y) + 0.3 * torch.cos(y - z) + 0.2 * torch.sin(3.0 * x + z)
