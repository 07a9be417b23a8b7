"""Light scattered by the shell, by quadrature along straight rays: slow, trusted, and the judge of `sky.render`.

Shares with it the model (densities, coefficients, the series over orders) but no formula: no closed form of a column,
no step that is exact for its medium, no bilinear table. Gauss and Legendre's rule is applied between the heights where
densities bend, along rays towards the eye, round every point and towards the sun. Mean radiance, as
`multiple_scattering.mean_radiance` defines it, is a polynomial in height and sun. Works in float64 on the CPU.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import PLANET_RADIUS, SUN_RADIUS, TOP, Medium, density
from diffrender.atmosphere.sky_view import SkyView
from diffrender.numerics import gauss_legendre
from diffrender.parameters import record

# Heights [m] between which the rule is applied; the ozone's tent bends at 10, 25 and 40 km.
FEW_BORDERS = (0.0, 2e3, 10e3, 25e3, 40e3, TOP)
MANY_BORDERS = (0.0, 0.3e3, 1e3, 2e3, 4e3, 7e3, 10e3, 15e3, 20e3, 25e3, 30e3, 40e3, 60e3, TOP)

_DARK = 1e-14  # mean radiance [1/sr] below which its logarithm no longer counts
_SUN_SCALE = 0.06  # cosine over which the polynomial's nodes are dense round the horizon


@dataclass(frozen=True)
class Fineness:
    """How many nodes each integral has."""

    along: int  # each panel of a ray to the eye
    around: int  # each panel of other rays
    heights: int  # of the polynomial of mean radiance
    suns: int
    polar: int  # directions above the ground's edge, and as many below
    azimuths: int


USUAL = Fineness(along=8, around=6, heights=10, suns=12, polar=8, azimuths=3)


@record
class Nodes:
    """Where the rule evaluates rays through the shell."""

    distance: Float[Tensor, "*batch panels n"]  # from their start [m]
    length: Float[Tensor, "*batch panels n"]  # that each node stands for [m]
    height: Float[Tensor, "*batch panels n"]  # [m]


def in_scatter(
    air: Medium, view: SkyView, length: Float[Tensor, "*#batch"], fineness: Fineness = USUAL
) -> tuple[Float[Tensor, "*batch 3 3"], Float[Tensor, "*batch 3"]]:
    """Light that rays gather within a length [m], which may be infinite, and the share of light that passes it.

    Light is per irradiance of the sun [1/sr]: by air and by haze, phase functions left out, and by higher orders.
    """
    height = view.eye_altitude.expand(view.direction.shape[:-1])
    ray = _nodes(height, view.direction[..., 2], MANY_BORDERS, fineness.along, length)
    local_sun = _sun_along(height, view.to_sun[2], (view.direction * view.to_sun).sum(-1), ray)
    species = density(ray.height)
    weight, through = _weights(air, ray, species)
    direct = weight * sunlight(air, ray.height, local_sun, fineness.along)
    by_air = (direct * species[..., :1]).sum((-3, -2)) * air.rayleigh
    by_haze = (direct * species[..., 1:2]).sum((-3, -2)) * air.haze_scattering
    around = _mean_radiance_between(air, ray.height, local_sun, fineness)
    higher = (weight * (species @ air.scattering()) * around).sum((-3, -2))
    return torch.stack([by_air, by_haze, higher], -2), through


def sunlight(
    air: Medium, height: Float[Tensor, "*batch"], cosine: Float[Tensor, "*batch"], count: int = USUAL.along
) -> Float[Tensor, "*batch 3"]:
    """Share of the sun's light that reaches points; 0 in the earth's shadow.

    `cosine` is of the zenith angle of the disc's middle. The segment of an even disc above the ground's edge, seen
    through the air towards the middle of that segment.
    """
    angle = torch.acos(cosine)
    edge = math.pi / 2.0 + torch.acos(PLANET_RADIUS / (PLANET_RADIUS + height))
    rise = ((edge - angle) / SUN_RADIUS).clamp(-1.0, 1.0)
    level = torch.sqrt(1.0 - rise.square())
    share = 0.5 + (torch.asin(rise) + rise * level) / math.pi
    towards = torch.cos(angle - SUN_RADIUS * 2.0 / (3.0 * math.pi) * level**3 / share.clamp(min=1e-9))
    reached = torch.zeros(*height.shape, 3, dtype=torch.float64)
    # Rays that fall and rays that rise apart: each kind has panels that the other leaves empty.
    for kind in ((share > 0.0) & (towards < 0.0), (share > 0.0) & (towards >= 0.0)):
        ray = _nodes(height[kind], towards[kind], FEW_BORDERS, count)
        columns = (density(ray.height) * ray.length[..., None]).sum((-3, -2))
        reached[kind] = share[kind][:, None] * torch.exp(-columns @ air.extinction())
    return reached


def mean_radiance(
    air: Medium, height: Float[Tensor, " heights"], cos_sun: Float[Tensor, " suns"], fineness: Fineness = USUAL
) -> Float[Tensor, "heights suns 3"]:
    """Mean over the sphere of light scattered at least once, per irradiance of the sun [1/sr]."""
    return torch.stack([_mean_radiance_at(air, one, cos_sun, fineness) for one in height])


def _mean_radiance_at(air: Medium, height: Tensor, cos_sun: Tensor, fineness: Fineness) -> Tensor:
    place, weight = gauss_legendre(fineness.polar)
    place, weight = 0.5 + 0.5 * place, 0.5 * weight
    turn = math.pi * (torch.arange(fineness.azimuths, dtype=torch.float64) + 0.5) / fineness.azimuths
    edge = -torch.sin(torch.acos(PLANET_RADIUS / (PLANET_RADIUS + height)))
    once, share = torch.zeros(len(cos_sun), 3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    for span in (1.0 - edge, -1.0 - edge):
        # Squares of the places: directions are dense where radiance jumps, at the ground's edge.
        cosine, solid = edge + span * place.square(), span.abs() * place * weight
        ray = _nodes(height.expand_as(cosine), cosine, FEW_BORDERS, fineness.around)
        species = density(ray.height)
        source, through = _weights(air, ray, species)
        source = source * (species @ air.scattering())
        share = share + (source.sum((-3, -2)) * solid[:, None]).sum(0)
        sine = torch.sqrt(1.0 - cosine.square())[:, None, None]
        angle = cosine[:, None, None] * cos_sun[:, None]
        angle = angle + sine * torch.sqrt(1.0 - cos_sun.square())[:, None] * torch.cos(turn)
        every = Nodes(*(part[:, None, None].expand(*angle.shape, -1, -1) for part in vars(ray).values()))
        local_sun = _sun_along(height, cos_sun[:, None], angle, every)
        radiance = source[:, None, None] * sunlight(air, every.height, local_sun, fineness.around) / (4.0 * math.pi)
        radiance = radiance.sum((-3, -2))
        if span < 0.0:
            radiance = radiance + through[:, None, None] * _bounced(air, height, cos_sun[:, None], angle, every)
        once = once + (radiance.mean(2) * solid[:, None, None]).sum(0)
    return once / (1.0 - share)


def _bounced(air: Medium, height: Tensor, cos_sun: Tensor, cos_angle: Tensor, ray: Nodes) -> Tensor:
    """Radiance of the sunlit ground where rays end."""
    along = (PLANET_RADIUS + height) * cos_sun + ray.length.sum((-2, -1)) * cos_angle
    ground_sun = (along / PLANET_RADIUS).clamp(-1.0, 1.0)
    light = sunlight(air, torch.zeros_like(ground_sun), ground_sun)
    return air.ground_albedo / math.pi * torch.relu(ground_sun)[..., None] * light


def _mean_radiance_between(air: Medium, height: Tensor, cos_sun: Tensor, fineness: Fineness) -> Tensor:
    """Mean radiance at points, by a polynomial for its logarithm over just the suns that they see."""
    scaled = torch.asinh(cos_sun / _SUN_SCALE)
    # A little wider than the points, so that the sun at the zenith is a range too.
    low, high = scaled.min() - 1e-3, scaled.max() + 1e-3
    rows, columns = chebyshev_places(fineness.heights), chebyshev_places(fineness.suns)
    # Fourth power: smooth functions of the root of the height, as the ground's edge is, stay smooth.
    heights = TOP * (0.5 + 0.5 * rows) ** 4
    suns = (_SUN_SCALE * torch.sinh(low + (high - low) * (0.5 + 0.5 * columns))).clamp(-1.0, 1.0)
    table = torch.log(mean_radiance(air, heights, suns, fineness) + _DARK)
    of_row = _chebyshev(2.0 * (height / TOP) ** 0.25 - 1.0, fineness.heights)
    of_column = _chebyshev(2.0 * (scaled - low) / (high - low) - 1.0, fineness.suns)
    return torch.exp(torch.einsum("...i,ijc,...j->...c", of_row, table, of_column)) - _DARK


def _nodes(
    height: Tensor, cosine: Tensor, borders: tuple[float, ...], count: int, length: Tensor | float = math.inf
) -> Nodes:
    """Nodes of rays from a height at a cosine from the zenith to the ground or to space, or as far as a length.

    Places on a ray are counted from its lowest point; where it crosses the borders, one panel ends and another begins.
    """
    start = (PLANET_RADIUS + height) * cosine
    lowest_square = (PLANET_RADIUS + height).square() * (1.0 - cosine * cosine)
    border = PLANET_RADIUS + torch.tensor(borders, dtype=torch.float64)
    crossing = torch.sqrt(torch.relu(border.square() - lowest_square[..., None]))
    lands = (cosine < 0.0) & (lowest_square < PLANET_RADIUS**2)
    end = torch.minimum(torch.where(lands, -crossing[..., 0], crossing[..., -1]), start + length)
    limit = torch.cat([-crossing.flip(-1), crossing], -1)
    limit = torch.maximum(torch.minimum(limit, end[..., None]), start[..., None])
    half, first = (limit[..., 1:] - limit[..., :-1]) / 2.0, limit[..., :-1]
    used = (half > 0.0).flatten(0, -2).any(0)
    half, first = half[..., used, None], first[..., used, None]
    place, weight = gauss_legendre(count)
    along = first + half * (1.0 + place)
    above = torch.sqrt(lowest_square[..., None, None] + along.square()) - PLANET_RADIUS
    return Nodes(along - start[..., None, None], half * weight, torch.relu(above))


def _sun_along(height: Tensor, cos_sun: Tensor, cos_angle: Tensor, ray: Nodes) -> Tensor:
    """Cosine of the sun's local zenith angle at nodes; `cos_angle` is that between ray and sun."""
    along = ((PLANET_RADIUS + height) * cos_sun)[..., None, None] + ray.distance * cos_angle[..., None, None]
    return (along / (PLANET_RADIUS + ray.height)).clamp(-1.0, 1.0)


def _weights(air: Medium, ray: Nodes, species: Tensor) -> tuple[Tensor, Tensor]:
    """What each node adds to the eye per unit of source [m], and the transmittance of the whole ray."""
    extinction = species @ air.extinction()
    count = ray.length.shape[-1]
    half = (ray.length / gauss_legendre(count)[1])[..., None]
    within = torch.einsum("ij,...jc->...ic", running_weights(count), extinction) * half
    panel = (extinction * ray.length[..., None]).sum(-2)
    before = torch.cumsum(panel, -2) - panel
    return torch.exp(-before[..., None, :] - within) * ray.length[..., None], torch.exp(-panel.sum(-2))


def running_weights(count: int) -> Float[Tensor, "n n"]:
    """Weights of the integral from -1 to each place of the rule, exact up to the power count - 1."""
    place, _ = gauss_legendre(count)
    power = torch.arange(count)
    integral = (place[:, None] ** (power + 1) - (-1.0) ** (power + 1)) / (power + 1)
    weights: Tensor = torch.linalg.solve(place[:, None] ** power, integral, left=False)
    return weights


def chebyshev_places(count: int) -> Float[Tensor, " n"]:
    """Places in [-1, 1] through which a polynomial runs without overshooting."""
    return -torch.cos(math.pi * (torch.arange(count, dtype=torch.float64) + 0.5) / count)


def _chebyshev(where: Tensor, count: int) -> Tensor:
    """Weight of the value at each Chebyshev place in the polynomial's value elsewhere."""

    def powers(at: Tensor) -> Tensor:
        return torch.cos(torch.arange(count, dtype=torch.float64) * torch.acos(at.clamp(-1.0, 1.0))[..., None])

    weights: Tensor = torch.linalg.solve(powers(chebyshev_places(count)), powers(where).flatten(0, -2), left=False)
    return weights.reshape(*where.shape, count)
