"""Sunlight scattered once in height fog, predicted for path-traced scenes that nobody here made.

Each scene is a folder with `scene.json` and pictures by Mitsuba 3's `volpath`; `fog_medium_only_black.exr` shows the
sunlight that fog scatters to the eye, and nothing else. Nothing is fitted: all comes from `scene.json`.

How much noise a pixel has is no guess either. One sample finds a scattering point with the probability of the ray's
opacity, and multiplies what is scattered there by an estimate of the sun's transmittance, whose second moment is known
for ratio tracking through layers of constant majorant [1]. Samples a pixel were chosen by opacity, threefold between
0.2 and 0.5.

[1] J. Novák, A. Selle, W. Jarosz, "Residual ratio tracking for estimating attenuation in participating media", ACM
    Transactions on Graphics 33(6), 2014.
"""

import argparse
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import torch
from torch import Tensor

from diffrender.atmosphere import height_fog
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.rays import Rays
from experiments import records

PICTURE = "fog_medium_only_black"
FOGGY = 0.2  # mean opacity from which a pixel counts
WELL_SAMPLED = (0.2, 0.5)  # opacities with the larger of the two numbers of samples
CUTS, FEW_CUTS, LOW = (1.0, 2.2, 4.0, 7.0), (2.0, 5.0), 25.0  # of layers [scale heights]; the few to 25 m of those
POINTS = 128  # of a ray, where the second moment of a sample is taken
GREEN = 1  # whose noise is measured: the fog is grey, and the channels share their samples


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene as its files tell it, in float64."""

    name: str
    fog: HeightFog
    view: FogView
    picture: Tensor
    samples: tuple[int, int]  # of pixels outside and inside the range that has more
    box: tuple[float, float]  # lowest and highest altitude that has fog [m]


@dataclass(frozen=True)
class Agreement:
    """A prediction beside the picture; all over foggy pixels but the first.

    Attributes:
        ratio: sum of the picture's pixels over that of the prediction's.
        ratio_error: its standard error by the noise of the pixels.
        chi_square: mean of the squared difference in units of the noise; 1 for a perfect prediction.
        noise: mean over pixels of the noise over the prediction.
        noise_told: the same by the renderer's own account of its samples.
    """

    scene: str
    rung: str
    ratio_everywhere: float
    ratio: float
    ratio_error: float
    chi_square: float
    noise: float
    noise_told: float


def read(folder: Path) -> tuple[Scene, float]:
    """A scene, and the relative noise that its renderer measured."""
    told = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    image = told["images"][PICTURE]

    def tensor(value: Any) -> Tensor:
        return torch.tensor(value, dtype=torch.float64)

    extinction, shares = tensor(told["sigma0"]), told["phase"]
    fog = HeightFog(
        extinction=extinction.mean(),
        extinction_tint=extinction / extinction.mean(),
        scale_height=tensor(told["scale_height"]),
        base_height=tensor(told["z0"]),
        albedo=tensor(told["albedo"]),
        rayleigh_share=tensor(shares["rayleigh_weight"]).expand(3),
        asymmetry=tensor(shares["g"]),
        sun_tint=torch.ones(3, dtype=torch.float64),
        ambient_tint=torch.zeros(3, dtype=torch.float64),
    )
    direction = channels(folder / "rays.exr", "RGB")
    rays = Rays(
        origin=tensor(told["eye"]),
        direction=direction / direction.norm(dim=-1, keepdim=True),  # stored in half the digits of float64
        length=channels(folder / "distance.exr", "Z")[..., 0],
    )
    nothing = torch.zeros(3, dtype=torch.float64)
    view = FogView(rays, nothing, tensor(told["direction_towards_sun"]), tensor(told["sun_irradiance"]), nothing)
    few, many = sorted(image["samples_per_pixel"])
    box = told["fog_box"]["bottom"], told["fog_box"]["top"]
    scene = Scene(told["name"], fog, view, channels(folder / f"{PICTURE}.exr", "RGB"), (few, many), box)
    return scene, float(image["noise"]["mean_relative_foggy"])


def channels(path: Path, names: str) -> Tensor:
    """Channels of an .exr file, last, in float64."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = file.parts[0].channels
        return torch.tensor(np.stack([found[name].pixels for name in names], -1), dtype=torch.float64)


def standard_error(scene: Scene) -> Tensor:
    """Noise of each pixel in green [W/(m² sr)]: that of one sample over the root of their number.

    Points are even in the opacity of the ray up to them, as the renderer draws them.
    """
    fog, rays = scene.fog, scene.view.rays
    extinction = height_fog.extinction(fog)[GREEN]
    eye = torch.exp(-(rays.origin[2] - fog.base_height) / fog.scale_height)
    opacity = 1.0 - torch.exp(-height_fog.optical_depth(fog, rays)[..., GREEN])
    share = (torch.arange(POINTS, dtype=torch.float64) + 0.5) / POINTS
    depth = -torch.log1p(-share * opacity[..., None])
    # The density falls linearly with the optical depth of the ray up to it.
    dense = eye - rays.direction[..., 2, None] * depth / (extinction * fog.scale_height)
    above = extinction * fog.scale_height * dense / scene.view.to_sun[2]
    height = fog.base_height - fog.scale_height * torch.log(dense.clamp(min=1e-30))
    first = opacity * torch.exp(-above).mean(-1)
    second = opacity * torch.exp(-2.0 * above + ratio_tracking(scene, height)).mean(-1)
    light = (height_fog.phase(fog, scene.view) * fog.albedo * scene.view.irradiance)[..., GREEN]
    many = (opacity > WELL_SAMPLED[0]) & (opacity < WELL_SAMPLED[1])
    few_samples, many_samples = (torch.full_like(first, float(count)) for count in scene.samples)
    return light * torch.sqrt((second - first * first) / torch.where(many, many_samples, few_samples))


def ratio_tracking(scene: Scene, height: Tensor) -> Tensor:
    """What ratio tracking adds to the logarithm of the second moment of the sun's transmittance.

    Tentative collisions come at the majorant's rate, and each multiplies the square by (1 - extinction/majorant)²; so
    it is the integral of extinction²/majorant along the sun's ray, with the majorant at the bottom of each layer.
    """
    fog, scale, base = scene.fog, float(scene.fog.scale_height), float(scene.fog.base_height)
    cuts = [base + cut * scale for cut in (FEW_CUTS if scale <= LOW else CUTS)]
    borders = [scene.box[0], *cuts, scene.box[1]]
    total = torch.zeros_like(height)
    for bottom, top in itertools.pairwise(borders):
        start = height.clamp(bottom, top)
        squared = torch.exp(-2.0 * (start - base) / scale) - math.exp(-2.0 * (top - base) / scale)
        total = total + squared * math.exp((bottom - base) / scale)
    return total * height_fog.extinction(fog)[GREEN] * scale / 2.0 / scene.view.to_sun[2]


def compare(folder: Path) -> list[Agreement]:
    """Predictions of one scene by the two closed forms."""
    scene, told = read(folder)
    noise = standard_error(scene)
    foggy = 1.0 - torch.exp(-height_fog.optical_depth(scene.fog, scene.view.rays)).mean(-1) > FOGGY
    found = []
    for rung in ("flat earth", "round earth"):
        predicted = height_fog.EFFECT.rungs[rung](scene.fog, scene.view)
        green = predicted[foggy][:, GREEN]
        chi = (scene.picture[foggy][:, GREEN] - green) / noise[foggy]
        found.append(
            Agreement(
                scene=scene.name,
                rung=rung,
                ratio_everywhere=float(scene.picture.sum() / predicted.sum()),
                ratio=float(scene.picture[foggy].sum() / predicted[foggy].sum()),
                ratio_error=float(noise[foggy].square().sum().sqrt() / green.sum()),
                chi_square=float(chi.square().mean()),
                noise=float((noise[foggy] / green).mean()),
                noise_told=told,
            )
        )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table and write it as JSON."""
    parser = argparse.ArgumentParser(description="height fog against path-traced scenes")
    parser.add_argument("--scenes", type=Path, required=True, help="folder of scenes, each a folder")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    folders = sorted(path.parent for path in given.scenes.glob("*/scene.json"))
    found = [asdict(row) for folder in folders for row in compare(folder)]
    print(table(found))
    records.write(given.out / "fog_scenes.json", {"records": found})


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Text of the table."""
    head = ("scene", "rung", "ratio, all pixels", "ratio, foggy", "its error", "chi²", "noise", "noise told")
    lines = [
        [
            row["scene"],
            row["rung"],
            *(f"{row[name]:.4f}" for name in ("ratio_everywhere", "ratio", "ratio_error")),
            f"{row['chi_square']:.3f}",
            *(f"{row[name]:.4f}" for name in ("noise", "noise_told")),
        ]
        for row in rows
    ]
    return records.table(head, lines)


if __name__ == "__main__":
    main()
