"""A face to see skin on: smoothly joined balls, lit hard from one side, with pores, lips and freckles.

The surface is where a distance is 0; rays of a camera without perspective step along it, as do those towards the
light, so that the nose throws a shadow as sharp as the pixels.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.rays import from_angles
from diffrender.shading.skin_view import SkinView
from diffrender.surfaces import EvenSky, Lights

HIGH = 0.15  # of what the picture shows [m]
STEPS, SHADOW_STEPS = 90, 90
NEAR = 1e-3  # of the surface; rays that have not left it by then are taken as having met it [m]
LIFT = 4e-4  # from which shadows are looked for [m]
EPSILON = 1e-4  # of differences that give normals [m]
# Middle, radius and how softly it is joined [m]: brow, cheeks, nose, its wings, mouth and chin, on the skull.
SKULL = ((-0.075, 0.0, 0.0), 0.085)
BALLS = (
    ((-0.020, 0.0, 0.042), 0.036, 0.030),
    ((-0.024, 0.034, -0.010), 0.026, 0.024),
    ((-0.024, -0.034, -0.010), 0.026, 0.024),
    ((0.008, 0.0, 0.028), 0.0060, 0.022),
    ((0.014, 0.0, 0.016), 0.0070, 0.020),
    ((0.021, 0.0, 0.004), 0.0090, 0.016),
    ((0.011, 0.0095, 0.000), 0.0065, 0.012),
    ((0.011, -0.0095, 0.000), 0.0065, 0.012),
    ((-0.014, 0.0, -0.028), 0.026, 0.022),
    ((-0.016, 0.0, -0.058), 0.020, 0.026),
)
HOLLOWS = (((0.024, 0.031, 0.021), 0.019, 0.016), ((0.024, -0.031, 0.021), 0.019, 0.016))
EYES = (((-0.0075, 0.029, 0.0195), 0.0150), ((-0.0075, -0.029, 0.0195), 0.0150))  # closed, under their lids
LIPS = ((-0.0235, 0.0036), (-0.0310, 0.0046))  # height and half thickness
MOUTH = 0.023  # half as wide


def picture_view(width: int, height: int) -> SkinView:
    """The face, with one light from its left, a faint one from behind its right, and a dim sky; in float64."""
    pixel = HIGH / height
    place = [(torch.arange(count, dtype=torch.float64) + 0.5 - count / 2) * pixel for count in (height, width)]
    down, right = torch.meshgrid(*place, indexing="ij")
    start = torch.stack([torch.full_like(down, 0.08), -right, -down], -1)
    to_eye = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    position, is_hit = _met(start, -to_eye, STEPS)
    of_lights = torch.tensor([[32.0, 10.0], [70.0, -140.0]], dtype=torch.float64).deg2rad()
    to_light = from_angles(of_lights[0], of_lights[1])
    normal = _normal(position, distance)
    shadows = [~_met(position + LIFT * normal, towards.expand_as(position), SHADOW_STEPS)[1] for towards in to_light]
    sky = EvenSky(*(position.new_tensor(colour) for colour in ((0.06, 0.07, 0.09), (0.03, 0.03, 0.03))))
    return SkinView(
        position=position,
        normal=_normal(position, lambda place: distance(place) + _pores(place)),
        to_eye=to_eye.expand_as(position),
        texture=_texture(position),
        mask=is_hit.to(position),
        unshadowed=torch.stack(shadows, -1).to(position),
        lights=Lights(to_light, position.new_tensor([[4.5, 4.2, 3.8], [1.2, 1.5, 2.0]]), sky),
    )


def distance(place: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """About how far a place is from the face [m], below 0 inside."""
    found = _to_ball(place, SKULL[0]) - SKULL[1]
    for middle, radius, soft in BALLS:
        found = _joined(found, _to_ball(place, middle) - radius, soft)
    found = found + 0.0014 * _lips(place)[1]
    for middle, radius, soft in HOLLOWS:
        found = -_joined(-found, _to_ball(place, middle) - radius, soft)
    for middle, radius in EYES:
        found = _joined(found, _to_ball(place, middle) - radius, 0.005)
    return found - 0.0026 * _lips(place)[0]


def _to_ball(place: Tensor, middle: tuple[float, float, float]) -> Tensor:
    length: Tensor = (place - place.new_tensor(middle)).norm(dim=-1)
    return length


def _joined(first: Tensor, second: Tensor, soft: float) -> Tensor:
    """The smaller of two distances, rounded where they meet."""
    share = torch.relu(soft - (first - second).abs()) / soft
    return torch.minimum(first, second) - 0.25 * soft * share.square()


def _lips(place: Tensor) -> tuple[Tensor, Tensor]:
    """How much of a place is lip, from 0 to 1, and how much of it is the line between the lips."""
    across = place[..., 1] / MOUTH
    narrow = torch.relu(1.0 - across.square()).square()
    # Raised at its corners, and the upper one with its bow.
    rise = place[..., 2] - 0.003 * across.square()
    found = torch.zeros_like(across)
    for height, thick in LIPS:
        found = torch.maximum(found, torch.exp(-((rise - height) / (thick * (0.5 + 0.5 * narrow))).pow(4)))
    between = torch.exp(-((rise + 0.0268) / 0.0009).square())
    front = (place[..., 0] > -0.03).to(place)
    return found * narrow.sqrt() * front, between * narrow.sqrt() * front


def _pores(place: Tensor) -> Tensor:
    """Depth of pores and of fine folds [m]."""
    x, y, z = (place / 1.1e-3).unbind(-1)
    fine = torch.sin(2.1 * y + 0.8 * z + torch.sin(1.3 * z)) * torch.sin(2.3 * z - 0.7 * y + torch.sin(1.7 * y + x))
    coarse = torch.sin(0.61 * y + 0.3 * x) * torch.sin(0.53 * z + 1.1 * torch.sin(0.4 * y))
    return 2e-5 * fine + 1.2e-5 * coarse


def _texture(place: Tensor) -> Tensor:
    """Lips, freckles on nose and cheeks, paler elsewhere."""
    lips = _lips(place)[0][..., None]
    y, z = place[..., 1], place[..., 2]
    cell = torch.stack([y, z], -1) / 4.5e-3
    whole = cell.floor()
    chance = torch.frac(torch.sin(whole @ whole.new_tensor([[12.9898, 39.35], [78.233, 11.14]])) * 43758.5453).abs()
    away = (cell - whole - 0.22 - 0.56 * chance).norm(dim=-1)
    size = 0.10 + 0.12 * chance[..., 0]
    where = torch.exp(-(((z + 0.002) / 0.016).square() + (y / 0.045).square()))
    freckle = (where * torch.sigmoid((size - away) / 0.03) * (chance[..., 1] > 0.35))[..., None]
    skin = torch.ones_like(place) - freckle * place.new_tensor([0.25, 0.45, 0.55])
    return skin * torch.lerp(torch.ones_like(place), place.new_tensor([0.85, 0.45, 0.55]), lips)


def _met(start: Tensor, direction: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Where rays are after so many steps, and whether they have met the face."""
    gone = torch.zeros_like(start[..., 0])
    for _ in range(steps):
        # Joined distances may be too long by some.
        gone = gone + (0.8 * distance(start + gone[..., None] * direction)).clamp(max=0.02)
    place = start + gone[..., None] * direction
    return place, distance(place) < NEAR


def _normal(place: Tensor, height: Callable[[Tensor], Tensor]) -> Tensor:
    sides = EPSILON * torch.eye(3).to(place)
    rise = torch.stack([height(place + side) - height(place - side) for side in sides], -1)
    return torch.nn.functional.normalize(rise, dim=-1)
