import math

import pytest
import torch

from diffrender import colour

REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
COLOURS = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def matrix(*rows):
    return torch.tensor(rows, dtype=torch.float64)


def slope(function, x):
    """Derivative by reverse mode, found equal to that by forward mode under vmap."""
    leaf = x.clone().requires_grad_()
    reverse = torch.autograd.grad(function(leaf).sum(), leaf)[0]

    def along(tangent):
        return torch.func.jvp(function, (x,), (tangent,))[1]

    forward = torch.func.vmap(along)(torch.eye(len(x), dtype=x.dtype)).diagonal()
    torch.testing.assert_close(forward, reverse)
    return reverse


def test_rec709_from_rec709_changes_nothing():
    torch.testing.assert_close(
        colour.rec709_from(colour.REC709), torch.eye(3, dtype=torch.float64), atol=1e-15, rtol=0.0
    )


def test_rec709_from_rec2020_is_the_matrix_of_itu_r_bt_2087():
    published = matrix((1.6605, -0.5876, -0.0728), (-0.1246, 1.1329, -0.0083), (-0.0182, -0.1006, 1.1187))
    torch.testing.assert_close(colour.rec709_from(REC2020), published, atol=5e-5, rtol=0.0)


def test_rec709_from_aces_is_the_matrix_of_the_academys_configuration():
    # ACES 1.2 configuration of OpenColorIO, AP0 (white near D60) to Rec. 709, Bradford adaptation.
    published = matrix(
        (2.52168618674388, -1.13413098823972, -0.387555198504164),
        (-0.276479914229922, 1.37271908766826, -0.096239173438334),
        (-0.0153780649660342, -0.152975335867399, 1.16835340083343),
    )
    torch.testing.assert_close(colour.rec709_from(ACES), published, atol=1e-13, rtol=0.0)


@pytest.mark.parametrize("chromaticities", [REC2020, ACES, (0.6, 0.35, 0.3, 0.55, 0.16, 0.1, 0.4476, 0.4074)])
def test_white_stays_white(chromaticities):
    torch.testing.assert_close(colour.rec709_from(chromaticities).sum(1), torch.ones(3, dtype=torch.float64))


def test_luminance_of_a_channel_is_its_y_in_xyz():
    # Each point scaled to Y = 1: the amounts that mix white are the shares of Y.
    red, green, blue, white = (
        matrix((x, y, 1.0 - x - y)) / y for x, y in zip(colour.REC709[::2], colour.REC709[1::2], strict=True)
    )
    shares = torch.linalg.solve(torch.cat([red, green, blue]).T, white[0])
    torch.testing.assert_close(colour.luminance(torch.eye(3, dtype=torch.float64)), shares, atol=5e-5, rtol=0.0)


@pytest.mark.parametrize(
    "chromaticities",
    [
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.7, 0.2),  # white outside
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.0),  # white without luminance
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.16, 0.065),  # white too blue for any eye to adapt to
        (0.3,) * 8,  # no triangle
        (0.0,) * 8,
        (math.nan,) * 8,
        (math.inf,) * 8,
    ],
)
def test_impossible_chromaticities_are_refused_in_one_line(chromaticities):
    with pytest.raises(ValueError, match=f"^chromaticities {chromaticities[0]:g}, [^\n]*correct them[^\n]*$"):
        colour.rec709_from(chromaticities)


def test_neutral_gains_make_a_colour_grey_and_keep_its_luminance():
    balanced = COLOURS * colour.neutral_gains(COLOURS)
    torch.testing.assert_close(balanced, colour.luminance(COLOURS)[..., None].expand_as(balanced))


def test_ev100_of_camera_is_zero_for_a_second_at_f_1_and_counts_stops():
    assert colour.ev100_of_camera(aperture=1.0, seconds=1.0, iso=100.0) == 0.0
    assert colour.ev100_of_camera(aperture=2.0, seconds=0.25, iso=100.0) == 4.0
    assert colour.ev100_of_camera(aperture=2.0, seconds=0.25, iso=400.0) == 2.0


def test_ev_15_saturates_at_the_luminance_of_the_frostbite_course():
    ev100 = torch.tensor(15.0, dtype=torch.float64)
    torch.testing.assert_close(1.0 / colour.exposure_from_ev100(ev100), torch.tensor(39321.6, dtype=torch.float64))


def test_a_meter_places_mean_luminance_at_one_tenth_of_saturation():
    # K / 100 over 1.2.
    mean = torch.logspace(-3, 9, 13, dtype=torch.float64)
    exposed = mean * colour.exposure_from_ev100(colour.ev100_of_luminance(mean))
    torch.testing.assert_close(exposed, torch.full_like(mean, 0.125 / 1.2))


def test_preview_is_white_where_exposed_above_one_and_black_below_zero():
    radiance = torch.tensor([[8.0, 4.0, 2.0], [1.0, 0.0, -1.0]])
    seen = colour.preview(radiance, torch.tensor(0.5))
    torch.testing.assert_close(seen, torch.tensor([[1.0, 1.0, 1.0], [0.7354, 0.0, 0.0]]), atol=5e-5, rtol=0.0)


def test_srgb_has_the_published_values():
    # Of the usual 8-bit tables; 10 lies on the straight line.
    encoded = torch.tensor([0.0, 10.0, 55.0, 188.0, 255.0], dtype=torch.float64) / 255.0
    linear = torch.tensor([0.0, 0.003035, 0.038204, 0.502886, 1.0], dtype=torch.float64)
    torch.testing.assert_close(colour.srgb_decode(encoded), linear, atol=5e-7, rtol=0.0)
    torch.testing.assert_close(colour.srgb_encode(linear), encoded, atol=5e-6, rtol=0.0)


def test_srgb_is_continuous_at_its_knee():
    knee = torch.tensor([0.0031308, 0.0031308 + 1e-12], dtype=torch.float64)
    below, above = colour.srgb_encode(knee)
    assert abs(above - below) < 3e-8
    assert slope(colour.srgb_encode, knee).tolist() == pytest.approx([12.92, 12.70], abs=0.005)


def test_srgb_has_finite_slope_at_and_below_zero():
    dark = torch.tensor([-1.0, -1e-30, 0.0, 1e-30])
    torch.testing.assert_close(slope(colour.srgb_encode, dark), torch.full((4,), 12.92))
    torch.testing.assert_close(slope(colour.srgb_decode, dark), torch.full((4,), 1.0 / 12.92))


def test_pq_has_the_published_values():
    # Of SMPTE ST 2084: 100, 1000 and 10 000 cd/m^2 are codes 520, 769 and 1023 of 10 bits.
    displayed = torch.tensor([0.01, 1.0, 100.0, 1000.0, 10_000.0], dtype=torch.float64)
    encoded = torch.tensor([0.02149, 0.14995, 0.50808, 0.75183, 1.0], dtype=torch.float64)
    torch.testing.assert_close(colour.pq_encode(displayed), encoded, atol=5e-6, rtol=0.0)
    assert (colour.pq_encode(displayed)[2:] * 1023).round().tolist() == [520.0, 769.0, 1023.0]


def pq_as_printed(displayed):
    """ST 2084, equation 5.2, term by term."""
    power = (displayed / 10_000.0) ** (2610 / 16384)
    return ((3424 / 4096 + 2413 / 128 * power) / (1.0 + 2392 / 128 * power)) ** (2523 / 32)


def test_pq_is_the_printed_formula_down_to_a_millionth_of_a_candela():
    displayed = torch.logspace(-5.9, 4, 1000, dtype=torch.float64)
    torch.testing.assert_close(colour.pq_encode(displayed), pq_as_printed(displayed), rtol=1e-12, atol=0.0)


def test_pq_departs_from_the_printed_formula_by_less_than_half_a_step_of_12_bits():
    displayed = torch.logspace(-30, -5.9, 1000, dtype=torch.float64)
    assert (colour.pq_encode(displayed) - pq_as_printed(displayed)).abs().max() < 0.5 / 4095


def test_pq_has_finite_slope_at_zero_and_is_flat_below():
    dark = torch.tensor([-1.0, -1e-9, 0.0, 1e-9], dtype=torch.float64)
    below, just_below, black, above = slope(colour.pq_encode, dark)
    assert below == just_below == 0.0
    assert black == above
    assert 0.0 < black < 1e3
    assert torch.equal(colour.pq_encode(dark[:3]), torch.zeros(3, dtype=torch.float64))


@pytest.mark.parametrize(
    ("encode", "decode", "linear"),
    [
        (colour.srgb_encode, colour.srgb_decode, torch.logspace(-9, 3, 500)),
        (colour.pq_encode, colour.pq_decode, torch.logspace(-9, 4, 500)),
        (colour.ycocg_from_rgb, colour.rgb_from_ycocg, COLOURS.float()),
    ],
)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 2e-5)])
def test_decoding_undoes_encoding(encode, decode, linear, dtype, tolerance):
    linear = linear.to(dtype)
    torch.testing.assert_close(decode(encode(linear)), linear, rtol=tolerance, atol=tolerance * 1e-9)


@pytest.mark.parametrize("function", [colour.srgb_encode, colour.srgb_decode, colour.pq_encode, colour.pq_decode])
def test_encodings_in_float32_follow_float64(function):
    x = torch.logspace(-9, 0, 1000)
    torch.testing.assert_close(function(x).double(), function(x.double()), rtol=5e-6, atol=0.0)


@pytest.mark.parametrize("function", [colour.srgb_encode, colour.srgb_decode, colour.pq_encode, colour.pq_decode])
def test_gradients_of_encodings_match_finite_differences(function):
    x = torch.tensor([0.001, 0.02, 0.3, 0.9], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, x, check_forward_ad=True, check_batched_grad=True)


def test_ycocg_of_grey_is_its_brightness_alone():
    torch.testing.assert_close(colour.ycocg_from_rgb(torch.full((2, 3), 0.7)), torch.tensor([[0.7, 0.0, 0.0]] * 2))


def test_ycocg_of_the_primaries_is_the_printed_matrix():
    printed = matrix((0.25, 0.5, 0.25), (0.5, 0.0, -0.5), (-0.25, 0.5, -0.25))
    assert torch.equal(colour.ycocg_from_rgb(torch.eye(3, dtype=torch.float64)).T, printed)
