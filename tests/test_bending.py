import math

import pytest
import torch

from diffrender.weather.bending import FARTHEST_LEAN, bent, flutter, lean

FLOAT = torch.float64
LEANS = torch.tensor([[0.0, 0.0], [1e-9, 0.0], [0.3, -0.4], [-1.5, 0.2]], dtype=FLOAT)
LENGTH = torch.tensor(2.5, dtype=FLOAT)


def stem(count, dtype=FLOAT):
    height = torch.linspace(0.0, 2.5, count, dtype=dtype)
    return torch.stack([torch.zeros_like(height), torch.zeros_like(height), height], -1)


@pytest.mark.parametrize("tip", LEANS)
def test_a_stem_lies_on_a_circle_and_keeps_its_length(tip):
    found = bent(stem(2001), tip, LENGTH)
    pieces = (found[1:] - found[:-1]).norm(dim=-1)
    torch.testing.assert_close(pieces, torch.full_like(pieces, 2.5 / 2000), rtol=1e-6, atol=0.0)  # chords of the arc
    angle = float(tip.norm())
    if angle > 0.1:
        centre = torch.cat([tip / angle * (2.5 / angle), tip.new_zeros(1)])
        torch.testing.assert_close((found - centre).norm(dim=-1), torch.full((2001,), 2.5 / angle, dtype=FLOAT))
    ahead = found[-1] - found[-2]
    assert float(torch.atan2(ahead[:2].norm(), ahead[2])) == pytest.approx(angle, abs=1e-3)


@pytest.mark.parametrize("dtype", [torch.float32, FLOAT])
def test_every_piece_keeps_its_length_to_rounding_in_float32_too(dtype):
    whole = bent(stem(65, FLOAT), LEANS[2], LENGTH)
    found = bent(stem(65, dtype), LEANS[2].to(dtype), LENGTH.to(dtype))
    torch.testing.assert_close(found.double(), whole, rtol=0.0, atol=2e-6 if dtype == torch.float32 else 0.0)


@pytest.mark.parametrize("tip", LEANS)
def test_what_stands_beside_the_stem_is_turned_with_it(tip):
    leaf = torch.tensor([0.3, -0.2, 1.7], dtype=FLOAT)
    foot = bent(leaf * torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT), tip, LENGTH)
    beside = bent(leaf, tip, LENGTH) - foot
    assert float(beside.norm()) == pytest.approx(math.hypot(0.3, 0.2), rel=1e-14)
    along = torch.func.jacfwd(lambda height: bent(torch.stack([height * 0, height * 0, height]), tip, LENGTH))(leaf[2])
    assert float(along.norm()) == pytest.approx(1.0, rel=1e-14)
    assert float(along @ beside) == pytest.approx(0.0, abs=1e-14)


def test_without_wind_nothing_moves():
    still = lean(torch.zeros(4, 3, dtype=FLOAT), torch.tensor(0.02, dtype=FLOAT))
    vertex = torch.randn(4, 3, generator=torch.Generator().manual_seed(1), dtype=FLOAT)
    assert torch.equal(bent(vertex, still, LENGTH), vertex)


def test_lean_grows_by_the_square_and_comes_near_a_quarter_turn():
    wind = torch.tensor([[0.1, 0.0, 0.0], [0.2, 0.0, 3.0], [0.0, -1e3, 0.0]], dtype=FLOAT)
    weak, twice, storm = lean(wind, torch.tensor(0.05, dtype=FLOAT))
    assert float(twice[0] / weak[0]) == pytest.approx(4.0, rel=1e-5)
    assert 0.999 * FARTHEST_LEAN < -float(storm[1]) < FARTHEST_LEAN


def test_sway_stays_within_one_and_is_at_rest_at_phase_0():
    swayed = flutter(torch.linspace(-300.0, 300.0, 5001, dtype=FLOAT))
    assert 0.9 < float(swayed.abs().max()) <= 1.0
    assert torch.equal(flutter(torch.zeros((), dtype=FLOAT)), torch.zeros(2, dtype=FLOAT))


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_gradients_match_finite_differences_at_rest_too(speed):
    def plant(vertex, wind, flexibility, length, phase):
        sway = lean(wind, flexibility) * (1.0 + 0.2 * flutter(phase)[..., :1])
        return bent(vertex, sway, length)

    given = [
        torch.tensor([[0.2, -0.1, 1.3], [0.0, 0.0, 2.0]], dtype=FLOAT),
        torch.tensor([speed, 0.3 * speed, 0.1], dtype=FLOAT),
        torch.tensor(0.05, dtype=FLOAT),
        LENGTH,
        torch.tensor(0.7, dtype=FLOAT),
    ]
    leaves = [one.clone().requires_grad_() for one in given]
    assert torch.autograd.gradcheck(plant, leaves, check_forward_ad=True, check_batched_grad=True)
