"""The sky's tables over the sun's elevation, so that a time of day is looked up, and their blend between two weathers.

In-scatter, sunlight and skylight are stored, as the Decima engine does [1]. Its axis of altitudes is left out, for the
eye stays where it stands; its axis of two weather types is a pair of these tables and a share.

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: advances in lighting and AA", SIGGRAPH 2017, slides 22-23.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import sky_view, sun_axis
from diffrender.atmosphere.scattering import Medium
from diffrender.atmosphere.sky_tables import SkyTables
from diffrender.parameters import record


@record
class Daylight:
    """All that the sky of one weather gives a scene at one elevation of the sun."""

    in_scatter: Float[Tensor, "rows columns 3 3"]  # as in SkyTables
    cloud: Float[Tensor, "3"]  # as in SkyTables
    sunlight: Float[Tensor, "3"]  # share of the sun's irradiance that reaches the eye through the air
    skylight: Float[Tensor, "3"]  # irradiance of level ground by the clear sky, over the sun's
    amount: Float[Tensor, "3 3"]  # of what scatters, as in `amount`

    def sky(self) -> SkyTables:
        """Those of the tables that a sky is drawn from."""
        return SkyTables(self.in_scatter, self.cloud)


@record
class StoredTables:
    """Daylight of one weather over the sun's elevation; its cells are those of `sun_axis`."""

    in_scatter: Float[Tensor, "suns rows columns 3 3"]
    cloud: Float[Tensor, "suns 3"]
    sunlight: Float[Tensor, "suns 3"]
    skylight: Float[Tensor, "suns 3"]
    amount: Float[Tensor, "3 3"]


def amount(air: Medium) -> Float[Tensor, "3 3"]:
    """Scattering by air and by haze [1/m], to which their in-scatter is proportional, and 1 for higher orders."""
    return torch.stack([air.rayleigh, air.haze_scattering, torch.ones_like(air.rayleigh)])


def stored(each: Sequence[Daylight]) -> StoredTables:
    """Tables from the daylight of every cell, the lowest sun first."""
    names = ("in_scatter", "cloud", "sunlight", "skylight")
    return StoredTables(**{n: torch.stack([getattr(one, n) for one in each]) for n in names}, amount=each[0].amount)


def at_sun(tables: StoredTables, to_sun: Float[Tensor, "3"]) -> Daylight:
    """Daylight under a sun, between that of the two cells round its elevation."""
    index = sun_axis.place(sky_view.elevation(to_sun), tables.cloud.shape[0])
    found = {name: sun_axis.between(table, index) for name, table in vars(tables).items() if name != "amount"}
    return Daylight(**found, amount=tables.amount)


def between(first: Tensor, second: Tensor, share: Float[Tensor, ""]) -> Tensor:
    """Values between those of two tables, by their logarithms."""
    return sun_axis.between(torch.stack([first, second]), share)


def blended(first: Daylight, second: Daylight, share: Float[Tensor, ""]) -> Daylight:
    """Daylight of air that is mixed of two weathers: all of the first at a share of 0, of the second at 1."""
    sky = sky_blended(first.sky(), second.sky(), torch.stack([first.amount, second.amount]), share)
    return Daylight(
        in_scatter=sky.in_scatter,
        cloud=sky.cloud,
        sunlight=between(first.sunlight, second.sunlight, share),
        skylight=between(first.skylight, second.skylight, share),
        amount=torch.lerp(first.amount, second.amount, share),
    )


def sky_blended(
    first: SkyTables, second: SkyTables, amounts: Float[Tensor, "2 3 3"], share: Float[Tensor, ""]
) -> SkyTables:
    """Tables of the sky for air that is mixed of two weathers, given the amounts of what scatters in each.

    What scatters light is mixed; what dims it is a factor for each amount, so that its logarithm is mixed. Half way
    from half a clear day's haze to ten times it, the root of the mean square of the error against tables made for the
    mixture is 1 to 4 %, where a mixture of the light itself is off by 5 to 27 % (`experiments.stored_tables`).
    """
    mixed = between(first.in_scatter / amounts[0], second.in_scatter / amounts[1], share)
    return SkyTables(mixed * torch.lerp(amounts[0], amounts[1], share), between(first.cloud, second.cloud, share))
