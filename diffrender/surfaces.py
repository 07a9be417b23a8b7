"""Surfaces, the lights that shine on them from afar, and a G-buffer that keeps a surface in eight bytes a pixel.

A deferred renderer writes what is seen first, and lights it afterwards, each pixel once. What it writes, of the basic
material, are two targets of four bytes:

    colour   base colour as sRGB encodes it, metalness
    normal   a place on the octahedron unfolded to a square [1], twice 12 bits, and roughness

So base and metalness, roughness too, are kept within half of one of 255 steps, of base in sRGB; normals within
`NORMAL_ERROR`. What is unpacked packs to the same bytes again. The talk has such a layout, and does not say which [2].

Gradient: none, bytes are whole numbers; deferred pictures follow the gradient of what they are lit by.

[1] Z. Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT 3(2), 2014, oct24.
[2] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "G-buffer layout for
    basic BRDF material".
"""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from diffrender.colour import srgb_decode, srgb_encode
from diffrender.parameters import record
from diffrender.rays import unit

NORMAL_ERROR = 1.05e-3  # largest angle between a normal and what is unpacked of it [rad]

_STEPS = 255.0  # of a byte
# Steps from the middle of the unfolded octahedron to its border: an even number in all, so that axes are kept as they
# are.
_HALF_SQUARE = 2047


@record
class Surface:
    """The basic material and how it is turned; all but the normal from 0 to 1."""

    normal: Float[Tensor, "*#batch 3"]  # unit vector
    base: Float[Tensor, "*#batch 3"]  # what a metal reflects straight on, and of all else the colour of its ground
    roughness: Float[Tensor, "*#batch"]
    metallic: Float[Tensor, "*#batch"]


@record
class EvenSky:
    """Radiance of a direction: the mean plus the gradient times the sine of its elevation [W/(m² sr)]."""

    mean: Float[Tensor, "*#batch 3"]
    gradient: Float[Tensor, "*#batch 3"]


@record
class Lights:
    """Lights from afar, alike for all surfaces, and the sky all round; exposed already."""

    to_light: Float[Tensor, "lights 3"]  # unit vectors
    irradiance: Float[Tensor, "lights 3"]  # on what faces the light [W/m²]
    sky: EvenSky


@record
class GBuffer:
    """Surfaces in two targets of four bytes."""

    colour: UInt8[Tensor, "*batch 4"]
    normal: UInt8[Tensor, "*batch 4"]


def packed(surface: Surface) -> GBuffer:
    """Surfaces as bytes.

    Raises:
        ValueError: when base, roughness or metalness is not within 0 and 1, which bytes cannot hold.
    """
    for name in ("base", "roughness", "metallic"):
        value = getattr(surface, name)
        if not ((value >= 0.0) & (value <= 1.0)).all():
            raise ValueError(f"{name} is from {value.min():g} to {value.max():g}; a G-buffer holds 0 to 1, scale it")
    base, roughness, metallic = surface.base, surface.roughness[..., None], surface.metallic[..., None]
    batch = (surface.normal[..., :1] + base[..., :1] + roughness + metallic).shape[:-1]
    colour = torch.cat([srgb_encode(base).expand(*batch, 3), metallic.expand(*batch, 1)], -1)
    across, along = _unfolded(surface.normal).unbind(-1)
    places = torch.stack([across >> 4, ((across & 15) << 4) | (along >> 8), along & 255], -1)
    rough = (roughness * _STEPS).round().to(places).expand(*batch, 1)
    normal = torch.cat([places.expand(*batch, 3), rough], -1)
    return GBuffer((colour * _STEPS).round().to(torch.uint8), normal.to(torch.uint8))


def unpacked(buffer: GBuffer, dtype: torch.dtype) -> Surface:
    """Surfaces that bytes stand for."""
    colour = buffer.colour.to(dtype) / _STEPS
    first, shared, last, rough = buffer.normal.to(torch.int32).unbind(-1)
    place = torch.stack([(first << 4) | (shared >> 4), ((shared & 15) << 8) | last], -1)
    return Surface(
        _folded(place.to(dtype) / _HALF_SQUARE - 1.0),
        srgb_decode(colour[..., :3]),
        rough.to(dtype) / _STEPS,
        colour[..., 3],
    )


def _unfolded(normal: Float[Tensor, "*batch 3"]) -> Tensor:
    """Place of a normal on the unfolded octahedron, in steps."""
    on_octahedron = normal / normal.abs().sum(-1, keepdim=True)
    place = torch.where(on_octahedron[..., 2:] < 0.0, _turned_over(on_octahedron[..., :2]), on_octahedron[..., :2])
    steps = (place * _HALF_SQUARE).round().to(torch.int32)
    # The border's two halves are the same edge of the octahedron: of them the upper one.
    steps = torch.where((steps.abs() == _HALF_SQUARE).flip(-1), steps.abs(), steps)
    return steps + _HALF_SQUARE


def _folded(place: Float[Tensor, "*batch 2"]) -> Tensor:
    """Unit normal at a place of the square from -1 to 1; its corners are the lower pole."""
    height = 1.0 - place.abs().sum(-1, keepdim=True)
    return unit(torch.cat([torch.where(height < 0.0, _turned_over(place), place), height], -1))


def _turned_over(place: Tensor) -> Tensor:
    """The square's corners folded over its inscribed diamond; the same undoes it."""
    side = torch.where(place < 0.0, -1.0, 1.0).to(place)
    return side * (1.0 - place.flip(-1).abs())
