"""Colour: luminance, primaries, white balance, exposure, and the encodings of displays.

Channels last; linear Rec. 709 unless said.

[1] B. Lindbloom, "Chromatic adaptation", brucelindbloom.com: the linear Bradford transform, as in ICC profiles.
[2] IEC 61966-2-1, "Default RGB colour space - sRGB", 1999.
[3] SMPTE ST 2084, "High Dynamic Range Electro-Optical Transfer Function of Mastering Reference Displays", 2014.
[4] S. Lagarde, C. de Rousiers, "Moving Frostbite to PBR", SIGGRAPH 2014 course, section 5.1.
[5] H. Malvar, G. Sullivan, "YCoCg-R: A Color Space with RGB Reversibility and Low Dynamic Range", JVT-I014r3, 2003.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Float64
from torch import Tensor

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x and y of red, green, blue, white (ITU-R BT.709)
LUMINANCE = (0.2126, 0.7152, 0.0722)  # shares of red, green, blue (ITU-R BT.709)
BRADFORD = ((0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296))  # XYZ -> cones [1]

SRGB_KNEE = 0.0031308  # linear value up to which sRGB is a straight line [2]
SRGB_SLOPE = 12.92

PQ_PEAK = 10_000.0  # luminance that PQ encodes as 1 [cd/m^2]
PQ_M1, PQ_M2 = 2610 / 16384, 2523 / 32
PQ_C2, PQ_C3 = 2413 / 128, 2392 / 128
PQ_C1 = PQ_C3 - PQ_C2 + 1.0
PQ_KNEE = 1e-10  # share of the peak up to which ours is a straight line; encoded, half a step of 12 bits
PQ_KNEE_ENCODED = ((PQ_C1 + PQ_C2 * PQ_KNEE**PQ_M1) / (1.0 + PQ_C3 * PQ_KNEE**PQ_M1)) ** PQ_M2

SENSOR_CALIBRATION = 12.5  # K of ISO 2720: reflected-light meters [cd s/m^2]
SATURATION_OVER_EXPOSURE = 1.2  # 78 / (100 q) with the lens and vignetting factor q = 0.65 [4]


def rec709_from(chromaticities: Sequence[float]) -> Float64[Tensor, "3 3"]:
    """Matrix that takes linear colours of other primaries to Rec. 709; apply it as `colour @ matrix.T`.

    The chromaticities are x and y of red, green, blue and white, as in an OpenEXR header. White stays
    neutral, (1, 1, 1) becomes (1, 1, 1), by linear Bradford adaptation to D65 [1].

    Raises:
        ValueError: when the white does not lie inside the triangle of the primaries.

    >>> rec709_from((0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290))[0]
    tensor([ 1.6605, -0.5876, -0.0728], dtype=torch.float64)
    """
    to_xyz = _adaptation(chromaticities, REC709) @ _xyz_from(chromaticities)
    matrix: Tensor = torch.linalg.solve(_xyz_from(REC709), to_xyz)
    return matrix


def luminance(colour: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Luminance of linear Rec. 709 colours, in their own unit.

    >>> luminance(torch.tensor([[1.0, 1.0, 1.0], [0.0, 1.0, 0.0]]))
    tensor([1.0000, 0.7152])
    """
    return (colour * colour.new_tensor(LUMINANCE)).sum(-1)


def neutral_gains(white: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """White balance: gains per channel that turn a colour neutral and keep its luminance.

    >>> neutral_gains(torch.tensor([2.0, 1.0, 0.5])) * torch.tensor([2.0, 1.0, 0.5])
    tensor([1.1765, 1.1765, 1.1765])
    """
    return luminance(white)[..., None] / white


def ev100_of_camera(aperture: float, seconds: float, iso: float) -> float:
    """Exposure value at ISO 100 of a camera's settings: one more is half the light.

    >>> round(ev100_of_camera(aperture=16.0, seconds=1 / 125, iso=100.0), 2)
    14.97
    """
    return math.log2(aperture * aperture / seconds * 100.0 / iso)


def ev100_of_luminance(mean: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Exposure value at ISO 100 that a light meter advises for a mean luminance [cd/m^2].

    >>> ev100_of_luminance(torch.tensor([0.125, 4096.0]))
    tensor([ 0., 15.])
    """
    return torch.log2(mean * (100.0 / SENSOR_CALIBRATION))


def exposure_from_ev100(ev100: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Factor that takes luminance to a picture whose sensor saturates at 1 [m^2/cd].

    Multiply lights by it before shading, not the picture after it: half floats end at 65504, and the sun does not.

    >>> 1.0 / exposure_from_ev100(torch.tensor(15.0))
    tensor(39321.6016)
    """
    return torch.exp2(-ev100) / SATURATION_OVER_EXPOSURE


def preview(radiance: Float[Tensor, "*batch 3"], exposure: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch 3"]:
    """Picture for a screen, sRGB in [0, 1]: exposed and cut off; highlights turn white, nothing is compressed.

    Gradient: 0 where a channel is cut off.
    """
    return srgb_encode((radiance * exposure[..., None]).clamp(0.0, 1.0))


def srgb_encode(linear: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """SRGB value of a linear one [2]; the curve goes on above 1, the straight line below 0.

    Gradient: finite everywhere; it falls by 1.7 % at the knee, where the standard has a corner.

    >>> srgb_encode(torch.tensor([0.0, 0.0031308, 0.2140, 1.0]))
    tensor([0.0000, 0.0404, 0.5000, 1.0000])
    """
    bright = linear > SRGB_KNEE
    curve = 1.055 * torch.where(bright, linear, torch.ones_like(linear)) ** (1.0 / 2.4) - 0.055
    return torch.where(bright, curve, SRGB_SLOPE * linear)


def srgb_decode(encoded: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Linear value of an sRGB one [2]; the inverse of `srgb_encode`, with its limits."""
    bright = encoded > SRGB_KNEE * SRGB_SLOPE
    curve = ((torch.where(bright, encoded, torch.ones_like(encoded)) + 0.055) / 1.055) ** 2.4
    return torch.where(bright, curve, encoded / SRGB_SLOPE)


def pq_encode(displayed: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """PQ value of a displayed luminance [cd/m^2]: 0 for black, and for negative ones; 1 for 10 000 [3].

    Departs from [3] below 1e-6 cd/m^2, where the curve's slope is endless: a straight line to 0.
    Gradient: finite from 0 up; 0 below 0.

    >>> pq_encode(torch.tensor([0.0, 1.0, 100.0, 10_000.0]))
    tensor([0.0000, 0.1499, 0.5081, 1.0000])
    """
    share = (displayed / PQ_PEAK).clamp(min=0.0)
    bright = share > PQ_KNEE
    log_power = PQ_M1 * torch.log(torch.where(bright, share, torch.ones_like(share)))
    # Both logarithms taken as distances from that of 1, else float32 loses two digits to the exponent of 78.
    missing = -torch.expm1(log_power) * (1.0 - PQ_C1) / (1.0 + PQ_C3 * torch.exp(log_power))
    curve = torch.exp(PQ_M2 * torch.log1p(-missing))
    return torch.where(bright, curve, share * (PQ_KNEE_ENCODED / PQ_KNEE))


def pq_decode(encoded: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Displayed luminance of a PQ value in [0, 1] [cd/m^2]; the inverse of `pq_encode`, with its limits."""
    bright = encoded > PQ_KNEE_ENCODED
    rise = torch.expm1(torch.log(torch.where(bright, encoded, torch.ones_like(encoded))) / PQ_M2)
    curve = ((1.0 - PQ_C1 + rise) / (PQ_C2 - PQ_C3 - PQ_C3 * rise)) ** (1.0 / PQ_M1)
    return PQ_PEAK * torch.where(bright, curve, encoded.clamp(min=0.0) * (PQ_KNEE / PQ_KNEE_ENCODED))


def ycocg_from_rgb(colour: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Brightness, orange minus blue, green minus magenta [5]; the two differences are 0 for greys.

    >>> ycocg_from_rgb(torch.tensor([1.0, 0.5, 0.0]))
    tensor([0.5000, 0.5000, 0.0000])
    """
    red, green, blue = colour.unbind(-1)
    return torch.stack([(red + blue) / 4 + green / 2, (red - blue) / 2, green / 2 - (red + blue) / 4], -1)


def rgb_from_ycocg(colour: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Red, green and blue; the inverse of `ycocg_from_rgb`."""
    brightness, orange, green = colour.unbind(-1)
    return torch.stack([brightness + orange - green, brightness + green, brightness - orange - green], -1)


def _xyz_from(chromaticities: Sequence[float]) -> Float64[Tensor, "3 3"]:
    """Matrix from linear colours of some primaries to XYZ, with Y = 1 for (1, 1, 1)."""
    primaries, white = _points(chromaticities)
    amounts, singular = torch.linalg.solve_ex(primaries.mT, white)
    if singular or not bool((torch.cat([amounts, _cones(white)]) > 0.0).all()):
        given = ", ".join(f"{value:g}" for value in chromaticities)
        raise ValueError(
            f"chromaticities {given}: the white must be an everyday one inside the triangle of red, green and blue, "
            "each given by x and y; correct them where the picture was written"
        )
    columns: Tensor = primaries.mT * amounts
    return columns


def _adaptation(seen: Sequence[float], wanted: Sequence[float]) -> Float64[Tensor, "3 3"]:
    """Matrix from XYZ under one white to XYZ under another [1]."""
    source, target = (_cones(_points(chromaticities)[1]) for chromaticities in (seen, wanted))
    to_cones = torch.tensor(BRADFORD, dtype=torch.float64)
    matrix: Tensor = torch.linalg.inv(to_cones) @ torch.diag(target / source) @ to_cones
    return matrix


def _cones(white: Float64[Tensor, "3"]) -> Float64[Tensor, "3"]:
    """Responses of Bradford's sharpened cones [1]."""
    return (torch.tensor(BRADFORD, dtype=torch.float64) * white).sum(-1)


def _points(chromaticities: Sequence[float]) -> tuple[Float64[Tensor, "3 3"], Float64[Tensor, "3"]]:
    """X, Y, Z of red, green and blue in rows with sum 1, and of white with Y = 1."""
    pairs = torch.tensor(chromaticities, dtype=torch.float64).reshape(4, 2)
    points = torch.cat([pairs, 1.0 - pairs.sum(-1, keepdim=True)], -1)
    return points[:3], points[3] / points[3, 1]
