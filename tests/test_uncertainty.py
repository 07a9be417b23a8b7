import math

import numpy as np
import pytest
import torch

from diffrender import rays
from fit.uncertainty import patches, uncertainty

PIXELS = 600
MIDDLE = np.full(2, 0.5)


def line(patch, noise=0.05, seed=0):
    """Residuals and slopes of a line fitted to noise, three values a pixel, alike within a patch as asked."""
    generator = torch.Generator().manual_seed(seed)
    along = torch.linspace(-1.0, 1.0, PIXELS, dtype=torch.float64).repeat_interleave(3)
    slopes = torch.stack([torch.ones_like(along), along], -1)
    own = noise * torch.randn(int(patch.max()) + 1, 3, generator=generator, dtype=torch.float64)
    measured = own[patch].flatten()
    coefficients = torch.linalg.lstsq(slopes, measured[:, None]).solution
    return (slopes @ coefficients)[:, 0] - measured, slopes


def test_independent_residuals_have_the_errors_of_ordinary_least_squares():
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alone)
    found = uncertainty(residuals, slopes, alone, MIDDLE)
    variance = float(residuals.square().sum()) / (3 * PIXELS - 2)
    ordinary = torch.linalg.inv(slopes.T @ slopes).diagonal().mul(variance).sqrt()
    assert found.standard_error == pytest.approx(ordinary.numpy(), rel=0.15)  # 600 clusters know it to 4 %
    assert found.why == ("", "")


def test_neighbours_that_are_alike_count_once():
    alike = torch.arange(PIXELS) // 20
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alike)
    together = uncertainty(residuals, slopes, alike, MIDDLE).standard_error
    apart = uncertainty(residuals, slopes, alone, MIDDLE).standard_error
    assert together / apart == pytest.approx(math.sqrt(20.0), rel=0.4)


def test_half_the_noise_is_half_the_error():
    patch = torch.arange(PIXELS) // 10
    whole, half = (uncertainty(*line(patch, noise), patch, MIDDLE).standard_error for noise in (0.04, 0.02))
    assert half == pytest.approx(whole / 2.0)


def test_the_errors_are_those_that_repeated_noise_shows():
    patch = torch.arange(PIXELS) // 10
    slopes = line(patch)[1]
    estimates, errors = [], []
    for seed in range(60):
        residuals, _ = line(patch, seed=seed)
        noise = 0.05 * torch.randn(
            int(patch.max()) + 1, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
        )
        estimates.append(torch.linalg.lstsq(slopes, noise[patch].flatten()[:, None]).solution[:, 0].numpy())
        errors.append(uncertainty(residuals, slopes, patch, MIDDLE).standard_error)
    assert np.mean(errors, 0) == pytest.approx(np.std(estimates, 0), rel=0.35)  # of 60 repeats: 9 %, three times that


def test_correlation_is_that_of_the_estimates():
    patch = torch.arange(PIXELS) // 10
    residuals, slopes = line(patch)
    shifted = slopes @ torch.tensor([[1.0, 0.9], [0.0, 0.436]], dtype=torch.float64)  # the second leans on the first
    found = uncertainty(residuals, shifted, patch, MIDDLE).correlation
    assert found.diagonal() == pytest.approx([1.0, 1.0])
    assert found[0, 1] == pytest.approx(found[1, 0])
    assert -1.0 <= found[0, 1] < -0.5


def test_what_changes_nothing_is_not_determined():
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alone)
    slopes[:, 0] = 0.0
    found = uncertainty(residuals, slopes, alone, MIDDLE)
    assert found.why == ("without influence on this photo", "")
    assert np.isnan(found.standard_error[0])
    assert found.standard_error[1] > 0.0
    assert found.correlation[0].tolist() == [1.0, 0.0]


def test_what_changes_too_little_is_not_determined():
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alone)
    slopes[:, 1] *= 1e-4
    found = uncertainty(residuals, slopes, alone, MIDDLE)
    assert found.why == ("", "not determined by the photo")
    assert np.isnan(found.standard_error[1])


@pytest.mark.parametrize(("place", "why"), [(0.0, "at its lower bound"), (1.0, "at its upper bound")])
def test_what_lies_on_a_bound_has_no_error(place, why):
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alone)
    found = uncertainty(residuals, slopes, alone, np.array([place, 0.5]))
    assert found.why == (why, "")
    assert np.isnan(found.standard_error[0])


def test_where_nothing_is_determined_there_is_no_number():
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alone)
    found = uncertainty(residuals, 0.0 * slopes, alone, MIDDLE)
    assert np.isnan(found.standard_error).all()
    assert np.array_equal(found.correlation, np.eye(2))


def test_two_parameters_that_do_the_same_are_not_both_determined():
    alone = torch.arange(PIXELS)
    residuals, slopes = line(alone)
    slopes[:, 1] = slopes[:, 0]
    found = uncertainty(residuals, slopes, alone, MIDDLE)
    assert sorted(found.why) == ["", "not told apart from others by the photo"]


def test_patches_are_equally_large():
    generator = torch.Generator().manual_seed(0)
    height, turn = torch.rand(2, 100_000, generator=generator, dtype=torch.float64)
    patch = patches(rays.from_angles(torch.asin(height), 2.0 * math.pi * turn))
    _, counts = patch.unique(return_counts=True)
    # Squares of a third on the disc of radius 1, whose area is pi; those at the horizon are cut off.
    whole = 100_000 * (4.0 / 12.0) ** 2 / math.pi
    assert counts.max() < 1.06 * whole
    assert int((counts > 0.94 * whole).sum()) == 21  # of squares in rows of 3, 5, 5, 5, 3


def test_neighbours_share_a_patch_and_opposites_do_not():
    degree = math.radians(1.0)
    high = torch.tensor([0.7, 0.7 + degree, 0.7], dtype=torch.float64)
    patch = patches(rays.from_angles(high, torch.tensor([0.2, 0.2 + degree, 0.2 + math.pi], dtype=torch.float64)))
    assert patch[0] == patch[1]
    assert patch[0] != patch[2]


def test_the_zenith_has_a_patch():
    assert patches(torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)).shape == (1,)
