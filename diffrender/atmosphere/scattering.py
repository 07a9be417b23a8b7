"""Light in a spherical shell of air, haze and ozone: phase functions, columns, and paths along which it scatters.

Heights are carried apart from the planet's radius, and differences of squares are written as products, so that float32
holds at the horizon. Everything here is geometry of unit densities; what scatters how much is a `Medium`.

[1] S. Hillaire, "A scalable and production ready sky and atmosphere rendering technique", EGSR, 2020.
[2] E. Bruneton, F. Neyret, "Precomputed atmospheric scattering", Computer Graphics Forum 27(4), 2008.
[3] S. Chapman, "The absorption and dissociative or ionizing effect of monochromatic radiation in an atmosphere on a
    rotating earth", Proceedings of the Physical Society 43, 1931.
[4] L. Henyey, J. Greenstein, "Diffuse radiation in the galaxy", Astrophysical Journal 93, 1941.
[5] W. Cornette, J. Shanks, "Physically reasonable analytic expression for the single-scattering phase function",
    Applied Optics 31(16), 1992.
"""

import itertools
import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import erfcx, mean_decay, safe_sqrt
from diffrender.parameters import record

PLANET_RADIUS = 6_360e3  # [m], [1]
TOP = 100e3  # height where the air ends [m], [1]
RAYLEIGH_HEIGHT = 8e3  # e-fold climb of the air's density [m], [1]
HAZE_HEIGHT = 1.2e3  # e-fold climb of the haze's density [m], [1]
OZONE_MIDDLE, OZONE_HALF_WIDTH = 25e3, 15e3  # tent of the ozone's density [m], [1]
RAYLEIGH = (5.802e-6, 13.558e-6, 33.1e-6)  # scattering of the air at height 0 [1/m], [1]
HAZE = 4.44e-6  # extinction of a clear day's haze at height 0 [1/m], [1]
OZONE = (0.650e-6, 1.881e-6, 0.085e-6)  # absorption in the middle of the tent [1/m], [1]
WAVELENGTH = (680e-9, 550e-9, 440e-9)  # of the channels [m], [2]
SUN_RADIUS = 0.004675  # angular radius of the sun [rad], Bruneton 2017, reference code


def rayleigh_phase(chord_square: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of scattered light per solid angle for molecules [1/sr].

    The angle is given as |view - sun|², twice the cosine's distance from 1, which float32 keeps near the sun.
    """
    cosine = 1.0 - 0.5 * chord_square
    return 3.0 / (16.0 * math.pi) * (1.0 + cosine * cosine)


def henyey_greenstein(chord_square: Float[Tensor, "*batch"], asymmetry: Float[Tensor, ""]) -> Float[Tensor, "*batch"]:
    """Share of scattered light per solid angle [1/sr] with mean cosine `asymmetry` in (-1, 1) [4]."""
    return (1.0 - asymmetry * asymmetry) / (4.0 * math.pi) / _spread(chord_square, asymmetry)


def cornette_shanks(chord_square: Float[Tensor, "*batch"], asymmetry: Float[Tensor, ""]) -> Float[Tensor, "*batch"]:
    """Share of scattered light per solid angle [1/sr]; Rayleigh's at asymmetry 0 [5].

    Turned up, the glow gathers round the sun. Its mean cosine is 3g(4 + g²) / (5(2 + g²)), not g.
    """
    square = asymmetry * asymmetry
    cosine = 1.0 - 0.5 * chord_square
    factor = 3.0 / (8.0 * math.pi) * (1.0 - square) / (2.0 + square)
    return factor * (1.0 + cosine * cosine) / _spread(chord_square, asymmetry)


def _spread(chord_square: Tensor, asymmetry: Tensor) -> Tensor:
    # (1 - g)² + 2g(1 - cos): the textbook's 1 + g² - 2g cos cancels in the forward peak.
    base = (1.0 - asymmetry) * (1.0 - asymmetry) + asymmetry * chord_square
    return base * torch.sqrt(base)


@record
class Medium:
    """What the shell is made of: coefficients [1/m] where each species is densest, and the ground below."""

    rayleigh: Float[Tensor, "3"]  # scattering
    haze: Float[Tensor, "3"]  # extinction
    haze_scattering: Float[Tensor, "3"]
    ozone: Float[Tensor, "3"]  # absorption
    ground_albedo: Float[Tensor, ""]

    def extinction(self) -> Float[Tensor, "3 3"]:
        """Extinction [1/m] by species (air, haze, ozone) and channel."""
        return torch.stack([self.rayleigh, self.haze, self.ozone])

    def scattering(self) -> Float[Tensor, "3 3"]:
        """Scattering [1/m] by species (air, haze, ozone) and channel."""
        return torch.stack([self.rayleigh, self.haze_scattering, torch.zeros_like(self.ozone)])


def density(height: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
    """Density of air, haze and ozone relative to their densest, at a height above the ground [m]."""
    ozone = torch.relu(1.0 - (height - OZONE_MIDDLE).abs() / OZONE_HALF_WIDTH)
    return torch.stack([torch.exp(-height / RAYLEIGH_HEIGHT), torch.exp(-height / HAZE_HEIGHT), ozone], -1)


def column(height: Float[Tensor, "*batch"], cosine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
    """Length of dense air, haze and ozone from a point to space [m], along a ray at `cosine` from the zenith.

    Below the horizontal a ray is twice the one from its lowest point less the one going up. A ray that would dip below
    the ground counts as if the ground were 10 km lower: nearly opaque, but finite. Within 0.1 % of the integral
    for rays above the horizontal, 0.5 % below.
    """
    radius = PLANET_RADIUS + height
    sine = safe_sqrt(1.0 - cosine * cosine)
    falls = cosine < 0.0
    dip = height - radius * cosine * cosine / (1.0 + sine)
    lowest = torch.where(falls, torch.clamp(dip, min=-10e3), height)
    level = torch.zeros_like(cosine)
    # One sign decides here as above: abs() has no slope at a sun that stands exactly level, where the column has one.
    up = _column_up(height, torch.where(falls, -cosine, cosine))
    return torch.where(falls[..., None], 2.0 * _column_up(lowest, level) - up, up)


def _column_up(height: Tensor, cosine: Tensor) -> Tensor:
    exponential = [
        scale * torch.exp(-height / scale) * chapman((PLANET_RADIUS + height) / scale, cosine)
        for scale in (RAYLEIGH_HEIGHT, HAZE_HEIGHT)
    ]
    return torch.stack([*exponential, _ozone_up(height, cosine)], -1)


def chapman(radius: Float[Tensor, "*batch"], cosine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Column along a ray relative to the vertical one, in an exponential atmosphere [3].

    `radius` is in units of the scale height, `cosine` of the zenith angle in [0, 1]. 1 at the zenith,
    sqrt(pi radius / 2) at the horizon; a parabola for the height near the ray's lowest point keeps it within 0.1 %.
    """
    # Near the zenith the quotients below are 1/cosine, whatever the floor under the sine.
    sine = torch.sqrt(torch.clamp(1.0 - cosine * cosine, min=1e-6))
    steepness = torch.sqrt(radius / 2.0) * cosine / sine
    return torch.sqrt(math.pi / 2.0 * radius) / sine * erfcx(steepness)


# Gauss and Legendre's rule on [-1, 1]: place and weight of each of its four nodes.
GAUSS_4 = ((-0.8611363115940526, 0.34785484513745385), (-0.3399810435848563, 0.6521451548625461),
            (0.3399810435848563, 0.6521451548625461), (0.8611363115940526, 0.34785484513745385))  # fmt: skip


def _ozone_up(height: Tensor, cosine: Tensor) -> Tensor:
    borders = [OZONE_MIDDLE + share * OZONE_HALF_WIDTH for share in (-1.0, 0.0, 1.0)]
    reached = [_distance_up(height, cosine, border) for border in borders]
    total = torch.zeros_like(height)
    for near, far in itertools.pairwise(reached):
        for place, weight in GAUSS_4:
            distance = near + (far - near) * (0.5 + 0.5 * place)
            above = height_along(height, cosine, distance) - OZONE_MIDDLE
            total = total + weight * 0.5 * (far - near) * torch.relu(1.0 - above.abs() / OZONE_HALF_WIDTH)
    return total


def _distance_up(height: Tensor, cosine: Tensor, border: float) -> Tensor:
    """Length of a rising ray to a higher border; 0 where the border is lower."""
    rise = torch.relu(border - height) * (2.0 * PLANET_RADIUS + border + height)
    climb = (PLANET_RADIUS + height) * cosine
    # The floor keeps 0/0 from a level ray that starts on the border: 1 m² against a climb of kilometres.
    return rise / (climb + torch.sqrt(climb * climb + torch.clamp(rise, min=1.0)))


def height_along(height: Tensor, cosine: Tensor, distance: Tensor) -> Tensor:
    """Height above the ground [m] after a distance along a ray that starts at a height and zenith cosine."""
    radius = PLANET_RADIUS + height
    gained = distance * (distance + 2.0 * radius * cosine)
    return height + gained / (torch.sqrt(radius * radius + gained) + radius)


def horizon_cosine(height: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Cosine of the zenith angle of the ground's edge as seen from a height: 0 on the ground, negative above."""
    return -safe_sqrt(height * (2.0 * PLANET_RADIUS + height)) / (PLANET_RADIUS + height)


def sunlit(height: Float[Tensor, "*batch"], cosine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of the sun's disc above the ground's edge: 0 in the earth's shadow, 1/2 when half is seen.

    A polynomial within 1.3 % of the disc of the segment of a circle, and as steep as that at half.
    """
    rise = _rise(height, cosine)
    square = rise * rise
    # Slope (1 - x²)(a + b x²), where a = 2 / pi is the circle's in the middle, and b makes the ends 0 and 1.
    middle, side = 2.0 / math.pi, 15.0 / 4.0 - 10.0 / math.pi
    return 0.5 + rise * (middle + square * ((side - middle) / 3.0 - square * (side / 5.0)))


def to_visible_sun(height: Float[Tensor, "*batch"], cosine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Cosine of the zenith angle of the middle of that part of the sun's disc which the ground leaves visible.

    Light of a setting sun comes from there: the air towards the hidden part would dim it too much.
    """
    hidden = 1.0 - _rise(height, cosine)
    # In radii, within 0.03 of the circle's segment: 0 for the whole disc, 4 / (3 pi) for the half, 1 for nothing.
    return cosine + math.sin(SUN_RADIUS) * hidden * (0.5 - (0.5 - 4.0 / (3.0 * math.pi)) * (2.0 - hidden))


def _rise(height: Tensor, cosine: Tensor) -> Tensor:
    """Height of the sun's middle over the ground's edge in its radii, from -1, hidden, to 1, in full view."""
    return torch.clamp((cosine - horizon_cosine(height)) / math.sin(SUN_RADIUS), -1.0, 1.0)


@record
class Paths:
    """Rays through the shell cut into steps, with all that does not depend on the medium.

    What does not depend on the sun keeps a batch of its own, which broadcasts: rays that differ in the sun share it.
    """

    step: Float[Tensor, "*#batch n 1"]  # lengths [m]
    density: Float[Tensor, "*#batch n 3"]  # by species
    height: Float[Tensor, "*#batch n"]
    sun_column: Float[Tensor, "*batch n 3"]  # towards the sun, by species [m]
    sunlit: Float[Tensor, "*batch n 1"]
    cos_sun: Float[Tensor, "*batch n"]  # of the sun's local zenith angle
    ground: Float[Tensor, "*batch 1"]  # sunlight on the ground where the ray ends, by angle alone; 0 in space
    ground_column: Float[Tensor, "*batch 3"]


def paths(
    height: Float[Tensor, "*#batch"],
    cos_view: Float[Tensor, "*#batch"],
    cos_sun: Float[Tensor, "*#batch"],
    cos_angle: Float[Tensor, "*batch"],
    steps: int,
) -> Paths:
    """Rays from a height to space or to the ground, in steps that grow linearly with distance.

    `cos_view` and `cos_sun` are cosines of zenith angles, `cos_angle` of the angle between view and sun.
    """
    length, lands = _length(height, cos_view)
    radius = PLANET_RADIUS + height
    ground_sun = torch.clamp((radius * cos_sun + length * cos_angle) / PLANET_RADIUS, -1.0, 1.0)
    sea = torch.zeros_like(ground_sun)
    return replace(
        _cut(Lines(height, cos_view, cos_sun, cos_angle), length, steps),
        ground=(lands * torch.relu(ground_sun) * sunlit(sea, ground_sun))[..., None],
        ground_column=_lit_column(sea, ground_sun, sunlit(sea, ground_sun)),
    )


@record
class Lines:
    """Half-lines from points in the shell, by the angles that `paths` takes."""

    height: Float[Tensor, "*#batch"]  # [m]
    cos_view: Float[Tensor, "*#batch"]
    cos_sun: Float[Tensor, "*#batch"]
    cos_angle: Float[Tensor, "*batch"]


def stretches(lines: Lines, length: Float[Tensor, "*#batch"], steps: int) -> Paths:
    """The first metres of rays, so many as a length that may be infinite, in steps as of `paths`; without ground.

    They end where the ray meets the ground or leaves for space, whatever is beyond.
    """
    whole, _ = _length(lines.height, lines.cos_view)
    return _cut(lines, torch.minimum(length, whole), steps)


def _cut(lines: Lines, length: Tensor, steps: int) -> Paths:
    height, cos_angle = lines.height, lines.cos_angle
    border = torch.linspace(0.0, 1.0, steps + 1).to(height).square()
    middle = length[..., None] * (border[1:] + border[:-1]) / 2.0
    along = height_along(height[..., None], lines.cos_view[..., None], middle)
    local_sun = ((PLANET_RADIUS + height) * lines.cos_sun)[..., None] + middle * cos_angle[..., None]
    local_sun = torch.clamp(local_sun / (PLANET_RADIUS + along), -1.0, 1.0)
    along_suns = along.expand_as(local_sun)
    lit = sunlit(along_suns, local_sun)
    nothing = torch.zeros_like(local_sun[..., :1])
    return Paths(
        step=length[..., None, None] * (border[1:] - border[:-1])[:, None],
        density=density(along),
        height=along,
        sun_column=_lit_column(along_suns, local_sun, lit),
        sunlit=lit[..., None],
        cos_sun=local_sun,
        ground=nothing,
        ground_column=nothing.expand(*nothing.shape[:-1], 3),
    )


def _lit_column(height: Tensor, cos_sun: Tensor, lit: Tensor) -> Tensor:
    """Column towards the sun; 0 in the dark, where it has no use, and exp() of a larger one is slow in float32."""
    towards = column(height, to_visible_sun(height, cos_sun))
    return torch.where((lit > 0.0)[..., None], towards, torch.zeros_like(towards))


def _length(height: Tensor, cos_view: Tensor) -> tuple[Tensor, Tensor]:
    """Length of a ray within the shell [m], and whether it ends on the ground."""
    climb = (PLANET_RADIUS + height) * cos_view
    below = height * (2.0 * PLANET_RADIUS + height)
    reach = climb * climb - below
    lands = (reach > 0.0) & (cos_view < 0.0)
    rises = cos_view > 0.0
    steep = torch.where(rises, climb, -climb)  # abs() has no slope at a level ray, where the length has one
    # The millimetre keeps 0/0 from a level ray that starts on the ground.
    to_ground = below / (safe_sqrt(reach) + steep + 1e-3)
    # The square metre keeps 0/0 from a level ray that starts where the air ends.
    above = torch.clamp((TOP - height) * (2.0 * PLANET_RADIUS + TOP + height), min=1.0)
    reach_up = torch.sqrt(climb * climb + above) + steep
    # The two roots' product is `above`: neither side of the horizontal cancels.
    to_space = torch.where(rises, above / reach_up, reach_up)
    return torch.where(lands, to_ground, to_space), lands


def transmittance(medium: Medium, columns: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Share of light that passes columns of air, haze and ozone [m], by channel."""
    return torch.exp(-columns @ medium.extinction())


def step_weights(medium: Medium, along: Paths) -> tuple[Float[Tensor, "*rays n 3"], Float[Tensor, "*rays 3"]]:
    """What each step adds to the eye per unit of source [m], and the transmittance of the whole path.

    Exact for a source and an extinction that are constant within the step [1, section 5.3]: thick steps do not
    overshoot.
    """
    depth = (along.density @ medium.extinction()) * along.step
    total = torch.cumsum(depth, -2)
    return torch.exp(depth - total) * mean_decay(depth) * along.step, torch.exp(-total[..., -1, :])
