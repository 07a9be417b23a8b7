"""Pictures of a sharpening fit: what each way of anti-aliasing makes of a photo, how good it is, and crops of it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, UInt8
from skimage.metrics import structural_similarity
from torch import Tensor

from diffrender.antialiasing import fxaa
from diffrender.antialiasing.display import PEAK
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.colour import pq_decode, srgb_decode, srgb_encode
from diffrender.parameters import defaults
from fit.picture import Drawn
from fit.sampled_photo import FASTEST, Scenery, Views, inner
from fit.sharpening_objective import UNSMOOTHED, drawn

ROWS = 128  # of a picture, drawn at a time
CROPS = 3  # that the report shows
# Pixels beyond which nothing changes a pixel: FXAA's search of preset 12, two taps and a sample's square, and motion.
REACH = 16 + 1 + math.ceil(FASTEST)
SHOWN = ("none", "fxaa", "default", "fitted", "reference")  # side by side in the report and in fitted.exr


def methods(settings: AntiAliasing, views: Views) -> dict[str, Float[Tensor, "views height width 3"]]:
    """Pictures of views by the fitted settings and by what they are compared with.

    "none" is one sample in each pixel's centre, "fxaa" that smoothed; "average" the mean of the four samples round a
    pixel, "catmull-rom" the same sharpened by 1/16 whatever the contrast, both without FXAA; "without fxaa" the fitted
    settings without it.
    """
    usual = defaults(AntiAliasing, views.truth.dtype)
    return {
        "none": views.centres,
        "fxaa": fxaa.preset(usual, views.centres, quality=12),
        "average": drawn(_sharpened_by(usual, 0.0), views, UNSMOOTHED),
        "catmull-rom": drawn(_sharpened_by(usual, 1.0 / 16.0), views, UNSMOOTHED),
        "default": drawn(usual, views),
        "without fxaa": drawn(settings, views, UNSMOOTHED),
        "fitted": drawn(settings, views),
        "reference": views.truth,
    }


def _sharpened_by(settings: AntiAliasing, lobe: float) -> AntiAliasing:
    one = settings.sharpening
    return replace(settings, sharpening=one.new_tensor(lobe), contrast_response=one.new_tensor(0.0))


def scores(settings: AntiAliasing, views: Views) -> dict[str, dict[str, float]]:
    """Method -> "psnr" [dB] and "ssim" of the judged part of views, of what the screen is sent.

    A picture without any error counts as 200 dB.
    """
    pictures = {name: inner(picture).numpy() for name, picture in methods(settings, views).items()}
    truth = pictures.pop("reference")
    return {name: {"psnr": psnr(picture, truth), "ssim": _ssim(picture, truth)} for name, picture in pictures.items()}


def psnr(picture: Float[np.ndarray, "*shape"], truth: Float[np.ndarray, "*shape"]) -> float:
    """Ratio of a screen's peak to the root mean square error [dB]; 200 at most.

    >>> round(psnr(np.array([0.1]), np.array([0.0])), 9)
    20.0
    """
    return float(-10.0 * np.log10(max(float(np.square(picture - truth).mean()), 1e-20)))


def _ssim(pictures: Float[np.ndarray, "n h w 3"], truths: Float[np.ndarray, "n h w 3"]) -> float:
    similarity: Callable[..., float] = structural_similarity  # it has no types
    found = [
        similarity(one, truth, channel_axis=-1, data_range=1.0) for one, truth in zip(pictures, truths, strict=True)
    ]
    return float(np.mean(found))


def draw(scenery: Scenery, settings: AntiAliasing) -> Drawn:
    """The whole photo by each method that is shown, the fitted one first: linear light of the screen, 1 its peak.

    Band by band, in float32, in the size of the pictures; where the scene moves, all of it does. What filters push
    beyond black and white is cut off there.
    """
    height, width = scenery.size
    found: Drawn = {
        name: np.zeros((height, width, 3), np.float32) for name in sorted(SHOWN, key=lambda name: name != "fitted")
    }
    for top in range(0, height, ROWS):
        bottom = min(top + ROWS, height)
        first, last = max(top - REACH, 0), min(bottom + REACH, height)
        views = scenery.views([(first, 0)], (last - first, width), torch.float32)
        pictures = methods(settings, views)
        for name, whole in found.items():
            whole[top:bottom] = _light(scenery, pictures[name])[0, top - first : bottom - first].numpy()
    return found


def crops(settings: AntiAliasing, scenery: Scenery, some: Views) -> list[Mapping[str, UInt8[np.ndarray, "h w 3"]]]:
    """Of the first views, the picture by each method that is shown, as a screen of standard range shows it."""
    views = some.first(CROPS)
    pictures = {
        name: srgb_encode(_light(scenery, inner(picture)))
        for name, picture in methods(settings, views).items()
        if name in SHOWN
    }
    eight_bits = {name: np.rint(255.0 * picture.numpy()).astype(np.uint8) for name, picture in pictures.items()}
    return [{name: eight_bits[name][index] for name in SHOWN} for index in range(len(views.truth))]


def _light(scenery: Scenery, shown: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Linear light of a screen that is sent something, 1 its peak."""
    inside = shown.clamp(0.0, 1.0)
    if scenery.sampling.screen == "pq":
        return (pq_decode(inside) / PEAK).clamp(0.0, 1.0)
    return srgb_decode(inside)
