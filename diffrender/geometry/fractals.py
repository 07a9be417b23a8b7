"""Fractals in the light of a sun and a sky, met by rays: the Mandelbulb, Menger's sponge and Sierpinski's tetrahedron.

Their surface is matt, as bright as it faces the sun and sees the sky: the sun behind other parts of the shape is dimmed
by how near they come to its rays, and clefts see less of the sky. Where the orbit of a point came near the origin, it
has the accent's colour. No light is sent on twice, and an eye inside the shape sees the background.

Gradient: of what a ray hits, exact: that of the hit by the implicit function theorem, that of a shadow by the place
where the ray passes nearest to the shape, which does not move it. Whether a ray hits, how many bulbs the estimate
rounds off at its depth, and which of several nearest parts casts the shadow are not differentiated.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.effect import Effect, Rung
from diffrender.geometry import fractals_reference as by_force
from diffrender.geometry.fractal_shapes import Fractal, Mandelbulb, Orbit, Shape
from diffrender.geometry.sphere_tracing import (
    Hit,
    arrived,
    gradient,
    meet,
    nearest_pass,
    openness,
    soft_shadow,
    within_ball,
)
from diffrender.numerics import safe_sqrt
from diffrender.parameters import record
from diffrender.rays import Rays, from_angles

COARSE_STEPS, STEPS, SHADOW_STEPS = 20, 8, 8
PER_DEPTH = 12  # steps more for each iteration: rays pass by more detail
REACH = 0.3  # up to which surroundings dim the sky [size]
LIFTED = 0.005  # how far from the surface rays to the light begin [size]


@record
class FractalView:
    """Rays towards a fractal round the origin, what lies behind it, its light, exposed already, and which it is."""

    rays: Rays
    background: Float[Tensor, "*#batch 3"]  # [W/(m² sr)]
    to_light: Float[Tensor, "3"]
    irradiance: Float[Tensor, "3"]  # of a surface that faces the light [W/m²]
    sky: Float[Tensor, "3"]  # radiance of an even one [W/(m² sr)]
    shape: Shape


@dataclass(frozen=True)
class _Sized:
    """A fractal in metres, as functions of places."""

    fractal: Fractal
    shape: Shape

    def distance(self, position: Tensor) -> Tensor:
        return self.orbit(position).distance * self.fractal.size

    def orbit(self, position: Tensor) -> Orbit:
        return self.shape.orbit(self.fractal, position / self.fractal.size)

    @property
    def radius(self) -> Tensor:
        return self.fractal.size * self.shape.radius

    def still(self) -> "_Sized":
        return replace(self, fractal=pytree.tree_map(torch.Tensor.detach, self.fractal))


def found(fractal: Fractal, rays: Rays, shape: Shape, steps: int) -> Hit:
    """Where rays meet a fractal, with the derivatives of the hit."""
    whole = _Sized(fractal, shape)
    still = whole.still()
    fixed = Rays(rays.origin.detach(), rays.direction.detach(), rays.length.detach())
    span = within_ball(fixed, still.radius)
    return meet(whole.distance, still.distance, rays, arrived(still.distance, fixed, span, still.radius, steps))


def render(fractal: Fractal, view: FractalView) -> Float[Tensor, "*batch 3"]:
    """Radiance that arrives along rays [W/(m² sr)]: of the fractal with soft shadows, and of the background."""
    hit = found(fractal, view.rays, view.shape, STEPS + PER_DEPTH * view.shape.iterations)
    whole = _Sized(fractal, view.shape)
    normal = gradient(whole.distance, hit.position)
    lit = torch.relu((_unit(normal) * view.to_light).sum(-1)) * shadow(fractal, view, hit.position)
    sky = openness(whole.distance, hit.position, normal, REACH * fractal.size)
    return _painted(whole, view, hit, (lit, sky))


def shadow(fractal: Fractal, view: FractalView, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Share of the light that reaches places round a fractal past its other parts, from 0 to 1."""
    whole = _Sized(fractal, view.shape)
    still = whole.still()
    towards = Rays(position, view.to_light.expand_as(position), torch.full_like(position[..., 0], torch.inf))
    fixed = Rays(position.detach(), towards.direction.detach(), towards.length)
    span = within_ball(fixed, still.radius)
    begin = (LIFTED * still.fractal.size).expand_as(span.far)
    lit = replace(span, near=begin, far=torch.maximum(span.far, begin))
    passing = nearest_pass(still.distance, fixed, lit, SHADOW_STEPS + PER_DEPTH * view.shape.iterations)
    return soft_shadow(whole.distance, towards, passing, fractal.light_spread)


def render_coarse(fractal: Fractal, view: FractalView) -> Float[Tensor, "*batch 3"]:
    """The same at half the depth, without shadows: facing the light and up is all that makes it bright."""
    shape = replace(view.shape, iterations=max(1, view.shape.iterations // 2))
    hit = found(fractal, view.rays, shape, COARSE_STEPS)
    whole = _Sized(fractal, shape)
    up = _unit(gradient(whole.distance, hit.position))
    return _painted(whole, view, hit, (torch.relu((up * view.to_light).sum(-1)), 0.75 + 0.25 * up[..., 2]))


def skip(fractal: Fractal, view: FractalView) -> Float[Tensor, "*batch 3"]:
    """The background, as if there were no fractal."""
    return view.background + 0.0 * (fractal.size + torch.zeros_like(view.rays.direction))


def _painted(whole: _Sized, view: FractalView, hit: Hit, light: tuple[Tensor, Tensor]) -> Tensor:
    """Radiance of what is hit by how much of the sun and of the sky shines on it, else the background."""
    of_sun, of_sky = light
    trap = whole.orbit(hit.position).trap[..., None]
    paint = torch.lerp(whole.fractal.accent, whole.fractal.colour, trap)
    sent = paint * (view.irradiance / torch.pi * of_sun[..., None] + view.sky * of_sky[..., None])
    return torch.where(hit.is_hit[..., None], sent, view.background)


def _unit(normal: Tensor) -> Tensor:
    square = normal.square().sum(-1, keepdim=True)
    return normal / torch.where(square > 0.0, safe_sqrt(square), torch.ones_like(square))


def largest_change(fractal: Fractal, view: FractalView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all rays [W/(m² sr)]: all of it faces the sun, or hides what is behind."""
    paint = torch.maximum(fractal.colour, fractal.accent)
    return torch.maximum(paint * (view.irradiance / torch.pi + view.sky), view.background.abs()).amax()


def reference(fractal: Fractal, view: FractalView) -> Float[Tensor, "*batch 3"]:
    """The same by brute force, of `fractals_reference`."""
    size, shape, rays = fractal.size, view.shape, view.rays
    direction, origin = rays.direction, (rays.origin / size).expand_as(rays.direction)
    length = (rays.length / size).expand(direction.shape[:-1]).clamp(max=2.0 * float(origin.norm(dim=-1).max()) + 4.0)
    way, enters = by_force.border(
        lambda place: by_force.holds(shape, fractal, place), origin, direction, (torch.zeros_like(length), length)
    )
    place = origin + way[..., None] * direction

    def distance(at: Tensor) -> Tensor:
        return shape.orbit(fractal, at).distance

    normal = by_force.slopes(distance, place)
    steep = normal.norm(dim=-1, keepdim=True)
    up = normal / steep
    least = by_force.least_share(distance, place, view.to_light.expand_as(place), (LIFTED, 2.0 * shape.radius))
    dimmed = (least / fractal.light_spread).clamp(0.0, 1.0)
    lit = (up * view.to_light).sum(-1).clamp(min=0.0) * dimmed * dimmed * (3.0 - 2.0 * dimmed)
    away = REACH * place.new_tensor((0.25, 0.5, 1.0))
    free = (distance(place[..., None, :] + away[:, None] * up[..., None, :]) / (away * steep)).clamp(0.0, 1.0)
    sky = (free * free * (3.0 - 2.0 * free)).mean(-1)
    trap = shape.orbit(fractal, place).trap[..., None]
    paint = trap * fractal.colour + (1.0 - trap) * fractal.accent
    sent = paint * (view.irradiance / torch.pi * lit[..., None] + view.sky * sky[..., None])
    return torch.where(enters[..., None], sent, view.background)


# Where on a sphere of radius 3 rays begin and, in the plane across, which places they are aimed at [degrees, m].
_EXAMPLES = (
    (20.0, 215.0, 0.10, 0.20),
    (20.0, 215.0, -0.55, 0.25),
    (20.0, 215.0, 0.35, -0.45),
    (35.0, 250.0, 0.15, -0.05),
    (35.0, 250.0, -0.75, 0.10),
    (60.0, 180.0, 0.30, 0.30),
    (85.0, 100.0, 0.05, 0.02),  # along the axis
    (5.0, 30.0, 0.20, 0.40),  # unlit
    (-70.0, 10.0, 0.10, -0.20),
    (10.0, 225.0, 1.70, 0.30),  # a miss within its ball
    (10.0, 225.0, 2.60, 0.00),  # and outside
)


def example_inputs(dtype: torch.dtype) -> FractalView:
    """A Mandelbulb from all sides, in the sun and in its own shadow; misses, a ray from inside, one that is short."""
    elevation, azimuth, left, up = torch.tensor(_EXAMPLES, dtype=torch.float64).unbind(-1)
    elevation, azimuth = elevation.deg2rad(), azimuth.deg2rad()
    outward = from_angles(elevation, azimuth)
    across = from_angles(torch.zeros_like(azimuth), azimuth + torch.pi / 2)
    aim = left[:, None] * across + up[:, None] * from_angles(elevation + torch.pi / 2, azimuth)
    origin = torch.cat([3.0 * outward, torch.zeros(1, 3, dtype=torch.float64), 3.0 * outward[:1]])
    direction = torch.cat([_unit(aim - 3.0 * outward), outward[:1], -outward[:1]])
    length = torch.full_like(origin[:, 0], torch.inf).index_fill(0, torch.tensor([len(origin) - 1]), 1.0)
    shade = torch.linspace(0.1, 0.4, len(origin), dtype=torch.float64)[:, None]

    def single(*numbers: float) -> Tensor:
        return torch.tensor(numbers, dtype=torch.float64)

    view = FractalView(
        rays=Rays(origin, direction, length),
        background=shade * single(0.8, 1.0, 1.2),
        to_light=from_angles(single(40.0).deg2rad(), single(230.0).deg2rad())[0],
        irradiance=single(3.0, 2.7, 2.3),
        sky=single(0.35, 0.42, 0.55),
        shape=Mandelbulb(iterations=2),
    )
    cast: FractalView = pytree.tree_map_only(torch.Tensor, lambda tensor: tensor.to(dtype), view)
    return cast


EFFECT = Effect(
    parameters=Fractal,
    prefix="FRACTAL",
    rungs={"skip": Rung(skip), "coarse": Rung(render_coarse), "soft shadows": Rung(render)},
    reference=reference,
    # All of it the reference's, whose shadows go in steps of 3 % of the way; float32 is off by a fifth of it.
    tolerance=1e-5,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
