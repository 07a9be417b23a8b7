import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import scattering, sky_reference
from diffrender.atmosphere.scattering import HAZE, OZONE, PLANET_RADIUS, RAYLEIGH, SUN_RADIUS, TOP, Medium
from diffrender.numerics import gauss_legendre


def double(value):
    return torch.as_tensor(value, dtype=torch.float64)


# A clear day of Hillaire 2020: grey haze, nine tenths of it scattering.
CLEAR_DAY = Medium(double(RAYLEIGH), double([HAZE] * 3), double([0.9 * HAZE] * 3), double(OZONE), double(0.1))

ASYMMETRIES = [0.0, 0.3, 0.76, 0.9, 0.99]
PHASES = {
    "Rayleigh": lambda chord_square, _: scattering.rayleigh_phase(chord_square),
    "Henyey-Greenstein": scattering.henyey_greenstein,
    "Cornette-Shanks": scattering.cornette_shanks,
}


def over_the_sphere(phase, asymmetry):
    """Integral of a phase function and its mean cosine; solid angle is pi times the square of the chord."""
    place, weight = gauss_legendre(200)
    near = 0.5 + 0.5 * place  # fourth power: dense in the forward peak
    chord_square = 4.0 * near**4
    solid = math.pi * 16.0 * near**3 * 0.5 * weight
    value = phase(chord_square, double(asymmetry))
    return (value * solid).sum(), (value * solid * (1.0 - 0.5 * chord_square)).sum()


@pytest.mark.parametrize("asymmetry", ASYMMETRIES)
@pytest.mark.parametrize("name", PHASES)
def test_phase_function_integrates_to_one_over_the_sphere(name, asymmetry):
    total, _ = over_the_sphere(PHASES[name], asymmetry)
    torch.testing.assert_close(total, double(1.0), rtol=1e-10, atol=0.0)


@pytest.mark.parametrize("g", ASYMMETRIES)
def test_phase_functions_have_the_mean_cosines_of_their_authors(g):
    means = {name: over_the_sphere(phase, g)[1].item() for name, phase in PHASES.items()}
    wanted = {"Rayleigh": 0.0, "Henyey-Greenstein": g, "Cornette-Shanks": 3 * g * (4 + g * g) / (5 * (2 + g * g))}
    assert means == pytest.approx(wanted, abs=1e-10)


def test_cornette_and_shanks_is_rayleigh_where_nothing_is_favoured():
    chord_square = torch.linspace(0.0, 4.0, 9, dtype=torch.float64)
    torch.testing.assert_close(
        scattering.cornette_shanks(chord_square, double(0.0)), scattering.rayleigh_phase(chord_square)
    )


@pytest.mark.parametrize("name", ["Henyey-Greenstein", "Cornette-Shanks"])
def test_forward_peak_keeps_its_digits_in_float32(name):
    # 1 + g² - 2g cos is 7 % off here.
    asymmetry, chord_square = torch.tensor(0.999), torch.tensor([0.0, 1e-8, 1e-6, 1e-3])
    single = PHASES[name](chord_square, asymmetry)
    truth = PHASES[name](chord_square.double(), asymmetry.double())
    torch.testing.assert_close(single.double(), truth, rtol=2e-4, atol=0.0)  # 1 - g itself is known to 6e-5


@pytest.mark.parametrize("name", ["Henyey-Greenstein", "Cornette-Shanks"])
def test_gradient_by_asymmetry_is_right_in_the_peak_and_behind(name):
    chord_square = double([0.0, 1e-4, 2.0, 4.0])
    for asymmetry in ASYMMETRIES:
        leaf = double(asymmetry).requires_grad_()
        assert torch.autograd.gradcheck(lambda g: PHASES[name](chord_square, g), leaf, eps=1e-7, rtol=1e-4)


# By quadrature: zenith angle in degrees -> column over the vertical one, at 796.4 scale heights from the centre.
CHAPMAN = {0: 1, 60: 1.99258, 80: 5.55052, 85: 10.14003, 88: 18.66611, 90: 35.38532, 91: 55.02434, 93: 195.924}


@pytest.mark.parametrize("angle", CHAPMAN)
def test_column_is_chapmans_above_and_below_the_horizontal(angle):
    height = double(796.4 * scattering.RAYLEIGH_HEIGHT - PLANET_RADIUS)
    vertical = scattering.RAYLEIGH_HEIGHT * torch.exp(-height / scattering.RAYLEIGH_HEIGHT)
    found = scattering.column(height, torch.cos(torch.deg2rad(double(angle))))[0] / vertical
    torch.testing.assert_close(found, double(CHAPMAN[angle]), rtol=1e-3 if angle <= 90 else 5e-3, atol=0.0)


def test_vertical_column_of_ozone_is_the_area_of_its_tent():
    ozone = scattering.column(double([0.0, 5e3, 25e3, 40e3, 60e3]), torch.ones(5, dtype=torch.float64))[:, 2]
    torch.testing.assert_close(ozone, double([15e3, 15e3, 7.5e3, 0.0, 0.0]), rtol=1e-9, atol=1e-6)


def test_transmittance_from_the_ground_has_its_known_values_at_the_zenith_and_the_horizon():
    through = scattering.transmittance(CLEAR_DAY, scattering.column(double([0.0, 0.0]), double([1.0, 0.0])))
    depth = double(RAYLEIGH) * scattering.RAYLEIGH_HEIGHT + HAZE * scattering.HAZE_HEIGHT + double(OZONE) * 15e3
    torch.testing.assert_close(through[0], torch.exp(-depth), rtol=1e-6, atol=0.0)
    # Computed apart, by stepping; printed with these digits.
    torch.testing.assert_close(through[0], double([0.9405, 0.8678, 0.7626]), rtol=0.0, atol=4e-4)
    torch.testing.assert_close(through[1], double([0.107, 0.0097, 5.3e-5]), rtol=1.5e-2, atol=0.0)


HEIGHTS = [0.0, 2.0, 500.0, 5e3, 12e3, 30e3, 90e3]
DIPS = [0.9, 0.5, 0.1, 0.01, 0.0]  # of a ray, in parts of the way from the horizontal to the ground's edge


@pytest.mark.parametrize("height", HEIGHTS)
def test_column_follows_quadrature_from_the_zenith_down_to_the_grounds_edge(height):
    rising = torch.cos(torch.deg2rad(torch.arange(0.0, 91.0, 5.0, dtype=torch.float64)))
    cosine = torch.cat([rising, double(DIPS) * scattering.horizon_cosine(double(height))])
    # Far above the ground's edge no part of the sun is hidden: sunlight is transmittance.
    seen = cosine - scattering.horizon_cosine(double(height)) > 1.1 * math.sin(SUN_RADIUS)
    heights = torch.full_like(cosine[seen], height)
    truth = sky_reference.sunlight(CLEAR_DAY, heights, cosine[seen])
    found = scattering.transmittance(CLEAR_DAY, scattering.column(heights, cosine[seen]))
    # Half a per cent of the depth, so the blue of a setting sun is known to a few per cent; and the air above the top.
    assert (torch.log(found / truth).abs() <= 2e-5 - 5e-3 * torch.log(truth)).all()


@pytest.mark.parametrize("height", HEIGHTS[1:])
def test_column_has_no_step_and_no_wild_slope_across_the_horizontal(height):
    cosine = double([-1e-9, 0.0, 1e-9]).requires_grad_()
    columns = scattering.column(double(height).expand(3), cosine)
    torch.testing.assert_close(columns[0], columns[2], rtol=1e-6, atol=1e-3)
    slope = torch.stack([torch.autograd.grad(c.sum(), cosine, retain_graph=True)[0] for c in columns.T])
    torch.testing.assert_close(slope[:, 0], slope[:, 2], rtol=1e-2, atol=1.0)


def test_columns_and_their_slopes_are_finite_everywhere():
    height, cosine = torch.meshgrid(
        double([*HEIGHTS, 10e3, 25e3, 40e3, TOP]), double([-1.0, -0.1, -1e-3, 0.0, 1e-3, 1.0]), indexing="ij"
    )
    leaves = height.clone().requires_grad_(), cosine.clone().requires_grad_()
    for dtype in (torch.float32, torch.float64):
        columns = scattering.column(*(leaf.to(dtype) for leaf in leaves))
        slopes = torch.autograd.grad(columns.sum(), leaves)
        assert columns.isfinite().all()
        assert all(slope.isfinite().all() for slope in slopes)


def test_horizon_dips_as_the_tangent_to_a_sphere_in_float32_too():
    height = double([0.0, 2.0, 100.0, 10e3])
    sine = PLANET_RADIUS / (PLANET_RADIUS + height)
    cosine = -torch.sqrt(1.0 - sine * sine)
    torch.testing.assert_close(scattering.horizon_cosine(height), cosine, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(scattering.horizon_cosine(height.float()).double(), cosine, rtol=1e-6, atol=0.0)


def ray(height, cosine, dtype=torch.float64, steps=16):
    height, cosine = (torch.tensor(value, dtype=torch.float64).to(dtype) for value in (height, cosine))
    return scattering.paths(height, cosine, torch.ones_like(height), cosine, steps)


def length(height, cosine, dtype=torch.float64):
    return ray(height, cosine, dtype).step.sum().item()


def test_rays_end_on_the_ground_or_where_the_air_ends():
    tangent = math.sqrt(TOP * (2.0 * PLANET_RADIUS + TOP))
    assert length(0.0, 1.0) == pytest.approx(TOP)
    assert length(10e3, 1.0) == pytest.approx(TOP - 10e3)
    assert length(10e3, -1.0) == pytest.approx(10e3, abs=2e-3)
    assert length(0.0, 0.0) == pytest.approx(tangent)
    just_over = scattering.horizon_cosine(double(10e3)).item() * (1.0 - 1e-9)
    to_edge = math.sqrt(10e3 * (2.0 * PLANET_RADIUS + 10e3))
    assert length(10e3, just_over) == pytest.approx(to_edge + tangent, rel=1e-4)


def test_ray_that_just_dips_from_a_standing_eye_has_its_length_in_float32():
    # From 2 m at a cosine of -0.001 the naive discriminant is 7 % off.
    climb = (PLANET_RADIUS + 2.0) * 0.001
    exact = climb - math.sqrt(climb * climb - 2.0 * (2.0 * PLANET_RADIUS + 2.0))
    assert length(2.0, -0.001) == pytest.approx(exact, rel=1e-6)
    assert length(2.0, -0.001, torch.float32) == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("cosine", [1.0, 0.3, 1e-4, 0.0, -1e-4])
def test_heights_along_a_ray_from_a_standing_eye_keep_their_centimetres_in_float32(cosine):
    distance = double([1.0, 100.0, 5e3, 50e3])
    arguments = double(2.0), double(cosine), distance
    position = torch.hypot((PLANET_RADIUS + 2.0) * math.sqrt(1.0 - cosine**2) + 0.0 * distance,
                           (PLANET_RADIUS + 2.0) * cosine + distance)  # fmt: skip
    truth = position - PLANET_RADIUS
    torch.testing.assert_close(scattering.height_along(*arguments), truth, rtol=0.0, atol=1e-8)
    single = scattering.height_along(*(argument.float() for argument in arguments))
    torch.testing.assert_close(single.double(), truth, rtol=1e-6, atol=1e-2)


@pytest.mark.parametrize("height", [0.0, 2.0, 10e3])
def test_whole_disc_half_disc_and_none_of_it_are_seen_as_the_sun_sets(height):
    edge = scattering.horizon_cosine(double(height))
    radius = math.sin(SUN_RADIUS)
    found = scattering.sunlit(double(height).expand(5), edge + radius * double([-1.1, -1.0, 0.0, 1.0, 1.1]))
    torch.testing.assert_close(found, double([0.0, 0.0, 0.5, 1.0, 1.0]), rtol=0.0, atol=1e-12)


def test_setting_disc_is_covered_as_a_circle_by_a_line_and_lit_from_the_middle_of_the_rest():
    rise = torch.linspace(-0.999, 0.999, 201, dtype=torch.float64)
    half_chord = torch.sqrt(1.0 - rise * rise)
    segment = 0.5 + (torch.asin(rise) + rise * half_chord) / math.pi
    sea, cosine = torch.zeros_like(rise), rise * math.sin(SUN_RADIUS)
    share = scattering.sunlit(sea, cosine)
    torch.testing.assert_close(share, segment, rtol=0.0, atol=0.013)
    assert (share.diff() > 0.0).all()
    middle = (scattering.to_visible_sun(sea, cosine) - cosine) / math.sin(SUN_RADIUS)
    torch.testing.assert_close(middle, 2.0 * half_chord**3 / (3.0 * math.pi * segment), rtol=0.0, atol=0.03)


def test_light_of_a_setting_sun_comes_over_the_ground_and_that_of_a_high_one_from_its_middle():
    height = double([0.0, 2.0, 1e3, 50e3])[:, None]
    edge = scattering.horizon_cosine(height)
    rise = math.sin(SUN_RADIUS) * torch.linspace(-1.0, 1.0, 21, dtype=torch.float64)
    assert (scattering.to_visible_sun(height.expand(4, 21), edge + rise) >= edge - 1e-12).all()
    high = double([0.1, 1.0])
    assert torch.equal(scattering.to_visible_sun(torch.zeros(2, dtype=torch.float64), high), high)


def test_edge_of_the_shadow_has_a_finite_slope_inside_and_none_outside():
    cosine = (math.sin(SUN_RADIUS) * double([-2.0, -1.0, 0.0, 1.0, 2.0])).requires_grad_()
    share = scattering.sunlit(
        torch.full((5,), 2e3, dtype=torch.float64), cosine + scattering.horizon_cosine(double(2e3))
    )
    slope = torch.autograd.grad(share.sum(), cosine)[0] * math.sin(SUN_RADIUS)
    torch.testing.assert_close(slope, double([0.0, 0.0, 2.0 / math.pi, 0.0, 0.0]), rtol=0.0, atol=1e-9)


def hazy(scale):
    return replace(CLEAR_DAY, haze=scale * CLEAR_DAY.haze, haze_scattering=scale * CLEAR_DAY.haze_scattering)


@pytest.mark.parametrize("steps", [1, 4, 64])
@pytest.mark.parametrize("scale", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("cosine", [1.0, 0.1, 0.0, -0.5])
def test_what_a_path_takes_away_and_what_it_lets_through_are_all_its_light(cosine, scale, steps):
    # A source equal to the extinction glows as brightly as the light it removes, however thick the steps.
    medium, along = hazy(scale), ray(500.0, cosine, steps=steps)
    weights, through = scattering.step_weights(medium, along)
    glow = (weights * (along.density @ medium.extinction())).sum(-2)
    torch.testing.assert_close(glow + through, torch.ones_like(through), rtol=1e-12, atol=0.0)


def test_path_to_the_top_lets_through_what_its_column_does():
    along = ray(0.0, 0.2, steps=512)
    _, through = scattering.step_weights(CLEAR_DAY, along)
    truth = scattering.transmittance(CLEAR_DAY, scattering.column(double(0.0), double(0.2)))
    torch.testing.assert_close(through, truth, rtol=2e-4, atol=0.0)


def test_local_sun_stays_at_the_zenith_of_a_ray_that_climbs_towards_it():
    assert torch.equal(ray(0.0, 1.0).cos_sun, torch.ones(16, dtype=torch.float64))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_paths_and_their_slopes_are_finite_in_every_corner(dtype):
    height, cosine, cos_sun = torch.meshgrid(
        double([0.0, 2.0, 10e3, TOP]).to(dtype),
        double([-1.0, -1e-3, 0.0, 1e-3, 1.0]).to(dtype),
        double([-1.0, -0.2, 0.0, 0.2, 1.0]).to(dtype),
        indexing="ij",
    )
    leaves = [leaf.clone().requires_grad_() for leaf in (height, cosine, cos_sun)]
    along = scattering.paths(*leaves, leaves[1] * leaves[2], 8)
    weights, through = scattering.step_weights(replace(CLEAR_DAY, **{
        name: value.to(dtype) for name, value in vars(CLEAR_DAY).items()
    }), along)  # fmt: skip
    total = weights.sum() + through.sum() + sum(part.sum() for part in vars(along).values()) / TOP
    assert total.isfinite()
    assert all(slope.isfinite().all() for slope in torch.autograd.grad(total, leaves))


@pytest.mark.parametrize("height", [0.0, 2.0, 8e3])
def test_a_column_has_its_slope_where_the_sun_stands_exactly_level(height):
    level = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    at = torch.full((1,), height, dtype=torch.float64)
    (slope,) = torch.autograd.grad(scattering.column(at, level).sum(), level)
    above, below = (scattering.column(at, torch.full_like(at, side)).sum() for side in (1e-6, -1e-6))
    torch.testing.assert_close(slope[0], (above - below) / 2e-6, rtol=1e-4, atol=0.0)


def test_a_ray_has_the_slope_of_its_length_where_it_is_exactly_level():
    def length(cos_view):
        at = torch.full_like(cos_view, 2e3)
        return scattering.paths(
            at, cos_view, torch.full_like(cos_view, 0.5), torch.full_like(cos_view, 0.5), 4
        ).step.sum()

    level = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(length(level), level)
    above, below = (length(torch.full((1,), side, dtype=torch.float64)) for side in (1e-6, -1e-6))
    torch.testing.assert_close(slope[0], (above - below) / 2e-6, rtol=1e-4, atol=0.0)
