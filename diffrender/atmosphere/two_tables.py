"""The sky of Final Fantasy XV: two tables over the heights of sun and view, times phase functions [1].

    Sky = LutR(theta, gamma) phaseR(mu) + LutM(theta, gamma) phaseM(mu, g)

theta is the sun's zenith angle, gamma the view's, mu the cosine of the angle between them, g the haziness. The tables
are made by least squares from a sky of given air, so that haziness alone acts on it afterwards; how the
sky differs by azimuth is left to the phase functions, which know nothing of the earth's shadow.

The tables that come with the package are made from the march of the default sky, by the command

    fit tables --out diffrender/atmosphere/two_tables.safetensors

[1] M. Miyamoto, R. Driancourt, "Rendering techniques of Final Fantasy XV", SIGGRAPH 2016.
"""

from functools import cache
from importlib.resources import files

import torch
from jaxtyping import Float
from safetensors.torch import load
from torch import Tensor

from diffrender.atmosphere import sky_view, sun_axis
from diffrender.atmosphere.sky_view import SkyView
from diffrender.numerics import lookup
from diffrender.parameters import record

PACKAGED = "two_tables.safetensors"
ROWS = 24  # of the tables that come with the package
# Tables are fitted to. Without several the two could not be told apart where all azimuths look the same, at the zenith.
HAZINESSES = (0.5, 0.65, 0.76, 0.85, 0.9)
DARK = 1e-12  # radiance per irradiance of the sun [1/sr] far below that of the deepest twilight


@record
class TwoTables:
    """Light per irradiance of the sun, over the elevations of the sun (`sun_axis`) and of the view (`sky_view`)."""

    air: Float[Tensor, "suns rows 3"]  # LutR [1]; what is scattered more than once is in it
    haze: Float[Tensor, "suns rows 3"]  # LutM [1]
    cloud: Float[Tensor, "suns 3"]  # radiance [1/sr] at the zenith of an overcast layer that lets all light through


@record
class OneSun:
    """The tables at one elevation of the sun."""

    air: Float[Tensor, "rows 3"]
    haze: Float[Tensor, "rows 3"]
    cloud: Float[Tensor, "3"]


@record
class TwoTabledView:
    """A view with its tables."""

    view: SkyView
    tables: OneSun


@cache
def packaged() -> TwoTables:
    """The tables that come with the package, in float32; their eye is at 2 m."""
    return TwoTables(**load(files(__package__).joinpath(PACKAGED).read_bytes()))


def at_sun(tables: TwoTables, to_sun: Float[Tensor, "3"]) -> OneSun:
    """Tables at an elevation of the sun, in its precision and on its device."""
    index = sun_axis.place(sky_view.elevation(to_sun), tables.air.shape[0])
    return OneSun(**{name: sun_axis.between(table.to(to_sun), index) for name, table in vars(tables).items()})


def look_up(prepared: TwoTabledView) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """What the phase functions of air and of haze are multiplied by along each view [1]."""
    row = sky_view.row(prepared.view, prepared.tables.air.shape[0])
    by_air, by_haze = (
        lookup(table[:, None], row, torch.zeros_like(row)) for table in (prepared.tables.air, prepared.tables.haze)
    )
    return by_air, by_haze


def least_positive(
    functions: Float[Tensor, "rows n 3 2"], wanted: Float[Tensor, "rows n 3"]
) -> Float[Tensor, "rows 3 2"]:
    """Factors of two positive functions, neither of them negative, whose sums are nearest to what is wanted."""
    squares = torch.einsum("rnci,rncj->rcij", functions, functions)
    products = torch.einsum("rnci,rnc->rci", functions, wanted)
    alone = products / torch.diagonal(squares, dim1=-2, dim2=-1)
    # A share of the diagonal that changes nothing but what both functions do alike.
    both = torch.linalg.solve(squares + 1e-12 * torch.diag_embed(torch.diagonal(squares, dim1=-2, dim2=-1)), products)
    first, second = both.unbind(-1)
    nothing = torch.zeros_like(first)
    without_second = torch.stack([alone[..., 0], nothing], -1)
    without_first = torch.stack([nothing, alone[..., 1]], -1)
    found = torch.where((second < 0.0)[..., None], without_second, both)
    return torch.where((first < 0.0)[..., None], without_first, found)
