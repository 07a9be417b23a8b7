"""What is known of a sky's parameters before its photo is seen: a centre and a standard deviation each, with sources.

A search is drawn to the centres so weakly that the photo decides wherever it speaks; error bars count the spreads of
all that a fit holds still. `experiments.coverage` draws its skies from here.

Optical depths are in units of a clear day's haze, 4.44e-6 per metre over 1.2 km: 0.0053 at 550 nm.

[1] O. Dubovik et al., "Variability of absorption and optical properties of key aerosol types observed in worldwide
    locations", Journal of the Atmospheric Sciences 59, 2002, table 1: mean cosines of 0.6 to 0.7 for fine particles,
    above 0.7 where dust shares; Angstrom exponents of 1.2 to 2.5 for smoke and cities, 0 to 1.5 for dust and sea.
[2] N. O'Neill et al., "The lognormal distribution as a reference for reporting aerosol optical depth statistics",
    Geophysical Research Letters 27(20), 2000: optical depths are log-normal, with geometric deviations of about 2.
[3] N. O'Neill et al., "Spectral discrimination of coarse and fine mode optical depth", Journal of Geophysical Research
    108(D17), 2003: fine and coarse particles are told apart; the coarse ones vary by more.
[4] J. L. Pinedo et al., "Assessment of the latitudinal behavior of total column ozone at nine discrete 1-degree-wide
    latitude bands", The Open Atmospheric Science Journal 7, 2013: 250 to 430 Dobson units by latitude and season.
[5] T. R. Oke, "Boundary layer climates", 2nd edition, 1987, table 1.1: 0.05 (forest) to 0.4 (light dry soil).
[6] No climatology: spread over what fits of the eleven photos of `experiments.fit_accuracy` found. Air is less than the
    earth's there, because the wide bands of cameras see its blue weakened.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from diffrender.parameters import Specification
from diffrender.scene import weather_names
from fit.minimum import Point


@dataclass(frozen=True)
class Prior:
    """Normal distribution, in the parameter's own scale, cut off at its bounds."""

    centre: float  # in the library's unit
    spread: float  # standard deviation; for log parameters the factor that is one


PRIORS = {
    "SKY_HAZINESS": Prior(0.6, 0.12),  # [1]: of mean cosine 0.67
    "SKY_MIE_SCALE": Prior(12.0, 2.2),  # [2]: optical depth 0.06, the fine particles' part
    "SKY_MIE_COLOUR_EXPONENT": Prior(1.5, 0.7),  # [1]
    "SKY_COARSE_SCALE": Prior(1.0, 3.0),  # [3], on the clear side: optical depth 0.005
    "SKY_COARSE_HAZINESS": Prior(0.88, 0.06),  # [1] for dust, higher for ice: of mean cosine 0.91
    "SKY_RAYLEIGH_SCALE": Prior(0.6, 1.6),  # [6]
    "SKY_RAYLEIGH_COLOUR_EXPONENT": Prior(4.0, 0.7),  # [6], about Rayleigh's
    "SKY_OZONE": Prior(1.0, 0.15),  # [4]
    "SKY_GROUND_ALBEDO": Prior(0.2, 0.1),  # [5]
    "SKY_OVERCAST": Prior(0.3, 0.25),  # [6]
    "SKY_OVERCAST_AHEAD": Prior(0.0, 2.5),  # [6]
    "SKY_OVERCAST_LEFT": Prior(0.0, 2.5),  # [6]
    "SKY_OVERCAST_TRANSMITTANCE_R": Prior(0.35, 1.2),  # [6]
    "SKY_OVERCAST_TRANSMITTANCE_B": Prior(0.35, 1.2),  # [6]
}


@dataclass(frozen=True)
class UnitPriors:
    """Centres and standard deviations in the unit cube."""

    centre: Point
    spread: Point


def in_unit_cube(names: Sequence[str]) -> UnitPriors:
    """Priors of weather-file names; one that has none counts as anywhere between its bounds."""
    pairs = [_in_unit(name) for name in names]
    return UnitPriors(np.array([centre for centre, _ in pairs]), np.array([spread for _, spread in pairs]))


@cache
def _in_unit(name: str) -> tuple[float, float]:
    if name not in PRIORS:
        return 0.5, math.sqrt(1.0 / 12.0)  # mean and deviation of an even distribution
    prior, known = PRIORS[name], weather_names()[name]
    (low, high), centre, spread = (
        _own_scale(known, *pair) for pair in (known.bounds, (prior.centre,), (prior.spread,))
    )
    return (centre[0] - low) / (high - low), spread[0] / (high - low)


def _own_scale(known: Specification, *values: float) -> tuple[float, ...]:
    return tuple(map(math.log, values)) if known.scale == "log" else values
