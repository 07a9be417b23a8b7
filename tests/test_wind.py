import math

import pytest
import torch

from diffrender.weather.drawn_curve import DrawnCurve
from diffrender.weather.wind import Wave, displacement, velocity

FLOAT = torch.float64


def number(value):
    return torch.tensor(float(value), dtype=FLOAT)


def wave(values=(0.0, 1.0, 0.4, 0.0), azimuth=0.6, strength=6.0, wavelength=40.0, period=8.0):
    places = torch.arange(len(values), dtype=FLOAT) / len(values)
    towards = torch.tensor([math.cos(azimuth), math.sin(azimuth), 0.0], dtype=FLOAT)
    curve = DrawnCurve(places, torch.tensor(values, dtype=FLOAT))
    return Wave(curve, towards, number(strength), number(wavelength), number(period))


GUSTS = [wave(), wave((0.2, 0.5, 0.1), azimuth=0.9, strength=2.0, wavelength=13.0, period=2.7)]
STEADY = wave((1.0,), strength=3.0)
PLACES = 50.0 * torch.randn(20, 3, generator=torch.Generator().manual_seed(0), dtype=FLOAT)
TIMES = torch.linspace(-20.0, 60.0, 20, dtype=FLOAT)


def test_without_waves_there_is_no_wind():
    for function in (velocity, displacement):
        assert torch.equal(function([], PLACES, TIMES), torch.zeros_like(PLACES))


def test_a_wave_travels_a_wavelength_in_a_period():
    (one, _), later = GUSTS, 3.3
    moved = PLACES + one.towards * (one.wavelength / one.period * later)
    torch.testing.assert_close(velocity([one], moved, TIMES + later), velocity([one], PLACES, TIMES))
    beside = PLACES + torch.tensor([-one.towards[1], one.towards[0], 7.0], dtype=FLOAT)
    torch.testing.assert_close(velocity([one], beside, TIMES), velocity([one], PLACES, TIMES))


def test_waves_add_up():
    wanted = sum(velocity([one], PLACES, TIMES) for one in GUSTS)
    torch.testing.assert_close(velocity(GUSTS, PLACES, TIMES), wanted)


def test_one_keyframe_is_a_steady_wind():
    torch.testing.assert_close(velocity([STEADY], PLACES, TIMES), (3.0 * STEADY.towards).expand(20, 3))
    wanted = 3.0 * STEADY.towards * TIMES[:, None]
    torch.testing.assert_close(displacement([STEADY], PLACES, TIMES), wanted, rtol=1e-12, atol=1e-12)


def test_a_wave_of_infinite_length_is_everywhere_at_once():
    found = velocity([wave(wavelength=math.inf)], PLACES, number(2.0))
    torch.testing.assert_close(found, found[:1].expand(20, 3), rtol=0.0, atol=0.0)
    assert float(found.norm()) > 0.0


def test_displacement_is_the_integral_of_the_wind():
    found = torch.func.vmap(torch.func.jacfwd(lambda time, place: displacement(GUSTS, place, time)))(TIMES, PLACES)
    torch.testing.assert_close(found, velocity(GUSTS, PLACES, TIMES), rtol=1e-12, atol=1e-12)
    assert torch.equal(displacement(GUSTS, PLACES, number(0.0)), torch.zeros_like(PLACES))
    steps = (torch.arange(4000, dtype=FLOAT)[:, None] + 0.5) * (30.0 / 4000)
    summed = velocity(GUSTS, PLACES[:1].expand(4000, 3), steps[:, 0]).mean(0) * 30.0
    torch.testing.assert_close(displacement(GUSTS, PLACES[0], number(30.0)), summed, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("function", [velocity, displacement])
def test_gradients_match_finite_differences(function):
    one = wave()

    def blow(values, *given):
        strength, wavelength, period, place, time = given
        return function(
            [Wave(DrawnCurve(one.curve.places, values), one.towards, strength, wavelength, period)], place, time
        )

    given = (one.curve.values, one.strength, one.wavelength, one.period, PLACES[:2], TIMES[:2])
    leaves = [part.clone().requires_grad_() for part in given]
    # The drawn calm has a corner in its keyframes' values: a rise beside it may become a fall.
    leaves[0] = torch.tensor([0.1, 1.0, 0.4, -0.3], dtype=FLOAT, requires_grad=True)
    assert torch.autograd.gradcheck(blow, leaves, check_forward_ad=True, check_batched_grad=True)


def test_float32_follows_for_a_day():
    single = [
        Wave(
            DrawnCurve(one.curve.places.float(), one.curve.values.float()),
            *(part.float() for part in (one.towards, one.strength, one.wavelength, one.period)),
        )
        for one in GUSTS
    ]
    times = torch.linspace(0.0, 86_400.0, 20)
    found, wanted = (
        displacement(single, PLACES.float(), times),
        displacement(GUSTS, PLACES.float().double(), times.double()),
    )
    torch.testing.assert_close(found.double(), wanted, rtol=1e-5, atol=0.1)
