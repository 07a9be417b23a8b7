import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import sky, sky_reference, sky_view, stored_tables, sun_axis, two_tables
from diffrender.atmosphere.sky import EFFECT, Sky, SkyView
from diffrender.numerics import gauss_legendre
from diffrender.parameters import defaults
from diffrender.rays import from_angles

CLEAR = defaults(Sky, torch.float64)
SMALL = sky.Size(rows=10, columns=3, steps=8, heights=4, suns=6, steps_around=4)


def double(value):
    return torch.as_tensor(value, dtype=torch.float64)


def towards(elevation, azimuth=0.0):
    """Directions at angles in degrees."""
    return from_angles(*torch.broadcast_tensors(*(torch.deg2rad(double(angle)) for angle in (elevation, azimuth))))


def view(sun, direction=None):
    """All directions, or those given, under a sun at an elevation in degrees."""
    if direction is None:
        up = double([0.05, 0.5, 2.0, 5.0, 15.0, 40.0, 90.0])[:, None]
        direction = towards(up, torch.arange(0.0, 181.0, 30.0, dtype=torch.float64))
    return SkyView(direction, towards(sun), torch.ones(3, dtype=torch.float64), double(2.0))


def hazy(mie_scale):
    return replace(CLEAR, mie_scale=double(mie_scale))


def daylight(of, sun, size=SMALL):
    return sky.daylight(of, view(sun), sky.geometry(view(sun), size))


def relative_error(of, sun, rung, truth):
    drawn, wanted = (EFFECT.rungs[name](of, view(sun)) for name in (rung, truth))
    return (drawn / wanted - 1.0).square().mean().sqrt()


# Elevation of the sun -> root of the mean square of the relative error that the docstring of the rung states.
TWO_TABLES = {60.0: 0.05, 10.0: 0.07, 1.0: 0.2, -4.0: 0.5}


@pytest.mark.parametrize("sun", TWO_TABLES)
def test_two_tables_are_as_far_from_the_march_as_they_say(sun):
    error = relative_error(CLEAR, sun, "two tables", "march")
    assert TWO_TABLES[sun] / 3.0 < error < TWO_TABLES[sun]


# Haze and elevation of the sun -> the same against fresh tables of that haze.
WEATHERS = {(0.3, 60.0): 0.02, (1.0, 10.0): 0.04, (3.0, 10.0): 0.06, (8.0, 1.0): 0.06, (1.0, -4.0): 0.06}


@pytest.mark.parametrize(("haze", "sun"), WEATHERS)
def test_two_weathers_are_as_far_from_fresh_tables_as_they_say(haze, sun):
    error = relative_error(hazy(haze), sun, "two weathers", "tables")
    assert WEATHERS[haze, sun] / 3.0 < error < WEATHERS[haze, sun]


def test_daylight_between_two_stored_suns_is_near_that_made_for_it():
    index = sun_axis.place(sky_view.elevation(towards(10.0)), sun_axis.CELLS)
    lower = index.floor()
    beside = torch.rad2deg(sun_axis.elevations(torch.stack([lower, lower + 1.0]), sun_axis.CELLS))
    one, other, truth = (daylight(CLEAR, elevation) for elevation in (*beside, 10.0))
    for name in ("in_scatter", "cloud", "sunlight", "skylight"):
        found = stored_tables.between(getattr(one, name), getattr(other, name), index - lower)
        torch.testing.assert_close(found, getattr(truth, name), rtol=0.01, atol=1e-9)


def test_two_tables_follow_haziness_and_leave_the_air_as_it_was_made():
    seen = view(30.0, towards(double([31.0, 40.0, 80.0])))
    sharp, soft = (
        EFFECT.rungs["two tables"](replace(CLEAR, haziness=double(haziness)), seen) for haziness in (0.9, 0.5)
    )
    assert (sharp[0] > soft[0]).all()
    assert (sharp[2] < soft[2]).all()
    thick = replace(CLEAR, rayleigh_scale=double(3.0), ozone=double(5.0), ground_albedo=double(1.0))
    assert torch.equal(EFFECT.rungs["two tables"](thick, seen), EFFECT.rungs["two tables"](CLEAR, seen))


def test_packaged_tables_are_finite_light_that_ends_in_black():
    tables = two_tables.packaged()
    assert tables.air.shape == (sun_axis.CELLS, two_tables.ROWS, 3)
    for table in vars(tables).values():
        assert table.isfinite().all()
        assert (table >= 0.0).all()
        assert not table[0].any()
        assert table[1:].any(-1).any()


def test_cells_rise_from_the_night_to_the_zenith_and_are_their_own_places():
    index = torch.arange(9, dtype=torch.float64)
    elevation = sun_axis.elevations(index, 9)
    assert (elevation.diff() > 0.0).all()
    torch.testing.assert_close(elevation[[0, -1]], double([-math.pi / 2.0, math.pi / 2.0]))
    places = torch.stack([sun_axis.place(one, 9) for one in elevation])
    torch.testing.assert_close(places, index, rtol=1e-12, atol=1e-12)


def test_between_cells_the_logarithm_is_linear_and_black_stays_black():
    table = double([[1.0, 0.0, 4.0], [4.0, 0.0, 0.0]])
    middle = sun_axis.between(table, double(0.5))
    torch.testing.assert_close(middle[:2], double([2.0, 0.0]))
    assert middle[1] == 0.0
    assert 0.0 < middle[2] < 1e-5
    for index in (0, 1):
        torch.testing.assert_close(sun_axis.between(table, double(float(index))), table[index], rtol=1e-9, atol=0.0)


def test_gradient_between_cells_is_finite_where_light_is_nothing():
    table, index = torch.zeros(3, 2, dtype=torch.float64, requires_grad=True), double(0.7).requires_grad_()
    slopes = torch.autograd.grad(sun_axis.between(table, index).sum(), (table, index))
    assert all(slope.isfinite().all() for slope in slopes)


def test_stored_daylight_is_that_of_its_cells():
    elevations = torch.rad2deg(sun_axis.elevations(torch.arange(3, dtype=torch.float64), 3))
    each = [daylight(CLEAR, elevation) for elevation in elevations]
    tables = stored_tables.stored(each)
    for elevation, made in zip(elevations[1:], each[1:], strict=True):
        found = stored_tables.at_sun(tables, towards(elevation))
        for name, table in vars(made).items():
            torch.testing.assert_close(getattr(found, name), table, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_of_one_weather_is_that_weather(share):
    weathers = [daylight(hazy(haze), 20.0) for haze in (0.5, 5.0)]
    mixed = stored_tables.blended(*weathers, double(share))
    for name, table in vars(weathers[round(share)]).items():
        torch.testing.assert_close(getattr(mixed, name), table, rtol=1e-7, atol=1e-12)


def test_sunlight_through_mixed_air_is_beers():
    first, second, mixed = (daylight(hazy(haze), 20.0) for haze in (0.5, 5.0, 0.5 + 0.3 * 4.5))
    found = stored_tables.blended(first, second, double(0.3))
    torch.testing.assert_close(found.sunlight, mixed.sunlight, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(found.amount, mixed.amount, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("sun", [60.0, 3.0])
def test_sunlight_is_what_quadrature_lets_through(sun):
    truth = sky_reference.sunlight(sky.medium(CLEAR), double(2.0), towards(sun)[2])
    torch.testing.assert_close(sky.sunlight(CLEAR, view(sun)), truth, rtol=0.01, atol=0.0)


@pytest.mark.parametrize("sun", [60.0, 3.0])
def test_skylight_is_the_light_of_the_marched_sky_on_level_ground(sun):
    place, weight = gauss_legendre(24)
    elevation = math.pi / 2.0 * (0.5 + 0.5 * place) ** 2  # dense at the horizon
    solid = math.pi / 2.0 * (0.5 + 0.5 * place) * weight * torch.cos(elevation) * torch.sin(elevation)
    azimuth = math.pi * (torch.arange(24, dtype=torch.float64) + 0.5) / 24
    seen = view(sun, from_angles(*torch.meshgrid(elevation, azimuth, indexing="ij")))
    truth = (EFFECT.rungs["march"](CLEAR, seen).mean(1) * (2.0 * math.pi * solid)[:, None]).sum(0)
    torch.testing.assert_close(daylight(CLEAR, sun, sky.Size()).skylight, truth, rtol=0.01, atol=0.0)


def test_directions_over_the_sky_have_its_area_seen_from_the_ground():
    seen, share = sky_view.upper_half(view(30.0))
    assert share.sum().item() == pytest.approx(math.pi, rel=2e-3)  # midpoint rule in 32 rows
    torch.testing.assert_close(sky_view.elevation(seen.to_sun), torch.deg2rad(double(30.0)))
