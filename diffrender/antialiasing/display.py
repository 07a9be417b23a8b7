"""What anti-aliasing works on: radiance as a screen is sent it, tone-mapped, in sRGB or PQ, and in ten bits [1].

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games".
[2] E. Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002, equation 3.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.colour import pq_encode, srgb_encode

LEVELS = 1023.0  # steps of ten bits
PEAK = 1000.0  # of an HDR screen [cd/m^2]


def tone_mapped(exposed: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of a screen's peak, in [0, 1): x / (1 + x) of each channel [2]; 0 for negative ones.

    Gradient: falls like 1 / x^2 in the light; 0 below black.

    >>> tone_mapped(torch.tensor([-1.0, 0.0, 1.0, 4e5]))
    tensor([0.0000, 0.0000, 0.5000, 1.0000])
    """
    positive = exposed.clamp(min=0.0)
    return positive / (1.0 + positive)


def shown_srgb(exposed: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """What a screen of standard range is sent, in [0, 1]."""
    return srgb_encode(tone_mapped(exposed))


def shown_pq(exposed: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """What an HDR screen is sent, in [0, 1]."""
    return pq_encode(PEAK * tone_mapped(exposed))


def ten_bits(shown: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Nearest of 1024 levels from 0 to 1.

    Gradient: straight through, as if nothing were rounded; 0 outside [0, 1].
    """
    inside = shown.clamp(0.0, 1.0)
    return inside + (torch.round(inside * LEVELS) / LEVELS - inside).detach()
