"""Functions that keep value and gradient at delicate points; each says which, and has a test exactly there."""

import math

import torch
from jaxtyping import Float
from torch import Tensor


def mean_decay(depth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Mean of exp(-x) for x from 0 to a depth: (1 - exp(-depth)) / depth, in (0, 1] for depths from 0 up.

    1 - depth/2 near 0, value and gradient; 1/depth far out. Below 0 it grows like exp(-depth).
    A series below 1/4, because autograd of the quotient cancels there, and torch.compile's expm1 loses all digits.

    >>> mean_decay(torch.tensor([0.0, 1e-6, 100.0]))
    tensor([1.0000, 1.0000, 0.0100])
    """
    small = depth.abs() < 0.25
    near = torch.where(small, depth, torch.zeros_like(depth))
    far = torch.where(small, torch.ones_like(depth), depth)
    return torch.where(small, _mean_decay_near(near), (1.0 - torch.exp(-far)) / far)


def _mean_decay_near(depth: Tensor) -> Tensor:
    """Power series of `mean_decay` up to 1/4, to the order that value and slope need in the given precision."""
    # Without divisions, which cost compiled code as much as exp() does.
    last = 7 if depth.dtype == torch.float32 else 11
    series = torch.full_like(depth, 1.0 / math.factorial(last))
    for order in range(last - 1, 0, -1):
        series = series * depth + (-1.0) ** (order - 1) / math.factorial(order)
    return series


def decayed_length(length: Float[Tensor, "*#batch"], rate: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Integral of exp(-rate x) for x from 0 to a length, both from 0 up: (1 - exp(-length rate)) / rate.

    length - rate length²/2 near rate 0, value and gradient; 1/rate far out. Never more than either, so that its
    derivatives do not overflow, as those of length × mean_decay(length × rate) do for huge lengths.

    >>> decayed_length(torch.tensor([3.0, 3.0, 1e9]), torch.tensor([0.0, 1e-6, 0.01]))
    tensor([  3.0000,   3.0000, 100.0000])
    """
    depth = length * rate
    small = depth < 0.25
    near = torch.where(small, depth, torch.zeros_like(depth))
    far = torch.where(small, torch.ones_like(rate), rate)
    return torch.where(small, length * _mean_decay_near(near), (1.0 - torch.exp(-depth)) / far)


def opacity(depth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Share of light that an optical depth from 0 up takes out of a ray: 1 - exp(-depth), in [0, 1].

    Keeps its digits in thin fog, value and gradient, where the difference rounds to 0 and torch.compile's expm1 to
    noise.

    >>> opacity(torch.tensor([0.0, 1e-9, 100.0]))
    tensor([0.0000e+00, 1.0000e-09, 1.0000e+00])
    """
    near = torch.clamp(depth, max=0.25)
    # The difference has no pole to hide from the unused branch, and shares its exp() with the transmittance.
    return torch.where(depth < 0.25, near * _mean_decay_near(near), 1.0 - torch.exp(-depth))


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


def safe_sqrt(square: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Square root of what rounding may have taken below 0: 0 there, with gradient 0 at and below 0.

    >>> safe_sqrt(torch.tensor([-1e-9, 0.0, 4.0]))
    tensor([0., 0., 2.])
    """
    lost = square <= 0.0
    return torch.where(lost, torch.zeros_like(square), torch.sqrt(torch.where(lost, torch.ones_like(square), square)))


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
