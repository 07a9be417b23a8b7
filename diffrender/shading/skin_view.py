"""Skin's parameters, a view of it in pictures, how its surface is read from them, and two hard little pictures."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles
from diffrender.surfaces import EvenSky, Lights


@record
class Skin:
    """Skin, or wax, marble, milk: all that light wanders in. The default is that of a pale arm [1].

    [1] H. W. Jensen et al., "A Practical Model for Subsurface Light Transport", SIGGRAPH 2001, table 1, "Skin1".
    """

    colour: Float[Tensor, "3"] = parameter(
        (0.44, 0.22, 0.13), bounds=(0.0, 1.0), unit="1",
        about="share of the light inside that comes out again: turned up, paler, and a little softer",
    )  # fmt: skip
    mean_free_path: Float[Tensor, "3"] = parameter(
        (1.3e-3, 0.95e-3, 0.67e-3), bounds=(1e-6, 2e-2), unit="m", scale="log", in_files=("mm", 1e3),
        about="between two collisions inside: turned up, softer; in red most, shadows have red edges",
    )  # fmt: skip
    roughness: Float[Tensor, ""] = parameter(
        0.4, bounds=(0.0, 1.0), unit="1", about="of its surface: turned down, wet or oily"
    )
    specular: Float[Tensor, ""] = parameter(
        0.028, bounds=(0.0, 0.1), unit="1", about="share mirrored straight on: turned up, shinier; 0.028 is index 1.4"
    )


@record
class SkinView:
    """Pictures of skin, at least two pixels wide and high, and its light, exposed already.

    Attributes:
        position: of what pixels show, finite everywhere and of no two pixels the same, in any frame [m].
        normal: for the light; with its pores and wrinkles.
        texture: share of the skin's colour, such as freckles have less of; from 0 to 1.
        mask: share of a pixel that skin covers; nothing goes from other materials to it, nor back.
        unshadowed: share of every light that reaches the pixel.
    """

    position: Float[Tensor, "*#batch height width 3"]
    normal: Float[Tensor, "*#batch height width 3"]
    to_eye: Float[Tensor, "*#batch height width 3"]
    texture: Float[Tensor, "*#batch height width 3"]
    mask: Float[Tensor, "*#batch height width"]
    unshadowed: Float[Tensor, "*#batch height width lights"]
    lights: Lights


def steps(
    position: Float[Tensor, "*batch height width 3"],
) -> tuple[Float[Tensor, "*batch height width 3"], Float[Tensor, "*batch height width 3"]]:
    """Steps on a surface from pixel to pixel [m], to the right and down.

    Of both neighbours the nearer one's, which over an edge belongs to the same surface.
    """
    return _nearer_step(position, -2), _nearer_step(position, -3)


def _nearer_step(position: Tensor, axis: int) -> Tensor:
    step = position.diff(dim=axis)
    ahead = torch.cat([step, step.narrow(axis, -1, 1)], axis)
    behind = torch.cat([step.narrow(axis, 0, 1), step], axis)
    is_ahead = ahead.square().sum(-1, keepdim=True) <= behind.square().sum(-1, keepdim=True)
    return torch.where(is_ahead, ahead, behind)


def example_inputs(dtype: torch.dtype) -> SkinView:
    """A leant plane with a shadow's edge, a hole and freckles; and a ball before a wall, seen to its edge."""
    rows, columns, pixel = 7, 8, 6e-4
    y, x = torch.meshgrid(*(torch.arange(count, dtype=torch.float64) for count in (rows, columns)), indexing="ij")
    x, y = pixel * (x - 3.7), pixel * (3.3 - y)
    leant = torch.stack([x, y, 0.6 * x - 0.3 * y], -1)
    height_square = 2.1e-3**2 - x.square() - y.square()
    is_ball = height_square > 0.0
    z = torch.where(is_ball, height_square.clamp(min=0.0).sqrt(), -6e-3 + 0.1 * x)
    ball = torch.stack([x, y, z], -1)
    flat = torch.tensor([-0.6, 0.3, 1.0], dtype=torch.float64).expand_as(leant)
    bumps = 0.3 * torch.stack([torch.sin(4e3 * y), torch.cos(5e3 * x), torch.zeros_like(x)], -1)
    of_wall = torch.tensor([-0.1, 0.0, 1.0], dtype=torch.float64)
    normal = torch.stack([flat + bumps, torch.where(is_ball[..., None], ball / 2.1e-3, of_wall) + 0.3 * bumps])
    normal = torch.nn.functional.normalize(normal, dim=-1)
    hole = torch.ones_like(x)
    hole[2:4, 5:7], hole[5, 1], hole[6, 2] = 0.0, 0.5, 0.0
    freckles = 1.0 - 0.5 * (torch.sin(3e3 * x + 1.0) * torch.sin(4e3 * y)).square()
    freckles[1, 1] = 0.0  # black
    shadow = torch.stack([(x + 0.4 * y > 2e-4).to(x), torch.ones_like(x), (y > -1e-3).to(x)], -1)
    eye = from_angles(*torch.tensor([[60.0], [200.0]], dtype=torch.float64).deg2rad())[0]
    given = {
        "position": torch.stack([leant, ball]) + torch.tensor([0.1, -0.2, 0.4], dtype=torch.float64),
        "normal": normal,
        "to_eye": eye.expand(2, rows, columns, 3),
        "texture": torch.stack([freckles[..., None].expand(rows, columns, 3), torch.ones(rows, columns, 3).double()]),
        "mask": torch.stack([hole, torch.ones_like(hole)]),
        "unshadowed": torch.stack([shadow, torch.ones_like(shadow)]),
    }
    # Above, low from the side, and below the horizon.
    above = torch.tensor([[70.0, 8.0, -40.0], [150.0, 10.0, 100.0]], dtype=torch.float64).deg2rad()
    lights = {
        "to_light": from_angles(*above),
        "irradiance": torch.tensor([[3.0, 2.9, 2.7], [1.0, 1.2, 1.5], [2.0] * 3]),
    }
    sky = EvenSky(*(torch.tensor(colour).to(dtype) for colour in ((0.10, 0.12, 0.15), (0.05, 0.05, 0.06))))
    made = {name: value.to(dtype) for name, value in given.items()}
    return SkinView(**made, lights=Lights(**{name: value.to(dtype) for name, value in lights.items()}, sky=sky))
