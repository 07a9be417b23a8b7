"""Panes of coloured glass, bottles, a bubble and smoke on a chequered floor under the sky, each before the other.

Two of the panes cross, so that no order of whole things is right. A ball of clay hides what is behind it. The layers'
axis is that of things, and twice that of those with a front and a back.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.rays import Perspective, from_angles, pixel_centres
from diffrender.shading import brdf, transparent
from diffrender.shading.transparent_view import Transparent, TransparentView
from diffrender.surfaces import EvenSky, Lights, Surface

EYE = (0.0, 0.0, 1.45)  # [m]
SUN = (34.0, 128.0)  # elevation and azimuth [degrees]
SQUARE = 0.5  # of the floor [m]
CLAY = (6.1, -0.05, 0.5, 0.5)  # a ball's middle and radius [m]
SMOKE = (4.75, 0.62, 1.1, 0.55)  # a puff's middle and width [m]
BUBBLE = (4.3, -0.12, 1.62, 0.27)  # middle and radius [m]
# Middle, azimuth and elevation of the normal [degrees], half width and half height [m].
PANES = (
    (5.6, -0.75, 0.85, 172.0, 0.0, 0.85, 0.85),
    (5.1, 0.85, 0.80, 140.0, 0.0, 0.85, 0.80),
    (5.1, 0.75, 0.95, 220.0, 0.0, 0.85, 0.95),  # crosses the one before
)
# Middle of the foot, radius, height of the shoulder, radius and height of the neck [m].
BOTTLES = ((5.0, -0.85, 0.23, 0.75, 0.075, 1.28), (4.45, -0.48, 0.19, 0.50, 0.065, 0.92))
# Of each layer: colour through 10 mm, thickness, index, roughness and dust; front and back of bottles and the bubble.
_GLASS = (
    ((0.95, 0.55, 0.20), 0.008, 1.52, 0.05, 0.30),
    ((0.25, 0.50, 0.95), 0.008, 1.52, 0.05, 0.30),
    ((0.85, 0.22, 0.25), 0.008, 1.52, 0.05, 0.45),
    *(((0.15, 0.62, 0.30), 0.006, 1.52, 0.12, 0.25),) * 2,
    *(((0.62, 0.36, 0.12), 0.006, 1.52, 0.12, 0.15),) * 2,
    *(((0.98, 0.98, 0.99), 0.001, 1.45, 0.04, 0.00),) * 2,
    ((1.00, 1.00, 1.00), 0.001, 1.00, 1.00, 0.75),  # smoke: dust that hangs in the air
)
_DUST_COLOUR = ((0.42, 0.38, 0.32),) * 9 + ((0.85, 0.85, 0.88),)


def glass() -> Transparent:
    """What the layers are of."""
    tint, thickness, index, roughness, dust = zip(*_GLASS, strict=True)
    fields = (tint, thickness, index, roughness, dust, _DUST_COLOUR)
    return Transparent(*(torch.tensor(field, dtype=torch.float64) for field in fields))


def picture_view(width: int, height: int) -> TransparentView:
    """The scene as an eye before it sees it, in double precision."""
    camera = Perspective(width, height, math.radians(44.0), math.radians(-6.0))
    ray = camera.direction(*pixel_centres(camera, slice(None), torch.zeros((), dtype=torch.float64)))
    lights = _lights()
    met = [_pane(ray, pane) for pane in PANES]
    met += [side for bottle in BOTTLES for side in _bottle(ray, bottle)]
    met += [*_ball(ray, BUBBLE), _smoke(ray)]
    depth, normal = (torch.stack(values, along) for values, along in zip(zip(*met, strict=True), (-1, -2), strict=True))
    background, behind = _opaque(ray, lights)
    return TransparentView(
        depth=depth,
        normal=normal,
        dust=torch.cat([_smudged(_at(ray, depth))[..., :-1], _puff(ray)[..., None]], -1),
        background=background,
        background_depth=behind,
        to_eye=-ray,
        lights=lights,
    )


def sheet(width: int, height: int, samples: int) -> Float[Tensor, "high wide 3"]:
    """The rungs of the ladder one under another in two columns, and what weights get wrong, four times as strong.

    Radiance, of so many rays along each side of a pixel.
    """
    view, of = picture_view(samples * width, samples * height), glass()
    drawn = {name: rung(of, view) for name, rung in transparent.EFFECT.rungs.items()}
    wrong = 0.5 + 4.0 * (drawn["weighted"] - drawn["sorted"])
    cells = [one.reshape(height, samples, width, samples, 3).mean((1, 3)) for one in (*drawn.values(), wrong)]
    return torch.cat([torch.cat(cells[row : row + 2], 1) for row in range(0, len(cells), 2)], 0)


def _lights() -> Lights:
    elevation, azimuth = torch.deg2rad(torch.tensor(SUN, dtype=torch.float64))
    single = torch.tensor([(2.4, 2.2, 1.9), (0.55, 0.66, 0.80), (0.05, 0.15, 0.30)], dtype=torch.float64)
    return Lights(from_angles(elevation, azimuth)[None], single[:1], EvenSky(single[1], single[2]))


def _at(ray: Tensor, distance: Tensor) -> Tensor:
    """Places of the layers; those of absent ones are somewhere."""
    there = torch.where(distance.isfinite(), distance, torch.zeros_like(distance))
    return ray.new_tensor(EYE) + ray[..., None, :] * there[..., None]


def _pane(ray: Tensor, pane: Sequence[float]) -> tuple[Tensor, Tensor]:
    """Distance, infinite where it is missed, and normal of a rectangle."""
    middle, (azimuth, elevation) = ray.new_tensor(pane[:3]), torch.deg2rad(ray.new_tensor(pane[3:5]))
    normal, up = from_angles(elevation, azimuth), from_angles(elevation + 0.5 * math.pi, azimuth)
    distance = ((middle - ray.new_tensor(EYE)) @ normal) / (ray @ normal)
    away = ray.new_tensor(EYE) + ray * distance[..., None] - middle
    inside = ((away @ torch.linalg.cross(up, normal)).abs() < pane[5]) & ((away @ up).abs() < pane[6]) & (distance > 0)
    return torch.where(inside, distance, math.inf), normal.expand_as(ray)


def _crossings(square: Tensor, half_linear: Tensor, constant: Tensor) -> tuple[Tensor, Tensor]:
    """Both roots of square x² + 2 half_linear x + constant; first infinity and then minus infinity where none are."""
    discriminant = half_linear * half_linear - square * constant
    root = torch.sqrt(discriminant.clamp(min=0.0))
    is_met = discriminant > 0.0
    near, far = ((-half_linear + sign * root) / square for sign in (-1.0, 1.0))
    return torch.where(is_met, near, math.inf), torch.where(is_met, far, -math.inf)


def _ball(ray: Tensor, ball: Sequence[float]) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Front and back of a sphere."""
    away = ray.new_tensor(EYE) - ray.new_tensor(ball[:3])
    sides = _crossings(torch.ones_like(ray[..., 0]), ray @ away, away @ away - ball[3] ** 2)
    distance = [torch.where(side.abs() < math.inf, side, math.inf) for side in sides]
    near, far = ((d, _unit(_at(ray, d[..., None])[..., 0, :] - ray.new_tensor(ball[:3]))) for d in distance)
    return near, far


def _bottle(ray: Tensor, bottle: Sequence[float]) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Front and back of a bottle: a cylinder, half a ball for its shoulders and a neck; foot and mouth are open."""
    x, y, radius, shoulder, neck, top = bottle
    away = ray.new_tensor(EYE) - ray.new_tensor((x, y, 0.0))
    flat = ray.new_tensor((1.0, 1.0, 0.0))
    neck_foot = shoulder + math.sqrt(radius**2 - neck**2)
    pieces = []
    for wide, low, high in ((radius, 0.0, shoulder), (neck, neck_foot, top)):
        level = ray * flat
        sides = _crossings(level.square().sum(-1), level @ away, (away * flat).square().sum() - wide**2)
        pieces += [(side, low, high, flat) for side in sides]
    of_ball = away - ray.new_tensor((0.0, 0.0, shoulder))
    sides = _crossings(torch.ones_like(ray[..., 0]), ray @ of_ball, of_ball @ of_ball - radius**2)
    pieces += [(side, shoulder, neck_foot, torch.ones_like(flat)) for side in sides]
    near = torch.full_like(ray[..., 0], math.inf), torch.zeros_like(ray)
    far = torch.full_like(ray[..., 0], -math.inf), torch.zeros_like(ray)
    for side, low, high, along in pieces:
        place = _at(ray, side[..., None])[..., 0, :]
        is_met = side.isfinite() & (place[..., 2] > low) & (place[..., 2] <= high)
        outward = _unit((place - ray.new_tensor((x, y, shoulder))) * along)
        near = _chosen(is_met & (side < near[0]), (side, outward), near)
        far = _chosen(is_met & (side > far[0]), (side, outward), far)
    one_side = near[0] == far[0]
    far_depth = torch.where((far[0] > -math.inf) & ~one_side, far[0], math.inf)
    return (near[0], _unit(near[1])), (far_depth, _unit(far[1]))


def _chosen(where: Tensor, one: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    return torch.where(where, one[0], other[0]), torch.where(where[..., None], one[1], other[1])


def _smoke(ray: Tensor) -> tuple[Tensor, Tensor]:
    """A puff as games draw one: a square that faces the eye."""
    distance = (ray.new_tensor(SMOKE[:3]) - ray.new_tensor(EYE)).norm().expand_as(ray[..., 0])
    return distance, -ray


def _puff(ray: Tensor) -> Tensor:
    """How dense the puff is where a ray meets it."""
    place = ray.new_tensor(EYE) + ray * _smoke(ray)[0][..., None] - ray.new_tensor(SMOKE[:3])
    far = place.norm(dim=-1) / SMOKE[3]
    billows = torch.sin(9.0 * place[..., 1] + 2.0 * torch.sin(7.0 * place[..., 2]))
    billows = billows * torch.sin(8.0 * place[..., 2] + 2.0 * torch.sin(6.0 * place[..., 1]))
    density: Tensor = (1.0 - (far * (1.0 + 0.25 * billows)).square()).clamp(min=0.0).square()
    return density


def _smudged(place: Tensor) -> Tensor:
    """Dust that lies thicker below, wiped in arcs."""
    x, y, z = place.unbind(-1)
    wiped = 0.5 + 0.5 * torch.sin(11.0 * torch.hypot(x + y - 4.6, z - 0.4))
    grain = 0.5 + 0.5 * torch.sin(23.0 * y + 5.0 * torch.sin(9.0 * z)) * torch.sin(27.0 * z + 4.0 * torch.sin(8.0 * x))
    return (torch.exp(-1.6 * z.clamp(min=0.0)) * (0.35 + 0.65 * wiped) * (0.5 + 0.5 * grain)).clamp(0.0, 1.0)


def _opaque(ray: Tensor, lights: Lights) -> tuple[Tensor, Tensor]:
    """The deferred picture and its depth: the floor, a ball of clay, the sky."""
    sky = lights.sky.mean + lights.sky.gradient * ray[..., 2:]
    falls = -ray[..., 2]
    floor = torch.where(falls > 1e-3, EYE[2] / falls.clamp(min=1e-3), math.inf)
    (ball, outward), _ = _ball(ray, CLAY)
    place = _at(ray, floor[..., None])[..., 0, :]
    odd = ((place[..., 0] / SQUARE).floor() + (place[..., 1] / SQUARE).floor()) % 2.0
    grey = (0.12 + 0.5 * odd)[..., None] * ray.new_tensor((1.0, 0.98, 0.94))
    is_ball = ball < floor
    surface = Surface(
        normal=torch.where(is_ball[..., None], outward, ray.new_tensor((0.0, 0.0, 1.0))),
        base=torch.where(is_ball[..., None], ray.new_tensor((0.75, 0.70, 0.64)), grey),
        roughness=torch.full_like(falls, 0.7),
        metallic=torch.zeros_like(falls),
    )
    shaded = _in_shadow(place, lights) & ~is_ball
    dark = Lights(lights.to_light, 0.0 * lights.irradiance, lights.sky)
    lit = torch.where(shaded[..., None], brdf.lit(surface, -ray, dark), brdf.lit(surface, -ray, lights))
    depth = torch.minimum(floor, ball)
    # Far floor fades into the sky.
    clear = torch.where(depth.isfinite(), torch.exp(-depth / 40.0), torch.zeros_like(depth))[..., None]
    return torch.lerp(sky, lit, clear), depth


def _in_shadow(place: Tensor, lights: Lights) -> Tensor:
    """Whether the ball of clay stands between the floor and the sun."""
    away = place.new_tensor(CLAY[:3]) - place
    along = away @ lights.to_light[0]
    return (along > 0.0) & (away.square().sum(-1) - along.square() < CLAY[3] ** 2)


def _unit(vector: Tensor) -> Tensor:
    """Unit vector; up where there is none, as of absent layers."""
    length = vector.norm(dim=-1, keepdim=True)
    return torch.where(length > 0.0, vector / length.clamp(min=1e-30), vector.new_tensor((0.0, 0.0, 1.0)))
