"""Frames of many materials, split over a deferred and a forward pass as in the talk [1].

    material      the deferred pass writes            the forward pass draws
    basic         all of it                           nothing
    eye           what is diffuse                     the second specular
    car paint     the base coat                       flakes and clear coat
    skin          diffuse and specular, two targets   the diffuse blurred, both combined
    hair          depth and direction                 all shading
    transparent   nothing                             all, over what is behind

Whatever is opaque stands in one G-buffer, and is lit once a pixel. Then each special material draws over its own
pixels, from what the buffer has kept of them and from their light; transparent ones come last. So a frame is that of
the materials' own renderers but for the bytes of `surfaces`.

Gradient: exact by lights and by what forward passes draw; 0 by what has become bytes.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slides "Deferred" and
    "Forward: tricks for special materials".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.shading import brdf
from diffrender.surfaces import GBuffer, Lights, Surface, packed, unpacked

Pixels = Bool[Tensor, "height width"] | tuple[slice, slice]
Forward = Callable[[Surface, Tensor], Tensor]


@dataclass(frozen=True)
class Part:
    """A special material's pixels: any of a picture, or a rectangle where neighbours have to be known.

    Attributes:
        surface: what its deferred pass writes into them; None for what is transparent.
        forward: radiance towards the eye, by the surface that the buffer has kept and by the light on it.
    """

    pixels: Pixels
    surface: Surface | None
    forward: Forward


def written(ground: Surface, parts: Sequence[Part]) -> GBuffer:
    """The deferred pass: a picture of the basic material, with the surfaces of all parts in their places.

    Raises:
        ValueError: as of `surfaces.packed`.
    """
    whole = {name: value.clone() for name, value in vars(ground).items()}
    for part in parts:
        if part.surface is not None:
            for name, value in vars(part.surface).items():
                whole[name][part.pixels] = value
    return packed(Surface(**whole))


def drawn(
    buffer: GBuffer, to_eye: Float[Tensor, "height width 3"], lights: Lights, parts: Sequence[Part]
) -> Float[Tensor, "height width 3"]:
    """Radiance towards the eye [W/(m² sr)]: the buffer is lit, then parts draw over it in their order."""
    kept = unpacked(buffer, to_eye.dtype)
    picture = brdf.lit(kept, to_eye, lights)
    for part in parts:
        of_part = Surface(**{name: value[part.pixels] for name, value in vars(kept).items()})
        # A copy of these pixels alone: their light is kept for gradients, and then drawn over.
        picture[part.pixels] = part.forward(of_part, picture[part.pixels].clone())
    return picture
