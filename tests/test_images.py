import math

import pytest
import torch

from diffrender import images
from diffrender.antialiasing import edge_taa

GENERATOR = torch.Generator().manual_seed(1)
NOISE = torch.rand(6, 8, 3, generator=GENERATOR, dtype=torch.float64)
CENTRED = torch.zeros(2, dtype=torch.float64)


def ramp(place):
    return torch.stack([2.0 * place[..., 0], 3.0 * place[..., 1], place.sum(-1)], -1)


def test_pixel_centres_are_at_half():
    assert images.places(4, 3, CENTRED)[2, 1].tolist() == [1.5, 2.5]
    assert images.places(4, 3, torch.tensor([0.5, 0.0]))[2, 1].tolist() == [2.0, 2.5]


def test_a_jittered_camera_shows_what_lies_beside_the_centres():
    # A pinhole that looks along -z, in normalised device coordinates, as OpenGL has it.
    near, far, focal, size = 0.1, 100.0, 1.3, (8, 6)
    depth = [(far + near) / (near - far), 2.0 * far * near / (near - far)]
    projection = torch.tensor(
        [[focal, 0, 0, 0], [0, focal, 0, 0], [0, 0, *depth], [0, 0, -1.0, 0]], dtype=torch.float64
    )
    point = torch.tensor([0.3, 0.2, -2.0, 1.0], dtype=torch.float64)

    def pixels(matrix):
        x, y, _, w = matrix @ point
        return torch.stack([(x / w + 1.0) * size[0] / 2.0, (1.0 - y / w) * size[1] / 2.0])

    offset = torch.tensor([0.5, 0.25], dtype=torch.float64)
    moved = pixels(images.jittered(projection, offset, size)) - pixels(projection)
    # The scene moves left and up, so that a pixel's centre meets what lay to the right and below.
    torch.testing.assert_close(moved, -offset)


def test_samples_of_a_ramp_are_its_values_at_the_jittered_places():
    fine = ramp(images.places(32, 24, CENTRED) / 4.0)
    for offset in [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (-0.5, -0.5)]:
        for footprint in (0.0, 0.3, 1.0):
            found = images.sampled(fine, 4, offset, footprint)
            wanted = ramp(images.places(8, 6, torch.tensor(offset, dtype=torch.float64)))
            torch.testing.assert_close(found[1:-1, 1:-1], wanted[1:-1, 1:-1])


@pytest.mark.parametrize("factor", [1, 4, 5])
def test_a_footprint_of_one_pixel_is_the_mean_over_it(factor):
    fine = torch.rand(3 * factor, 2 * factor, 3, generator=GENERATOR, dtype=torch.float64)
    mean = fine.unflatten(0, (3, factor)).unflatten(2, (2, factor)).mean((1, 3))
    torch.testing.assert_close(images.sampled(fine, factor, (0.0, 0.0), 1.0), mean)


def test_a_point_is_one_fine_pixel_and_on_a_border_the_mean_of_both():
    fine = torch.rand(10, 15, 3, generator=GENERATOR, dtype=torch.float64)
    assert torch.equal(images.sampled(fine, 5, (0.0, 0.0), 0.0), fine[2::5, 2::5])
    beside = (fine[2::5, 4::5] + fine[2::5, [5, 10, 14]]) / 2.0
    torch.testing.assert_close(images.sampled(fine, 5, (0.5, 0.0), 0.0), beside)


def test_supersampling_is_exact_for_ramps_and_finds_the_area_of_a_disc():
    torch.testing.assert_close(
        images.supersampled(ramp, 4, 3, 2, CENTRED), ramp(images.places(4, 3, CENTRED)), rtol=1e-14, atol=0.0
    )

    def disc(place):
        return ((place - 4.0).norm(dim=-1) < 3.0).to(place)[..., None].expand(*place.shape[:-1], 3)

    area = images.supersampled(disc, 8, 8, 16, CENTRED)[..., 0].sum().item()
    assert area == pytest.approx(9.0 * math.pi, rel=2e-3)


@pytest.mark.parametrize("address", [images.clamped, images.wrapped])
def test_bilinear_gives_the_pixels_at_their_centres_and_means_between(address):
    centres = images.places(8, 6, CENTRED)
    assert torch.equal(images.bilinear(NOISE, centres, address), NOISE)
    between = images.bilinear(NOISE, centres[:, :-1] + torch.tensor([0.5, 0.0]), address)
    torch.testing.assert_close(between, (NOISE[:, :-1] + NOISE[:, 1:]) / 2.0)


def test_beyond_the_border_lies_its_pixel_or_the_other_side():
    outside = torch.tensor([[[-3.5, 2.5], [9.5, -1.5]]], dtype=torch.float64)
    assert torch.equal(images.bilinear(NOISE, outside, images.clamped)[0], NOISE[[2, 0], [0, 7]])
    assert torch.equal(images.bilinear(NOISE, outside, images.wrapped)[0], NOISE[[2, 4], [4, 1]])
    bordered = images.bordered(NOISE[..., 0], 2, images.wrapped)
    assert torch.equal(bordered[2:-2, 2:-2], NOISE[..., 0])
    assert torch.equal(bordered[:2, 2:-2], NOISE[-2:, :, 0])


def test_bilinear_has_the_gradients_of_its_formula():
    place = images.places(2, 3, torch.tensor([0.21, 0.37], dtype=torch.float64)).requires_grad_()
    picture = NOISE[:4, :4, :1].clone().requires_grad_()

    def draw(picture, place):
        return images.bilinear(picture, place, images.wrapped)

    assert torch.autograd.gradcheck(draw, (picture, place), check_forward_ad=True, check_batched_grad=True)


def test_the_cubic_gives_the_pixels_at_their_centres_and_parabolas_between():
    centres = images.places(8, 6, CENTRED)
    assert torch.equal(images.catmull_rom(NOISE, centres, images.clamped), NOISE)

    def parabola(place):
        right, down = place[..., 0, None], place[..., 1, None]
        return torch.cat([right * right, down * down - right * down, 3.0 - right], -1)

    place = centres[1:-2, 1:-2] + torch.tensor([0.3, 0.85])
    torch.testing.assert_close(images.catmull_rom(parabola(centres), place, images.clamped), parabola(place))


def test_the_cubic_overshoots_a_corner_by_its_negative_weights():
    worst = (torch.arange(4) % 3 == 0)[:, None] ^ (torch.arange(4) % 3 == 0)  # where one weight of two is negative
    middle = torch.full((1, 1, 2), 2.0, dtype=torch.float64)
    value = images.catmull_rom(worst.double()[..., None], middle, images.clamped)
    assert value.item() == pytest.approx(-edge_taa.OVERSHOOT)


def test_the_cubic_has_the_gradients_of_its_formula():
    place = images.places(2, 3, torch.tensor([0.21, 0.37], dtype=torch.float64)).requires_grad_()
    picture = NOISE[:4, :4, :1].clone().requires_grad_()

    def draw(picture, place):
        return images.catmull_rom(picture, place, images.wrapped)

    assert torch.autograd.gradcheck(draw, (picture, place), check_forward_ad=True, check_batched_grad=True)


def test_resizing_keeps_ramps_and_the_same_size_to_the_bit():
    assert torch.equal(images.resized(NOISE, 6, 8), NOISE)
    coarse = ramp(2.0 * images.places(4, 3, CENTRED))
    fine = images.resized(coarse, 6, 8)
    torch.testing.assert_close(fine[1:-1, 1:-1], ramp(images.places(8, 6, CENTRED))[1:-1, 1:-1])


def test_what_a_filter_would_smear_is_refused_with_its_place():
    images.require_finite(NOISE, "noise")
    broken = NOISE.clone()
    broken[4, 5, 1] = math.nan
    with pytest.raises(ValueError, match=r"noise: 1 of 144 values .* row 4, column 5"):
        images.require_finite(broken, "noise")
