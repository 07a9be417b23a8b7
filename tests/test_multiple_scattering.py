import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import multiple_scattering as multiple
from diffrender.atmosphere import scattering, sky, sky_reference
from diffrender.atmosphere.scattering import HAZE, OZONE, RAYLEIGH, TOP, Medium
from diffrender.parameters import defaults, specifications


def double(value):
    return torch.as_tensor(value, dtype=torch.float64)


CLEAR_DAY = Medium(double(RAYLEIGH), double([HAZE] * 3), double([0.9 * HAZE] * 3), double(OZONE), double(0.2))
EYE = double(2.0)


def sine(degrees):
    return torch.sin(torch.deg2rad(double(degrees)))


def tabled(medium, elevation, **size):
    """Table of mean radiance for a sun in degrees, with the range of suns that it covers."""
    suns = multiple.sun_range(sine(elevation), EYE)
    return multiple.mean_radiance(medium, multiple.table_paths(suns, **size)), suns


def conservative(scale):
    """Air and haze that take nothing away, `scale` times as thick as on a clear day, over black ground."""
    haze = scale * CLEAR_DAY.haze
    return Medium(scale * CLEAR_DAY.rayleigh, haze, haze, double([0.0] * 3), double(0.0))


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_in_a_furnace_light_that_is_scattered_and_light_from_the_walls_are_one(scale):
    # Walls and ground of radiance 1: what enters, and every order of scattering, must add up to 1 everywhere.
    medium = conservative(scale)
    around = multiple.table_paths(multiple.sun_range(sine(30.0), EYE))
    _, through = scattering.step_weights(medium, around)
    ordinary = replace(around, sunlit=torch.zeros_like(around.sunlit), ground=torch.ones_like(around.ground))
    ordinary = replace(ordinary, ground_column=torch.zeros_like(around.ground_column))
    # Ground of albedo pi under light 1 is a wall of radiance 1 in every direction.
    entering, share = multiple.first_order(replace(medium, ground_albedo=double(math.pi)), ordinary)
    assert through.shape[0] == share.shape[0]
    torch.testing.assert_close(entering / (1.0 - share), torch.ones_like(entering), rtol=1e-9, atol=0.0)


def test_share_scattered_back_is_near_that_of_64_directions_of_20_steps():
    # Hillaire's f_ms as his code computes it, without ground bounce.
    published = {
        0.5e3: (0.079, 0.150, 0.271),
        5e3: (0.086, 0.172, 0.331),
        20e3: (0.100, 0.164, 0.281),
        60e3: (0.046, 0.090, 0.190),
    }
    around = multiple.table_paths(multiple.sun_range(sine(30.0), EYE), heights=40, steps=32)
    _, share = multiple.first_order(CLEAR_DAY, around)
    row = (double(list(published)) / TOP) ** (1.0 / 3.0) * 39.0
    below = row.long()
    found = torch.lerp(share[below, 0], share[below + 1, 0], (row - below)[:, None])
    torch.testing.assert_close(found, double(list(published.values())), rtol=0.0, atol=0.022)


def test_share_scattered_back_is_less_than_one_all_over_the_box():
    around = multiple.table_paths(multiple.sun_range(sine(5.0), EYE))
    middle = defaults(sky.Sky, torch.float64)
    for name, known in specifications(sky.Sky).items():
        for bound in known.bounds:
            extreme = replace(middle, **{name: torch.full_like(getattr(middle, name), bound)})
            once, share = multiple.first_order(sky.medium(extreme), around)
            assert (once >= 0.0).all()
            assert ((share > 0.0) & (share < 1.0)).all()
    _, share = multiple.first_order(conservative(10.0), around)
    assert (share < 0.99).all()


@pytest.mark.parametrize("elevation", [90.0, 60.0, 10.0, 1.0, -3.0])
def test_mean_radiance_follows_fine_quadrature(elevation):
    table, suns = tabled(CLEAR_DAY, elevation)
    height, cos_sun = double([0.0, 500.0, 3e3, 10e3]), sine(elevation)[None]
    truth = sky_reference.mean_radiance(CLEAR_DAY, height, cos_sun)[:, 0]
    found = multiple.look_up(table, suns, height, cos_sun.expand(4))
    torch.testing.assert_close(found, truth, rtol=0.06, atol=0.0)  # 5 nodes above and below the horizon, 8 steps


@pytest.mark.slow
@pytest.mark.parametrize("elevation", [60.0, 1.0])
def test_finer_tables_come_closer_to_quadrature(elevation):
    height, cos_sun = double([0.0, 500.0, 3e3, 10e3]), sine(elevation)[None]
    truth = sky_reference.mean_radiance(CLEAR_DAY, height, cos_sun)[:, 0]

    def error(**size):
        found = multiple.look_up(*tabled(CLEAR_DAY, elevation, **size), height, cos_sun.expand(4))
        return (found / truth - 1.0).square().mean().sqrt()

    usual, fine = error(), error(heights=24, columns=32, steps=32)
    assert fine < 0.6 * usual
    assert fine < 0.02


def test_ground_in_the_light_brightens_the_air_by_its_albedo():
    around = multiple.table_paths(multiple.sun_range(sine(40.0), EYE))
    black, grey, white = (
        multiple.mean_radiance(replace(CLEAR_DAY, ground_albedo=double(albedo)), around) for albedo in (0.0, 0.5, 1.0)
    )
    assert (black > 0.0).all()
    assert (grey > black).all()
    torch.testing.assert_close(grey - black, white - grey, rtol=1e-9, atol=0.0)


def test_mean_radiance_falls_with_the_sun_down_to_nothing():
    ground = double([0.0])
    brightness = [
        multiple.look_up(*tabled(CLEAR_DAY, elevation), ground, sine(elevation)[None])[0]
        for elevation in (90, 60, 30, 10, 3, 1, 0, -1, -3, -6, -9, -12)
    ]
    assert (torch.stack(brightness).diff(dim=0) < 0.0).all()
    assert (brightness[-1] > 0.0).all()
    night, _ = tabled(CLEAR_DAY, -60.0)
    assert torch.equal(night, torch.zeros_like(night))


@pytest.mark.parametrize("eye_altitude", [0.0, 2.0, 1e3, 10e3])
@pytest.mark.parametrize("elevation", [90.0, 85.0, 45.0, 0.0, -12.0, -85.0, -90.0])
def test_columns_cover_the_sun_of_every_point_that_an_eye_sees(elevation, eye_altitude):
    altitude, cos_sun = double(eye_altitude), sine(elevation)
    low, high = multiple.sun_range(cos_sun, altitude)
    lowest = scattering.horizon_cosine(altitude) + 1e-9
    cos_view = lowest + (1.0 - lowest) * torch.linspace(0.0, 1.0, 33, dtype=torch.float64)[:, None] ** 4
    level = torch.sqrt(1.0 - cos_view**2) * torch.sqrt((1.0 - cos_sun**2).clamp(min=0.0))
    cos_angle = cos_view * cos_sun + level * torch.linspace(-1.0, 1.0, 9, dtype=torch.float64)
    flat = torch.zeros_like(cos_angle)
    seen = scattering.paths(altitude + flat, cos_view + flat, cos_sun + flat, cos_angle, 64).cos_sun
    assert (seen >= low - 1e-9).all()
    assert (seen <= high + 1e-9).all()
    # And not much more than that, for the columns are few.
    assert seen.max() - seen.min() >= 0.9 * (high - low)


def test_table_is_found_again_at_its_own_cells_and_between_them_otherwise():
    table, suns = tabled(CLEAR_DAY, 5.0)
    heights, columns = table.shape[:2]
    height = TOP * torch.linspace(0.0, 1.0, heights, dtype=torch.float64) ** 3
    low, high = torch.asinh(suns / 0.06)
    cos_sun = 0.06 * torch.sinh(low + (high - low) * torch.linspace(0.0, 1.0, columns, dtype=torch.float64))
    at_cells = multiple.look_up(table, suns, height[1:, None].expand(-1, columns), cos_sun.expand(heights - 1, -1))
    torch.testing.assert_close(at_cells, table[1:], rtol=1e-6, atol=0.0)
    between = multiple.look_up(table, suns, height[3:4].expand(columns - 1), (cos_sun[1:] + cos_sun[:-1]) / 2.0)
    neighbours = torch.stack([table[3, 1:], table[3, :-1]])
    assert (between >= neighbours.amin(0)).all()
    assert (between <= neighbours.amax(0)).all()


@pytest.mark.parametrize("elevation", [90.0, 45.0, 0.0, -6.0, -12.0, -60.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_looked_up_radiance_has_finite_slopes_in_height_and_sun(dtype, elevation):
    leaves = [leaf.to(dtype).requires_grad_() for leaf in (sine(elevation), EYE.clone(), double([0.0, 2.0, 50e3, TOP]))]
    cos_sun, altitude, height = leaves
    medium = Medium(**{name: value.to(dtype) for name, value in vars(CLEAR_DAY).items()})
    suns = multiple.sun_range(cos_sun, altitude)
    table = multiple.mean_radiance(medium, multiple.table_paths(suns))
    found = multiple.look_up(table, suns, height, cos_sun.expand(4))
    assert found.isfinite().all()
    assert all(slope.isfinite().all() for slope in torch.autograd.grad(found.sum(), leaves))


@pytest.mark.parametrize("elevation", [60.0, 1.0, -6.0, -12.0])
def test_table_in_float32_follows_float64(elevation):
    medium = Medium(**{name: value.float() for name, value in vars(CLEAR_DAY).items()})
    suns = multiple.sun_range(sine(elevation).float(), EYE.float())
    single = multiple.mean_radiance(medium, multiple.table_paths(suns))
    truth, _ = tabled(CLEAR_DAY, elevation)
    bright = truth > 1e-6 * truth.max()  # below it a sun of float32 stands elsewhere behind the ground's edge
    torch.testing.assert_close(single.double()[bright], truth[bright], rtol=2e-3, atol=0.0)
