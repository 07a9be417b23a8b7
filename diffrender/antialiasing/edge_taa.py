"""Anti-aliasing of two frames whose samples lie on the edges between pixels [1].

Even frames are sampled half a pixel below the pixel centres, odd ones half a pixel to the right of them. FXAA smooths
each; then it is resampled to the centres along its jitter, by four taps with negative lobes that shrink with contrast,
so that textures stay sharp and edges get little halo. The picture is the mean of this frame and the reprojected one
before, both so sharpened: four samples at the middles of the pixel's edges. Where the one before may not be used, it
is this frame alone without sharpening, which would show its aliasing. It is read between its pixels by a cubic, because
bilinear means blur what moves by fractions of a pixel.

Only the input of the frame before is used, never its output: nothing lasts longer than one frame, and a scene at rest
whose motion is known never changes from the second frame on.

The filter's taps are -k, 1/2 + k, 1/2 + k, -k with k = sharpening / (1 + (response contrast)^2), contrast being the
range of brightness of the four; the talk gives neither taps nor response, and these are ours.

Gradient: that of `fxaa` and `history`: exact where decisions stay; "soft" differentiates them.

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games".
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.antialiasing import footage, fxaa, history
from diffrender.antialiasing.edges import encoded_luma
from diffrender.antialiasing.footage import Footage
from diffrender.antialiasing.settings import PREFIX, AntiAliasing
from diffrender.effect import Effect, Rung
from diffrender.images import Frames, catmull_rom, clamped

OVERSHOOT = 9.0 / 32.0  # of `catmull_rom` between four pixels: its negative weights [of the range of its pixels]
OFFSETS = ((0.0, 0.5), (0.5, 0.0))  # of even and odd frames: to the right and down [pixels]


@dataclass(frozen=True)
class Decisions:
    """How edges are smoothed and history is accepted."""

    smoothed: Callable[[AntiAliasing, Tensor], Tensor]
    accept: history.Accept


HARD = Decisions(partial(fxaa.preset, quality=12), history.accept)
SOFT = Decisions(fxaa.soft, partial(history.accept_softly, softness=fxaa.SOFTNESS))


@dataclass(frozen=True)
class State:
    """What a frame leaves to the next: its sharpened picture, its motion, and how many frames there were."""

    sharpened: Float[Tensor, "*batch height width 3"]
    motion: Float[Tensor, "*batch height width 2"]
    frames: int


def step(
    settings: AntiAliasing, frame: Frames, state: State | None, decisions: Decisions = HARD
) -> tuple[Float[Tensor, "*batch height width 3"], State]:
    """Picture of one frame and what it leaves to the next; without a state it is the first, an even one."""
    count = 0 if state is None else state.frames
    smoothed = decisions.smoothed(settings, frame.colour)
    plain, sharpened = centred(settings, smoothed, count)
    motion = history.motion_of(frame, (plain.shape[-3], plain.shape[-2]))
    left = State(sharpened, motion, count + 1)
    if state is None:
        return plain, left
    before = history.reprojected(partial(catmull_rom, state.sharpened, address=clamped), state.motion, motion)
    share = decisions.accept(settings, plain, before)[..., None]
    return torch.lerp(plain, (sharpened + before.colour) / 2, share), left


def render(
    settings: AntiAliasing, frames: Frames, decisions: Decisions = HARD
) -> Float[Tensor, "*batch time height width 3"]:
    """Pictures of a sequence of frames, the first of which is even."""
    return history.folded(partial(step, decisions=decisions), settings, frames)


def centred(
    settings: AntiAliasing, samples: Float[Tensor, "*batch height width 3"], count: int
) -> tuple[Float[Tensor, "*batch height width 3"], Float[Tensor, "*batch height width 3"]]:
    """Frame number `count` resampled from the pixels' edges to their centres: the mean of two, and sharpened."""
    axis = -2 if count % 2 else -3
    size = samples.shape[axis]
    centre = torch.arange(size, device=samples.device)
    before, left, right, after = (samples.index_select(axis, clamped(centre + tap, size)) for tap in (-2, -1, 0, 1))
    luma = torch.stack([encoded_luma(tap) for tap in (before, left, right, after)])
    response = settings.contrast_response * (luma.amax(0) - luma.amin(0))
    lobe = settings.sharpening / (1.0 + response * response)
    inner = left + right
    return inner / 2, inner / 2 + lobe[..., None] * (inner - (before + after))


def skip(_settings: AntiAliasing, frames: Frames) -> Float[Tensor, "*batch time height width 3"]:
    """Frames as they are: one sample in each pixel's centre."""
    return frames.colour


def largest_change(settings: AntiAliasing, shown: Footage) -> Float[Tensor, ""]:
    """Bound on the change of any value: the range of the samples, what the lobes add to either end, and history."""
    lobes = 2.0 * settings.sharpening
    return footage.spread(shown.fine) * (1.0 + lobes + OVERSHOOT / 2.0 * (1.0 + 2.0 * lobes))


def between_pixels(_settings: AntiAliasing, shown: Footage) -> Frames:
    """Frames sampled between the pixel centres, as `step` takes them."""
    even, odd = (footage.points(shown.fine, offset) for offset in OFFSETS)
    is_odd = torch.arange(even.shape[-4], device=even.device) % 2 == 1
    return Frames(torch.where(is_odd[:, None, None, None], odd, even), shown.motion, None)


def centres(_settings: AntiAliasing, shown: Footage) -> Frames:
    """Frames sampled at the pixel centres."""
    return Frames(footage.points(shown.fine, (0.0, 0.0)), shown.motion, None)


def truth(_settings: AntiAliasing, shown: Footage) -> Float[Tensor, "*batch time height width 3"]:
    """Mean of 256 samples of each pixel of each frame."""
    return footage.truth(shown.fine)


EFFECT = Effect(
    parameters=AntiAliasing,
    prefix=PREFIX,
    rungs={
        "skip": Rung(skip, centres),
        "soft": Rung(partial(render, decisions=SOFT), between_pixels),
        "two frames": Rung(render, between_pixels),
    },
    reference=truth,
    # Two samples in a pixel's first frame, four later on, of lines much thinner than a pixel.
    tolerance=0.6,
    largest_change=largest_change,
    example_inputs=footage.example_footage,
)
