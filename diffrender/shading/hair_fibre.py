"""A strand of hair as a clear, coloured cylinder with rough, tilted scales: the ways of light through it [1, 2, 3].

Light that meets a strand is mirrored (R), passes through it (TT), is mirrored once inside (TRT), or more often. Each
way is a lobe: M of angles along the strand, N of angles round it, and the share A of the light that takes it [1].
Angles along are from the plane across the strand, those round it from the eye's.

    M   von Mises and Fisher's spread over the sphere, taken over all angles round the strand [2, equation 7]
    N   a logistic on the circle, cut at half a turn, round where a smooth cylinder would send the light [3]
    A   Fresnel's law at its true angle, and absorption along the way through the strand [2, 3]

What is taken by its mean across the strand is cut into SEGMENTS between the middle and the edge, in the angle of the
surface and finest at the edge, where Fresnel's law is steep. A smooth cylinder spreads a segment's light between two
angles round it; by the difference of the logistic's distribution there its mean density is known in closed form, so
that no roughness is too small for so few segments. That is ours; others take single rays, as many as the roughness asks
for. What is left is that a segment has one share: pictures of the examples are off by up to 0.6 % of their brightest,
at the bounds of the parameters.

[1] S. Marschner et al., "Light Scattering from Human Hair Fibers", SIGGRAPH 2003.
[2] E. d'Eon et al., "An Energy-Conserving Hair Reflectance Model", EGSR 2011.
[3] M. Chiang et al., "A Practical and Controllable Hair and Fur Model for Production Path Tracing", EGSR 2016.
[4] M. Pharr, "The Implementation of a Hair Scattering Model", pbrt.org, 2016.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import i0e, mean_decay, opacity
from diffrender.parameters import record
from diffrender.shading.hair_view import Hair
from diffrender.shading.microfacet import LEAST_COSINE, fresnel_exact

INDEX = 1.55  # of refraction
SEGMENTS = 16  # between a strand's middle and its edge
# Of R, TT, TRT and all further ways: how much wider than R's their squared widths are [1], and by how many tilts of the
# scales they lean towards the root [3].
WIDTHS = (1.0, 0.25, 4.0, 4.0)
LEANS = (2.0, -1.0, -4.0, 0.0)
_EVEN = 0.5 / math.pi  # density all round a circle [1/rad]


@record
class Ways:
    """Ways of light through strands that an eye sees, by segment, of either half.

    Attributes:
        shares: of light, of R, TT, TRT and all further ways; together at most 1.
        azimuth: where R, TT and TRT leave on one side, from the eye's, in the middle of the segment [rad]; on the
            other it is the opposite.
        half_width: of where they leave [rad].
    """

    shares: Float[Tensor, "*batch segments 4 3"]
    azimuth: Float[Tensor, "*batch segments 3"]
    half_width: Float[Tensor, "*batch segments 3"]


@record
class Round:
    """Where a light is round a strand.

    Attributes:
        azimuth: from the eye's [rad].
        share: by which there is one, for light along the strand is on no side of it: from 0, even all round, to 1.
    """

    azimuth: Float[Tensor, "*#batch"]
    share: Float[Tensor, "*#batch"]


def absorption(hair: Hair) -> Float[Tensor, "*batch 3"]:
    """Of light that crosses a strand, by its radius: what leaves the colour of straight on a way of two radii.

    Not Chiang's fit to the colour of much hair [3], whose strands are nearly clear: without light from strand to
    strand, which is not drawn, they would be grey.
    """
    return -0.5 * torch.log(hair.colour)


def variances(hair: Hair) -> Float[Tensor, "*batch 4"]:
    """Squared width along the strand of each lobe, of which R's is Chiang's fit [3, equation 7]."""
    rough = hair.longitudinal_roughness
    square = rough * rough
    fourth = square * square
    eighth = fourth * fourth
    width = 0.726 * rough + 0.812 * square + 3.7 * eighth * eighth * fourth
    return (width * width)[..., None] * width.new_tensor(WIDTHS)


def azimuthal_scale(hair: Hair) -> Float[Tensor, "*batch"]:
    """Scale of the logistic round the strand [rad], Chiang's fit [3, equation 8]."""
    rough = hair.azimuthal_roughness
    square = rough * rough
    fourth = square * square
    eighth = fourth * fourth
    wide = eighth * eighth * fourth * square
    return math.sqrt(math.pi / 8.0) * (0.265 * rough + 1.194 * square + 5.372 * wide)


def mirror_angles(eye_angle: Float[Tensor, "*#batch"], tilt: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 4"]:
    """Angle along the strand of an eye, for which each lobe's middle is its mirror's, by the scales' tilt [rad].

    Past a quarter turn it is on the strand's other side.
    """
    angle = eye_angle[..., None] + tilt[..., None] * tilt.new_tensor(LEANS)
    over = torch.where(angle < 0.0, -math.pi, math.pi) - angle
    return torch.where(angle.abs() > 0.5 * math.pi, over, angle)


def along(
    light_angle: Float[Tensor, "*#batch"],
    mirror_angle: Float[Tensor, "*#batch 4"],
    variance: Float[Tensor, "*#batch 4"],
) -> Float[Tensor, "*batch 4"]:
    """Density M of lights along the strand, by each lobe; times the cosine it is 1 over all angles [2].

    Written by the sum of both angles: of the published exponents only differences matter, in which float32 has no
    digits left for narrow lobes.
    """
    angle = light_angle[..., None]
    turned = torch.sin(0.5 * (angle + mirror_angle))
    product = torch.cos(angle) * torch.cos(mirror_angle) / variance
    # Rounding takes cosines of 90 degrees below 0, where the derivatives are those of the other side.
    exponent = product.abs() - product - 2.0 * turned * turned / variance
    return i0e(product) * torch.exp(exponent) / (variance * opacity(2.0 / variance))


def ways(cos_eye: Float[Tensor, "*#batch"], absorption: Float[Tensor, "*#batch 3"]) -> Ways:
    """All ways of light to an eye, by its cosine along the strand.

    An eye that looks along the strand is taken as just beside, where nearly all is mirrored.
    """
    cosine = cos_eye.clamp(min=LEAST_COSINE)[..., None]
    left = torch.linspace(1.0, 0.0, SEGMENTS + 1, dtype=torch.float64)
    outside = 0.5 * math.pi * (1.0 - left * torch.sqrt(left))
    middle = 0.5 * (outside[1:] + outside[:-1])
    weight = (torch.sin(outside[1:]) - torch.sin(outside[:-1])).to(cosine)
    shares = _shares(cosine, middle.to(cosine), absorption) * weight[:, None, None]
    inside = torch.asin(_bent_sine(cosine, torch.sin(outside).to(cosine)))
    # R, TT and TRT leave at 2 p inside - 2 outside + p pi.
    times = cosine.new_tensor((0.0, 1.0, 2.0))
    leaving = times * (2.0 * inside[..., None] + math.pi) - 2.0 * outside.to(cosine)[:, None]
    begin, end = leaving[..., :-1, :], leaving[..., 1:, :]
    return Ways(shares, 0.5 * (begin + end), 0.5 * (end - begin).abs())


def around(ways: Ways, light: Round, scale: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 4 3"]:
    """Density of lights round the strand, times the share of light: mean of A N over its width, per lobe [1/rad]."""
    sides = torch.stack([ways.azimuth, -ways.azimuth], -1)
    apart = light.azimuth[..., None, None, None] - sides
    apart = apart - 2.0 * math.pi * torch.floor(apart / (2.0 * math.pi) + 0.5)
    density = _logistic_mean(apart, ways.half_width[..., None], scale[..., None, None, None]).mean(-1)
    density = _EVEN + light.share[..., None, None] * (density - _EVEN)
    sharp = (density[..., None] * ways.shares[..., :3, :]).sum(-3)
    rest = ways.shares[..., 3:, :].sum(-3) * _EVEN
    return torch.cat([sharp, rest + 0.0 * sharp[..., :1, :]], -2)


def kept(half_width: Float[Tensor, "*#batch"], scale: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Share of a logistic that is within half a turn, in the mean over middles up to so far to either side.

    By two points, which is the mean to the fourth power of the width.
    """
    aside = half_width / math.sqrt(3.0)
    return 0.5 * (torch.tanh(0.5 * (math.pi + aside) / scale) + torch.tanh(0.5 * (math.pi - aside) / scale))


def _logistic_mean(apart: Tensor, half_width: Tensor, scale: Tensor) -> Tensor:
    """Mean density of the cut logistic between two angles, by their middle.

    It is the distribution's difference over the width, as a product, which is exact for no width too.
    """
    above, below = (apart + half_width) / scale, (apart - half_width) / scale
    mean = torch.sigmoid(above) * torch.sigmoid(-below) * mean_decay(2.0 * half_width / scale) / scale
    return mean / kept(half_width, scale)


def _bent_sine(cos_eye: Tensor, across: Tensor) -> Tensor:
    """Sine of the angle inside, in the plane across the strand, of light that meets it so far from its middle.

    By Bravais' index of refraction [1].
    """
    return across * cos_eye / torch.sqrt(INDEX * INDEX - 1.0 + cos_eye * cos_eye)


def _shares(cos_eye: Tensor, angle: Tensor, absorption: Tensor) -> Tensor:
    """Shares of light of each way, by the angle of the surface across the strand."""
    bent = _bent_sine(cos_eye, torch.sin(angle))
    # Inside, cosines across the strand and along it.
    across, inside = torch.sqrt((1.0 - bent) * (1.0 + bent)), torch.sqrt(1.0 - (1.0 - cos_eye * cos_eye) / INDEX**2)
    passed = torch.exp(-absorption[..., None, :] * (2.0 * across / inside)[..., None])
    mirrored = fresnel_exact(INDEX, cos_eye * torch.cos(angle))[..., None]
    crossed = 1.0 - mirrored
    through = crossed * crossed * passed
    again = mirrored * passed
    further = through * again * again / (crossed + mirrored * (1.0 - passed))
    return torch.stack([mirrored + 0.0 * passed, through, through * again, further], -2)
