import itertools
import math

import pytest
import torch

from diffrender.atmosphere.sky import Sky
from diffrender.numerics import smooth_rise
from diffrender.parameters import Specification, defaults, from_cube, specifications
from diffrender.weather.entities import Area, Sequence, Transition, share_after, share_at, share_during
from diffrender.weather.mixing import Carried, blend, mixed
from diffrender.weather.own_scale import mean

KNOWN = {
    "fog": Specification(1.0, bounds=(1e-6, 1.0), unit="1/m", about="", scale="log"),
    "rain": Specification(0.0, bounds=(0.0, 100.0), unit="1", about=""),
    "wind": Specification(0.0, bounds=(-math.pi, math.pi), unit="rad", about=""),
    "tint": Specification((0.5, 0.5, 0.5), bounds=(0.0, 1.0), unit="1", about=""),
}


def number(value):
    return torch.tensor(value, dtype=torch.float64)


def weather(fog, rain, wind, tint):
    return {"fog": number(fog), "rain": number(rain), "wind": number(wind), "tint": number(tint)}


CLEAR = weather(1e-4, 0.0, 3.0, (0.1, 0.2, 0.3))
STORM = weather(1e-2, 50.0, -3.0, (0.7, 0.2, 0.1))
FROST = weather(1e-1, 7.0, 0.5, (0.9, 0.9, 1.0))


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    assert all(torch.equal(found[name], expected[name]) for name in expected)


def assert_close(found, expected):
    assert found.keys() == expected.keys()
    assert all(torch.allclose(found[name], expected[name], rtol=1e-12, atol=1e-14) for name in expected)


# Two weathers


def test_a_blend_begins_and_ends_with_its_weathers_bit_for_bit():
    assert_same(blend(CLEAR, STORM, number(0.0), KNOWN), CLEAR)
    assert_same(blend(CLEAR, STORM, number(1.0), KNOWN), STORM)
    assert_same(blend(CLEAR, CLEAR, number(0.3), KNOWN), CLEAR)


def test_halfway_lies_the_mean_in_each_parameter_s_own_scale():
    found = blend(CLEAR, STORM, number(0.5), KNOWN)
    assert_close(found, weather(1e-3, 25.0, math.pi, (0.4, 0.2, 0.2)))  # the wind turns over the back


def test_a_blend_backwards_is_the_same():
    assert_close(blend(CLEAR, STORM, number(0.2), KNOWN), blend(STORM, CLEAR, number(0.8), KNOWN))


def test_records_are_blended_as_weathers_are():
    hazy, clear = (from_cube(Sky, torch.full((15,), place, dtype=torch.float64)) for place in (0.2, 0.6))
    found = Sky(**blend(vars(hazy), vars(clear), number(0.25), specifications(Sky)))
    expected = from_cube(Sky, torch.full((15,), 0.3, dtype=torch.float64))
    assert all(torch.allclose(getattr(found, name), getattr(expected, name)) for name in specifications(Sky))
    assert vars(defaults(Sky)).keys() == specifications(Sky).keys()


def test_weathers_of_different_names_are_not_blended():
    with pytest.raises(ValueError, match="fog, wind: only one of two weathers has it; give both the same names"):
        blend({"rain": number(1.0), "wind": number(0.0)}, {"rain": number(2.0), "fog": number(1.0)}, number(0.5), KNOWN)


def test_derivatives_of_a_blend_are_those_of_differences():
    names = ("fog", "rain", "wind")

    def changed(share, *values):
        first, second = (dict(zip(names, some, strict=True)) for some in (values[:3], values[3:]))
        return tuple(blend(first, second, share, KNOWN).values())

    for share in (0.0, 0.3, 0.8, 1.0):
        values = [weather[name].clone().requires_grad_() for weather in (CLEAR, STORM) for name in names]
        given = (number(share).requires_grad_(), *values)
        assert torch.autograd.gradcheck(changed, given, check_forward_ad=True, check_batched_grad=True)


def test_a_transition_comes_and_goes_smoothly():
    change = Transition(number(10.0), number(4.0))
    time = torch.tensor([9.0, 10.0, 11.0, 12.0, 14.0, 20.0], dtype=torch.float64, requires_grad=True)
    share = share_after(change, time)
    assert torch.allclose(share, number([0.0, 0.0, 0.15625, 0.5, 1.0, 1.0]))
    (speed,) = torch.autograd.grad(share.sum(), time)
    assert torch.allclose(speed, number([0.0, 0.0, 0.28125, 0.375, 0.0, 0.0]))


# Areas and sequences


def test_an_area_fades_with_the_distance_from_its_box_alike_on_all_sides():
    box = Area(number([0.0, 0.0, 0.0]), number([4.0, 2.0, 1.0]), number(10.0))
    centre, half = number([2.0, 1.0, 0.5]), number([2.0, 1.0, 0.5])
    directions = number(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))[:13])  # half of them; the rest mirrored
    for direction in (*directions, *-directions):
        for distance, expected in ((0.0, 1.0), (2.5, 0.84375), (5.0, 0.5), (10.0, 0.0), (99.0, 0.0)):
            position = centre + direction.sign() * half + distance * direction / direction.norm()
            assert share_at(box, position) == pytest.approx(expected, abs=1e-14)
    assert share_at(box, centre) == 1.0


def test_gradients_of_an_area_are_finite_everywhere():
    box = Area(*(number(corner).requires_grad_() for corner in ([0.0] * 3, [1.0] * 3)), number(2.0).requires_grad_())
    position = number([[0.5] * 3, [0.0] * 3, [1.0, 0.5, 0.5], [2.0, 0.5, 0.5], [3.0, 0.5, 0.5], [1.5] * 3, [9.0] * 3])
    share = share_at(box, position.requires_grad_())
    gradients = torch.autograd.grad(share.sum(), (position, box.lowest, box.highest, box.fade))
    assert all(bool(gradient.isfinite().all()) for gradient in gradients)
    assert torch.equal(gradients[0].any(-1), torch.tensor([False, False, False, True, False, True, False]))
    outside = position[[3, 5]].detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda there: share_at(box, there), outside, check_forward_ad=True)


def test_an_area_without_fade_ends_at_its_faces():
    box = Area(number([0.0] * 3), number([1.0] * 3), number(0.0).requires_grad_())
    share = share_at(box, number([[0.5] * 3, [1.0] * 3, [1.0 + 1e-12, 0.5, 0.5]]))
    assert share.tolist() == [1.0, 1.0, 0.0]
    assert torch.autograd.grad(share.sum(), box.fade)[0] == 0.0


def test_a_sequence_fades_inside_its_time():
    scene = Sequence(*map(number, (10.0, 20.0, 2.0, 4.0)))
    time = number([9.9, 10.0, 11.0, 12.0, 15.0, 16.0, 18.0, 20.0, 20.1])
    assert torch.allclose(share_during(scene, time), number([0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0]))


def test_cuts_between_sequences_leave_no_moment_and_double_none():
    first = Sequence(*map(number, (0.0, 5.0, 0.0, 0.0)))
    second = Sequence(*map(number, (5.0, 9.0, 0.0, 0.0)))
    time = number([-0.1, 0.0, 4.9, 5.0, 8.9, 9.0])
    assert share_during(first, time).tolist() == [0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert share_during(second, time).tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 0.0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_smooth_rise_stays_finite_for_any_width(dtype):
    limits = torch.finfo(dtype)
    ends = torch.tensor([limits.min, -1.0, 0.0, limits.tiny, 1.0, limits.max], dtype=dtype)
    distance, width = (tensor.clone().requires_grad_() for tensor in torch.meshgrid(ends, ends[2:], indexing="ij"))
    share = smooth_rise(distance, width)
    assert bool(((share >= 0.0) & (share <= 1.0)).all())
    assert all(bool(gradient.isfinite().all()) for gradient in torch.autograd.grad(share.sum(), (distance, width)))


# Several at once


def layer(values, share, priority=0):
    return Carried(values, number(share), priority)


def test_what_no_one_carries_stays():
    assert_same(mixed(CLEAR, [], KNOWN), CLEAR)
    found = mixed(CLEAR, [layer({"rain": number(9.0)}, 1.0)], KNOWN)
    assert_same(found, CLEAR | {"rain": number(9.0)})


def test_one_carried_weather_is_a_blend():
    for share in (0.0, 0.3, 0.7, 1.0):
        assert_same(mixed(CLEAR, [layer(STORM, share)], KNOWN), blend(CLEAR, STORM, number(share), KNOWN))


def test_a_higher_priority_covers_a_lower_one_by_its_share_in_any_order():
    below, above = layer(STORM, 0.6, 1), layer(FROST, 0.25, 2)
    expected = blend(blend(CLEAR, STORM, number(0.6), KNOWN), FROST, number(0.25), KNOWN)
    assert_same(mixed(CLEAR, [below, above], KNOWN), expected)
    assert_same(mixed(CLEAR, [above, below], KNOWN), expected)
    assert_same(mixed(CLEAR, [below, layer(FROST, 1.0, 2)], KNOWN), FROST)


def test_equal_priorities_share_and_what_is_below_has_the_rest():
    rain = [{"rain": number(value)} for value in (10.0, 20.0, 40.0)]
    for first, second, expected in ((0.2, 0.3, 21.0), (0.5, 0.5, 30.0), (1.0, 1.0, 30.0), (1.0, 0.25, 24.0)):
        layers = [layer(rain[1], first), layer(rain[2], second)]
        for some in (layers, layers[::-1]):
            assert float(mixed(rain[0], some, KNOWN)["rain"]) == pytest.approx(expected, rel=1e-14)


def test_a_weather_that_has_gone_changes_nothing():
    # Else it would jump when the next area comes into reach.
    some = [layer(STORM, 0.4), layer(FROST, 0.8, 3)]
    assert_same(mixed(CLEAR, [*some, layer(FROST, 0.0), layer(STORM, 0.0, 9)], KNOWN), mixed(CLEAR, some, KNOWN))


def test_a_weather_cannot_come_from_nothing():
    with pytest.raises(ValueError, match="fog is carried over a weather that lacks it; give the base a value"):
        mixed({"rain": number(1.0)}, [layer(STORM, 0.5)], KNOWN)


def test_derivatives_of_a_mixture_are_those_of_differences():
    def rain_and_fog(base, first, second, share, higher):
        layers = [Carried({"rain": first, "fog": first}, share, 0), Carried({"rain": second}, number(0.4), 0)]
        top = Carried({"fog": second}, higher, 1)
        return tuple(mixed({"rain": base, "fog": base}, [*layers, top], KNOWN).values())

    for share in (0.1, 0.9):
        given = [number(value).requires_grad_() for value in (0.3, 0.02, 0.7, share, 0.25)]
        assert torch.autograd.gradcheck(rain_and_fog, given, check_forward_ad=True, check_batched_grad=True)


def test_many_places_are_mixed_at_once():
    area = Area(number([0.0] * 3), number([1.0] * 3), number(2.0))
    positions = torch.rand(5, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 4.0

    def there(position):
        return mixed(CLEAR, [Carried(STORM, share_at(area, position), 0)], KNOWN)

    every = torch.func.vmap(there)(positions)
    for index, position in enumerate(positions):
        assert_same({name: values[index] for name, values in every.items()}, there(position))


def test_the_mean_of_directions_does_not_care_where_they_are_counted_from():
    angles, shares = number([2.9, -3.1, 2.7]), number([0.5, 0.2, 0.3])
    expected = mean(angles.remainder(2.0 * math.pi).unbind(), shares.unbind(), KNOWN["rain"])
    found = mean(angles.unbind(), shares.unbind(), KNOWN["wind"])
    assert float(found) == pytest.approx(float(expected), rel=1e-12)
