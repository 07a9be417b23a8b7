"""Our FXAA beside that of the npm package `three`, drawn by a headless Chromium in software, pixel by pixel.

Give the unpacked package (`npm pack three && tar xzf three-*.tgz`) as `--three package`. Ours runs with the pass' own
constants. Of two equally steep sides of a vertical edge the pass takes the right one and we the left one, so ours
runs on the mirrored picture.
"""

import argparse
import base64
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from diffrender.antialiasing import fxaa
from diffrender.antialiasing.display import shown_srgb
from diffrender.antialiasing.edges import Search
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.parameters import defaults
from experiments import browser, records
from experiments.aliased_scenes import SCENES, Drifting
from fit import photo

WIDTH, HEIGHT = 256, 144
PHOTOS = Path(__file__).parent / "photos"
PHOTO_NAMES = ("blender_courtyard", "blender_forest")

STEPS = (1.0, 1.5, 2.0, 2.0, 2.0, 4.0, 8.0)
LUMA = (0.3, 0.59, 0.11)
SETTINGS = replace(
    defaults(AntiAliasing, torch.float64),
    edge_threshold=torch.tensor(0.063, dtype=torch.float64),
    edge_threshold_minimum=torch.tensor(0.0312, dtype=torch.float64),
    subpixel=torch.tensor(1.0, dtype=torch.float64),
)

PAGE = """<!doctype html><html><body><pre id="out"></pre>
IMPORTS
<script type="module">
import * as THREE from 'three';
import { FXAAPass } from 'three/addons/postprocessing/FXAAPass.js';
const given = GIVEN, renderer = new THREE.WebGLRenderer();
const target = new THREE.WebGLRenderTarget(given.width, given.height, { type: THREE.FloatType });
const pass = new FXAAPass();
pass.setSize(given.width, given.height);
const drawn = given.pictures.map((text) => {
  const bytes = Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
  const texture = new THREE.DataTexture(bytes, given.width, given.height, THREE.RGBAFormat, THREE.UnsignedByteType);
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  pass.render(renderer, target, { texture });
  const found = new Float32Array(4 * given.width * given.height);
  renderer.readRenderTargetPixels(target, 0, 0, given.width, given.height, found);
  return Array.from(found, (value) => Math.round(value * 65535));
});
document.getElementById('out').textContent = JSON.stringify({ version: THREE.REVISION, drawn });
</script></body></html>
"""


@dataclass(frozen=True)
class Compared:
    """Mean absolute differences on one picture, of 1.

    Attributes:
        change: the pass' output less its input.
        apart: ours less the pass' output.
        share: apart over change.
        pixels: share of pixels that are more than 1/255 apart.
    """

    picture: str
    change: float
    apart: float
    share: float
    pixels: float


def pictures() -> dict[str, Tensor]:
    """Aliased scenes and photos, in 8 bits."""
    found = {name: Drifting(shown, WIDTH, HEIGHT).sampled(0, (0.0, 0.0)) for name, shown in SCENES.items()}
    for name in PHOTO_NAMES:
        radiance = torch.from_numpy(np.ascontiguousarray(photo.read(PHOTOS / f"{name}.exr").radiance)).clamp(min=0.0)
        top, left = (size // 2 - half for size, half in zip(radiance.shape, (HEIGHT // 2, WIDTH // 2), strict=False))
        crop = radiance[top : top + HEIGHT, left : left + WIDTH].float()
        found[name] = shown_srgb(crop / crop.median())
    return {name: torch.round(255.0 * picture) / 255.0 for name, picture in found.items()}


def ours(picture: Tensor) -> Tensor:
    """The picture smoothed by our FXAA with the pass' constants."""
    mirrored = picture.double().flip(-2)
    luma = (mirrored * mirrored.new_tensor(LUMA)).sum(-1)
    return fxaa.filtered(SETTINGS, mirrored, luma, Search(STEPS)).flip(-2)


def compared(name: str, picture: Tensor, theirs: Tensor) -> Compared:
    """Figures of one picture, from what the pass made of it."""
    change = float((theirs - picture).abs().mean())
    differences = (ours(picture) - theirs).abs()
    apart = float(differences.mean())
    far = float((differences > 1.0 / 255.0).any(-1).double().mean())
    return Compared(name, change, apart, apart / change, far)


def browser_page(given: Sequence[Tensor]) -> str:
    """Page that smooths pictures; its rows go from the bottom up, as textures do."""
    height, width = given[0].shape[:2]
    texts = []
    for picture in given:
        pixels = np.full((height, width, 4), 255, np.uint8)
        pixels[..., :3] = np.rint(255.0 * picture.flip(0).numpy())
        texts.append(base64.b64encode(pixels.tobytes()).decode())
    page = PAGE.replace("IMPORTS", browser.IMPORTS)
    return page.replace("GIVEN", json.dumps({"width": width, "height": height, "pictures": texts}))


def smoothed_by_three(package: Path, given: Sequence[Tensor]) -> tuple[str, list[Tensor]]:
    """Version of three, and what its pass makes of pictures.

    Raises:
        FileNotFoundError: when there is no Chromium.
        RuntimeError: when the page ends without a result.
    """
    found = browser.result(package, {"page.html": browser_page(given)})
    height, width = given[0].shape[:2]
    drawn = [torch.tensor(one, dtype=torch.float64).reshape(height, width, 4) / 65535.0 for one in found["drawn"]]
    return found["version"], [one[..., :3].flip(0) for one in drawn]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write the differences."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--three", type=Path, required=True, help="the unpacked npm package")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    shown = pictures()
    version, theirs = smoothed_by_three(given.three, list(shown.values()))
    rows = [compared(name, picture, made) for (name, picture), made in zip(shown.items(), theirs, strict=True)]
    columns = ["change", "apart", "share", "pixels"]
    lines = [[row.picture, *(f"{getattr(row, name):.5f}" for name in columns)] for row in rows]
    print(records.table(["picture", *columns], lines))
    records.write(given.out / "three_fxaa.json", {"three": version, "records": [asdict(row) for row in rows]})


if __name__ == "__main__":
    main()
