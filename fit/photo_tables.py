"""FFXV's two tables from photos: the packaged ones, corrected by what the skies of photos show.

What is found is a factor on either table, over the heights of sun and view, by linear least squares of relative
differences, and is not negative. It is smooth, so that a photo also changes what other suns and directions give, and
the less the farther they are from its own; without photos it would be 1.

The exposure of a photo is not known: its sky is taken to be as bright, in the geometric mean over its pixels, as that
of the packaged tables under the same sun; its colours are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from scipy.optimize import nnls
from torch import Tensor

from diffrender.atmosphere import sky, sky_view, sun_axis, two_tables
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.atmosphere.two_tables import TwoTables
from diffrender.colour import luminance
from diffrender.numerics import lookup
from diffrender.parameters import defaults
from diffrender.scene import EYE_ALTITUDE
from fit import photo as photos
from fit import sky_mask, sun
from fit.input_error import InputError
from fit.pixels import averaged, stratified, usable

PIXELS = 2000  # of a photo
SUNS, ROWS = 16, 6  # of the factors
SMOOTH = 1e-4  # weight of the square of a factor's step between neighbours, beside the mean over a photo's pixels
NEAR = 1e-6  # weight of the square of a factor's distance from 1
HAZINESSES = (0.4, 0.5, 0.6, 0.7, 0.76, 0.8, 0.85, 0.9)


@dataclass(frozen=True, eq=False)
class SkySample:
    """Pixels of a photo's sky, each standing for the same solid angle, brought to the packaged tables' brightness."""

    name: str
    view: SkyView
    radiance: Float[Tensor, "n 3"]


@dataclass(frozen=True, eq=False)
class PhotoTables:
    """Tables, the haziness that goes with them, and for each photo how far a sky drawn from them is from it.

    Attributes:
        tables: in float64.
        haziness: to be set when they are drawn from.
        errors: name of a photo -> root of the mean square of the relative difference of radiance.
    """

    tables: TwoTables
    haziness: float
    errors: dict[str, float]


def sample(path: Path, mask_folder: Path | None) -> SkySample:
    """Pixels of the sky of a photo, whose sun is found in it.

    Raises:
        InputError: when the photo or its mask cannot be used.
    """
    photo = photos.read(path)
    place = sun.find(photo)
    mask = sky_mask.read(mask_folder / f"{path.stem}.png", photo) if mask_folder else sky_mask.find(photo, place)
    pixels = averaged(photo, usable(photo, mask.used))
    chosen = stratified(pixels, PIXELS, seed=0)
    direction, radiance = pixels.direction[pixels.used][chosen].double(), pixels.radiance[pixels.used][chosen].double()
    bright = luminance(radiance) > pixels.floor
    bright &= sky_view.elevation(direction) > sky_view.horizon(torch.tensor(EYE_ALTITUDE))
    if int(bright.sum()) < 30:
        raise InputError(f"only {int(bright.sum())} usable pixels of sky in {path}; give a mask, white where sky is")
    ones = torch.ones(3, dtype=torch.float64)
    eye = torch.tensor(EYE_ALTITUDE, dtype=torch.float64)
    view = SkyView(direction[bright], sun.to_sun(place).double(), ones, eye)
    prepared = sky.prepare_two_tables(_packaged_sky(), view)
    ratio = luminance(sky.render_two_tables(_packaged_sky(), prepared)) / luminance(radiance[bright])
    if not bool((ratio > 0.0).all()):
        raise InputError(f"the sun of {path} is too far below the horizon for a sky; give photos by day or in twilight")
    return SkySample(path.name, view, radiance[bright] * torch.exp(torch.log(ratio).mean()))


def from_photos(samples: Sequence[SkySample]) -> PhotoTables:
    """Tables nearest to photos, for the haziness among a few with which they come nearest."""
    return min((_with_haziness(samples, haziness) for haziness in HAZINESSES), key=lambda one: sum(one.errors.values()))


def _packaged_sky() -> Sky:
    return defaults(Sky, torch.float64)


def _with_haziness(samples: Sequence[SkySample], haziness: float) -> PhotoTables:
    of = replace(_packaged_sky(), haziness=torch.tensor(haziness, dtype=torch.float64))
    designs = [_design(of, one) for one in samples]
    penalty, target = _penalty()
    factors = []
    for channel in range(3):
        rows = [design[:, channel] / len(design) ** 0.5 for design in designs]
        ones = [torch.full((len(design),), len(design) ** -0.5, dtype=torch.float64) for design in designs]
        # The triangle of the whole system has the same least squares in a few hundred rows.
        whole = torch.cat([torch.cat([*rows, penalty]), torch.cat([*ones, target])[:, None]], 1)
        triangle = torch.linalg.qr(whole, mode="r").R.numpy()
        factors.append(torch.from_numpy(nnls(triangle[:-1, :-1], triangle[:-1, -1])[0]))
    drawn = [torch.stack([d[:, c] @ factors[c] for c in range(3)], -1) for d in designs]
    errors = {one.name: float((d - 1.0).square().mean().sqrt()) for one, d in zip(samples, drawn, strict=True)}
    return PhotoTables(_corrected(torch.stack(factors, -1)), haziness, errors)


def _design(of: Sky, one: SkySample) -> Float[Tensor, "n 3 unknowns"]:
    """What each factor adds to each pixel, over the photo's radiance."""
    prepared = sky.prepare_two_tables(of, one.view)
    by_air, by_haze = two_tables.look_up(prepared)
    air_phase, haze_phase = sky.phases(of, one.view)
    parts = torch.stack([by_air * air_phase, by_haze * haze_phase], -1) / one.radiance[..., None]
    place = sun_axis.place(sky_view.elevation(one.view.to_sun), SUNS)
    shares = _hats(sky_view.row(one.view, ROWS), ROWS)[:, None, :] * _hats(place[None], SUNS)[:, :, None]
    return (parts[..., None] * shares.flatten(1)[:, None, None]).flatten(2)


def _hats(index: Float[Tensor, " n"], count: int) -> Float[Tensor, "n count"]:
    """Weight of each cell at fractional indices."""
    return torch.relu(1.0 - (index[:, None] - torch.arange(count).to(index)).abs())


def _penalty() -> tuple[Float[Tensor, "rows unknowns"], Float[Tensor, " rows"]]:
    """Rows that hold the factors smooth and near 1, and what they are to give."""
    number = torch.arange(2 * SUNS * ROWS).reshape(2, SUNS, ROWS)
    pairs = [(number[:, 1:], number[:, :-1]), (number[..., 1:], number[..., :-1])]
    one, other = (torch.cat([pair[side].flatten() for pair in pairs]) for side in (0, 1))
    same = torch.eye(number.numel(), dtype=torch.float64)
    steps = SMOOTH**0.5 * (same[one] - same[other])
    target = torch.cat([torch.zeros(len(steps)), torch.full((number.numel(),), NEAR**0.5)])
    return torch.cat([steps, NEAR**0.5 * same]), target.double()


def _corrected(factors: Float[Tensor, "unknowns 3"]) -> TwoTables:
    """The packaged tables times factors between their cells."""
    known = two_tables.packaged()
    suns, rows = known.air.shape[:2]
    sun = torch.linspace(0.0, SUNS - 1.0, suns, dtype=torch.float64)[:, None].expand(suns, rows)
    row = torch.linspace(0.0, ROWS - 1.0, rows, dtype=torch.float64).expand(suns, rows)
    of_air, of_haze = (lookup(part, sun, row) for part in factors.reshape(2, SUNS, ROWS, 3))
    return TwoTables(known.air.double() * of_air, known.haze.double() * of_haze, known.cloud.double())
