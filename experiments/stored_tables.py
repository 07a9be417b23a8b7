"""How far skies from stored tables are from freshly computed ones, by the sun's height; and what they look like.

FFXV's two tables against the march they were made from; Decima's tables between two stored suns against tables made for
that sun; and tables blended between two weathers against tables made for the mixed air, by the logarithm of what each
amount of air dims, as the library does, and by the light itself, as a texture unit would.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import sky, stored_tables, sun_axis
from diffrender.atmosphere.sky import EFFECT, Sky, SkyTables, SkyView, TabledView
from diffrender.atmosphere.stored_tables import StoredTables
from diffrender.parameters import defaults
from diffrender.rays import from_angles
from experiments import records
from fit import png, stored_sky

SUNS = (60.0, 30.0, 10.0, 5.0, 1.0, 0.0, -1.0, -4.0, -8.0)  # degrees
DRAWN = (60.0, 10.0, 1.0, -4.0)
SHOWN = ("march", "two tables", "two weathers")
WEATHERS = (0.5, 10.0)  # haze of the two that are blended, in units of a clear day's
SHARES = (0.25, 0.5, 0.75)
# Of the tables stored for a day.
SIZES = {"full": sky.Size(), "small": sky.Size(rows=8, columns=3, steps=6, heights=3, suns=4, steps_around=3)}
WIDTH, HEIGHT, ENLARGED = 200, 60, 2  # of a drawn sky; each pixel is a square

Light = Float[Tensor, "*batch 3"]


def view(sun: float, direction: Float[Tensor, "*batch 3"]) -> SkyView:
    """Directions under a sun at an elevation in degrees over +x; eye at 2 m."""
    to_sun = from_angles(*torch.deg2rad(direction.new_tensor([sun, 0.0])))
    return SkyView(direction, to_sun, torch.ones_like(to_sun), to_sun.new_tensor(2.0))


def all_round() -> Float[Tensor, "rows columns 3"]:
    """Directions from the horizon to the zenith."""
    elevation = torch.deg2rad(torch.tensor([0.05, 0.5, 2.0, 5.0, 15.0, 40.0, 90.0], dtype=torch.float64))
    azimuth = torch.deg2rad(torch.arange(0.0, 181.0, 15.0, dtype=torch.float64))
    return from_angles(*torch.meshgrid(elevation, azimuth, indexing="ij"))


def compared(drawn: Light, truth: Light) -> dict[str, float]:
    """Relative error: root of the mean square, and largest; and the largest difference over the brightest value."""
    error = drawn / truth - 1.0
    return {
        "root_mean_square": float(error.square().mean().sqrt()),
        "largest": float(error.abs().max()),
        "over_brightest": float((drawn - truth).abs().max() / truth.max()),
    }


def hazy(amount: float) -> Sky:
    """The default sky with an amount of haze."""
    return replace(defaults(Sky, torch.float64), mie_scale=torch.tensor(amount, dtype=torch.float64))


def of_sun(sun: float, stored: StoredTables) -> dict[str, Any]:
    """Errors at one elevation of the sun, of tables stored for a day among others."""
    of, seen = hazy(1.0), view(sun, all_round())
    pictures = {name: EFFECT.rungs[name](of, seen) for name in ("two tables", "two weathers", "tables", "march")}
    between_suns = sky.render_tables(of, TabledView(seen, stored_tables.at_sun(stored, seen.to_sun).sky()))
    return {
        "sun_elevation": sun,
        "two_tables_to_march": compared(pictures["two tables"], pictures["march"]),
        "two_weathers_to_march": compared(pictures["two weathers"], pictures["march"]),
        "two_weathers_to_tables": compared(pictures["two weathers"], pictures["tables"]),
        "tables_to_march": compared(pictures["tables"], pictures["march"]),
        "stored_suns_to_tables": compared(between_suns, pictures["tables"]),
    }


def _tables(of: Sky, seen: SkyView) -> SkyTables:
    return sky.tables(of, sky.geometry(seen))


def of_blend(sun: float, share: float) -> dict[str, Any]:
    """Errors of a blend of two weathers at one elevation of the sun."""
    seen, weathers = view(sun, all_round()), [hazy(amount) for amount in WEATHERS]
    first, second = (_tables(one, seen) for one in weathers)
    amounts = torch.stack([stored_tables.amount(sky.medium(one)) for one in weathers])
    part = torch.tensor(share, dtype=torch.float64)
    mixed = hazy(WEATHERS[0] + share * (WEATHERS[1] - WEATHERS[0]))
    of_light = SkyTables(
        torch.lerp(first.in_scatter, second.in_scatter, part), torch.lerp(first.cloud, second.cloud, part)
    )
    by_amount = stored_tables.sky_blended(first, second, amounts, part)
    truth, ours, plain = (
        sky.render_tables(mixed, TabledView(seen, one)) for one in (_tables(mixed, seen), by_amount, of_light)
    )
    return {
        "sun_elevation": sun,
        "share": share,
        "blended": compared(ours, truth),
        "light_blended": compared(plain, truth),
    }


def picture(width: int, height: int) -> Float[Tensor, "high wide 3"]:
    """Skies as SHOWN from left to right, under the suns DRAWN from above, each row exposed alike."""
    elevation = torch.deg2rad(torch.linspace(80.0, 0.2, height))[:, None].expand(height, width)
    azimuth = torch.deg2rad(torch.linspace(180.0, -180.0, width)).expand(height, width)
    irradiance, rows = torch.tensor([1.474, 1.8504, 1.91198]), []
    for sun in DRAWN:
        seen = replace(view(sun, from_angles(elevation, azimuth)), irradiance=irradiance)
        drawn = [EFFECT.rungs[name](defaults(Sky), seen) for name in SHOWN]
        exposure = 0.5 / drawn[0].quantile(0.8)
        rows.append(torch.cat([(one * exposure).clamp(0.0, 1.0) ** (1.0 / 2.2) for one in drawn], 1))
    return torch.cat(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the errors, and draw the picture."""
    parser = argparse.ArgumentParser(description="errors of stored tables of the sky")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    suns = SUNS if given.size == "full" else SUNS[2:3]
    cells = torch.arange(sun_axis.CELLS, dtype=torch.float64)
    stored = stored_sky.stored(hazy(1.0), sun_axis.elevations(cells, sun_axis.CELLS), SIZES[given.size])
    by_sun = [of_sun(sun, stored) for sun in suns]
    blends = [of_blend(sun, share) for sun in (DRAWN if given.size == "full" else suns) for share in SHARES]
    for rows, keys in ((by_sun, ("sun_elevation",)), (blends, ("sun_elevation", "share"))):
        names = [name for name in rows[0] if name not in keys]
        lines = [
            [*(f"{row[k]:g}" for k in keys), *(f"{row[n]['root_mean_square']:.4f}" for n in names)] for row in rows
        ]
        print(records.table([*keys, *names], lines))
    records.write(
        given.out / "stored_tables.json",
        {"weathers": WEATHERS, "cells": sun_axis.CELLS, "suns": by_sun, "blends": blends},
    )
    width, height = (WIDTH, HEIGHT) if given.size == "full" else (8, 4)
    drawn = (255.0 * picture(width, height)).byte().numpy().repeat(ENLARGED, 0).repeat(ENLARGED, 1)
    (given.out / "stored_tables.png").write_bytes(png.encoded(np.ascontiguousarray(drawn)))


if __name__ == "__main__":
    main()
