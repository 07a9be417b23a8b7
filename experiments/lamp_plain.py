"""A plain that mirrors a low lamp, as a street does at night."""

import torch

from diffrender.shading.sphere_surface import SphereLight, SphereView

EYE = 1.5  # height over the plain [m]
LAMP = (14.0, 0.0, 1.6)  # its centre [m]
RADIUS = 0.8  # of it [m]
RADIANCE = (9.0, 7.5, 5.5)
GREY = 0.5  # of the plain
WIDE, HIGHEST, LOWEST = 0.9, 0.01, 0.43  # of the picture, in slopes of rays; the horizon is at 0


def lamp() -> SphereLight:
    """The lamp, in double precision."""
    return SphereLight(torch.tensor(RADIUS, dtype=torch.float64), torch.tensor(RADIANCE, dtype=torch.float64))


def plain(width: int, height: int, roughness: float) -> SphereView:
    """The plain up to near the horizon, seen by an eye as high as the lamp."""
    axes = [(torch.arange(count, dtype=torch.float64) + 0.5) / count for count in (width, height)]
    column, row = torch.meshgrid(*axes, indexing="xy")
    down = HIGHEST + (LOWEST - HIGHEST) * row
    direction = torch.stack([torch.ones_like(down), WIDE * (0.5 - column), -down], -1)
    centre, up = direction.new_tensor(LAMP), direction.new_tensor((0.0, 0.0, 1.0))
    return SphereView(
        position=direction * (EYE / down)[..., None] + EYE * up,
        normal=up.expand_as(direction),
        to_eye=-torch.nn.functional.normalize(direction, dim=-1),
        base=torch.full_like(direction, GREY),
        roughness=torch.full_like(down, roughness),
        metallic=torch.zeros_like(down),
        centre=centre,
    )
