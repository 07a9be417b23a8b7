"""README's picture: a photo, its fitted sky and the difference, side by side.

`python -m experiments.readme_picture` writes experiments/results/spruit_sunrise.png.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from diffrender.colour import preview
from fit import keyframes, photo, picture, png, sky

HERE = Path(__file__).parent
GAP = 6  # columns of white between pictures
STOPS = 1.0  # of difference that saturate its colours


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--photo", type=Path, default=HERE / "photos" / "spruit_sunrise.exr")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "spruit_sunrise.png")
    options = parser.parse_args()
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_bytes(png.encoded(side_by_side(options.photo)))


def side_by_side(path: Path) -> np.ndarray:
    """Photo, fitted sky and difference, tone-mapped, upper halves of the panorama."""
    seen = photo.read(path)
    solution = sky.fit(seen)
    drawn = picture.draw(keyframes.scene(keyframes.values(solution.scene)), seen.camera)["sky"]
    horizon = seen.camera.height // 2
    shot, model = seen.radiance[:horizon].astype(np.float32), drawn[:horizon]
    # Lossy compression leaves negative channels beside the sun, which would be shown as coloured boxes.
    shot = np.where(shot < 0.0, shot.max(-1, keepdims=True), shot)
    exposure = 0.35 / float(np.median(shot[solution.used[:horizon]]))
    white = np.full((horizon, GAP, 3), 255, np.uint8)
    parts = [_shown(shot, exposure), white, _shown(model, exposure), white]
    return np.concatenate([*parts, _difference(shot, model, solution.used[:horizon])], 1)


def _shown(radiance: Float[np.ndarray, "h w 3"], exposure: float) -> np.ndarray:
    shown: np.ndarray = preview(torch.from_numpy(radiance), torch.tensor(exposure)).numpy()
    pixels: np.ndarray = np.rint(255.0 * shown).astype(np.uint8)
    return pixels


def _difference(shot: np.ndarray, model: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Stops by which the model is brighter (red) or darker (blue); grey where the photo was not used."""
    stops = np.log2(np.maximum(model, 1e-9) / np.maximum(shot, 1e-9)).mean(-1) / STOPS
    warm, cold = np.clip(stops, 0.0, 1.0), np.clip(-stops, 0.0, 1.0)
    shown = np.stack([1.0 - cold, 1.0 - warm - cold, 1.0 - warm], -1)
    shown[~used] = 0.6
    pixels: np.ndarray = np.rint(255.0 * np.clip(shown, 0.0, 1.0)).astype(np.uint8)
    return pixels


if __name__ == "__main__":
    main()
