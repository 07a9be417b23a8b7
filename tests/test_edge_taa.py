import math

import pytest
import sequences
import torch

from diffrender.antialiasing import edge_taa
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames, places
from diffrender.parameters import defaults

SIZE = (20, 16)
FREQUENCIES = [(0.0, 0.0), (0.1, 0.0), (0.0, 0.2), (0.15, 0.3), (0.45, 0.1), (0.4, 0.0)]
EVEN_ODD = edge_taa.OFFSETS * 2


def drawn(scene, settings, count=3, motion=sequences.still):
    known = motion(count, SIZE) if motion else None
    return edge_taa.render(settings, sequences.frames(scene, EVEN_ODD[:count], SIZE, known))


@pytest.mark.parametrize(("across", "down"), FREQUENCIES)
@pytest.mark.parametrize("lobe", [0.0, 1.0 / 16.0, 0.1])
def test_frequency_response_of_one_frame_and_of_two(across, down, lobe):
    def response(frequency, k):
        return (1.0 + 2.0 * k) * math.cos(math.pi * frequency) - 2.0 * k * math.cos(3.0 * math.pi * frequency)

    picture = drawn(sequences.wave(across, down), sequences.settings(sharpening=lobe))
    first, second = (sequences.amplitude(one, across, down) for one in picture[:2])
    assert first == pytest.approx(math.cos(math.pi * down), abs=1e-9)  # no history: not sharpened
    assert second == pytest.approx((response(across, lobe) + response(down, lobe)) / 2.0, abs=1e-9)


@pytest.mark.parametrize("lobe", [0.0, 0.0625, 0.25])
def test_ramps_are_exact_for_every_lobe(lobe):
    def ramp(place, _time):
        return 0.5 + 0.01 * place[..., 0] - 0.02 * place[..., 1]

    wanted = ramp(places(*SIZE, torch.zeros(2, dtype=torch.float64)), 0)[2:-2, 2:-2]
    picture = drawn(ramp, sequences.settings(sharpening=lobe, contrast_response=3.0))
    torch.testing.assert_close(picture[:, 2:-2, 2:-2, 0], wanted.expand(3, -1, -1), rtol=1e-13, atol=0.0)


def test_without_sharpening_a_pixel_is_the_mean_of_the_samples_on_its_four_edges():
    colours = sequences.noise(0, 2, 16, 20)
    frames = Frames(colours, sequences.still(2, SIZE), None)
    picture = edge_taa.render(sequences.settings(sharpening=0.0), frames)
    even, odd = colours
    mean = (even[:-1, 1:] + even[1:, 1:] + odd[1:, :-1] + odd[1:, 1:]) / 4.0
    torch.testing.assert_close(picture[1, 1:, 1:], mean)


def test_contrast_lowers_the_lobe():
    step = torch.cat([torch.full((8, 4, 3), 0.25), torch.full((8, 4, 3), 0.75)], 1).double()
    full, half = (
        edge_taa.centred(sequences.settings(sharpening=0.1, contrast_response=response), step, 1)[1] - step
        for response in (0.0, 2.0)  # the contrast is a half
    )
    halo = full[4, 3, 0]
    assert float(halo) != 0.0
    plain = edge_taa.centred(sequences.settings(), step, 1)[0] - step
    torch.testing.assert_close(half - plain, (full - plain) / 2.0)


def test_a_scene_at_rest_never_changes_from_the_second_frame_on():
    colours = torch.cat([sequences.noise(1, 2, 16, 20)] * 3)  # even and odd frames have nothing in common
    picture = edge_taa.render(defaults(AntiAliasing, torch.float64), Frames(colours, sequences.still(6, SIZE), None))
    assert not torch.equal(picture[0], picture[1])
    assert all(torch.equal(one, picture[1]) for one in picture[2:])


@pytest.mark.parametrize("motion", [sequences.still(3, SIZE), None])
def test_nothing_lasts_longer_than_one_frame(motion):
    colours = sequences.noise(2, 3, 16, 20)
    other = torch.cat([sequences.noise(3, 1, 16, 20), colours[1:]])
    settings = defaults(AntiAliasing, torch.float64)
    one, two = (edge_taa.render(settings, Frames(c, motion, None)) for c in (colours, other))
    assert torch.equal(one[2], two[2])
    assert not torch.equal(one[0], two[0])


def test_splitting_a_sequence_changes_nothing():
    settings = defaults(AntiAliasing, torch.float64)
    frames = Frames(sequences.noise(4, 4, 16, 20), sequences.still(4, SIZE), None)
    whole, state = edge_taa.render(settings, frames), None
    for one, wanted in zip(frames.in_order(), whole, strict=True):
        picture, state = edge_taa.step(settings, one, state)
        assert torch.equal(picture, wanted)


def test_what_moves_and_says_so_is_drawn_as_at_rest():
    def moving(place, time):
        return sequences.wave(0.07, 0.11)(place - torch.tensor([3.0, 1.0]).double() * time, time)

    moved = torch.tensor([-3.0, -1.0], dtype=torch.float64).expand(2, 16, 20, 2)
    settings = sequences.settings(sharpening=0.1)
    picture = edge_taa.render(settings, sequences.frames(moving, EVEN_ODD[:2], SIZE, moved))[1]
    rest = drawn(lambda place, _: moving(place, 1), settings, 2)[1]
    torch.testing.assert_close(picture[6:-6, 6:-6], rest[6:-6, 6:-6])


def test_a_strange_history_without_known_motion_leaves_this_frame_unsharpened():
    bright, dark = 0.8 + 0.1 * sequences.noise(5, 1, 16, 20), 0.1 * sequences.noise(6, 1, 16, 20)
    settings = sequences.settings(sharpening=0.2)
    picture = edge_taa.render(settings, Frames(torch.cat([bright, dark]), None, None))[1]
    assert torch.equal(picture, edge_taa.centred(settings, dark[0], 1)[0])


def test_soft_decisions_are_near_the_hard_ones():
    frames = Frames(sequences.noise(7, 3, 16, 20), None, None)
    settings = defaults(AntiAliasing, torch.float64)
    hard, soft = (edge_taa.EFFECT.rungs[name].render(settings, frames) for name in ("two frames", "soft"))
    assert 0.0 < float((hard - soft).abs().mean()) < 0.03


@pytest.mark.parametrize("name", ["soft", "two frames"])
def test_awkward_pictures_have_finite_values_and_gradients(name):
    settings = defaults(AntiAliasing, torch.float32)
    settings.sharpening.requires_grad_()
    colours = sequences.awkward(6, 8).requires_grad_()
    picture = edge_taa.EFFECT.rungs[name].render(settings, Frames(colours, None, None))
    found = torch.autograd.grad(picture.sum(), [colours, settings.sharpening])
    assert all(bool(tensor.isfinite().all()) for tensor in (picture, *found))
