"""MATH of the blog's directions, by sums over cells and by moments; scipy tells how likely a chi-square is."""

import math

import pytest
import torch
from scipy.stats import chi2

from diffrender import sampling

COUNT = 200_000
CELLS = (16, 12)  # by the angle from x and round it


def drawn(name):
    draw = torch.Generator().manual_seed(7)
    if name == "three angles":
        return sampling.from_three_angles(sampling.random_three_angles(COUNT, draw))
    made = {"sphere": sampling.on_sphere, "cosine": sampling.by_cosine}[name]
    return made(sampling.random_pairs(COUNT, draw))


def expected(name):
    """Share of directions in each cell, by the midpoint rule over the density that is claimed."""
    fine = 64
    from_x = (torch.arange(CELLS[0] * fine, dtype=torch.float64) + 0.5) * math.pi / (CELLS[0] * fine)
    round_x = (torch.arange(CELLS[1] * fine, dtype=torch.float64) + 0.5) * 2.0 * math.pi / (CELLS[1] * fine) - math.pi
    level, turn = torch.sin(from_x)[:, None], round_x[None, :]
    place = torch.stack(
        torch.broadcast_tensors(torch.cos(from_x)[:, None], level * torch.cos(turn), level * torch.sin(turn)), -1
    )
    density = {
        "three angles": sampling.three_angles_density,
        "sphere": lambda at: torch.full_like(at[..., 0], 0.25 / math.pi),
        "cosine": lambda at: at[..., 2].clamp(min=0.0) / math.pi,
    }[name](place)
    solid_angle = level * (math.pi / len(from_x)) * (2.0 * math.pi / len(round_x))
    return (density * solid_angle).reshape(CELLS[0], fine, CELLS[1], fine).sum((1, 3)).flatten()


def counted(direction):
    x, y, z = direction.unbind(-1)
    row = (torch.acos(x.clamp(-1.0, 1.0)) / math.pi * CELLS[0]).long().clamp(max=CELLS[0] - 1)
    column = ((torch.atan2(z, y) / (2.0 * math.pi) + 0.5) * CELLS[1]).long().clamp(max=CELLS[1] - 1)
    return torch.bincount(row * CELLS[1] + column, minlength=CELLS[0] * CELLS[1]).double()


def chance(found, share):
    """How likely so large a chi-square is, over the cells that should hold any."""
    held = share > 0.0
    assert not found[~held].any()
    square = ((found - COUNT * share)[held].square() / (COUNT * share[held])).sum()
    return chi2.sf(float(square), int(held.sum()) - 1)


@pytest.mark.parametrize("name", ["three angles", "sphere", "cosine"])
def test_directions_are_as_dense_as_claimed(name):
    share = expected(name)
    assert share.sum() == pytest.approx(1.0, abs=1e-4)
    assert chance(counted(drawn(name)), share) > 0.01


def test_the_blogs_directions_are_not_even():
    assert chance(counted(drawn("three angles")), expected("sphere")) < 1e-100


def test_the_blogs_directions_weighed_are_even():
    direction = drawn("three angles")
    weight = sampling.evenness(direction)
    assert weight.mean() == pytest.approx(1.0, abs=2e-3)
    torch.testing.assert_close((weight[:, None] * direction).mean(0), torch.zeros(3).double(), atol=4e-3, rtol=0.0)
    second = (weight[:, None] * direction.square()).mean(0)
    torch.testing.assert_close(second, torch.full((3,), 1.0 / 3.0).double(), atol=3e-3, rtol=0.0)


def test_moments_of_the_blogs_directions():
    # E[x²] = E[cos²(a2 + a3)] = (1 + E[cos 2a2]² - E[sin 2a2]²) / 2 = 1/2 - 2/pi²
    along = 0.5 - 2.0 / math.pi**2
    moments = drawn("three angles").square().mean(0)
    torch.testing.assert_close(
        moments, torch.tensor([along, (1.0 - along) / 2, (1.0 - along) / 2]).double(), atol=2e-3, rtol=0.0
    )


def test_the_blogs_formula_is_its_matrices():
    angles = sampling.random_three_angles(50, torch.Generator().manual_seed(1))
    assert (angles.amin(0) >= torch.tensor([-math.pi, 0.0, 0.0])).all()
    assert (angles.amax(0) <= torch.tensor([math.pi, math.pi / 2, math.pi / 2])).all()
    for (first, second, third), found in zip(angles.tolist(), sampling.from_three_angles(angles), strict=True):
        c, s = math.cos(first), math.sin(first)
        round_x = torch.tensor([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]).double()
        c, s = math.cos(second), math.sin(second)
        round_z = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).double()
        start = torch.tensor([math.cos(third), math.sin(third), 0.0]).double()
        torch.testing.assert_close(found, round_x @ round_z @ start, atol=1e-6, rtol=0.0)


def test_the_weight_is_exact_at_the_poles_and_smooth_beside_them():
    poles = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 1e-9, 0.0], [1.0, 1e-3, 0.0]]).double()
    poles.requires_grad_()
    weight = sampling.evenness(poles)
    torch.testing.assert_close(weight, torch.full((4,), math.pi**2 / 8).double(), rtol=1e-6, atol=0.0)
    assert torch.autograd.grad(weight.sum(), poles)[0].isfinite().all()


@pytest.mark.parametrize(("name", "share"), [("fibonacci", 0.01), ("sequence", 0.2)])
def test_even_patterns_integrate_better_than_chance(name, share):
    count = 1024
    pattern = sampling.fibonacci(count) if name == "fibonacci" else sampling.on_sphere(sampling.even_pairs(count))
    assert pattern.norm(dim=-1) == pytest.approx(torch.ones(count).numpy())
    x, y, z = pattern.unbind(-1)
    truth = math.sinh(1.0)  # mean of exp(d . u) over the sphere for a unit vector u
    off = torch.exp(0.6 * x + 0.48 * y - 0.64 * z).mean() - truth
    by_chance = 0.657 / math.sqrt(count)  # standard deviation of exp() over the sphere, over the root
    assert abs(off) < share * by_chance


def test_sequences_are_even_from_the_first_on():
    pairs = sampling.even_pairs(4096)
    assert ((pairs >= 0.0) & (pairs < 1.0)).all()
    torch.testing.assert_close(sampling.even_pairs(10), pairs[:10])
    for count in (64, 500, 4096):
        cells = torch.bincount((4 * pairs[:count]).long() @ torch.tensor([4, 1]), minlength=16)
        assert (cells - count / 16).abs().max() <= 4.0  # 16 by chance of 4096


def test_patterns_keep_the_dtype_and_generators_their_draws():
    draw = torch.Generator().manual_seed(3)
    first, second = (sampling.random_pairs(4, draw, torch.float32) for _ in range(2))
    assert first.dtype == sampling.fibonacci(4, torch.float32).dtype == torch.float32
    assert not torch.equal(first, second)
    assert torch.equal(first, sampling.random_pairs(4, torch.Generator().manual_seed(3), torch.float32))
