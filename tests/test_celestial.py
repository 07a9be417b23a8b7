import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import celestial
from diffrender.atmosphere.celestial import Sun, SunView
from diffrender.atmosphere.scattering import SUN_RADIUS
from diffrender.colour import exposure_from_ev100
from diffrender.parameters import defaults
from diffrender.rays import Rays, from_angles

DISCS = [celestial.uniform_disc, celestial.render, celestial.measured]
SUN = defaults(Sun, torch.float64)
CLEAR = torch.ones(3, dtype=torch.float64)


def rays_at(share_of_radius, elevation=SUN.elevation, azimuth=SUN.azimuth, turn=0.3):
    """Rays at angles from a sun's middle, given in radii of the disc."""
    angle = (SUN_RADIUS * torch.as_tensor(share_of_radius, dtype=torch.float64))[..., None]
    middle, up = from_angles(elevation, azimuth), from_angles(elevation + math.pi / 2, azimuth)
    aside = math.cos(turn) * up + math.sin(turn) * torch.linalg.cross(up, middle)
    direction = torch.cos(angle) * middle + torch.sin(angle) * aside
    return Rays(direction.new_zeros(3), direction, direction.new_tensor(math.inf))


def view(share_of_radius, transmittance=CLEAR):
    return SunView(rays_at(share_of_radius), transmittance)


def rings(count):
    """Middles of rings of equal solid angle over the disc, in radii."""
    share = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    return 2.0 * torch.asin(torch.sqrt(share) * math.sin(SUN_RADIUS / 2.0)) / SUN_RADIUS


@pytest.mark.parametrize("disc", DISCS)
def test_radiance_summed_over_the_disc_is_the_irradiance(disc):
    transmittance = torch.tensor([0.9, 0.5, 0.1], dtype=torch.float64)
    radiance = disc(SUN, view(rings(10_000), transmittance))
    solid_angle = 2.0 * math.pi * (1.0 - math.cos(SUN_RADIUS))
    torch.testing.assert_close(radiance.mean(0) * solid_angle, SUN.irradiance * transmittance, rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("disc", DISCS)
def test_disc_ends_at_its_angular_radius(disc):
    radiance = disc(SUN, view([1.0 - 1e-6, 1.0 + 1e-6, 2.0, math.pi / SUN_RADIUS]))
    assert (radiance[0] > 0.0).all()
    assert torch.equal(radiance[1:], torch.zeros_like(radiance[1:]))


@pytest.mark.parametrize("disc", DISCS)
def test_disc_looks_the_same_all_round_and_wherever_it_stands(disc):
    share = torch.linspace(0.0, 1.2, 50, dtype=torch.float64)
    wanted = disc(SUN, view(share))
    for elevation, azimuth, turn in [(math.pi / 2, 0.0, 1.0), (-math.pi / 2, 1.0, 2.0), (0.0, math.pi, 5.0)]:
        place = torch.tensor([elevation, azimuth], dtype=torch.float64).unbind()
        sun = replace(SUN, elevation=place[0], azimuth=place[1])
        seen = SunView(rays_at(share, *place, turn=turn), CLEAR)
        torch.testing.assert_close(disc(sun, seen), wanted, rtol=1e-9, atol=0.0)


def test_darkening_follows_the_measurements_but_for_the_last_percent_of_the_radius():
    share = torch.linspace(0.0, 0.99, 200, dtype=torch.float64)
    mean = celestial.uniform_disc(SUN, view(share))
    error = (celestial.render(SUN, view(share)) - celestial.measured(SUN, view(share))) / mean
    assert error[share <= 0.9].abs().max() < 0.012
    assert error.abs().max() < 0.1


def test_measured_polynomials_have_their_published_means():
    # Table 1 of Neckel and Labs also prints the mean over the disc, in units of the middle.
    published = [0.7495, 0.7588, 0.8002, 0.8061, 0.8360, 0.8434]
    means = [sum(2.0 * a / (n + 2) for n, a in enumerate(row)) for row in celestial.MEASURED.values()]
    assert means == pytest.approx(published, abs=6e-5)


def test_limb_is_redder_than_the_middle():
    middle, limb = celestial.render(SUN, view([0.0, 0.95]))
    red, green, blue = limb / middle
    assert red > green > blue


def test_exponents_are_those_of_hestroffer_and_magnan():
    # Their formula at 680, 550 and 440 nm.
    assert pytest.approx((0.4064, 0.5079, 0.6406), abs=5e-5) == celestial.LIMB_EXPONENTS


@pytest.mark.parametrize("share", [0.0, 1e-3, 0.5, 0.99])
def test_disc_in_float32_follows_float64_from_the_middle_to_the_limb(share):
    # A float32 direction is itself known to 1e-5 of the disc's radius; a cosine would be wrong by 0.5 % of its area.
    sun, seen = defaults(Sun, torch.float32), view([share])
    rays = Rays(*(part.float() for part in (seen.rays.origin, seen.rays.direction, seen.rays.length)))
    single = celestial.render(sun, SunView(rays, CLEAR.float()))
    torch.testing.assert_close(single.double(), celestial.render(SUN, seen), rtol=1e-3, atol=0.0)


def test_middle_of_the_disc_does_not_brighten_when_the_sun_moves():
    def towards(elevation, azimuth):
        return celestial.render(replace(SUN, elevation=elevation, azimuth=azimuth), view(0.0))

    for slope in torch.func.jacfwd(towards, argnums=(0, 1))(SUN.elevation, SUN.azimuth):
        assert torch.equal(slope, torch.zeros(3, dtype=torch.float64))


@pytest.mark.parametrize("disc", DISCS)
def test_sun_moved_across_a_ray_by_its_edge_switches_it_without_a_gradient(disc):
    def towards(azimuth):
        return disc(replace(SUN, azimuth=azimuth), view(0.0)).sum()

    just_out = torch.tensor(1.0001 * SUN_RADIUS / math.cos(SUN.elevation), dtype=torch.float64)
    assert towards(0.999 * just_out) > 0.0
    assert towards(just_out) == 0.0
    assert torch.func.grad(towards)(just_out) == 0.0


def test_disc_is_proportional_to_irradiance():
    twice = replace(SUN, irradiance=2.0 * SUN.irradiance)
    torch.testing.assert_close(celestial.render(twice, view(0.4)), 2.0 * celestial.render(SUN, view(0.4)))


def test_no_sunlight_no_disc():
    dark = celestial.render(SUN, view(torch.linspace(0.0, 2.0, 9), torch.zeros(3, dtype=torch.float64)))
    assert torch.equal(dark, torch.zeros_like(dark))


def test_sun_to_moon_of_400_000_to_1_survives_half_floats_when_exposed_before_and_not_after():
    # 1e5 lux of sun; a moon as large but 400 000 times fainter; a sunny day's exposure (units: lux, cd/m^2).
    exposure = exposure_from_ev100(torch.tensor(15.0, dtype=torch.float64))
    sun = replace(SUN, irradiance=torch.full((3,), 1e5, dtype=torch.float64))
    moon = replace(sun, irradiance=sun.irradiance / 400_000.0)

    before = [celestial.render(celestial.pre_exposed(light, exposure), view(0.0)).half() for light in (sun, moon)]
    after = [celestial.render(light, view(0.0)).half() * exposure.half() for light in (sun, moon)]

    half_a_step = 2.0**-11
    ratio = before[0].double() / before[1].double()
    torch.testing.assert_close(ratio, torch.full_like(ratio, 400_000.0), rtol=2.0 * half_a_step, atol=0.0)
    assert after[0].isinf().all()


def test_exposing_before_or_after_is_the_same_picture_in_exact_arithmetic():
    exposure = torch.tensor(2.5e-5, dtype=torch.float64)
    before = celestial.render(celestial.pre_exposed(SUN, exposure), view([0.0, 0.7, 1.3]))
    torch.testing.assert_close(before, exposure * celestial.render(SUN, view([0.0, 0.7, 1.3])))


def test_to_sun_points_up_by_the_elevation_and_left_by_the_azimuth():
    sun = replace(SUN, elevation=torch.tensor(math.pi / 6).double(), azimuth=torch.tensor(math.pi / 2).double())
    wanted = torch.tensor([0.0, math.sqrt(0.75), 0.5], dtype=torch.float64)
    torch.testing.assert_close(celestial.to_sun(sun), wanted)
