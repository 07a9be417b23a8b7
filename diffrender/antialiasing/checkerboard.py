"""Checkerboard: every frame renders half of the pixels' corners, and two frames all of them [1].

Each frame, as a screen is sent it, is kept in ten bits, packed into a tangram in YCoCg, and smoothed by FXAA there,
whose horizontal and vertical edges are the screen's diagonals: those are the sparse ones of a checkerboard. A pixel's
centre is the mean of its two lit corners, one bilinear tap. Where the frame before may be used, the picture is the mean
of both, four corners; elsewhere of this frame alone. Nothing is sharpened: it has more detail than a smaller frame
sharpened to the same size, and less contrast in it.

Nothing but corners is rendered: no depth or identity at full resolution.

Gradient: that of `fxaa` and `history`: exact where decisions stay; the ten bits are straight through.

[1] G. de Carpentier, K. Ishiyama, "Decima Engine: Advances in Lighting and AA", SIGGRAPH 2017 course "Advances in
    Real-Time Rendering in Games".
"""

from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.antialiasing import edge_taa, footage, fxaa, history, tangram
from diffrender.antialiasing.display import ten_bits
from diffrender.antialiasing.edges import Search
from diffrender.antialiasing.footage import Footage
from diffrender.antialiasing.settings import PREFIX, AntiAliasing
from diffrender.colour import rgb_from_ycocg, ycocg_from_rgb
from diffrender.effect import Effect, Rung
from diffrender.images import Frames, places, wrapped

OFFSET = (-0.5, -0.5)  # of a pixel's upper left corner from its centre [pixels]


@dataclass(frozen=True)
class State:
    """What a frame leaves to the next: its smoothed tangram, its motion, and how many frames there were."""

    texture: Float[Tensor, "*batch height height 3"]
    motion: Float[Tensor, "*batch height width 2"]
    frames: int


def step(
    settings: AntiAliasing, frame: Frames, state: State | None
) -> tuple[Float[Tensor, "*batch height width 3"], State]:
    """Picture of one frame and what it leaves to the next; without a state it is the first, of parity 0.

    The frame's colours are its lit corners (*batch, height, width / 2, 3), as `tangram.pack` takes them.
    """
    count = 0 if state is None else state.frames
    height, width = frame.colour.shape[-3], 2 * frame.colour.shape[-2]
    packed = tangram.pack(ycocg_from_rgb(ten_bits(frame.colour)), parity=count % 2)
    whole = tangram.filled(packed, width=width, parity=count % 2)
    texture = fxaa.filtered(settings, whole, whole[..., 0], Search(address=wrapped))
    motion = history.motion_of(frame, (height, width))
    current = shown_at(texture, places(width, height, texture.new_zeros(2)), width, count)
    left = State(texture, motion, count + 1)
    if state is None:
        return current, left
    before = history.reprojected(
        partial(shown_at, state.texture, width=width, count=state.frames - 1), state.motion, motion
    )
    share = history.accept(settings, current, before)[..., None]
    return torch.lerp(current, (current + before.colour) / 2, share), left


def render(settings: AntiAliasing, frames: Frames) -> Float[Tensor, "*batch time height width 3"]:
    """Pictures of a sequence of frames, the first of which has parity 0."""
    return history.folded(step, settings, frames)


def shown_at(
    texture: Float[Tensor, "*batch texels texels 3"],
    place: Float[Tensor, "*#batch height width 2"],
    width: int,
    count: int,
) -> Float[Tensor, "*batch height width 3"]:
    """Red, green and blue of frame number `count` at places of the picture."""
    return rgb_from_ycocg(tangram.sample(texture, place, width=width, parity=count % 2))


def corners(_settings: AntiAliasing, shown: Footage) -> Frames:
    """Frames of lit corners, as `step` takes them."""
    every = footage.points(shown.fine, OFFSET)
    frames = [tangram.lit(one, parity=count % 2) for count, one in enumerate(every.unbind(-4))]
    return Frames(torch.stack(frames, -4), shown.motion, None)


def largest_change(_settings: AntiAliasing, shown: Footage) -> Float[Tensor, ""]:
    """Bound on the change of any value: the range of the samples, and half a step of ten bits."""
    return footage.spread(shown.fine) + 0.5 / 1023.0


EFFECT = Effect(
    parameters=AntiAliasing,
    prefix=PREFIX,
    rungs={
        "skip": Rung(edge_taa.skip, edge_taa.centres),
        "two frames": Rung(render, corners),
    },
    reference=edge_taa.truth,
    # Half a sample in a pixel's first frame, one later on, of lines much thinner than a pixel.
    tolerance=0.6,
    largest_change=largest_change,
    example_inputs=footage.example_footage,
)
