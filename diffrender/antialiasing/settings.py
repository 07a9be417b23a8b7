"""Settings of anti-aliasing: one record for FXAA, two frames at pixel edges and the checkerboard, which share them."""

from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record

PREFIX = "AA"  # of the names in weather files


@record
class AntiAliasing:
    """What an artist may tune; pictures are what a screen is sent, from 0 to 1."""

    edge_threshold: Float[Tensor, ""] = parameter(
        0.166,
        bounds=(0.0, 1.0),
        unit="1",
        about="least contrast of an edge that FXAA smooths, over its brightest pixel",
    )
    edge_threshold_minimum: Float[Tensor, ""] = parameter(
        0.0833, bounds=(0.0, 1.0), unit="1", about="least contrast of an edge that FXAA smooths, in the dark"
    )
    subpixel: Float[Tensor, ""] = parameter(
        0.75, bounds=(0.0, 1.0), unit="1", about="how far FXAA blurs lone pixels and thin lines away"
    )
    sharpening: Float[Tensor, ""] = parameter(
        1.0 / 16.0,
        bounds=(0.0, 0.25),
        unit="1",
        about="negative lobe of the filter from pixel edges to centres; 0 is a mean of two, 1/16 keeps parabolas, "
        "more sharpens and draws haloes",
    )
    contrast_response: Float[Tensor, ""] = parameter(
        2.0,
        bounds=(0.0, 32.0),
        unit="1",
        about="how fast sharpening falls with contrast; at 2, by half where it is 0.5",
    )
    history_tolerance: Float[Tensor, ""] = parameter(
        0.02,
        bounds=(1e-3, 1.0),
        unit="1",
        about="how far outside the colours near it a pixel of the last frame may lie and be used; more ghosts",
        scale="log",
    )
