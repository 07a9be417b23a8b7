"""How often the intervals of `fit sky` hold the truth: on synthetic skies with the residuals of real fits as noise.

Every searched parameter of a sky's truth, and every one that may take the place of others, is drawn from its prior; the
sun stands anywhere from 5 to 60 degrees high. What a real fit has left over of its photo, log radiance by channel, is
turned about the zenith by a random angle and added; pixels where that photo has no residual are not used. So the noise
has real clouds, and the fit holds parameters still that are not what it takes them for, as with a photo.

An interval is value +- 1 or 1.96 standard errors in the parameter's own scale (log parameters: in the logarithm).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import sky as sky_model
from diffrender.rays import Equirectangular
from diffrender.scene import places, sky_view
from experiments import plots, records, shots
from experiments.shots import Shot
from fit import keyframes, picture, priors, sky, sky_mask
from fit import photo as photos
from fit.pixels import Pixels, averaged, usable
from fit.search_space import put
from fit.sky import Options, Solved
from fit.solution import SunPlace

CAMERA = Equirectangular(256, 128)
LOWEST_SUN, HIGHEST_SUN = 5.0, 60.0  # [degrees]
SKIES = {"small": 2, "full": 1000}
DRAWN = (*sky.SEARCHED, *sky.POOL)
ONE, TWO = 1.0, 1.96  # standard errors, between which 68 % and 95 % of a normal distribution lie


@dataclass(frozen=True)
class Miss:
    """How far one determined parameter of one fit is from the truth, both in shares of its bounds."""

    photo: str
    name: str
    error: float  # with its sign
    standard_error: float


@dataclass(frozen=True)
class Coverage:
    """Shares of intervals that hold the truth, of one parameter or all."""

    name: str
    determined: int
    within_one: float
    within_two: float
    median_error: float  # without sign
    median_standard_error: float


def residual_field(shot: Shot) -> Float[Tensor, "128 256 3"]:
    """Log radiance of a photo less that of its fit, in the boxes of CAMERA; NaN where the mask is black."""
    photo, sun = photos.read(shot.photo), SunPlace(*shot.sun, "known", visible=True)
    pixels = averaged(photo, usable(photo, sky_mask.read(shot.mask, photo).used))
    solved = sky.solve(pixels, sun, Options())
    high, wide = pixels.used.shape
    drawn = torch.from_numpy(
        picture.draw(keyframes.scene(keyframes.values(solved.scene)), Equirectangular(wide, high))["sky"]
    )
    left = torch.log(pixels.radiance + pixels.floor) - torch.log(drawn + pixels.floor)
    left[~pixels.used] = math.nan
    side = high // CAMERA.height
    return left.reshape(CAMERA.height, side, CAMERA.width, side, 3).mean((1, 3)).double()


def truth(generator: np.random.Generator) -> dict[str, float]:
    """Place between its bounds of each parameter, drawn from its prior."""
    prior = priors.in_unit_cube(DRAWN)
    drawn = {}
    for name, centre, spread in zip(DRAWN, prior.centre, prior.spread, strict=True):
        place = generator.normal(centre, spread)
        while not 0.0 < place < 1.0:
            place = generator.normal(centre, spread)
        drawn[name] = float(place)
    return drawn


def seen(places_in_unit: Mapping[str, float], sun: SunPlace, noise: Float[Tensor, "128 256 3"]) -> Pixels:
    """Pixels that show a sky under a sun with noise in its log radiance."""
    known = places()
    values = {"SUN_ELEVATION": sun.elevation, "SUN_AZIMUTH": sun.azimuth}
    scene = keyframes.scene(values | {"SKY_OVERCAST": 0.0}, torch.float64)
    for name, place in places_in_unit.items():
        unit = torch.tensor(place, dtype=torch.float64)
        scene = put(scene, known[name], known[name].specification.from_unit(unit))
    y, x = (torch.arange(count, dtype=torch.float64) + 0.5 for count in (CAMERA.height, CAMERA.width))
    columns, lines = torch.meshgrid(x, y, indexing="xy")
    direction = CAMERA.direction(columns, lines)
    used = noise.isfinite().all(-1) & (direction[..., 2] > 0.0)
    assert scene.sky is not None
    prepared = sky_model.prepare(scene.sky, sky_view(scene, direction[used]))
    radiance = torch.zeros(*used.shape, 3)
    radiance[used] = (sky_model.render_tables(scene.sky, prepared) * torch.exp(noise[used])).float()
    return Pixels(radiance, used, direction, CAMERA.solid_angle(columns, lines))


def misses(seed: int, fields: Mapping[str, Tensor]) -> list[Miss]:
    """Errors of the fit of one synthetic sky beside its standard errors."""
    generator = np.random.default_rng(seed)
    photo = str(generator.choice(sorted(fields)))
    noise = torch.roll(fields[photo], int(generator.integers(CAMERA.width)), 1)
    sun = SunPlace(
        elevation=float(generator.uniform(LOWEST_SUN, HIGHEST_SUN)),
        azimuth=float(generator.uniform(-180.0, 180.0)),
        how="known",
        visible=True,
    )
    drawn = truth(generator)
    solved = sky.solve(seen(drawn, sun, noise), sun, Options(seed=seed))
    return [Miss(photo, *miss) for miss in _determined(solved, drawn)]


def _determined(solved: Solved, drawn: Mapping[str, float]) -> list[tuple[str, float, float]]:
    errors = zip(solved.space.free, solved.minimum.point, solved.known.standard_error, strict=True)
    return [(name, float(place) - drawn[name], float(error)) for name, place, error in errors if math.isfinite(error)]


def coverage(name: str, found: Sequence[Miss]) -> Coverage:
    """Shares of some errors within one and two standard errors.

    >>> coverage("", [Miss("", "", error, 1.0) for error in (-0.5, 0.5, 1.5, 2.5)]).within_two
    0.75
    """
    error = np.array([abs(miss.error) for miss in found])
    standard = np.array([miss.standard_error for miss in found])
    return Coverage(
        name=name,
        determined=len(found),
        within_one=float((error < ONE * standard).mean()),
        within_two=float((error < TWO * standard).mean()),
        median_error=float(np.median(error)),
        median_standard_error=float(np.median(standard)),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it as JSON and as a chart."""
    torch.set_num_threads(1)
    given = shots.ask("coverage of the intervals of fitted skies", arguments)
    fields = {shot.name: residual_field(shot) for shot in given.shots}
    skies = SKIES["small" if given.is_small else "full"]
    write(given.out / "coverage.json", skies, [miss for seed in range(skies) for miss in misses(seed, fields)])


def write(path: Path, skies: int, found: Sequence[Miss]) -> None:
    """Print and write how often the intervals of some skies hold the truth, by parameter, by noise and altogether."""
    by_name = [coverage(name, own) for name in DRAWN if (own := [miss for miss in found if miss.name == name])]
    photos_of_noise = sorted({miss.photo for miss in found})
    by_photo = [coverage(name, [miss for miss in found if miss.photo == name]) for name in photos_of_noise]
    by_name.append(coverage("all", found))
    lines = [
        [
            row.name,
            str(row.determined),
            *(f"{100.0 * share:.1f}" for share in (row.within_one, row.within_two)),
            *(f"{size:.4f}" for size in (row.median_error, row.median_standard_error)),
        ]
        for row in [*by_name, *by_photo]
    ]
    print(records.table(["parameter", "determined", "68 %", "95 %", "error", "standard error"], lines))
    content = {"records": [asdict(row) for row in by_name], "noise": [asdict(row) for row in by_photo]}
    records.write(path, {"skies": skies, **content})
    plots.coverage(path)


if __name__ == "__main__":
    main()
