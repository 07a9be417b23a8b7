"""Exports run in their targets: three.js in a headless Chromium, Blender Cycles as `bpy`, beside `fit render`.

Give the unpacked npm package (`npm pack three && tar xzf three-*.tgz`) as `--three package`, and the interpreter of an
environment with `bpy` as `--blender-python` (see `blender_export`). Each weather is written as a file, exported by
`fit export` and drawn from what is in the folder, in five views of 90 degrees; without fog the sky is compared, with
fog the sky and a grey plain behind it.
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from experiments import blender_export, records, three_export
from experiments.export_views import VIEWS, View, directions, ours, plain
from fit import keyframes, sky, weather_file
from fit.export import targets
from fit.export.account import Difference, difference
from fit.export.analytic_sky import three_sky
from fit.export.described import Described, described
from fit.export.threejs import built_in_sky

PHOTO = Path(__file__).parent / "photos" / "spruit_sunrise.exr"
HOUR = 12.0
FOG = {
    "HEIGHT_FOG_EXTINCTION": 2e-3,
    "HEIGHT_FOG_EXTINCTION_TINT_R": 0.8,
    "HEIGHT_FOG_EXTINCTION_TINT_B": 1.3,
    "HEIGHT_FOG_SCALE_HEIGHT": 60.0,
    "HEIGHT_FOG_BASE_HEIGHT": 5.0,
    "HEIGHT_FOG_RAYLEIGH_SHARE_R": 0.3,
    "HEIGHT_FOG_ASYMMETRY": 0.75,
    "HEIGHT_FOG_SUN_TINT_R": 0.5,
    "HEIGHT_FOG_SUN_TINT_G": 0.4,
    "HEIGHT_FOG_SUN_TINT_B": 0.3,
}
SHOWN = "ahead"
BRIGHT = 0.9  # share of a picture's pixels that are not burnt out when it is shown


@dataclass(frozen=True)
class Compared:
    """Relative differences from ours over all pixels of all views that are compared.

    Attributes:
        target: and which part of it: what is exported, or an engine's own sky.
        told: what the export's account says of an engine's own sky over the upper half, mean and largest.
        formula: of the engine's own sky from our copy of its formula, mean and largest.
    """

    weather: str
    target: str
    mean: float
    largest: float
    told: Difference | None = None
    formula: Difference | None = None


def weathers() -> dict[str, dict[str, float]]:
    """Values in files' units by weather: a fitted sunrise, a high and a low sun, each with fog and without."""
    sunrise = keyframes.values(sky.fit(PHOTO).scene)
    noon = {"SKY_HAZINESS": 0.76, "EXPOSURE": 10.0, "SUN_ELEVATION": 60.0, "SUN_AZIMUTH": -40.0}
    low = {**noon, "SUN_ELEVATION": 1.0, "SKY_COARSE_SCALE": 1.0, "SKY_OVERCAST": 0.2, "SKY_OVERCAST_LEFT": 2.0}
    thin = {**FOG, "HEIGHT_FOG_EXTINCTION": 3e-4, "HEIGHT_FOG_SCALE_HEIGHT": 300.0}
    return {
        "sunrise": sunrise,
        "sunrise, fog": sunrise | FOG,
        "noon": noon,
        "noon, thin fog": noon | thin,
        "low sun": low,
        "low sun, fog": low | FOG,
    }


@dataclass(frozen=True, eq=False)
class Drawn:
    """A weather drawn by us and by targets: view -> radiance."""

    ours: Mapping[str, View]
    theirs: Mapping[str, Mapping[str, Float[Tensor, "n n 3"]]]


def exported(values: Mapping[str, float], target: str, folder: Path) -> None:
    """Folder of a target, by way of a weather file."""
    file = folder.parent / "weather.csv"
    weather_file.write(file, weather_file.of_photo(values, HOUR, {}))
    scene = keyframes.scene(keyframes.at(weather_file.read(file), HOUR))
    targets.write(target, scene, file.name, HOUR, folder)


def compared(name: str, target: str, drawn: Drawn) -> Compared:
    """Figures of one target's pictures of a weather."""
    pairs = [(one.radiance[one.compared], drawn.theirs[target][view][one.compared]) for view, one in drawn.ours.items()]
    mine, theirs = (torch.cat(parts) for parts in zip(*pairs, strict=True))
    return Compared(name, target, *difference(mine, theirs))


def built_in(name: str, weather: Described, drawn: Mapping[str, Tensor], pixels: int) -> Compared:
    """three.js' own Sky, gain included, beside ours and beside our copy of its formula."""
    match, _ = built_in_sky(weather)
    dials = torch.tensor(list(match.dials.values()), dtype=torch.float64)
    rows = []
    for view, picture in drawn.items():
        direction = directions(view, pixels)
        above = direction[..., 2] > 0.0
        rows.append((direction[above], ours(weather, view, pixels).radiance[above], picture[above]))
    direction, mine, theirs = (torch.cat(parts) for parts in zip(*rows, strict=True))
    copied = three_sky(dials, direction.double(), weather.to_sun.double()).float()
    told = match.gain * theirs
    whole = difference(mine, told)
    return Compared(name, "three.js' own Sky", *whole, match.difference, difference(theirs, copied))


def taken(
    name: str, values: Mapping[str, float], given: argparse.Namespace
) -> tuple[Drawn, list[Compared], dict[str, str]]:
    """A weather drawn by ours and by the targets that are there, their figures, and their versions."""
    weather = described(keyframes.scene(values), name, HOUR)
    mine = {view: ours(weather, view, given.pixels) for view in VIEWS}
    theirs: dict[str, Mapping[str, Tensor]] = {}
    versions: dict[str, str] = {}
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "exported"
        if given.three is not None:
            exported(values, "threejs", folder)
            module = (folder / "weather.js").read_text(encoding="utf-8")
            by_three = three_export.drawn(given.three, module, plain(weather), given.pixels)
            theirs["three.js"], versions["three"] = by_three.exported, by_three.version
            if weather.scene.height_fog is None:
                theirs["three.js' own Sky"] = {
                    view: built_in_sky(weather)[0].gain * one for view, one in by_three.built_in.items()
                }
                rows.append(built_in(name, weather, by_three.built_in, given.pixels))
        if given.blender_python is not None:
            exported(values, "blender", folder)
            version, pictures = blender_export.drawn(
                given.blender_python, folder, plain(weather), given.pixels, given.samples
            )
            theirs["Blender"], versions["blender"] = pictures, version
    drawn = Drawn(mine, theirs)
    done = [compared(name, target, drawn) for target in ("three.js", "Blender") if target in theirs]
    return drawn, done + rows, versions


def plot(path: Path, pictures: Mapping[str, Drawn]) -> None:
    """One row a weather: ours and each target's, the view towards the fitted picture's middle."""
    figure = Figure(figsize=(10, 2.3 * len(pictures)), layout="constrained")
    columns = ["ours", *dict.fromkeys(name for one in pictures.values() for name in one.theirs)]
    places = figure.subplots(len(pictures), len(columns), squeeze=False)
    for row, (weather, drawn) in zip(places, pictures.items(), strict=True):
        mine = drawn.ours[SHOWN].radiance
        brightest = float(mine.mean(-1).quantile(BRIGHT))
        for place, column in zip(row, columns, strict=True):
            place.set_axis_off()
            radiance = mine if column == "ours" else drawn.theirs.get(column, {}).get(SHOWN)
            if radiance is not None:
                place.imshow(np.asarray((radiance / brightest).clamp(0.0, 1.0) ** (1.0 / 2.2)))
                place.set_title(f"{weather}: {column}", fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the differences, and pictures side by side."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("weathers", nargs="*", help="names of some; else all")
    parser.add_argument("--three", type=Path, help="the unpacked npm package; else three.js is left out")
    parser.add_argument("--blender-python", type=Path, help="interpreter that has bpy; else Blender is left out")
    parser.add_argument("--pixels", type=int, default=64, help="across each view")
    parser.add_argument("--samples", type=int, default=4, help="of Cycles in a pixel")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    found = {name: values for name, values in weathers().items() if not given.weathers or name in given.weathers}
    pictures: dict[str, Drawn] = {}
    rows: list[Compared] = []
    versions: dict[str, str] = {}
    for name, values in found.items():
        pictures[name], figures, told = taken(name, values, given)
        rows += figures
        versions |= told
    lines = [[f"{row.weather}: {row.target}", f"{row.mean:.1e}", f"{row.largest:.1e}"] for row in rows]
    print(records.table(["weather: target", "mean", "largest"], lines))
    size = {"pixels": given.pixels, "samples": given.samples}
    records.write(given.out / "exports.json", {**versions, **size, "records": [asdict(row) for row in rows]})
    plot(given.out / "exports.png", pictures)


if __name__ == "__main__":
    main()
