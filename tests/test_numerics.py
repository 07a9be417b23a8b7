import math

import pytest
import torch

from diffrender.numerics import atan_lack, b_splines, decayed_length, erfcx, i0e, lookup, mean_decay, opacity, safe_sqrt

TABLE = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def value(function, x):
    return function(x)


def reverse(function, x):
    x = x.clone().requires_grad_()
    return torch.autograd.grad(function(x).sum(), x)[0]


def forward(function, x):
    return torch.func.jvp(function, (x,), (torch.ones_like(x),))[1]


def batched_forward(function, x):
    def along(tangent):
        return torch.func.jvp(function, (x,), (tangent,))[1]

    return torch.func.vmap(along)(torch.eye(len(x), dtype=x.dtype)).diagonal()


WAYS = [reverse, forward, batched_forward]


def bit_patterns(lowest, highest):
    """Positive float32 numbers, evenly spread over their bit patterns: as many in each octave."""
    first, last = (torch.tensor(v).view(torch.int32).item() for v in (lowest, highest))
    bits = torch.randint(first, last, (20_000,), generator=torch.Generator().manual_seed(0), dtype=torch.int32)
    return bits.view(torch.float32)


def ulps(way, function, x):
    """Errors of float32 against float64, in units of float32's last place."""
    truth = way(function, x.double())
    size = truth.float().abs()
    last_place = torch.nextafter(size, torch.full_like(size, math.inf)) - size
    return (way(function, x).double() - truth).abs() / last_place.double()


def few_bits_lost(errors):
    return torch.log2(1.0 + errors).mean() < 1.0 and errors.quantile(0.99) < 8.0


def exact_mean_decay(x):
    return -torch.expm1(-x) / x


def exact_slope_of_mean_decay(x):
    return sum((-1) ** n * n * x ** (n - 1) / math.factorial(n + 1) for n in range(1, 20))


@pytest.mark.parametrize("way", [value, reverse, forward])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_mean_decay_in_float32_loses_few_bits(way, sign):
    assert few_bits_lost(ulps(way, mean_decay, sign * bit_patterns(1e-30, 80.0)))


def test_mean_decay_in_float64_is_its_definition():
    depth = torch.cat(
        [-torch.logspace(-3, 2, 500, dtype=torch.float64), torch.logspace(-3, 4, 500, dtype=torch.float64)]
    )
    torch.testing.assert_close(mean_decay(depth), exact_mean_decay(depth), rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("way", WAYS)
def test_slope_of_mean_decay_in_float64_is_its_power_series(way):
    depth = torch.tensor(
        [-1.0, -0.25, -1e-12, 0.0, 1e-300, 0.1, 0.25 - 1e-9, 0.25, 0.25 + 1e-9, 1.0], dtype=torch.float64
    )
    torch.testing.assert_close(way(mean_decay, depth), exact_slope_of_mean_decay(depth), rtol=1e-13, atol=0.0)


@pytest.mark.parametrize("way", [value, reverse, forward])
def test_opacity_and_decayed_length_in_float32_lose_few_bits(way):
    assert few_bits_lost(ulps(way, opacity, bit_patterns(1e-30, 80.0)))

    def by_rate(rate):
        return decayed_length(torch.full_like(rate, 3.0), rate)

    assert few_bits_lost(ulps(way, by_rate, bit_patterns(1e-30, 25.0)))


def test_opacity_in_float64_is_its_definition():
    depth = torch.cat([torch.zeros(1), torch.logspace(-20, 3, 500)]).double()
    torch.testing.assert_close(opacity(depth), -torch.expm1(-depth), rtol=1e-14, atol=0.0)
    torch.testing.assert_close(reverse(opacity, depth), torch.exp(-depth), rtol=1e-13, atol=0.0)


def test_decayed_length_is_mean_decay_of_every_length_and_never_overflows():
    rate = torch.cat([torch.zeros(1), torch.logspace(-12, 3, 500)]).double()
    for length in (0.0, 1e-3, 1.0, 1e6):
        wanted = length * mean_decay(length * rate)
        torch.testing.assert_close(decayed_length(torch.full_like(rate, length), rate), wanted, rtol=1e-14, atol=0.0)
    huge = torch.tensor([1e30, 1e38])
    assert torch.equal(decayed_length(huge, torch.ones(2)), torch.ones(2))
    assert torch.equal(reverse(lambda r: decayed_length(huge, r), torch.ones(2)), -torch.ones(2))


@pytest.mark.parametrize("way", [value, reverse, forward])
def test_erfcx_in_float32_keeps_its_digits_and_those_of_its_slope_far_out(way):
    x = bit_patterns(10.1, 1e8)
    assert few_bits_lost(ulps(way, erfcx, x))


@pytest.mark.parametrize("way", WAYS)
def test_slope_of_erfcx_in_float64_is_that_of_its_differential_equation(way):
    x = torch.tensor([0.0, 1.0, 9.9, 10.0, 10.1, 30.0, 200.0], dtype=torch.float64)
    wanted = 2.0 * x * torch.special.erfcx(x) - 2.0 / math.sqrt(math.pi)
    torch.testing.assert_close(way(erfcx, x), wanted, rtol=1e-10, atol=0.0)
    torch.testing.assert_close(erfcx(x), torch.special.erfcx(x), rtol=1e-13, atol=0.0)


@pytest.mark.parametrize("way", WAYS)
def test_i0e_keeps_its_value_and_slope_to_both_sides_of_where_its_series_begins(way):
    x = torch.tensor([-2000.0, -30.1, -3.0, 0.0, 1e-9, 5.0, 29.9, 30.0, 30.1, 60.0], dtype=torch.float64)
    slope = torch.special.i1e(x) - torch.sign(x) * torch.special.i0e(x)
    torch.testing.assert_close(i0e(x), torch.special.i0e(x), rtol=1e-13, atol=0.0)
    torch.testing.assert_close(way(i0e, x), slope, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize("way", [value, reverse, forward])
def test_i0e_in_float32_keeps_its_digits_and_those_of_its_slope_far_out(way):
    x = bit_patterns(30.1, 1e8)
    assert few_bits_lost(ulps(way, i0e, x))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("way", WAYS)
def test_mean_decay_is_level_with_slope_minus_half_at_zero(way, dtype):
    zeros = torch.tensor([0.0, -0.0], dtype=dtype)
    assert torch.equal(mean_decay(zeros), torch.ones_like(zeros))
    assert torch.equal(way(mean_decay, zeros), torch.full_like(zeros, -0.5))


@pytest.mark.parametrize("way", [value, *WAYS])
def test_mean_decay_of_endless_depth_is_zero_and_flat(way):
    depth = torch.tensor([1e30, 3e38, math.inf])
    assert (way(mean_decay, depth).abs() <= 1e-30).all()


def test_mean_decay_mirrored_is_the_same_mean_backwards():
    depth = torch.linspace(0.0, 5.0, 101, dtype=torch.float64)
    torch.testing.assert_close(mean_decay(-depth), torch.exp(depth) * mean_decay(depth), rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("way", WAYS)
def test_safe_sqrt_is_flat_at_and_below_zero(way, dtype):
    square = torch.tensor([-math.inf, -1.0, -1e-30, -0.0, 0.0], dtype=dtype)
    assert torch.equal(safe_sqrt(square), torch.zeros_like(square))
    assert torch.equal(way(safe_sqrt, square), torch.zeros_like(square))


@pytest.mark.parametrize("way", [value, *WAYS])
def test_safe_sqrt_above_zero_is_the_square_root(way):
    square = torch.tensor([1e-300, 1e-9, 1.0, 4.0, 1e300], dtype=torch.float64)
    torch.testing.assert_close(way(safe_sqrt, square), way(torch.sqrt, square), rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("way", [value, reverse, forward])
def test_safe_sqrt_in_float32_loses_few_bits(way):
    assert few_bits_lost(ulps(way, safe_sqrt, bit_patterns(1e-30, 1e30)))


@pytest.mark.parametrize("way", WAYS)
def test_atan_lack_is_its_definition_far_out_and_its_series_near_zero(way):
    near, far = torch.tensor([0.0, 1e-9, 0.05, 0.19999], dtype=torch.float64), torch.tensor([0.2, 1.0, 70.0]).double()
    series = sum((-1) ** k * near ** (2 * k) / (2 * k + 3) for k in range(20))
    torch.testing.assert_close(atan_lack(near), series, rtol=1e-13, atol=0.0)
    torch.testing.assert_close(atan_lack(far), (far - torch.atan(far)) / far**3, rtol=1e-13, atol=0.0)
    slopes = sum((-1) ** k * 2 * k * near ** (2 * k - 1) / (2 * k + 3) for k in range(1, 20))
    torch.testing.assert_close(way(atan_lack, near), slopes, rtol=1e-10, atol=0.0)
    x = torch.tensor([1e-20, 0.1, 0.199, 0.201, 3.0, 1e4])
    torch.testing.assert_close(way(atan_lack, x).double(), way(atan_lack, x.double()), rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("function", [mean_decay, safe_sqrt, atan_lack])
def test_not_a_number_stays_one(function):
    assert function(torch.tensor(math.nan)).isnan()


@pytest.mark.parametrize("function", [mean_decay, safe_sqrt, atan_lack])
def test_gradients_match_finite_differences(function):
    x = torch.tensor([0.01, 0.19, 0.3, 3.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, x, check_forward_ad=True, check_batched_grad=True)


def test_lookup_is_exact_on_bilinear_functions():
    def bilinear(row, column):
        return 3.0 - 2.0 * row + 0.5 * column + 0.25 * row * column

    rows, columns = torch.meshgrid(torch.arange(4.0), torch.arange(5.0), indexing="ij")
    places = torch.rand(2, 100, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    row, column = 3.0 * places[0], 4.0 * places[1]
    found = lookup(bilinear(rows, columns).double(), row, column)
    torch.testing.assert_close(found, bilinear(row, column), rtol=1e-14, atol=1e-14)


def test_lookup_at_whole_indices_gives_the_entries_themselves():
    rows, columns = torch.meshgrid(torch.arange(4.0), torch.arange(5.0), indexing="ij")
    assert torch.equal(lookup(TABLE.float(), rows, columns), TABLE.float())


@pytest.mark.parametrize(("row", "column", "entry"), [(-7.0, 2.0, (0, 2)), (9.0, 1e30, (3, 4)), (3.0, -0.1, (3, 0))])
def test_lookup_outside_gives_the_border(row, column, entry):
    found = lookup(TABLE, *torch.tensor([row, column], dtype=torch.float64))
    assert torch.equal(found, TABLE[entry])


def slopes(row, column):
    place = torch.tensor([row, column], dtype=torch.float64)
    return torch.func.jacfwd(lambda p: lookup(TABLE, p[0], p[1]))(place).unbind(-1)


def test_lookup_outside_has_no_slope():
    down, across = slopes(3.01, -0.01)
    assert torch.equal(down, torch.zeros(3, dtype=torch.float64))
    assert torch.equal(across, torch.zeros(3, dtype=torch.float64))


def test_slope_of_lookup_on_a_line_is_that_of_the_cell_after_and_on_the_last_of_the_one_before():
    down, across = slopes(1.0, 4.0)
    torch.testing.assert_close(down, TABLE[2, 4] - TABLE[1, 4])
    torch.testing.assert_close(across, TABLE[1, 4] - TABLE[1, 3])


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1)])
def test_lookup_in_a_table_of_one_row_or_column_varies_along_the_other_only(shape):
    table = TABLE[: shape[0], : shape[1], 0]
    found = lookup(table, torch.tensor([0.0, 0.5]).double(), torch.tensor([0.5, 0.0]).double())
    wanted = [table[0, : min(2, shape[1])].mean(), table[: min(2, shape[0]), 0].mean()]
    torch.testing.assert_close(found, torch.stack(wanted))


def test_lookup_keeps_the_shapes_of_indices_and_channels():
    assert lookup(TABLE, torch.zeros(2, 6).double(), torch.zeros(2, 6).double()).shape == (2, 6, 3)
    assert lookup(TABLE[..., 0], torch.zeros(()).double(), torch.zeros(()).double()).shape == ()


def test_lookup_of_not_a_number_is_one():
    nowhere = torch.tensor([math.nan, 1.0], dtype=torch.float64)
    assert lookup(TABLE, nowhere, nowhere.flip(0)).isnan().all()


def test_gradients_of_lookup_match_finite_differences_in_table_and_indices():
    row, column = torch.tensor([[0.3, 2.9, 3.2], [3.1, 0.4, 4.6]], dtype=torch.float64).unbind(0)
    inputs = (TABLE.clone().requires_grad_(), row.clone().requires_grad_(), column.clone().requires_grad_())
    assert torch.autograd.gradcheck(lookup, inputs, check_forward_ad=True, check_batched_grad=True)


def test_lookup_works_under_vmap_of_jvp():
    row, column = torch.tensor([0.3, 1.7]).double(), torch.tensor([2.2, 3.9]).double()

    def along(tangent):
        return torch.func.jvp(lambda r, c: lookup(TABLE, r, c), (row, column), (tangent, tangent))[1]

    both = torch.func.vmap(along)(torch.eye(2, dtype=torch.float64))
    assert torch.equal(both[0, 1], torch.zeros(3, dtype=torch.float64))
    torch.testing.assert_close(both.sum(0), along(torch.ones(2, dtype=torch.float64)))


# b_splines


@pytest.mark.parametrize("count", [4, 5, 7, 12])
def test_b_splines_are_positive_and_one_together_and_each_end_has_its_own(count):
    place = torch.linspace(0.0, 1.0, 97, dtype=torch.float64)
    found = b_splines(place, count)
    assert (found >= 0.0).all()
    torch.testing.assert_close(found.sum(-1), torch.ones_like(place), rtol=1e-14, atol=0.0)
    assert torch.equal(found[0], torch.eye(count, dtype=torch.float64)[0])
    assert torch.equal(found[-1], torch.eye(count, dtype=torch.float64)[-1])
    assert torch.equal(b_splines(torch.tensor([-3.0, 7.0]), count), b_splines(torch.tensor([0.0, 1.0]), count))


def test_four_b_splines_are_bernsteins_polynomials():
    place = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)
    wanted = [math.comb(3, i) * place**i * (1.0 - place) ** (3 - i) for i in range(4)]
    torch.testing.assert_close(b_splines(place, 4), torch.stack(wanted, -1))


@pytest.mark.parametrize("way", WAYS)
def test_b_splines_draw_straight_lines_whose_slope_is_one_at_every_knot_and_both_ends(way):
    knots = torch.tensor([0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.0], dtype=torch.float64)
    means = knots.unfold(0, 3, 1).mean(-1)  # of the three knots inside each spline
    place = torch.tensor([0.0, 1e-12, 0.25, 0.25 + 1e-12, 0.5, 0.6, 0.75, 1.0 - 1e-12, 1.0], dtype=torch.float64)
    torch.testing.assert_close(b_splines(place, 7) @ means, place, rtol=1e-14, atol=1e-16)
    torch.testing.assert_close(way(lambda at: b_splines(at, 7) @ means, place), torch.ones_like(place))
