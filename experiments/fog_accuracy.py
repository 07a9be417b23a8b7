"""How far height fog in float32 is from float64: optical depth and scattered sunlight, values and gradients.

Cases are drawn in float32, so that both precisions are given the same numbers: rays from a centimetre to 10^7 m and to
infinity, level, nearly level and as steep as the sun among them; eyes up to 80 scale heights over and under the base.
The error grows with the number of scale heights between the base and the ends of the ray, whose exponential it is, so
it is told by bands of that number.
"""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from diffrender.atmosphere import height_fog
from diffrender.atmosphere.height_fog import HeightFog
from diffrender.numerics import opacity
from diffrender.parameters import defaults, specifications
from diffrender.rays import Rays
from experiments import records

COUNT, SMALL_COUNT = 1_000_000, 2_000
CHUNK = 50_000  # cases at a time
BANDS = (10.0, 20.0, 40.0, 80.0)  # largest |altitude - base| / scale height of a ray's ends
LARGEST = 3e38  # of float32
SMALLEST = 1.2e-38  # of float32 with all its digits
INVISIBLE = 1e-15  # opacity of fog that scatters nothing to speak of, whose gradients pass through subnormal numbers
STEEPEST = 1e25  # optical depth up to which its gradients, per metre and by slope of a ray, are in float32's range
MOVED = ("extinction", "scale_height", "base_height", "up")  # of which gradients are taken

Case = Mapping[str, Tensor]
Quantity = Callable[[Case], Tensor]


def cases(count: int, seed: int) -> dict[str, Tensor]:
    """Cases in float32, every second one a corner in some respect."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)

    def chosen(*options: Tensor) -> Tensor:
        which = torch.randint(len(options), (count,), generator=generator)
        return torch.stack(options).gather(0, which[None])[0]

    def logarithmic(low: float, high: float) -> Tensor:
        return torch.exp(uniform(math.log(low), math.log(high)))

    known = specifications(HeightFog)
    scale_height = logarithmic(*known["scale_height"].bounds)
    base = chosen(uniform(*known["base_height"].bounds), torch.zeros(count, dtype=torch.float64))
    eye = chosen(uniform(-10.0, 10.0), uniform(-80.0, 80.0), uniform(-1.0, 1.0), torch.zeros_like(base))
    sun = torch.sin(torch.deg2rad(chosen(uniform(0.0, 90.0), uniform(-2.0, 5.0), torch.zeros_like(base))))
    tiny = chosen(logarithmic(1e-9, 1.0), -logarithmic(1e-9, 1.0))
    level = torch.zeros_like(base)
    by_sun = chosen(sun, sun * (1.0 + 1e-6), sun * (1.0 - 1e-6))
    climb = scale_height * logarithmic(1e-4, 20.0)  # ends within 20 scale heights of the eye, whatever the slope
    up = chosen(uniform(-1.0, 1.0), tiny, level, by_sun)
    length = chosen(logarithmic(1e-2, 1e7), climb / up.abs().clamp(min=1e-7), torch.full_like(base, math.inf))
    drawn = {
        "extinction": logarithmic(*known["extinction"].bounds),
        "scale_height": scale_height,
        "base_height": base,
        "altitude": base + eye * scale_height,
        "up": up,
        "length": length.where(length.isinf(), length.clamp(max=1e7)),
        "sun": sun,
    }
    return {name: value.float() for name, value in drawn.items()}


def fog_and_rays(case: Case) -> tuple[HeightFog, Rays, Tensor]:
    """Record, ray and direction to the sun of one case."""
    plain = defaults(HeightFog, case["up"].dtype)
    changed = {name: case[name] for name in ("extinction", "scale_height", "base_height")}
    fog = HeightFog(**(vars(plain) | changed))
    nothing = torch.zeros_like(case["up"])
    rays = Rays(
        origin=torch.stack([nothing, nothing, case["altitude"]]),
        # Nothing of the fog asks for the horizontal part of directions.
        direction=torch.stack([nothing, nothing, case["up"]]),
        length=case["length"],
    )
    return fog, rays, torch.stack([nothing, nothing, case["sun"]])


def depth(case: Case) -> Tensor:
    """Optical depth."""
    fog, rays, _ = fog_and_rays(case)
    return height_fog.optical_depth(fog, rays)[0]


def sunlight(case: Case) -> Tensor:
    """Share of sunlight that the ray collects, over a round earth."""
    fog, rays, to_sun = fog_and_rays(case)
    return height_fog.sun_share(fog, rays, height_fog.air_mass(fog, rays, to_sun))[0]


def sunlight_flat(case: Case) -> Tensor:
    """Share of sunlight that the ray collects, over a flat earth."""
    fog, rays, to_sun = fog_and_rays(case)
    return height_fog.sun_share(fog, rays, height_fog.flat_air_mass(to_sun))[0]


def transmittance(case: Case) -> Tensor:
    """Share of the background that is seen."""
    return torch.exp(-depth(case).clamp(max=height_fog.OPAQUE))


def slopes(quantity: Quantity) -> Quantity:
    """Gradient of a quantity by the parameters of `units`, a row of numbers."""

    def of(case: Case) -> Tensor:
        found = torch.func.grad(lambda moved: quantity({**case, **moved}))({name: case[name] for name in MOVED})
        return torch.stack([found[name] for name in MOVED])

    return of


def units(drawn: Case) -> Tensor:
    """Steps of parameters that matter alike: their own size; a scale height; one at the far end of the ray."""
    wide = {name: value.double() for name, value in drawn.items()}
    span = wide["length"].clamp(max=height_fog.FARTHEST) / wide["scale_height"]
    return torch.stack([wide["extinction"], wide["scale_height"], wide["scale_height"], 1.0 / span.clamp(min=1.0)], 1)


def in_both(quantity: Quantity, drawn: Case) -> tuple[Tensor, Tensor]:
    """Quantity of every case in float32 and in float64."""
    every = torch.func.vmap(quantity)
    found: list[tuple[Tensor, Tensor]] = []
    for start in range(0, len(drawn["up"]), CHUNK):
        part = {name: value[start : start + CHUNK] for name, value in drawn.items()}
        found.append((every(part).double(), every({name: value.double() for name, value in part.items()})))
    single, double = zip(*found, strict=True)
    return torch.cat(single), torch.cat(double)


def ends(drawn: Case) -> Tensor:
    """Scale heights between the base and the farther of the ends of rays; for sky rays, which end thin, the eye's."""
    wide = {name: value.double() for name, value in drawn.items()}
    eye = (wide["altitude"] - wide["base_height"]) / wide["scale_height"]
    end = eye + wide["up"] * wide["length"].clamp(max=height_fog.FARTHEST) / wide["scale_height"]
    # A ray may end however high: its thin end counts for nothing.
    return torch.maximum(eye.abs(), torch.relu(-end))


def rows(count: int, seed: int) -> list[dict[str, Any]]:
    """Errors by quantity and band."""
    drawn = cases(count, seed)
    far = ends(drawn)
    depths = in_both(depth, drawn)
    known = (depths[1] > SMALLEST) & (depths[1] < LARGEST)
    share = opacity(depths[1].clamp(max=height_fog.OPAQUE))
    seen = share.clamp(min=INVISIBLE)
    told = [
        tell("optical depth, of its value", depths, depths[1], far, known),
        steepness("its gradient, of that gradient's length", depth, 0.0 * share, drawn, depths[1] < STEEPEST),
        tell("transmittance, of 1", in_both(transmittance, drawn), torch.ones_like(share), far, share >= 0.0),
    ]
    for name, quantity in (("round earth", sunlight), ("flat earth", sunlight_flat)):
        told.append(tell(f"sunlight, {name}, of the fog's opacity", in_both(quantity, drawn), share, far, known))
        told.append(steepness("its gradient, of its length or that opacity", quantity, seen, drawn, share >= 0.0))
    return [row for band in told for row in band]


def steepness(name: str, quantity: Quantity, least: Tensor, drawn: Case, held: Tensor) -> list[dict[str, Any]]:
    """Rows of a quantity's gradient, over its length or a least size, of cases in which float32 can hold it."""
    single, double = in_both(slopes(quantity), drawn)
    single = single.where(held[:, None], torch.zeros_like(single))
    scaled = single * units(drawn), double * units(drawn)
    size = torch.maximum(scaled[1].norm(dim=1), least)
    return tell(name, scaled, size, ends(drawn), held & (size > SMALLEST))


def tell(name: str, both: tuple[Tensor, Tensor], size: Tensor, far: Tensor, known: Tensor) -> list[dict[str, Any]]:
    """One row for each band; what is not finite is counted over all cases, errors over those that are known."""
    single, double = (value.reshape(len(far), -1) for value in both)
    share = (single - double).norm(dim=1) / size
    finite = single.isfinite().all(1)
    told, low = [], -1.0
    for high in (*BANDS, math.inf):
        inside = (far > low) & (far <= high)
        low = high
        ordered = share[inside & known & finite].sort().values
        if len(ordered) > 0:
            spread = {"median": 0.5, "p99": 0.99, "largest": 1.0}
            row: dict[str, Any] = {"quantity": name, "scale_heights": high if math.isfinite(high) else None}
            row |= {"cases": len(ordered), "not_finite": int((inside & ~finite).sum())}
            row |= {name: float(ordered[round(place * (len(ordered) - 1))]) for name, place in spread.items()}
            told.append(row)
    return told


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table and write it as JSON."""
    parser = argparse.ArgumentParser(description="height fog in float32 against float64")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    found = rows(COUNT if given.size == "full" else SMALL_COUNT, given.seed)
    print(table(found))
    records.write(given.out / "fog_accuracy.json", {"seed": given.seed, "records": found})


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """Text of the table."""
    head = ("error of", "scale heights up to", "cases", "not finite", "median", "p99", "largest")
    lines = [
        [
            row["quantity"],
            "any" if row["scale_heights"] is None else f"{row['scale_heights']:g}",
            str(row["cases"]),
            str(row["not_finite"]),
            *(f"{row[name]:.1e}" for name in ("median", "p99", "largest")),
        ]
        for row in found
    ]
    return records.table(head, lines)


if __name__ == "__main__":
    main()
