from dataclasses import replace

import pytest
import torch
from torch.utils import _pytree as pytree

from diffrender.atmosphere import froxel_fog, height_fog
from diffrender.atmosphere.froxel_fog import FroxelFog
from diffrender.atmosphere.froxel_grid import Grid, directions, eye_at
from diffrender.atmosphere.froxel_lights import Lights, Sunlight
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.parameters import defaults
from diffrender.rays import Rays, from_angles

FLOAT = torch.float64
EXAMPLE = froxel_fog.example_inputs(FLOAT)
FOG = defaults(FroxelFog, FLOAT)


def number(value):
    return torch.tensor(value, dtype=FLOAT)


def fog_of(**changed):
    return replace(FOG, **{name: number(value) for name, value in changed.items()})


def first_frame(view=EXAMPLE):
    return view.in_order()[0]


def again(frame, count):
    """A frame that stands still, so often."""
    moving = (frame.eye, frame.lights, frame.displacement)
    eye, lights, displacement = pytree.tree_map_only(
        torch.Tensor, lambda tensor: tensor.expand(count, *tensor.shape), moving
    )
    background, distance = frame.background[0].expand(count, -1, -1, -1), frame.distance[0].expand(count, -1, -1)
    return replace(frame, eye=eye, lights=lights, displacement=displacement, background=background, distance=distance)


# What the fog is


def test_without_extinction_lights_or_distance_there_is_only_the_background():
    clear = froxel_fog.render(fog_of(extinction=0.0), EXAMPLE)
    torch.testing.assert_close(clear, EXAMPLE.background)
    at_the_lens = replace(EXAMPLE, distance=torch.zeros_like(EXAMPLE.distance))
    assert torch.equal(froxel_fog.render(FOG, at_the_lens), EXAMPLE.background)
    unlit = replace(EXAMPLE, lights=Lights(None, None, None))
    assert (froxel_fog.render(FOG, unlit) <= EXAMPLE.background).all()


def test_lights_add_up_and_each_has_its_strength():
    def added(**lights):
        black = replace(first_frame(), background=torch.zeros_like(first_frame().background))
        fog = fog_of(**({"sun": 0.0, "local": 0.0, "probe": 0.0} | lights))
        return froxel_fog.step(fog, black, None)[0]

    parts = [added(sun=2.0), added(local=0.5), added(probe=1.5)]
    assert all(float(part.max()) > 0.0 for part in parts)
    torch.testing.assert_close(added(sun=2.0, local=0.5, probe=1.5), sum(parts))


def test_albedo_colours_the_fog_and_not_what_is_behind():
    red = froxel_fog.step(replace(FOG, albedo=number([0.95, 0.0, 0.0])), first_frame(), None)[0]
    grey = froxel_fog.step(FOG, first_frame(), None)[0]
    torch.testing.assert_close(red[..., 0], grey[..., 0])
    passed = froxel_fog.step(fog_of(albedo=[0.0, 0.0, 0.0]), first_frame(), None)[0]
    torch.testing.assert_close(red[..., 1:], passed[..., 1:])


def test_wind_carries_the_noise():
    place = torch.randn(9, 3, generator=torch.Generator().manual_seed(0), dtype=FLOAT)
    frame, blown = first_frame(), torch.tensor([5.0, -2.0, 0.0], dtype=FLOAT)
    moved = replace(frame, displacement=frame.displacement + blown)
    level = fog_of(height_decay=0.0)
    found = froxel_fog.density(level, moved, place + blown)
    torch.testing.assert_close(found, froxel_fog.density(level, frame, place))
    still = replace(level, wind=number(0.0))
    assert torch.equal(froxel_fog.density(still, moved, place), froxel_fog.density(still, frame, place))


def test_fog_thins_above_the_base_height_and_is_even_below():
    frame = replace(first_frame(), noise=None)
    heights = torch.tensor([[0.0, 0.0, z] for z in (-500.0, 20.0, 70.0)], dtype=FLOAT)
    found = froxel_fog.density(fog_of(base_height=20.0), frame, heights)
    torch.testing.assert_close(found, 0.02 * torch.exp(-torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT)))


def test_without_lamps_and_noise_it_is_height_fog_in_its_closed_form():
    direction, _ = directions(looking(), 6, 8)
    length = torch.linspace(0.5, 90.0, 48, dtype=FLOAT).reshape(6, 8)
    fog = fog_of(base_height=-40.0, height_decay=0.05, extinction=0.1)  # rays stay above
    to_sun, irradiance = from_angles(*number([0.3, 0.5])), number([3.0, 2.5, 2.0])
    tall = HeightFog(
        number(0.1), torch.ones(3, dtype=FLOAT), number(20.0), number(-40.0), FOG.albedo,
        torch.zeros(3, dtype=FLOAT), FOG.asymmetry, *torch.ones(2, 3, dtype=FLOAT),
    )  # fmt: skip
    background = torch.full((6, 8, 3), 0.4, dtype=FLOAT)
    rays = Rays(looking().position, direction, length)
    wanted = height_fog.render_blend(tall, FogView(rays, background, to_sun, irradiance, torch.zeros(3, dtype=FLOAT)))
    frame = replace(
        first_frame(), grid=Grid(8, 6, 64), eye=looking(), background=background, distance=length,
        lights=Lights(Sunlight(to_sun, irradiance, None), None, None), noise=None,
    )  # fmt: skip
    found = froxel_fog.step(fog, frame, None)[0]
    torch.testing.assert_close(found, wanted, rtol=0.0, atol=1e-3 * float(wanted.max()))


def looking():
    return eye_at(number([0.0, 0.0, 30.0]), number(-0.1), number(0.2), number([0.6, 0.4]))


# History


def test_splitting_a_sequence_changes_nothing():
    whole, state = froxel_fog.render(FOG, EXAMPLE), None
    for number_of, frame in enumerate(EXAMPLE.in_order()):
        picture, state = froxel_fog.step(FOG, frame, state)
        assert torch.equal(picture, whole[:, number_of])
    assert state.frames == 2


def test_without_history_only_the_slices_are_sampled_elsewhere():
    sequence = again(first_frame(), 3)
    one, two, three = froxel_fog.render(fog_of(history=0.0), sequence)
    alone = froxel_fog.EFFECT.rungs["froxels"](FOG, sequence)
    assert torch.equal(one, alone[0])
    assert not torch.equal(two, one)
    assert not torch.equal(three, two)


def test_history_of_a_scene_at_rest_is_nearer_to_the_march_than_a_frame():
    # Noise finer than slices, and columns finer than both: the error is along the ray, which history is for.
    fog, grid = fog_of(noise_size=4.0, noise_strength=1.0, extinction=0.05), Grid(28, 18, 5, near=0.5, far=60.0)
    frame = replace(first_frame(), grid=grid, lights=replace(first_frame().lights, sun=None))
    truth = froxel_fog.march(fog, again(frame, 1), 1000)[0]
    pictures = froxel_fog.render(fog, again(frame, 13))
    first, last = ((picture - truth).abs().mean() for picture in (pictures[0], pictures[-1]))
    assert float(last) < 0.5 * float(first)


def test_what_the_camera_did_not_see_before_stands_alone():
    frame = first_frame()
    _, state = froxel_fog.step(FOG, frame, None)
    elsewhere = eye_at(frame.eye.position, number(0.05), number(torch.pi), frame.eye.spread)
    turned = replace(frame, eye=elsewhere)
    found = froxel_fog.step(FOG, turned, state)[0]
    wanted = froxel_fog.step(fog_of(history=0.0), turned, state)[0]
    assert torch.equal(found, wanted)
    assert not torch.equal(froxel_fog.step(FOG, frame, state)[0], froxel_fog.step(fog_of(history=0.0), frame, state)[0])


def test_a_camera_that_moves_finds_its_froxels_again():
    # Even fog in even light is alike everywhere: a history that is read at the wrong place would tell.
    sun_alone = replace(EXAMPLE, noise=None, lights=replace(EXAMPLE.lights, local=None, probe=None))
    moving = replace(sun_alone, lights=replace(sun_alone.lights, sun=replace(sun_alone.lights.sun, shadow=None)))
    fog = fog_of(height_decay=0.05, base_height=-20.0, asymmetry=0.0)
    truth = froxel_fog.march(fog, moving, 400)
    apart = (froxel_fog.render(fog, moving) - truth).abs().amax((0, 2, 3, 4))
    assert float(apart[1]) < 2.0 * float(apart[0]) + 1e-4


def test_shifts_fill_a_slice_evenly():
    shifts = sorted(froxel_fog._shift(count) for count in range(15))
    assert froxel_fog._shift(0) == 0.0
    assert shifts == pytest.approx([(number_of - 7) / 16.0 for number_of in range(15)])
