"""Froxel fog: fog near the eye with light shafts, lamps and moving noise, in a grid of cells that the camera sees [1].

The talk's weather file calls its far fog VOLLIGHT_FARFOG, so what is not far is VOLLIGHT here: the volumetric light of
the first hundred metres. In every froxel the fog's density, thinned with height and stirred by noise that the wind
carries, meets the light of the sun through its blurred shadow, of lamps, and of a probe; columns of froxels are summed
to the eye [2, 3]. Grid, camera, lights and noise arrive as tensors; the record holds what an artist sets.

One frame's samples are too few for noise and thin shafts: each frame samples its slices elsewhere, and keeps a share of
what the frame before had sampled at the same places of the world. What is kept is the scattered light and the
extinction of every froxel, not their sums, which belong to the old camera [2]. Where the camera did not look before,
the frame stands alone. Light that moves leaves a trail of about 1 / (1 - history) frames.

What it does not draw: the fog's own shadow on its light, light scattered twice, shadows of lamps, and anything beyond
the grid's end, where far fog begins.

Gradient: exact in every parameter and input but one: whether a froxel was seen by the frame before is not
differentiated. At the base height that of the densest fog and of the thinning is their mean.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Volumetrics": a grid
    of 160 x 90 x 64 over 100 m.
[2] B. Wronski, "Volumetric fog: unified compute shader based solution to atmospheric scattering", SIGGRAPH 2014 course
    "Advances in Real-Time Rendering in Games".
[3] S. Hillaire, "Physically based and unified volumetric rendering in Frostbite", SIGGRAPH 2015 course "Advances in
    Real-Time Rendering in Games".
"""

from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere import froxel_grid, froxel_lights
from diffrender.atmosphere.froxel_examples import example_inputs
from diffrender.atmosphere.froxel_grid import Eye
from diffrender.atmosphere.froxel_view import FroxelView
from diffrender.atmosphere.volumes import repeated, trilinear
from diffrender.effect import Effect, Rung
from diffrender.images import clamped
from diffrender.numerics import opacity
from diffrender.parameters import parameter, record


@record
class FroxelFog:
    """Fog near the eye, and how strongly each kind of light shines on it."""

    extinction: Float[Tensor, ""] = parameter(
        0.02, bounds=(1e-6, 10.0), unit="1/m", scale="log", about="at and below the base height: turned up, thicker fog"
    )
    albedo: Float[Tensor, "3"] = parameter(
        (0.95, 0.95, 0.95), bounds=(0.0, 1.0), unit="1",
        about="share of the extinction that is scattering: the colour of thick fog",
    )  # fmt: skip
    asymmetry: Float[Tensor, ""] = parameter(
        0.5, bounds=(-0.9, 0.9), unit="1",
        about="mean cosine g of scattering: turned up, fog glows towards lights and is dark away from them",
    )  # fmt: skip
    base_height: Float[Tensor, ""] = parameter(
        0.0, bounds=(-1e3, 5e3), unit="m", about="altitude above which the fog thins: turned up, it rises"
    )
    height_decay: Float[Tensor, ""] = parameter(
        0.02, bounds=(0.0, 1.0), unit="1/m", in_files=("1/(100 m)", 100.0),
        about="how fast it thins above the base height: turned up, a sharper top",
    )  # fmt: skip
    noise_strength: Float[Tensor, ""] = parameter(
        0.5, bounds=(0.0, 1.0), unit="1", about="how uneven the fog is: 0 for even fog, at 1 holes and double density"
    )
    noise_size: Float[Tensor, ""] = parameter(
        40.0, bounds=(4.0, 1e3), unit="m", scale="log",
        about="length over which the noise repeats: turned up, larger billows",
    )  # fmt: skip
    wind: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 2.0), unit="1", about="share of the wind's displacement by which the noise drifts"
    )
    sun: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 16.0), unit="1", about="by what the sun's light on the fog is multiplied: brighter shafts"
    )
    local: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 16.0), unit="1", about="by what lamps' light on the fog is multiplied: brighter halos"
    )
    probe: Float[Tensor, ""] = parameter(
        1.0, bounds=(0.0, 16.0), unit="1", about="by what light from all around is multiplied: brighter shade"
    )
    history: Float[Tensor, ""] = parameter(
        0.9, bounds=(0.0, 0.98), unit="1", about="share of the frame before: turned up, smoother noise, longer trails"
    )


Medium = Float[Tensor, "slices rows columns 4"]  # light sent to the eye per length, and extinction [1/m]


@dataclass(frozen=True)
class State:
    """What a frame leaves to the next: its froxels, where its camera was, and how many frames there were."""

    medium: Medium
    eye: Eye
    frames: int


@record
class Summed:
    """A sequence, and the sums along the columns of every frame's froxels."""

    view: FroxelView
    columns: Float[Tensor, "time cuts rows columns 4"]


def step(
    fog: FroxelFog, frame: FroxelView, state: State | None
) -> tuple[Float[Tensor, "*batch height width 3"], State]:
    """Picture of one frame and what it leaves to the next; without a state it is the first.

    A frame is a view without the axis of time.
    """
    medium, state = _remembered(fog, frame, state)
    return _composed(frame, _columns(frame, medium)), state


def _remembered(fog: FroxelFog, frame: FroxelView, state: State | None) -> tuple[Medium, State]:
    """Froxels of a frame, mixed with those of the frame before, and the state that they are."""
    if state is None:
        medium = sampled(fog, frame, shift=0.0)
        return medium, State(medium, frame.eye, frames=1)
    now = sampled(fog, frame, _shift(state.frames))
    # Where froxels are, not where this frame samples them: a camera at rest finds its own froxels again.
    middle = froxel_grid.froxels(frame.grid, frame.eye, 0.0).from_eye
    place = froxel_grid.place_of(frame.grid, state.eye, middle + (frame.eye.position - state.eye.position))
    size = place.new_tensor([frame.grid.slices, frame.grid.rows, frame.grid.columns])
    was_seen = ((place >= 0.0) & (place <= size)).all(-1, keepdim=True)
    before = trilinear(state.medium, place, clamped)
    medium = torch.lerp(now, before, fog.history * was_seen.to(place))
    return medium, State(medium, frame.eye, state.frames + 1)


def _shift(count: int) -> float:
    """Where frame number `count` samples its slices: van der Corput's sequence, from -1/2 to 1/2, 0 in the first."""
    place, weight, rest = 0.0, 0.5, count + 1
    while rest:
        place, weight, rest = place + weight * (rest % 2), weight / 2.0, rest // 2
    return place - 0.5


def sampled(fog: FroxelFog, frame: FroxelView, shift: float) -> Medium:
    """Froxels of a frame alone, sampled a shift off the middle of their slices."""
    at = froxel_grid.froxels(frame.grid, frame.eye, shift)
    position = frame.eye.position + at.from_eye
    dense = density(fog, frame, position)
    light = arriving(fog, frame, position, at.direction)
    return torch.cat([light * fog.albedo * dense[..., None], dense[..., None]], -1)


def density(fog: FroxelFog, frame: FroxelView, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Extinction of the fog at places of the world [1/m], the noise as the wind has carried it."""
    even = fog.extinction * torch.exp(-fog.height_decay * torch.relu(position[..., 2] - fog.base_height))
    if frame.noise is None:
        return even
    drifted = (position - fog.wind * frame.displacement) / fog.noise_size
    return even * (1.0 + fog.noise_strength * repeated(frame.noise, drifted))


def arriving(
    fog: FroxelFog, frame: FroxelView, position: Float[Tensor, "*batch 3"], direction: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Light of all that shines at places, sent to the eye per scattering coefficient [W/(m² sr)]."""
    total, lights = torch.zeros_like(position), frame.lights
    if lights.sun is not None:
        total = total + fog.sun * froxel_lights.of_sun(lights.sun, fog.asymmetry, position, direction)
    if lights.local is not None:
        total = total + fog.local * froxel_lights.of_local(lights.local, fog.asymmetry, position, direction)
    if lights.probe is not None:
        total = total + fog.probe * froxel_lights.of_probe(lights.probe, fog.asymmetry, direction)
    return total


def _columns(frame: FroxelView, medium: Medium) -> Float[Tensor, "cuts rows columns 4"]:
    stretch = froxel_grid.directions(frame.eye, frame.grid.rows, frame.grid.columns)[1]
    return froxel_grid.integrated(frame.grid, stretch, medium)


def _composed(
    frame: FroxelView, columns: Float[Tensor, "cuts rows columns 4"]
) -> Float[Tensor, "*batch height width 3"]:
    light, passed = froxel_grid.seen_through(frame.grid, frame.eye, columns, frame.distance)
    return frame.background * passed[..., None] + light


def render(fog: FroxelFog, view: FroxelView) -> Float[Tensor, "*batch time height width 3"]:
    """Radiance behind and within the fog [W/(m² sr)] of a sequence of frames, each with the history of those before."""
    pictures, state = [], None
    for frame in view.in_order():
        picture, state = step(fog, frame, state)
        pictures.append(picture)
    return torch.stack(pictures, -4)


def prepare(fog: FroxelFog, view: FroxelView) -> Summed:
    """Froxels of every frame alone, without history, summed to the eye."""
    frames = view.in_order()
    return Summed(view, torch.stack([_columns(frame, sampled(fog, frame, shift=0.0)) for frame in frames]))


def prepare_coarse(fog: FroxelFog, view: FroxelView) -> Summed:
    """The same in a grid of half as many froxels along each axis: an eighth of them."""
    return prepare(fog, replace(view, grid=view.grid.halved()))


def render_summed(_fog: FroxelFog, summed: Summed) -> Float[Tensor, "*batch time height width 3"]:
    """Pictures of frames whose columns are summed already."""
    frames = zip(summed.view.in_order(), summed.columns, strict=True)
    return torch.stack([_composed(frame, columns) for frame, columns in frames], -4)


def skip(fog: FroxelFog, view: FroxelView) -> Float[Tensor, "*batch time height width 3"]:
    """No fog: the background."""
    return view.background + torch.zeros_like(view.distance)[..., None] * fog.extinction


def march(fog: FroxelFog, view: FroxelView, steps: int) -> Float[Tensor, "*batch time height width 3"]:
    """The same as `render` without a grid or history: along every pixel's own ray, by the midpoint rule."""
    return torch.stack([_marched(fog, frame, steps) for frame in view.in_order()], -4)


def _marched(fog: FroxelFog, frame: FroxelView, steps: int) -> Float[Tensor, "*batch height width 3"]:
    direction, stretch = froxel_grid.directions(frame.eye, *frame.distance.shape[-2:])
    length = torch.minimum(frame.distance, frame.grid.far * stretch)[..., None] / steps
    along = (torch.arange(steps).to(length) + 0.5) * length
    position = frame.eye.position + along[..., None] * direction[..., None, :]
    passed = density(fog, frame, position) * length
    depth = torch.cumsum(passed, -1)
    arrived = arriving(fog, frame, position, direction[..., None, :])
    seen = (torch.exp(0.5 * passed - depth) * passed)[..., None] * fog.albedo * arrived
    return frame.background * torch.exp(-depth[..., -1:]) + seen.sum(-2)


def largest_change(fog: FroxelFog, view: FroxelView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) in all pixels [W/(m² sr)]: fog as dense as anywhere, lit as brightly as anywhere."""
    spread = torch.linalg.vector_norm(view.eye.spread, dim=-1).amax()
    length = view.grid.far * torch.sqrt(1.0 + spread * spread)
    densest = fog.extinction if view.noise is None else fog.extinction * (1.0 + fog.noise_strength)
    strengths = (fog.sun, fog.local, fog.probe)
    lit = froxel_lights.brightest(view.lights, fog.asymmetry)
    light = fog.albedo * sum(strength * one for strength, one in zip(strengths, lit, strict=True))
    return opacity(densest * length) * torch.maximum(view.background.abs().amax(), light.amax())


EFFECT = Effect(
    parameters=FroxelFog,
    prefix="VOLLIGHT",
    rungs={
        "skip": Rung(skip),
        "coarse": Rung(render_summed, prepare_coarse),
        "froxels": Rung(render_summed, prepare),
        "reprojected": Rung(render),
    },
    reference=partial(march, steps=1000),
    # A grid of 14 x 9 x 20, between whose froxels shafts and lamps are linear; four times as fine 1e-3.
    tolerance=0.03,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
