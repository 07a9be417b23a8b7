"""Hair by rays: Snell's law in space, from wall to wall of a cylinder, and rough lobes by summing what defines them.

Rays leave the eye side by side across a strand. At every wall a share is mirrored by the amplitudes of both
polarisations, the rest refracted as vectors; on the way light is absorbed. Where a ray leaves, its direction's azimuth
is the middle of a logistic on the circle; along the strand the light is spread over the sphere by von Mises' and
Fisher's density, which is summed round the strand. Nothing is shared with the fast ways but what is not under test:
how wide the lobes are, how they lean with the scales, and how a colour becomes absorption. Works in float64.
"""

import math
from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import gauss_legendre
from diffrender.parameters import record
from diffrender.shading.hair_fibre import INDEX, LEANS, absorption, azimuthal_scale, variances
from diffrender.shading.hair_view import Hair, HairView

RAYS, ROUND = 1024, 512  # across a strand; and round it, for lobes along
STEPS, TURNS = 256, 128  # of the sky, along a strand and round
_NO_SIDE = 1e-6  # cosine below which a direction, as float32 holds it, is along the strand
BOUNCES = 24  # walls that a ray meets, after which even white strands keep less than 1e-9 of it

ByLobe = Callable[[Tensor], Tensor]  # azimuth -> density round the strand of R, TT, TRT and all else


@record
class _Leaving:
    """Share of light that leaves at one wall, and its azimuth, of every ray."""

    share: Float[Tensor, "*batch rays 3"]
    azimuth: Float[Tensor, "*batch rays"]


def traced(hair: Hair, view: HairView, rays: int = RAYS) -> Float[Tensor, "*batch 3"]:
    """Radiance of strands towards the eye [W/(m² sr)], by so many rays across each."""
    along, across = _axes(view.tangent, view.to_eye)
    aside = torch.linalg.cross(along, across)
    rise = (along * view.to_eye).sum(-1)
    ends = list(_walls(hair, rise, rays))
    middles = rise.clamp(-1.0, 1.0).asin()[..., None] + (hair.tilt + view.shift)[..., None] * rise.new_tensor(LEANS)

    def by_lobe(azimuth: Tensor) -> Tensor:
        sharp = [_spread(one, azimuth, azimuthal_scale(hair)) for one in ends[:3]]
        rest = torch.stack([one.share.sum(-2) for one in ends[3:]]).sum(0) / (2.0 * math.pi)
        return torch.stack([*sharp, rest.expand_as(sharp[0])], -2)

    total = view.open[..., None] * _sky(hair, view, middles, (along, across), by_lobe)
    for place, (to_light, irradiance) in enumerate(zip(view.lights.to_light, view.lights.irradiance, strict=True)):
        height, ahead, beside = ((axis * to_light).sum(-1) for axis in (along, across, aside))
        lobes = by_lobe(torch.atan2(beside, ahead))
        # Light along a strand comes from no side of it.
        is_along = torch.maximum(ahead.abs(), beside.abs())[..., None, None] < _NO_SIDE
        lobes = torch.where(is_along, _evened(by_lobe, height), lobes)
        rough = _summed_round(height.clamp(-1.0, 1.0).asin(), middles, variances(hair))
        total = total + view.reaching[..., place, None] * irradiance * (rough[..., None] * lobes).sum(-2)
    return total


def _evened(by_lobe: ByLobe, of: Tensor) -> Tensor:
    """Mean of densities all round a strand."""
    turn = (torch.arange(TURNS).to(of) + 0.5) * (2.0 * math.pi / TURNS)
    return by_lobe(turn.reshape(-1, *(1,) * of.ndim)).mean(0)


def _axes(tangent: Tensor, to_eye: Tensor) -> tuple[Tensor, Tensor]:
    """Strand's direction, and the unit vector across it on the eye's side; none where the eye looks along."""
    across = to_eye - (tangent * to_eye).sum(-1, keepdim=True) * tangent
    length = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
    return tangent, torch.where(length < _NO_SIDE, torch.zeros_like(across), across / length)


def _walls(hair: Hair, rise: Tensor, rays: int) -> Iterator[_Leaving]:
    """What leaves at each wall that rays meet, backwards from the eye, whose sine along the strand is given.

    The cylinder has radius 1 and stands along the last axis; the eye is in the plane of the first and the last.
    """
    turn = ((torch.arange(rays, dtype=rise.dtype) + 0.5) / rays - 0.5) * math.pi
    weight = torch.cos(turn) * (0.5 * math.pi / rays)
    weight = weight / weight.sum()
    level = (1.0 - rise * rise).clamp(min=1e-6).sqrt()[..., None]
    zero = torch.zeros_like(level * turn)
    place = torch.stack([zero + torch.cos(turn), zero + torch.sin(turn), zero], -1)
    heading = torch.stack([zero - level, zero, zero - (1.0 - level * level).sqrt() * rise.sign()[..., None]], -1)
    wall = place
    into, mirrored, share = _met(heading, wall, 1.0 / INDEX)
    yield _Leaving((weight * share)[..., None].expand(*share.shape, 3), _azimuth(mirrored))
    carried = (weight * (1.0 - share))[..., None] * torch.ones_like(hair.colour)
    for _ in range(BOUNCES):
        across = into[..., :2]
        length = -2.0 * (place[..., :2] * across).sum(-1) / across.square().sum(-1)
        place = place + length[..., None] * into
        carried = carried * torch.exp(-length[..., None] * absorption(hair))
        wall = torch.cat([place[..., :2], zero[..., None]], -1)
        out, into, share = _met(into, -wall, INDEX)
        yield _Leaving(carried * (1.0 - share)[..., None], _azimuth(out))
        carried = carried * share[..., None]


def _met(heading: Tensor, wall: Tensor, ratio: float) -> tuple[Tensor, Tensor, Tensor]:
    """Refracted and mirrored direction at a wall, whose normal is on the ray's side, and the share that is mirrored.

    By the ratio of the indices of refraction, of this side over that.
    """
    cosine = -(heading * wall).sum(-1)
    bent = (1.0 - ratio * ratio * (1.0 - cosine * cosine)).clamp(min=0.0).sqrt()
    refracted = ratio * heading + (ratio * cosine - bent)[..., None] * wall
    mirrored = heading + 2.0 * cosine[..., None] * wall
    perpendicular = (ratio * cosine - bent) / (ratio * cosine + bent)
    parallel = (cosine - ratio * bent) / (cosine + ratio * bent)
    return refracted, mirrored, 0.5 * (perpendicular.square() + parallel.square())


def _azimuth(direction: Tensor) -> Tensor:
    return torch.atan2(direction[..., 1], direction[..., 0])


def _spread(leaving: _Leaving, azimuth: Tensor, scale: Tensor) -> Tensor:
    """Rays' light in the logistics round where they leave, at an azimuth [1/rad]."""
    apart = azimuth[..., None] - leaving.azimuth
    apart = torch.atan2(torch.sin(apart), torch.cos(apart)).abs()
    falling = torch.exp(-apart / scale)
    whole = 1.0 / (1.0 + torch.exp(-math.pi / scale)) - 1.0 / (1.0 + torch.exp(math.pi / scale))
    density = falling / (scale * (1.0 + falling).square() * whole)
    return torch.einsum("...r,...rc->...c", density, leaving.share)


def _summed_round(light_angle: Tensor, middles: Tensor, variance: Tensor) -> Tensor:
    """Density along the strand of light in von Mises' and Fisher's lobes round the mirror's direction."""
    turn = (torch.arange(ROUND, dtype=middles.dtype) + 0.5) * (2.0 * math.pi / ROUND)
    light, middle, narrow = light_angle[..., None, None], -middles[..., None], variance[..., None]
    cosine = torch.sin(light) * torch.sin(middle) + torch.cos(light) * torch.cos(middle) * torch.cos(turn)
    density = torch.exp((cosine - 1.0) / narrow) / (narrow * (1.0 - torch.exp(-2.0 / narrow)))
    return density.mean(-1)


def _sky(hair: Hair, view: HairView, middles: Tensor, axes: tuple[Tensor, Tensor], by_lobe: ByLobe) -> Tensor:
    """Radiance of the sky, whose sums along the strand and round it stand apart in every lobe.

    Directions to both sides of the eye get the same, so that their mean is in the eye's plane.
    """
    batch = (1,) * (middles.ndim - 1)
    node, weight = (one.reshape(-1, *batch).to(middles) for one in gauss_legendre(STEPS))
    angle = 0.5 * math.pi * node
    density = _summed_round(angle, middles, variances(hair)) * (0.5 * math.pi * weight * torch.cos(angle))[..., None]
    whole, sine, cosine = (
        (density * by).sum(0) for by in (1.0, torch.sin(angle)[..., None], torch.cos(angle)[..., None])
    )
    turn = ((torch.arange(TURNS).to(middles) + 0.5) * (2.0 * math.pi / TURNS)).reshape(-1, *batch)
    lobes = by_lobe(turn) * (2.0 * math.pi / TURNS)
    share, ahead = lobes.sum(0), (torch.cos(turn)[..., None, None] * lobes).sum(0)
    along, across = (axis[..., 2, None, None] for axis in axes)
    height = along * sine[..., None] * share + across * cosine[..., None] * ahead
    sky = view.lights.sky
    return (whole[..., None] * share).sum(-2) * sky.mean + height.sum(-2) * sky.gradient
