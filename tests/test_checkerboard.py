import math

import pytest
import sequences
import torch

from diffrender.antialiasing import checkerboard, tangram
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames, places, supersampled
from diffrender.parameters import defaults

SIZE = (24, 16)
LEVEL = 1.0 / 1023.0
FREQUENCIES = [(0.0, 0.0), (0.1, 0.0), (0.0, 0.2), (0.15, 0.3), (0.45, 0.1), (0.25, 0.25)]


def lit_frames(scene, count, size=SIZE, motion=None):
    every = sequences.frames(scene, [checkerboard.OFFSET] * count, size)
    colour = torch.stack([tangram.lit(one, parity=time % 2) for time, one in enumerate(every.colour)])
    return Frames(colour, motion, None)


@pytest.mark.parametrize(("across", "down"), FREQUENCIES)
def test_two_frames_have_the_frequency_response_of_the_mean_of_four_corners(across, down):
    frames = lit_frames(sequences.wave(across, down), 2, motion=sequences.still(2, SIZE))
    picture = checkerboard.render(sequences.settings(), frames)
    found = sequences.amplitude(picture[1], across, down)
    assert found == pytest.approx(math.cos(math.pi * across) * math.cos(math.pi * down), abs=0.01)  # ten bits


def test_one_frame_is_the_mean_along_either_diagonal_in_turn():
    across, down = 0.11, 0.17
    picture = checkerboard.render(sequences.settings(), lit_frames(sequences.wave(across, down), 1))[0, ..., 0]
    centres = places(*SIZE, torch.zeros(2, dtype=torch.float64))
    scene = sequences.wave(across, down)(centres, 0)
    falls = (torch.arange(16)[:, None] + torch.arange(24)) % 2 == 0  # corners at the upper left and lower right
    for is_here, frequency in ((falls, across + down), (~falls, across - down)):
        wanted = 0.5 + math.cos(math.pi * frequency) * (scene - 0.5)
        inner = (picture - wanted)[:-1, :-1][is_here[:-1, :-1]]
        assert float(inner.abs().max()) <= LEVEL


def test_ramps_are_exact_up_to_ten_bits():
    def ramp(place, _time):
        return 0.3 + 0.01 * place[..., 0] + 0.02 * place[..., 1]

    frames = lit_frames(ramp, 2, motion=sequences.still(2, SIZE))
    picture = checkerboard.render(defaults(AntiAliasing, torch.float64), frames)
    wanted = ramp(places(*SIZE, torch.zeros(2, dtype=torch.float64)), 0)
    assert float((picture[..., 0] - wanted)[:, 1:-2, 1:-2].abs().max()) <= 0.5 * LEVEL * (1.0 + 1e-9)


def test_a_scene_at_rest_never_changes_from_the_second_frame_on():
    colours = torch.cat([sequences.noise(1, 2, 16, 12)] * 3)
    frames = Frames(colours, sequences.still(6, SIZE), None)
    picture = checkerboard.render(defaults(AntiAliasing, torch.float64), frames)
    assert not torch.equal(picture[0], picture[1])
    assert all(torch.equal(one, picture[1]) for one in picture[2:])


def test_nothing_lasts_longer_than_one_frame():
    colours = sequences.noise(2, 3, 16, 12)
    other = torch.cat([sequences.noise(3, 1, 16, 12), colours[1:]])
    settings = defaults(AntiAliasing, torch.float64)
    one, two = (checkerboard.render(settings, Frames(c, sequences.still(3, SIZE), None)) for c in (colours, other))
    assert torch.equal(one[2], two[2])
    assert not torch.equal(one[1], two[1])


def test_splitting_a_sequence_changes_nothing():
    settings = defaults(AntiAliasing, torch.float64)
    frames = Frames(sequences.noise(4, 4, 16, 12), None, None)
    whole, state = checkerboard.render(settings, frames), None
    for one, wanted in zip(frames.in_order(), whole, strict=True):
        picture, state = checkerboard.step(settings, one, state)
        assert torch.equal(picture, wanted)


def test_a_strange_history_without_known_motion_is_not_used():
    bright, dark = 0.8 + 0.1 * sequences.noise(5, 1, 16, 12), 0.1 * sequences.noise(6, 1, 16, 12)
    settings = sequences.settings()
    after_bright, after_dark = (
        checkerboard.render(settings, Frames(torch.cat([before, dark]), None, None))[1] for before in (bright, dark)
    )
    assert float(after_bright.max()) < 0.11
    assert not torch.equal(after_bright, after_dark)


def test_smoothing_in_the_tangram_brings_near_diagonal_edges_nearer_to_the_truth():
    def edge(place, _time=0):
        return 0.2 + 0.6 * (place[..., 1] > 0.5 + 0.94 * place[..., 0]).to(place)

    size = (48, 40)
    truth = supersampled(lambda p: edge(p)[..., None].expand(*p.shape[:-1], 3), *size, 16, torch.zeros(1).double())
    errors = {
        minimum: (
            checkerboard.render(sequences.settings(edge_threshold_minimum=minimum), lit_frames(edge, 1, size))[0]
            - truth
        )[6:-6, 6:-6]
        for minimum in (1.0, 0.05)
    }
    without, smoothed = (float(error.square().mean().sqrt()) for error in errors.values())
    assert smoothed < 0.9 * without


def test_awkward_pictures_have_finite_values_and_gradients():
    settings = defaults(AntiAliasing, torch.float32)
    settings.subpixel.requires_grad_()
    colours = sequences.awkward(6, 5).requires_grad_()
    picture = checkerboard.render(settings, Frames(colours, None, None))
    found = torch.autograd.grad(picture.sum(), [colours, settings.subpixel])
    assert all(bool(tensor.isfinite().all()) for tensor in (picture, *found))
    assert float(picture.detach().max()) <= 1.0 + 1e-6
