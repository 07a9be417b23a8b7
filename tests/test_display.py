import pytest
import torch

from diffrender.antialiasing import display

RADIANCE = torch.tensor([-1.0, 0.0, 1e-8, 1e-3, 0.18, 1.0, 40.0, 4e5], dtype=torch.float64)


@pytest.mark.parametrize("shown", [display.shown_srgb, display.shown_pq])
def test_what_a_screen_is_sent_rises_from_0_and_stays_below_its_peak(shown):
    sent = shown(RADIANCE)
    assert sent[:2].tolist() == [0.0, 0.0]
    assert bool((sent.diff()[1:] > 0.0).all())
    assert float(sent[-1]) < 1.0


@pytest.mark.parametrize("shown", [display.shown_srgb, display.shown_pq])
def test_slopes_are_finite_from_black_to_the_sun(shown):
    radiance = RADIANCE.float().requires_grad_()
    (slope,) = torch.autograd.grad(shown(radiance).sum(), radiance)
    assert bool(slope.isfinite().all())


def test_middle_radiance_is_half_of_the_peak():
    assert display.tone_mapped(torch.tensor(1.0)).item() == 0.5


def test_ten_bits_are_the_nearest_of_1024_levels():
    level = torch.arange(1024, dtype=torch.float64) / 1023.0
    assert torch.equal(display.ten_bits(level + 0.4 / 1023.0).clamp(max=1.0), level)
    assert display.ten_bits(torch.tensor([-1.0, 7.0])).tolist() == [0.0, 1.0]


def test_the_slope_of_ten_bits_is_straight_through_in_both_modes():
    shown = torch.tensor([0.1234, 0.5], dtype=torch.float64, requires_grad=True)
    (reverse,) = torch.autograd.grad(display.ten_bits(shown).sum(), shown)
    _, forward = torch.func.jvp(display.ten_bits, (shown.detach(),), (torch.ones(2, dtype=torch.float64),))
    assert reverse.tolist() == forward.tolist() == [1.0, 1.0]
