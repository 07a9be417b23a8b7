"""Materials by a deferred and a forward pass: what each pass draws, and what is lost where the G-buffer keeps bytes.

Each special material stands in its own scene; its frame, drawn from the buffer, is held against its own renderer, which
has all digits. The sheet shows the deferred picture, the frame, and ten times their difference from that renderer.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.colour import preview
from diffrender.parameters import defaults
from diffrender.shading import car_paint, eye, hair, layered_materials, skin, transparent
from diffrender.shading.eye_ball import Eye
from diffrender.shading.hair_view import Hair
from diffrender.shading.layered_materials import Part
from diffrender.shading.painted_surface import CarPaint
from diffrender.shading.skin_view import Skin
from diffrender.surfaces import Surface
from experiments import car_paint_scene, eye_scene, hair_scene, records, skin_scene, transparent_scene
from fit import png

SIZE, SMALL = (240, 200), (24, 20)  # of a scene's picture
STRONGER = 10.0  # differences in the sheet
GAP = 4  # between its pictures


@dataclass(frozen=True)
class Passes:
    """Pictures of a material: after the deferred pass, after the forward one, and by the material's own renderer."""

    deferred: Float[Tensor, "height width 3"]
    frame: Float[Tensor, "height width 3"]
    whole: Float[Tensor, "height width 3"]


@dataclass(frozen=True)
class Apart:
    """How far a frame is from the material's own renderer.

    Attributes:
        largest: difference of any value, in the brightest.
        median: of the values that are lit, each in its own.
    """

    material: str
    largest: float
    median: float


def of_car_paint(width: int, height: int) -> Passes:
    """A painted ball."""
    view, paint = car_paint_scene.picture_view(width, height), defaults(CarPaint, torch.float64)

    def forward(kept: Surface, lit: Tensor) -> Tensor:
        return car_paint.forward(paint, replace(view, normal=kept.normal), lit)

    framed = _framed(car_paint.deferred(paint, view), view, forward, car_paint.render(paint, view))
    return _before_black(framed, car_paint_scene.is_ball(width, height))


def of_eye(width: int, height: int) -> Passes:
    """An eye, whose cornea stands before the surface that the buffer keeps."""
    view, looks = eye_scene.picture_view(width, height), defaults(Eye, torch.float64)

    def forward(_: Surface, lit: Tensor) -> Tensor:
        return eye.forward(looks, view, lit)

    framed = _framed(eye.deferred(looks, view), view, forward, eye.render(looks, view))
    return _before_black(framed, eye_scene.is_eye(width, height))


def of_skin(width: int, height: int) -> Passes:
    """A face, whose light is worked out by its own pass: lighting as of the basic material keeps no two targets."""
    view, of = skin_scene.picture_view(width, height), defaults(Skin, torch.float64)
    like = torch.ones_like(view.mask)
    surface = Surface(view.normal, of.colour * view.texture, of.roughness * like, 0.0 * like)

    def forward(kept: Surface, _: Tensor) -> Tensor:
        return skin.render(of, replace(view, normal=kept.normal))

    return _before_black(_framed(surface, view, forward, skin.render(of, view)), view.mask > 0.0)


def of_hair(width: int, height: int) -> Passes:
    """A head of hair, of which the buffer keeps the direction of strands."""
    view, of = hair_scene.picture_view(width, height), defaults(Hair, torch.float64)

    def forward(kept: Surface, lit: Tensor) -> Tensor:
        return hair.forward(of, hair.seen_in_buffer(view, kept), lit)

    framed = _framed(hair.deferred(of, view), view, forward, hair.render(of, view))
    return _before_black(framed, framed.whole.sum(-1) > 0.0)


def of_glass(width: int, height: int) -> Passes:
    """Panes and bottles, which leave nothing in the buffer, over the opaque picture."""
    view, of = transparent_scene.picture_view(width, height), transparent_scene.glass()
    whole = transparent.render(of, view)
    return Passes(view.background, transparent.forward(of, view, view.background), whole)


MATERIALS: Mapping[str, Callable[[int, int], Passes]] = {
    "car paint": of_car_paint,
    "eye": of_eye,
    "skin": of_skin,
    "hair": of_hair,
    "transparent": of_glass,
}


def _framed(surface: Surface, view: Any, forward: layered_materials.Forward, whole: Tensor) -> Passes:
    """Pictures of a material that fills them."""
    part = Part((slice(None), slice(None)), surface, forward)
    draw = partial(layered_materials.drawn, layered_materials.written(surface, [part]), view.to_eye, view.lights)
    return Passes(draw([]), draw([part]), whole)


def _before_black(passes: Passes, shown: Bool[Tensor, "height width"]) -> Passes:
    """The same with black where the material is not."""
    return Passes(**{name: torch.where(shown[..., None], value, 0.0) for name, value in vars(passes).items()})


def apart(material: str, passes: Passes) -> Apart:
    """Distance of the frame from the material's own renderer."""
    difference, brightest = (passes.frame - passes.whole).abs(), passes.whole.max()
    lit = passes.whole > 1e-3 * brightest
    return Apart(material, float(difference.max() / brightest), float((difference[lit] / passes.whole[lit]).median()))


def sheet(drawn: Mapping[str, Passes]) -> np.ndarray:
    """Deferred picture, frame and what bytes change, a material a row."""
    rows = []
    for passes in drawn.values():
        exposure = 0.7 / passes.whole.flatten().quantile(0.97)
        shown = [preview(one, exposure) for one in (passes.deferred, passes.frame)]
        shown.append(0.5 + STRONGER * exposure * (passes.frame - passes.whole))
        cells = [np.rint(255.0 * one.clamp(0.0, 1.0).numpy()).astype(np.uint8) for one in shown]
        rows.append(
            np.concatenate([np.pad(one, ((0, GAP), (0, GAP), (0, 0)), constant_values=255) for one in cells], 1)
        )
    return np.concatenate(rows, 0)


@torch.no_grad()
def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and write it as JSON and the sheet as a picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=["small", "full"], default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS)
    given = parser.parse_args(arguments)
    size = SMALL if given.size == "small" else SIZE
    drawn = {name: draw(*size) for name, draw in MATERIALS.items()}
    found = [apart(name, passes) for name, passes in drawn.items()]
    rows = [[one.material, f"{one.largest:.2g}", f"{one.median:.2g}"] for one in found]
    print(records.table(["material", "largest difference", "median"], rows))
    records.write(given.out / "materials.json", {"size": size, "materials": [asdict(one) for one in found]})
    (given.out / "materials.png").write_bytes(png.encoded(sheet(drawn)))


if __name__ == "__main__":
    main()
