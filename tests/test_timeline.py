import math

import numpy as np
import pytest
import torch
from scipy.interpolate import PchipInterpolator

from diffrender.parameters import Specification
from diffrender.weather.timeline import DAY, between

LINEAR = Specification(0.0, bounds=(-1e6, 1e6), unit="1", about="")
LOG = Specification(1.0, bounds=(1e-12, 1e12), unit="1", about="", scale="log")
CIRCLE = Specification(0.0, bounds=(-math.pi, math.pi), unit="rad", about="")
KNOWN = {"linear": LINEAR, "log": LOG, "circle": CIRCLE}
HOURS = torch.tensor([1.0, 6.5, 7.0, 12.0, 18.25, 23.0], dtype=torch.float64)


def day(seed, known, keyframes=6):
    """Hours and values of keyframes, and hours all over the day."""
    generator = np.random.default_rng(seed)
    hours = np.sort(generator.choice(np.arange(1, 960), keyframes, replace=False)) / 40.0
    values = {
        "log": np.exp(generator.uniform(-9.0, 9.0, keyframes)),
        "linear": generator.normal(size=keyframes),
    }[known.scale]
    if known.turn is not None:
        values = generator.uniform(-math.pi, math.pi, keyframes)
    return torch.tensor(hours), torch.tensor(values), torch.tensor(generator.uniform(-24.0, 48.0, 200))


def scipys(hours, scaled, turn, hour):
    """The same by scipy, over three days."""
    hours, scaled = np.asarray(hours), np.asarray(scaled)
    times = np.concatenate([hours + days * DAY for days in (-1, 0, 1)])
    values = np.concatenate([scaled + days * turn for days in (-1, 0, 1)])
    return PchipInterpolator(times, values)(np.asarray(hour) % DAY)


@pytest.mark.parametrize("keyframes", [2, 3, 6, 40])
@pytest.mark.parametrize("seed", range(3))
def test_the_curve_is_that_of_scipy(seed, keyframes):
    hours, values, hour = day(seed, LINEAR, keyframes)
    assert np.allclose(between(hours, values, hour, LINEAR), scipys(hours, values, 0.0, hour), rtol=0, atol=1e-12)
    hours, values, hour = day(seed, LOG, keyframes)
    expected = np.exp(scipys(hours, values.log(), 0.0, hour))
    assert np.allclose(between(hours, values, hour, LOG), expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("seed", range(3))
def test_a_circle_is_gone_round_the_shorter_way(seed):
    hours, values, hour = day(seed, CIRCLE)
    closed = np.unwrap([*values, values[0]])
    expected = scipys(hours, closed[:-1], closed[-1] - closed[0], hour)
    found = between(hours, values, hour, CIRCLE)
    assert np.allclose(np.cos(found.numpy() - expected), 1.0, rtol=0, atol=1e-12)
    assert float(found.abs().max()) <= math.pi


def test_steps_and_plateaus_are_those_of_scipy():
    values = torch.tensor([2.0, 2.0, 5.0, 5.0, 1.0, 1.5], dtype=torch.float64)
    hour = torch.linspace(0.0, 24.0, 481, dtype=torch.float64)
    found = between(HOURS, values, hour, LINEAR)
    assert np.allclose(found, scipys(HOURS, values, 0.0, hour), rtol=0, atol=1e-12)
    assert torch.equal(found[20:130], torch.full_like(found[20:130], 2.0))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", KNOWN)
def test_a_keyframe_holds_bit_for_bit_at_its_hour(kind, dtype):
    for seed in range(20):
        hours, values, _ = (tensor.to(dtype) for tensor in day(seed, KNOWN[kind]))
        assert torch.equal(between(hours, values, hours, KNOWN[kind]), values)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", ["linear", "log"])
def test_a_value_lies_between_its_keyframes(kind, dtype):
    part = torch.tensor([0.0, 1e-7, 0.01, 0.3, 0.4999, 0.5, 0.5001, 0.9, 1.0 - 1e-7, 1.0], dtype=dtype)
    for seed in range(20):
        hours, values, _ = (tensor.to(dtype) for tensor in day(seed, KNOWN[kind]))
        # Neighbours as near as two numbers can be.
        values[1] = torch.nextafter(values[0], values[0] + 1.0)
        found = between(hours, values, torch.lerp(hours[:-1, None], hours[1:, None], part), KNOWN[kind])
        low, high = torch.minimum(values[:-1], values[1:]), torch.maximum(values[:-1], values[1:])
        assert bool(((found >= low[:, None]) & (found <= high[:, None])).all())


@pytest.mark.parametrize("kind", KNOWN)
def test_a_single_keyframe_holds_all_day(kind):
    found = between(HOURS[2:3], torch.tensor([0.3], dtype=torch.float64), torch.linspace(-5.0, 30.0, 36), KNOWN[kind])
    assert torch.equal(found, torch.full_like(found, 0.3))


@pytest.mark.parametrize("kind", KNOWN)
def test_the_day_is_cyclic(kind):
    hours, values, _ = day(0, KNOWN[kind])
    hour = torch.arange(0.0, 24.0, 0.125, dtype=torch.float64)  # whole in binary, so that days are added exactly
    assert torch.equal(between(hours, values, hour, KNOWN[kind]), between(hours, values, hour - 48.0, KNOWN[kind]))


@pytest.mark.parametrize("kind", KNOWN)
def test_derivatives_by_keyframes_and_hour_are_those_of_differences(kind):
    hours, values, hour = day(3, KNOWN[kind])
    hour = torch.cat([hour[:4], hours[2:3] + 1e-3])

    def curve(values, hour):
        return between(hours, values, hour, KNOWN[kind])

    given = (values.requires_grad_(), hour.requires_grad_())
    assert torch.autograd.gradcheck(curve, given, check_forward_ad=True, check_batched_grad=True)


def test_channels_are_curves_of_their_own():
    values = torch.rand(6, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    hour = torch.linspace(0.0, 24.0, 10, dtype=torch.float64).reshape(2, 5)
    found = between(HOURS, values, hour, LINEAR)
    alone = [between(HOURS, channel, hour, LINEAR) for channel in values.unbind(-1)]
    assert torch.equal(found, torch.stack(alone, -1))


def test_parameters_and_hours_can_be_mapped_over():
    values = torch.rand(4, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    hour = torch.linspace(0.0, 24.0, 4, dtype=torch.float64)
    found = torch.func.vmap(lambda row, time: between(HOURS, row, time, LINEAR))(values, hour)
    alone = [between(HOURS, row, time, LINEAR) for row, time in zip(values, hour, strict=True)]
    assert torch.equal(found, torch.stack(alone))


FLAT = {
    "all equal": [1.0] * 6,
    "equal neighbours": [1.0, 1.0, 2.0, 2.0, 2.0, 1.0],
    "nearly equal": [1.0, 1.0 + 2e-16, 1.0 + 4e-16, 1.0 + 6e-16, 1.0, 1.0],
    "subnormal": [5e-324, 1e-323, 1e-310, 1e-300, 1e-160, 1e-150],
}


@pytest.mark.parametrize("values", FLAT.values(), ids=FLAT)
@pytest.mark.parametrize("kind", KNOWN)
def test_gradients_are_finite_where_slopes_vanish(kind, values):
    if kind == "log" and values[0] < 1.0:
        values = [1e-12 * (1.0 + value) for value in values]
    keyframes = torch.tensor(values, dtype=torch.float64)
    hour = torch.cat([HOURS, torch.linspace(0.0, 24.0, 33, dtype=torch.float64)])

    def curve(keyframes, hour):
        return between(HOURS, keyframes, hour, KNOWN[kind])

    by_values, by_hour = torch.func.jacrev(curve, (0, 1))(keyframes, hour)
    assert bool(by_values.isfinite().all())
    assert bool(by_hour.isfinite().all())
    # Adding the same to all keyframes adds it to the curve; multiplying them multiplies a log parameter's.
    moved = by_values @ keyframes if kind == "log" else by_values.sum(-1)
    assert np.allclose(moved, curve(keyframes, hour) if kind == "log" else 1.0, rtol=1e-9, atol=0)


def test_a_constant_day_feels_each_keyframe():
    # A fit starts there: keyframes that the curve did not feel would never move.
    flat = torch.ones(6, dtype=torch.float64)
    by_values = torch.func.jacrev(lambda values: between(HOURS, values, HOURS + 0.2, LINEAR))(flat)
    after = torch.roll(HOURS, -1) - HOURS
    place = 0.2 / torch.where(after < 0, after + DAY, after)
    smooth = place**2 * (3.0 - 2.0 * place)
    assert np.allclose(by_values.diagonal(), 1.0 - smooth, rtol=1e-12)
    assert np.allclose(torch.roll(by_values, -1, 1).diagonal(), smooth, rtol=1e-9)


def test_keyframes_at_the_ends_of_their_bounds_stay_finite_in_float32():
    hours = torch.tensor([0.0, 1e-6, 12.0, 23.9999])
    values = torch.tensor([1e-12, 1e12, 1e-12, 1e12])
    hour = torch.cat([hours, hours + 5e-7, torch.linspace(0.0, 24.0, 49)])
    by_values, by_hour = torch.func.jacfwd(lambda v, h: between(hours, v, h, LOG), (0, 1))(values, hour)
    assert bool(by_values.isfinite().all())
    assert bool(by_hour.isfinite().all())
    assert bool((between(hours, values, hour, LOG) >= 1e-12).all())
