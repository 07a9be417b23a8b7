"""Functions that keep value and gradient at delicate points; each says which, and has a test exactly there."""

import itertools
import math

import torch
from jaxtyping import Float
from torch import Tensor

# Of tanh(h) / h in h². Differences of exponentials over a depth x are their sum times it at h = x / 2: an even series,
# half as long as that of exp() itself, and right on both sides of 0.
_TANH = (1.0, -1.0 / 3.0, 2.0 / 15.0, -17.0 / 315.0, 62.0 / 2835.0, -1382.0 / 155925.0, 21844.0 / 6081075.0,
         -929569.0 / 638512875.0)  # fmt: skip
_NEAR = 1.0 / 8.0  # h below which the series is used: depths below 1/4
_SMALL_TANGENT = 0.2
_FLAT = 1e-11  # rate whose depth is below 1/4 over any length up to 10^10


def mean_decay(depth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Mean of exp(-x) for x from 0 to a depth: (1 - exp(-depth)) / depth, in (0, 1] for depths from 0 up.

    1 - depth/2 near 0, value and gradient; 1/depth far out. Below 0 it grows like exp(-depth).
    A series below 1/4, because autograd of the quotient cancels there, and torch.compile's expm1 loses all digits.

    >>> mean_decay(torch.tensor([0.0, 1e-6, 100.0]))
    tensor([1.0000, 1.0000, 0.0100])
    """
    return decayed_length(torch.ones_like(depth), depth)


def decayed_length(length: Float[Tensor, "*#batch"], rate: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Integral of exp(-rate x) for x from 0 to a length from 0 up: (1 - exp(-length rate)) / rate.

    length - rate length²/2 near rate 0, value and gradient; 1/rate far out. From rate 0 up never more than either, so
    that its derivatives do not overflow, as those of length × mean_decay(length × rate) do for huge lengths.

    >>> decayed_length(torch.tensor([3.0, 3.0, 1e9]), torch.tensor([0.0, 1e-6, 0.01]))
    tensor([  3.0000,   3.0000, 100.0000])
    """
    depth = length * rate
    return decayed_between(torch.zeros_like(depth), depth, length, rate)


def decayed_between(
    start: Float[Tensor, "*#batch"],
    end: Float[Tensor, "*#batch"],
    length: Float[Tensor, "*#batch"],
    rate: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch"]:
    """Integral of exp(-(start + rate x)) for x from 0 to a length, the exponent's end = start + rate length given too.

    Where the ends are nearly equal, exp(-start) × length, value and gradient. One exp() an end: where many lengths
    share a start, half of what exp(-start) × decayed_length takes.

    >>> decayed_between(*torch.tensor([[1.0, 1.0], [1.0, 3.0], [3.0, 2.0], [0.0, 1.0]]))
    tensor([1.1036, 0.3181])
    """
    from_start, from_end = torch.exp(-start), torch.exp(-end)
    half = 0.5 * length * rate
    # Lengths first: no factor is infinite where the product is, and its share of a gradient that is not taken is 0.
    near = 0.5 * length * _tanh_ratio(half) * (from_start + from_end)
    # Of the rate alone, so that lengths that share one share its division.
    inverse = 1.0 / torch.where(rate.abs() < _FLAT, torch.ones_like(rate), rate)
    far = (from_start - from_end) * inverse
    return torch.where(half.abs() < _NEAR, near, far)


def opacity(depth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of light that an optical depth from 0 up takes out of a ray: 1 - exp(-depth), in [0, 1].

    Keeps its digits in thin fog, value and gradient, where the difference rounds to 0 and torch.compile's expm1 to
    noise.

    >>> opacity(torch.tensor([0.0, 1e-9, 100.0]))
    tensor([0.0000e+00, 1.0000e-09, 1.0000e+00])
    """
    # The difference has no pole to hide from the unused branch, and shares its exp() with the transmittance.
    passed, half = torch.exp(-depth), 0.5 * depth
    return torch.where(half < _NEAR, half * (1.0 + passed) * _tanh_ratio(half), 1.0 - passed)


def _tanh_ratio(half: Tensor) -> Tensor:
    """tanh(h) / h for h up to 1/8 to both sides, beyond as there, to the order that value and slope need."""
    near = torch.clamp(half, -_NEAR, _NEAR)
    square = near * near
    # Without divisions, which cost compiled code as much as exp() does.
    *lower, last = _TANH[:4] if half.dtype == torch.float32 else _TANH
    series = torch.full_like(square, last)
    for coefficient in reversed(lower):
        series = series * square + coefficient
    return series


def erfcx(x: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """exp(x²) (1 - erf(x)), 1 at 0 and 1 / (x sqrt(pi)) far out, with its gradient far out too.

    torch's derivative, 2x erfcx(x) - 2 / sqrt(pi), is a difference that loses half of float32's digits at x = 100 and
    all at 4000; from 10 up the asymptotic series has none.

    >>> erfcx(torch.tensor([0.0, 1.0, 1000.0]))
    tensor([1.0000e+00, 4.2758e-01, 5.6419e-04])
    """
    large = x > 10.0
    near = torch.where(large, torch.ones_like(x), x)
    far = torch.where(large, x, torch.full_like(x, 10.0))
    shrink = 0.5 / (far * far)
    series = torch.ones_like(x)
    for odd in range(17, 0, -2):
        series = 1.0 - odd * shrink * series
    exact: Tensor = torch.special.erfcx(near)
    return torch.where(large, series / (math.sqrt(math.pi) * far), exact)


def i0e(x: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """exp(-|x|) I0(x), of the modified Bessel function: 1 at 0 and 1 / sqrt(2 pi |x|) far out, with its gradient there.

    torch's derivative, i1e - i0e, is a difference that loses a digit of float32 at x = 10 and four at 10000; from 30 up
    the asymptotic series has none. At 0 the derivative is 0, which is that of the Bessel function alone.

    >>> i0e(torch.tensor([0.0, 1.0, 1000.0]))
    tensor([1.0000, 0.4658, 0.0126])
    """
    large = x.abs() > 30.0
    near = torch.where(large, torch.ones_like(x), x)
    far = torch.where(large, x, torch.full_like(x, 30.0)).abs()
    series = torch.ones_like(x)
    for order in range(12, 0, -1):
        series = 1.0 + ((2 * order - 1) ** 2 / (8.0 * order)) * series / far
    exact: Tensor = torch.special.i0e(near)
    return torch.where(large, series / torch.sqrt(2.0 * math.pi * far), exact)


def safe_sqrt(square: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Square root of what rounding may have taken below 0: 0 there, with gradient 0 at and below 0.

    >>> safe_sqrt(torch.tensor([-1e-9, 0.0, 4.0]))
    tensor([0., 0., 2.])
    """
    lost = square <= 0.0
    return torch.where(lost, torch.zeros_like(square), torch.sqrt(torch.where(lost, torch.ones_like(square), square)))


def atan_lack(tangent: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """What an angle from 0 to a quarter turn lacks of its tangent x, over the tangent's cube: (x - atan(x)) / x³.

    1/3 - x²/5 near 0, value and gradient, and 1/x² far out. A series below 0.2, because the difference cancels there.

    >>> atan_lack(torch.tensor([0.0, 1.0, 10.0]))
    tensor([0.3333, 0.2146, 0.0085])
    """
    is_near = tangent < _SMALL_TANGENT
    square = torch.where(is_near, tangent, torch.zeros_like(tangent)).square()
    series = torch.zeros_like(square)
    for odd in range(19, 1, -2):
        series = 1.0 / odd - square * series
    far = torch.where(is_near, torch.ones_like(tangent), tangent)
    return torch.where(is_near, series, (1.0 - torch.atan(far) / far) / far.square())


def smooth_rise(distance: Float[Tensor, "*#batch"], width: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Share that rises from 0, at a distance of 0 and below, to 1 at a width and beyond, without a kink: 3x² - 2x³.

    A width of 0 makes it a step, 1 from a distance of 0 on.

    Gradient: 0 at both ends and beyond, and everywhere for a width of 0.

    >>> smooth_rise(torch.tensor([-1.0, 1.0, 2.0, 5.0]), torch.tensor(4.0))
    tensor([0.0000, 0.1562, 0.5000, 1.0000])
    """
    is_step = width <= 0.0
    over = torch.where(is_step, torch.ones_like(width), width)
    # Cut off before it is divided, so that no quotient overflows.
    place = torch.minimum(distance.clamp(min=0.0), over) / over
    return torch.where(is_step, (distance >= 0.0).to(place), place * place * (3.0 - 2.0 * place))


def lookup(
    table: Float[Tensor, "rows columns *channels"], row: Float[Tensor, "*batch"], column: Float[Tensor, "*batch"]
) -> Float[Tensor, "..."]:
    """Bilinear value of a table at fractional indices, of shape (*batch, *channels); outside, the border's value.

    Whole indices give the table's own entries, to the bit; NaN gives NaN.

    Gradient: of the table, exact; of the indices, the slope of the cell they lie in, 0 outside the table.
    By gather and lerp, because grid_sample has no forward-mode derivative.
    """
    rows, columns = table.shape[:2]
    row, column = row.clamp(0.0, rows - 1.0), column.clamp(0.0, columns - 1.0)
    # Clamped once more as whole numbers, because NaN becomes one that lies in no table.
    top = row.detach().floor().long().clamp(0, max(rows - 2, 0))
    left = column.detach().floor().long().clamp(0, max(columns - 2, 0))
    flat = table.flatten(0, 1)
    per_channel = row.shape + (1,) * (table.ndim - 2)
    down = (row - top).reshape(per_channel)
    across = (column - left).reshape(per_channel)
    corner = top * columns + left
    below = min(1, rows - 1) * columns
    beside = min(1, columns - 1)
    upper = torch.lerp(flat[corner], flat[corner + beside], across)
    lower = torch.lerp(flat[corner + below], flat[corner + below + beside], across)
    return torch.lerp(upper, lower, down)


def gauss_legendre(count: int) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Places in [-1, 1] and weights of the rule that is exact up to the power 2 count - 1.

    By G. Golub and J. Welsch, "Calculation of Gauss quadrature rules", Mathematics of Computation 23, 1969. In float64.

    >>> gauss_legendre(2)[0]
    tensor([-0.5774,  0.5774], dtype=torch.float64)
    """
    order = torch.arange(1, count, dtype=torch.float64)
    beside = order / torch.sqrt(4.0 * order * order - 1.0)
    place, vectors = torch.linalg.eigh(torch.diag(beside, 1) + torch.diag(beside, -1))
    return place, 2.0 * vectors[0].square()


def b_splines(place: Float[Tensor, "*batch"], count: int) -> Float[Tensor, "*batch {count}"]:
    """Cubic B-splines of a number of coefficients at places in [0, 1]; outside, those of the nearer end.

    Uniform knots but for the ends, where the first spline and the last are 1 and all others 0. Together they are 1.

    Gradient: exact and continuous inside; 0 outside.

    >>> b_splines(torch.tensor([0.0, 0.5]), 5)
    tensor([[1.0000, 0.0000, 0.0000, 0.0000, 0.0000],
            [0.0000, 0.2500, 0.5000, 0.2500, 0.0000]])
    """
    place, pieces = place.clamp(0.0, 1.0), count - 3
    knots = [min(max(knot, 0), pieces) / pieces for knot in range(-3, pieces + 4)]
    spans = list(itertools.pairwise(knots))
    # The last piece holds its end too.
    found = [((place >= low) & ((place < high) | (high == 1.0))).to(place) * float(low < high) for low, high in spans]
    for degree in (1, 2, 3):
        rising = [_share(place, knots[i], knots[i + degree]) for i in range(len(found))]
        found = [rising[i] * found[i] + (1.0 - rising[i + 1]) * found[i + 1] for i in range(len(found) - 1)]
    return torch.stack(found, -1)


def _share(place: Tensor, low: float, high: float) -> Tensor:
    """How far a place is from one knot to another; nothing where both are one, whose spline is 0."""
    return (place - low) / (high - low) if low < high else torch.zeros_like(place)
