"""Blurred shadows of the sun, out of which light shafts are made: from a map of depths as a camera in the sun sees it.

The shadow is softened before fog samples it, by the share of a map's texels round each place that see the sun [1]: a
froxel is larger than a texel, and would flicker.

Gradient: none by the depths, which are compared.

[1] W. Reeves, D. Salesin, R. Cook, "Rendering antialiased shadows with depth maps", SIGGRAPH 1987.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.images import bordered, clamped


def light_box(
    to_sun: Float[Tensor, "3"], centre: Float[Tensor, "3"], half_width: float, half_depth: float
) -> Float[Tensor, "3 4"]:
    """From the world to a box that lies along the sun's rays: layers away from it, rows and columns across.

    Its middle is at 1/2 of each, its ends at 0 and 1.
    """
    # Any direction but the sun's own will do for the rows to lie across.
    other = torch.where(to_sun[2].abs() < 0.9, to_sun.new_tensor([0.0, 0.0, 1.0]), to_sun.new_tensor([1.0, 0.0, 0.0]))
    across = torch.linalg.cross(other, to_sun)
    across = across / torch.linalg.vector_norm(across)
    down = torch.linalg.cross(across, to_sun)
    half = to_sun.new_tensor([half_depth, half_width, half_width])
    linear = torch.stack([-to_sun, down, across]) / (2.0 * half)[:, None]
    return torch.cat([linear, (0.5 - linear @ centre)[:, None]], -1)


def percentage_closer(
    depth: Float[Tensor, "rows columns"], layers: int, radius: int
) -> Float[Tensor, "{layers} rows columns"]:
    """How much of the sun is seen at layers of a box, from depths of what shadows in it.

    Depths are from 0, where the box begins, to 1, where it ends. Each value is the mean over a square
    of texels, `radius` of them to each side; what is deeper than 1 shadows nothing.
    """
    height, width = depth.shape[-2:]
    side = 2 * radius + 1
    layer = (torch.arange(layers).to(depth) + 0.5) / layers
    sees = (layer[:, None, None] <= depth).to(depth)
    wide = bordered(sees, radius, clamped)
    rows = torch.stack([wide[..., down : down + height, :] for down in range(side)]).mean(0)
    return torch.stack([rows[..., right : right + width] for right in range(side)]).mean(0)
