"""How well one point, or one facet, stands for a light that is a sphere: where it is, how bright, and how it looks.

Places: the largest (N·H)² over the sphere by brute force, less that of each way, for eyes and lights of all directions
and for grazing ones, with the sphere whole above the horizon and the mirror's direction outside it.

Radiance: every renderer against sums over the sphere, by material, roughness and size, for lights from 10 and eyes
from 2 degrees up; the error is of a highlight: its root of the mean square over that of the sums. For spheres that are
above the horizon as a whole also the largest error of a place in its own value.

White furnace: what a white surface sends under a sphere that fills the sky, by sums, for each BRDF. Rough facets lose
what they would scatter twice; none may send more than it gets.

The picture: a plain that mirrors a low sphere at a grazing angle, smoother on top; in columns Karis' point, the talk's
step, the guarded one, smaller when rough, mean brightness, mean facet, and sums.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.shading.brdf import Geometry
from diffrender.shading.light_bending import Step, bent, guarded_step, no_step, talk_step
from diffrender.shading.microfacet import visible_schlick, visible_smith
from diffrender.shading.sphere_light import EFFECT
from diffrender.shading.sphere_light_reference import summed
from diffrender.shading.sphere_surface import SphereLight, SphereView
from experiments import lamp_plain, records
from fit import png

STEPS: Mapping[str, Step] = {"karis": no_step, "talk": talk_step, "guarded": guarded_step}
SUN = 0.0047
SETS = ((SUN, "all"), (0.05, "all"), (0.2, "all"), (0.5, "all"), (0.05, "grazing"), (0.2, "grazing"))
CASES, SMALL_CASES = 50_000, 500
TURNS, SMALL_TURNS = 720, 90  # of the brute force
ROUGHNESSES = (0.02, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
SINES, SMALL_SINES = (SUN, 0.05, 0.2, 0.5), (0.2,)
ELEVATIONS = (10.0, 25.0, 50.0, 80.0)  # of the light [degrees]
SIDES = (0.0, 0.3, 0.6, 0.9, 1.1, 1.4, 2.0, 3.0)  # of the eye from the mirror's place, in radii and facets' spreads
METALS = (1.0, 0.0)
LOWEST = 2.0  # elevation of the eye [degrees]
NODES, SMALL_NODES = (64, 128), (24, 48)
FURNACE_NODES, SMALL_FURNACE_NODES = (192, 384), (48, 96)
FURNACE_ROUGHNESSES, FURNACE_ELEVATIONS = (0.0, 0.2, 0.5, 0.8, 1.0), (1.0, 10.0, 30.0, 90.0)
PICTURE_NODES = (32, 48)
PANEL, SMALL_PANEL = (240, 120), (24, 12)
GAP = 4
LOSES = 1e-9  # of (N·H)², below which nobody is worse
PLAINS = (0.1, 0.25, 0.4, 0.6)  # roughness in each row of the picture


@dataclass(frozen=True)
class Placed:
    """Loss of (N·H)² by one way of putting the point, over a set of eyes and lights."""

    sine: float
    directions: str
    way: str
    mean: float
    largest: float
    worse_than_karis: float  # share of cases


@dataclass(frozen=True)
class Shone:
    """Error of a renderer's highlight, in the highlight's own root of the mean square.

    Attributes:
        metallic: 1 for white metal, 0 for black varnish.
        largest_whole: of a place that sees all of the sphere above its horizon, in its own value.
    """

    sine: float
    roughness: float
    metallic: float
    rung: str
    error: float
    largest_whole: float


@dataclass(frozen=True)
class Sent:
    """Share of light from all around that a white surface sends to an eye."""

    visible: str
    metallic: float
    roughness: float
    elevation: float  # of the eye [degrees]
    share: float


def number(value: float | Sequence[float] | Sequence[Sequence[float]]) -> Tensor:
    """In double precision."""
    return torch.tensor(value, dtype=torch.float64)


def scattered(sine: float, directions: str, count: int) -> Geometry:
    """Eyes and lights over a level surface, by the same numbers each time.

    Grazing ones are up to 9 degrees over the horizon, the lights roughly opposite.
    """
    draw = torch.Generator().manual_seed(2)
    uniform = torch.rand(4, count, generator=draw, dtype=torch.float64)
    if directions == "grazing":
        eye_height, light_height = 1e-3 + 0.15 * uniform[0], sine + 0.15 * uniform[1]
        turn = math.pi + 0.3 * torch.randn(count, generator=draw, dtype=torch.float64)
    else:
        eye_height, light_height = 1e-3 + (1.0 - 1e-3) * uniform[0], sine + (1.0 - sine) * uniform[1]
        turn = 2.0 * math.pi * uniform[2]
    up = torch.eye(3, dtype=torch.float64)[2]
    return Geometry(up.expand(count, 3), _direction(eye_height, turn), _direction(light_height, torch.zeros(count)))


def _direction(height: Tensor, azimuth: Tensor) -> Tensor:
    level = torch.sqrt(1.0 - height * height)
    return torch.stack([level * torch.cos(azimuth), level * torch.sin(azimuth), height], -1)


def _outside(geometry: Geometry, sine: float) -> Geometry:
    """Those whose mirror's direction does not meet the sphere."""
    along = (geometry.normal * geometry.to_eye).sum(-1, keepdim=True)
    mirror = 2.0 * along * geometry.normal - geometry.to_eye
    kept = (mirror * geometry.to_light).sum(-1) < math.sqrt(1.0 - sine * sine)
    return Geometry(*(one[kept] for one in vars(geometry).values()))


def facing_square(geometry: Geometry, to_light: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """(N·H)² of a light; 0 where the half vector points into the surface."""
    half = to_light + geometry.to_eye
    return (half * geometry.normal).sum(-1).clamp(min=0.0).square() / half.square().sum(-1)


def best(geometry: Geometry, sine: float, turns: int) -> Float[Tensor, "*batch"]:
    """Largest (N·H)² on the sphere's edge, by trying so many places of it."""
    to_light = geometry.to_light
    axis = torch.eye(3, dtype=torch.float64)[to_light.abs().argmin(-1)]
    first = torch.nn.functional.normalize(torch.linalg.cross(to_light, axis), dim=-1)
    second = torch.linalg.cross(to_light, first)
    found = torch.zeros_like(to_light[..., 0])
    for turn in range(turns):
        angle = 2.0 * math.pi * turn / turns
        place = math.sqrt(1.0 - sine * sine) * to_light
        place = place + sine * (math.cos(angle) * first + math.sin(angle) * second)
        found = torch.maximum(found, facing_square(geometry, place))
    return found


def placed(sine: float, directions: str, count: int, turns: int) -> list[Placed]:
    """What each way of putting the point loses."""
    geometry = _outside(scattered(sine, directions, count), sine)
    ours = {way: facing_square(geometry, bent(geometry, number(sine), step)) for way, step in STEPS.items()}
    # Trying places misses the best between two of them.
    top = torch.stack([best(geometry, sine, turns), *ours.values()]).amax(0)
    return [
        Placed(
            sine=sine,
            directions=directions,
            way=way,
            mean=float((top - one).mean()),
            largest=float((top - one).max()),
            worse_than_karis=float((one < ours["karis"] - LOSES).double().mean()),
        )
        for way, one in ours.items()
    ]


def highlights(sine: float, roughness: float) -> SphereView:
    """Places round the highlights of a white metal, from their middles outwards, 1 m from the light."""
    wide = math.asin(sine) + 2.0 * roughness**2
    views = [(light, side * wide, turn) for light in ELEVATIONS for side in SIDES for turn in (0.0, 90.0, 180.0)]
    light, off, turn = number(views).unbind(-1)
    light, turn = light.deg2rad(), turn.deg2rad()
    # Round the mirror's direction, kept above the horizon.
    mirror = _direction(torch.sin(light), torch.full_like(light, math.pi))
    up = _direction(torch.cos(light), torch.zeros_like(light))
    off = off.clamp(max=0.5 * math.pi)
    aside = torch.cos(turn)[:, None] * up + torch.sin(turn)[:, None] * torch.linalg.cross(mirror, up)
    to_eye = torch.cos(off)[:, None] * mirror + torch.sin(off)[:, None] * aside
    above = to_eye[:, 2:].clamp(min=math.sin(math.radians(LOWEST)))
    to_eye = torch.nn.functional.normalize(torch.cat([to_eye[:, :2], above], -1), dim=-1)
    to_light = _direction(torch.sin(light), torch.zeros_like(light))
    return _white(-to_light, to_eye, roughness)


def _white(position: Tensor, to_eye: Tensor, roughness: float) -> SphereView:
    return SphereView(
        position=position,
        normal=number([0.0, 0.0, 1.0]),
        to_eye=to_eye,
        base=torch.ones(3, dtype=torch.float64),
        roughness=number(roughness),
        metallic=number(1.0),
        centre=torch.zeros(3, dtype=torch.float64),
    )


def shone(sine: float, roughness: float, nodes: tuple[int, int]) -> list[Shone]:
    """Error of every renderer on highlights of a size and roughness."""
    light, metal = SphereLight(number(sine), number([1.0, 1.0, 1.0])), highlights(sine, roughness)
    is_whole = -metal.position[:, 2] > sine
    rows = []
    for metallic in METALS:
        view = replace(metal, base=metallic * metal.base, metallic=number(metallic))
        truth = summed(light, view, nodes)[..., 0]
        for name, rung in EFFECT.rungs.items():
            apart = rung(light, view)[..., 0] - truth
            error = float((apart.square().mean() / truth.square().mean()).sqrt())
            rows.append(Shone(sine, roughness, metallic, name, error, float((apart / truth)[is_whole].abs().max())))
    return rows


def furnace(nodes: tuple[int, int]) -> list[Sent]:
    """White surfaces, of metal and of painted ground, under a white sky."""
    sky = SphereLight(number(1.0), torch.ones(3, dtype=torch.float64))
    up = number([0.0, 0.0, 1.0])
    elevation, roughness = torch.meshgrid(number(FURNACE_ELEVATIONS), number(FURNACE_ROUGHNESSES), indexing="ij")
    to_eye = _direction(torch.sin(elevation.deg2rad()), torch.zeros_like(elevation))
    found = []
    for name, visible in {"smith": visible_smith, "schlick": visible_schlick}.items():
        for metallic in (0.0, 1.0):
            view = replace(
                _white(-up, to_eye, 0.0), roughness=roughness, metallic=number(metallic).expand_as(roughness)
            )
            sent = summed(sky, view, nodes, visible)[..., 0]
            cases = zip(*(one.flatten().tolist() for one in (roughness, elevation, sent)), strict=True)
            found += [Sent(name, metallic, *case) for case in cases]
    return found


def sheet(width: int, height: int) -> np.ndarray:
    """The plain by each renderer and by sums, in columns, smoother on top."""
    rows = []
    for roughness in PLAINS:
        light, view = lamp_plain.lamp(), lamp_plain.plain(width, height, roughness)
        seen = [rung(light, view) for name, rung in EFFECT.rungs.items() if name != "skip"]
        lines = [summed(light, _line(view, line), PICTURE_NODES) for line in range(height)]
        rows.append(np.concatenate([_displayed(one) for one in (*seen, torch.stack(lines))], 1))
    return np.concatenate(rows, 0)


def _line(view: SphereView, line: int) -> SphereView:
    return replace(view, **{name: value[line] for name, value in vars(view).items() if name != "centre"})


def _displayed(radiance: Tensor) -> np.ndarray:
    shown = (1.0 - torch.exp(-radiance)).clamp(min=0.0) ** (1.0 / 2.2)
    pixels = np.rint(255.0 * shown.numpy()).astype(np.uint8)
    return np.pad(pixels, ((0, GAP), (0, GAP), (0, 0)), constant_values=255)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, and write them as JSON and the plain as a picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=["small", "full"], default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    is_small = given.size == "small"
    cases, turns, nodes = (SMALL_CASES, SMALL_TURNS, SMALL_NODES) if is_small else (CASES, TURNS, NODES)
    places = [one for sine, directions in SETS for one in placed(sine, directions, cases, turns)]
    lit = [one for sine in (SMALL_SINES if is_small else SINES)
           for roughness in ROUGHNESSES for one in shone(sine, roughness, nodes)]  # fmt: skip
    print(records.table(["sine, directions, way", "mean", "largest", "worse than Karis"], _place_rows(places)))
    print(records.table(["sine, roughness, metal", *EFFECT.rungs, "its largest where whole"], _light_rows(lit)))
    white = furnace(SMALL_FURNACE_NODES if is_small else FURNACE_NODES)
    print(records.table(["BRDF, metal, roughness", *map(str, FURNACE_ELEVATIONS)], _furnace_rows(white)))
    tables: Mapping[str, Sequence[Placed | Shone | Sent]] = {"places": places, "radiance": lit, "furnace": white}
    content = {"cases": cases, **{name: [vars(one) for one in rows] for name, rows in tables.items()}}
    records.write(given.out / "sphere_light.json", content)
    (given.out / "sphere_light.png").write_bytes(png.encoded(sheet(*(SMALL_PANEL if is_small else PANEL))))


def _place_rows(places: Sequence[Placed]) -> list[list[str]]:
    return [
        [f"{p.sine:g}, {p.directions}, {p.way}", f"{p.mean:.1e}", f"{p.largest:.1e}", f"{p.worse_than_karis:.2%}"]
        for p in places
    ]


def _light_rows(lit: Sequence[Shone]) -> list[list[str]]:
    count = len(EFFECT.rungs)
    groups = [lit[start : start + count] for start in range(0, len(lit), count)]
    return [
        [
            f"{g[0].sine:g}, {g[0].roughness:g}, {g[0].metallic:g}",
            *(f"{one.error:.3f}" for one in g),
            f"{g[-1].largest_whole:.3f}",
        ]
        for g in groups
    ]


def _furnace_rows(white: Sequence[Sent]) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for one in white:
        groups.setdefault(f"{one.visible}, {one.metallic:g}, {one.roughness:g}", []).append(f"{one.share:.4f}")
    return [[name, *shares] for name, shares in groups.items()]


if __name__ == "__main__":
    main()
