import torch

from diffrender.atmosphere.volumes import repeated, repeating_noise, trilinear
from diffrender.images import clamped, wrapped

FLOAT = torch.float64
SIZE = (3, 4, 5)


def centres():
    return torch.stack(torch.meshgrid(*(torch.arange(n, dtype=FLOAT) + 0.5 for n in SIZE), indexing="ij"), -1)


def test_a_cells_value_is_at_its_centre_to_the_bit():
    volume = torch.rand(*SIZE, 2, generator=torch.Generator().manual_seed(0), dtype=FLOAT)
    for address in (clamped, wrapped):
        assert torch.equal(trilinear(volume, centres(), address), volume)


def test_what_is_linear_is_exact_between_centres_and_held_beyond():
    slopes = torch.tensor([0.3, -1.0, 2.0], dtype=FLOAT)
    volume = (centres() * slopes).sum(-1)[..., None]
    inside = torch.tensor([[0.9, 2.2, 4.3], [1.5, 0.7, 3.9]], dtype=FLOAT)
    torch.testing.assert_close(trilinear(volume, inside, clamped)[:, 0], (inside * slopes).sum(-1))
    outside = torch.tensor([-7.0, 2.2, 99.0], dtype=FLOAT)
    held = (torch.tensor([0.5, 2.2, 4.5], dtype=FLOAT) * slopes).sum(-1, keepdim=True)
    torch.testing.assert_close(trilinear(volume, outside[None], clamped)[0], held)


def test_what_repeats_has_no_seam_and_a_continuous_gradient():
    volume = torch.rand(SIZE, generator=torch.Generator().manual_seed(1), dtype=FLOAT)
    place = torch.rand(6, 3, generator=torch.Generator().manual_seed(2), dtype=FLOAT)
    whole = torch.tensor([2.0, -1.0, 5.0], dtype=FLOAT)
    torch.testing.assert_close(repeated(volume, place + whole), repeated(volume, place))
    slope = torch.func.vmap(torch.func.grad(lambda at: repeated(volume, at[None])[0]))
    borders = centres().reshape(-1, 3) / torch.tensor(SIZE, dtype=FLOAT)
    torch.testing.assert_close(slope(borders - 1e-9), slope(borders + 1e-9), rtol=0.0, atol=1e-6)


def test_noise_is_the_same_for_a_seed_and_fills_its_range():
    first, second = (repeating_noise(8, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, second)
    assert float(first.abs().max()) == 1.0
    assert 0.5 < float(first.square().mean().sqrt()) < 0.8
    assert not torch.equal(first, repeating_noise(8, torch.Generator().manual_seed(4)))
