"""Light in exponential fog by quadrature: slow, trusted, and the judge of `height_fog.render`.

Shares with it the model (one exponential, flat ground under the ray, round earth under the sun's rays) but no formula:
optical depths are sums over nodes, those towards the sun over nodes of rays of their own. Works in float64 on the CPU.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.scattering import PLANET_RADIUS
from diffrender.atmosphere.sky_reference import running_weights
from diffrender.numerics import gauss_legendre
from diffrender.parameters import record
from diffrender.rays import Rays

_NODES = 8  # of a panel
_E_FOLDS = 45.0  # of density, beyond which nothing is left in float64


@record
class Fog:
    """Exponential fog."""

    extinction: Float[Tensor, "3"]  # at the base height [1/m]
    scale_height: Float[Tensor, ""]  # [m]
    base_height: Float[Tensor, ""]  # [m]


@record
class Light:
    """What a fog does to light along rays."""

    transmittance: Float[Tensor, "*batch 3"]
    sun_share: Float[Tensor, "*batch 3"]  # scattered sunlight over albedo, phase function and irradiance


def light(fog: Fog, rays: Rays, to_sun: Float[Tensor, "3"], panels: int = 128) -> Light:
    """Transmittance of rays, and the sunlight that they collect from fog which the sun reaches through fog."""
    altitude = rays.origin[..., 2] - fog.base_height
    distance, weight = _nodes(fog, altitude, rays, panels)
    height = altitude[..., None, None] + rays.direction[..., 2, None, None] * distance
    dense = fog.extinction * torch.exp(-height / fog.scale_height)[..., None]
    each = dense * weight[..., None]
    panel = each.sum(-2)
    half = (weight / gauss_legendre(_NODES)[1])[..., None]
    within = torch.einsum("ij,...jc->...ic", running_weights(_NODES), dense) * half
    before = torch.cumsum(panel, -2) - panel
    depth = before[..., None, :] + within
    reached = dense * sun_path(fog, height, to_sun[2])[..., None]
    return Light(torch.exp(-panel.sum(-2)), (each * torch.exp(-depth - reached)).sum((-3, -2)))


def _nodes(fog: Fog, altitude: Tensor, rays: Rays, panels: int) -> tuple[Tensor, Tensor]:
    """Distance of nodes along rays, and the length that each stands for [m]: (*batch, panels, n).

    Half of the panels are even, over as many e-folds of density as count; the other half grow from the eye, where thick
    fog ends all rays.
    """
    steep = rays.direction[..., 2].abs() / fog.scale_height
    reach = torch.minimum(rays.length, _E_FOLDS / steep)
    falls = (rays.direction[..., 2] < 0.0)[..., None]
    share = torch.linspace(0.0, 1.0, panels // 2 + 1, dtype=torch.float64)
    even = torch.where(falls, (rays.length - reach)[..., None], torch.zeros_like(altitude)[..., None])
    even = even + reach[..., None] * share
    whole = torch.where(falls[..., 0], rays.length, reach)
    growing = whole[..., None] * 10.0 ** (-9.0 * share)
    border = torch.cat([torch.zeros_like(whole)[..., None], even, growing], -1).sort(-1).values
    half = (border[..., 1:] - border[..., :-1])[..., None] / 2.0
    place, weight = gauss_legendre(_NODES)
    return border[..., :-1, None] + half * (1.0 + place), half * weight


def sun_path(
    fog: Fog, height: Float[Tensor, "*batch"], cos_sun: Float[Tensor, ""], panels: int = 32
) -> Float[Tensor, "*batch"]:
    """Length of fog as dense as at a height above the base that the sun's light crosses on its way there [m].

    Places on its ray are counted from the ray's lowest point.
    """
    radius = PLANET_RADIUS + fog.base_height + height
    lowest_square = radius.square() * (1.0 - cos_sun * cos_sun)
    start = radius * cos_sun
    top = radius + _E_FOLDS * fog.scale_height
    length = torch.sqrt(top.square() - lowest_square) - start
    place, weight = gauss_legendre(_NODES)
    step = (torch.arange(panels, dtype=torch.float64)[:, None] + 0.5 + 0.5 * place).flatten() / panels
    total = torch.zeros_like(height)
    for share, part in zip(step, (weight / (2.0 * panels)).repeat(panels), strict=True):
        along = start + length * share
        # (a² - b²) / (a + b): the heights of points whose distances from the earth's middle differ by metres.
        climb = (along.square() - start.square()) / (torch.sqrt(lowest_square + along.square()) + radius)
        total = total + part * torch.exp(-climb / fog.scale_height)
    return total * length
