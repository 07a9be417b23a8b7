import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import CHANNELS, parameter, record
from diffrender.scene import RECORDS, Exposure, Scene, weather_names
from fit import keyframes
from fit.input_error import InputError
from fit.weather_file import CLOSEST, Weather

BRIGHT = "EXPOSURE"  # a log parameter
HIGH = "SUN_ELEVATION"  # a linear one
ROUND = "SUN_AZIMUTH"  # a whole circle


def weather(hours: Sequence[float], **values: tuple[float | None, ...]) -> Weather:
    return Weather(tuple(hours), values, {})


@record
class Mist:
    amount: Float[Tensor, ""] = parameter(0.5, bounds=(0.0, 1.0), unit="1", about="opacity")
    tint: Float[Tensor, "3"] = parameter((0.1, 0.2, 0.3), bounds=(0.0, 1.0), unit="1", about="colour")


@record
class MistyScene:
    exposure: Exposure
    mist: Mist | None


@pytest.fixture
def _mist(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(RECORDS, "MIST", Mist)
    monkeypatch.setattr(keyframes, "Scene", MistyScene)
    weather_names.cache_clear()
    yield
    weather_names.cache_clear()


hours_of_days = st.sets(st.integers(0, 95), min_size=1, max_size=6).map(
    lambda quarters: [q / 4 for q in sorted(quarters)]
)


@pytest.mark.parametrize("name", [BRIGHT, HIGH, ROUND])
@given(hours=hours_of_days, data=st.data())
@settings(derandomize=True, max_examples=15, deadline=None)
def test_a_keyframe_holds_bit_for_bit_at_its_hour(name: str, hours: list[float], data: st.DataObject) -> None:
    cells = tuple(data.draw(st.floats(*weather_names()[name].file_bounds)) for _ in hours)
    day = weather(hours, **{name: cells})
    for hour, cell in zip(hours, cells, strict=True):
        found = keyframes.at(day, hour)[name]
        assert (found, math.copysign(1.0, found)) == (cell, math.copysign(1.0, cell))


@pytest.mark.parametrize("name", [BRIGHT, HIGH])
@given(hours=hours_of_days, data=st.data())
@settings(derandomize=True, max_examples=15, deadline=None)
def test_between_keyframes_the_values_are_monotone(name: str, hours: list[float], data: st.DataObject) -> None:
    cells = [data.draw(st.floats(*weather_names()[name].file_bounds)) for _ in hours]
    day = weather(hours, **{name: tuple(cells)})
    ends = [*zip(hours, cells, strict=True), (hours[0] + 24.0, cells[0])]
    for (start, first), (end, last) in pairwise(ends):
        found = [keyframes.at(day, start + (end - start) * part / 4)[name] for part in range(5)]
        assert min(first, last) <= min(found)
        assert max(found) <= max(first, last)
        rounding = 1e-12 * max(map(abs, found))
        assert all((b - a) * (last - first) >= -rounding * abs(last - first) for a, b in pairwise(found))


def test_halfway_between_two_keyframes_lies_the_mean_in_the_scale_of_the_parameter() -> None:
    day = weather([6.0, 18.0], **{BRIGHT: (0.01, 100.0), HIGH: (10.0, 60.0), ROUND: (-170.0, 150.0)})
    for hour in (0.0, 12.0):
        found = keyframes.at(day, hour)
        assert found[BRIGHT] == pytest.approx(1.0, rel=1e-14)  # the geometric mean
        assert found[HIGH] == pytest.approx(35.0, rel=1e-14)
        assert found[ROUND] == pytest.approx(170.0, rel=1e-14)  # the shorter way


def test_a_parameter_that_follows_the_clock_round_is_linear() -> None:
    day = weather([3.0, 9.0, 15.0, 21.0], **{ROUND: (-135.0, -45.0, 45.0, 135.0)})
    for hour in (0.5, 3.0, 7.25, 12.0, 20.0, 22.5, 23.75):
        assert keyframes.at(day, hour)[ROUND] == pytest.approx(15.0 * (hour - 12.0), abs=1e-11)


def test_the_other_direction_of_the_circle_is_linear_too() -> None:
    day = weather([3.0, 9.0, 15.0, 21.0], **{ROUND: (135.0, 45.0, -45.0, -135.0)})
    for hour in (0.5, 12.0, 23.75):
        assert keyframes.at(day, hour)[ROUND] == pytest.approx(-15.0 * (hour - 12.0), abs=1e-11)


@pytest.mark.parametrize("hour", [0.0, 3.25, 6.0, 23.5])
def test_the_day_is_cyclic(hour: float) -> None:
    day = weather(
        [1.0, 6.0, 18.0], **{BRIGHT: (0.01, 100.0, 3.0), HIGH: (10.0, 60.0, -80.0), ROUND: (0.0, 120.0, -120.0)}
    )
    assert keyframes.at(day, hour) == keyframes.at(day, hour + 24.0) == keyframes.at(day, hour - 48.0)


def test_midnight_is_continuous() -> None:
    day = weather([0.0, 8.0, 18.0], **{BRIGHT: (0.01, 100.0, 3.0), HIGH: (10.0, 60.0, -80.0)})
    at_midnight = keyframes.at(day, 0.0)
    assert at_midnight == keyframes.at(day, -1e-20)  # whose remainder by 24 rounds to 24
    assert keyframes.at(day, -1e-9) == pytest.approx(at_midnight, rel=1e-8)
    assert keyframes.at(day, 1e-9) == pytest.approx(at_midnight, rel=1e-8)


def test_a_single_keyframe_holds_all_day() -> None:
    day = weather([6.0, 18.0], **{BRIGHT: (None, 0.3)})
    assert [keyframes.at(day, hour) for hour in (0.0, 6.0, 18.0, 23.0)] == [{BRIGHT: 0.3}] * 4


def test_a_row_of_empty_cells_has_no_value() -> None:
    assert keyframes.at(weather([6.0, 18.0], **{BRIGHT: (None, None)}), 12.0) == {}


def test_empty_cells_are_no_keyframes() -> None:
    sparse = weather([0.0, 6.0, 9.0, 18.0], **{HIGH: (None, 10.0, None, 60.0), BRIGHT: (1.0, 2.0, 3.0, 4.0)})
    dense = weather([6.0, 18.0], **{HIGH: (10.0, 60.0)})
    for hour in (0.0, 9.0, 13.0):
        assert keyframes.at(sparse, hour)[HIGH] == keyframes.at(dense, hour)[HIGH]


def test_equal_keyframes_give_the_same_bits_between_them() -> None:
    day = weather([1.0, 6.0, 18.0], **{BRIGHT: (0.1, 0.1, 0.7), HIGH: (0.1, 0.1, 0.7), ROUND: (0.1, 0.1, 0.7)})
    assert keyframes.at(day, 4.0) == {BRIGHT: 0.1, HIGH: 0.1, ROUND: 0.1}


def test_the_steepest_keyframes_stay_finite() -> None:
    low, high = weather_names()[BRIGHT].file_bounds
    tiny = 5e-324
    day = weather(
        [0.0, CLOSEST, 12.0], **{BRIGHT: (low, high, low), HIGH: (tiny, 90.0, 0.0), ROUND: (-180.0, 180.0, tiny)}
    )
    for hour in (CLOSEST / 2, 2 * CLOSEST, 6.0, 23.0):
        for name, value in keyframes.at(day, hour).items():
            assert weather_names()[name].file_bounds[0] <= value <= weather_names()[name].file_bounds[1]


@pytest.mark.parametrize("hour", [math.nan, math.inf, -math.inf])
def test_an_hour_that_is_not_finite_is_refused(hour: float) -> None:
    with pytest.raises(InputError, match="give hours of the day"):
        keyframes.at(weather([6.0], **{BRIGHT: (1.0,)}), hour)


def test_a_scene_without_values_is_the_default() -> None:
    found = keyframes.values(keyframes.scene({}))
    assert found[BRIGHT] == 1.0
    assert found[HIGH] == 45.0


def test_angles_are_degrees_to_the_right_in_files_and_radians_to_the_left_in_scenes() -> None:
    sun = keyframes.scene({HIGH: 30.0, ROUND: 90.0}, torch.float64).sun
    assert float(sun.elevation) == pytest.approx(math.pi / 6, rel=1e-15)
    assert float(sun.azimuth) == pytest.approx(-math.pi / 2, rel=1e-15)


def test_an_absent_channel_takes_its_default() -> None:
    given_one = keyframes.values(keyframes.scene({"SUN_IRRADIANCE_G": 7.0}))
    default = keyframes.values(keyframes.scene({}))
    assert given_one == default | {"SUN_IRRADIANCE_G": 7.0}


@pytest.mark.usefixtures("_mist")
def test_an_effect_without_values_is_not_there() -> None:
    assert keyframes.scene({BRIGHT: 2.0}).mist is None
    assert keyframes.values(keyframes.scene({BRIGHT: 2.0})) == {BRIGHT: 2.0}


@pytest.mark.usefixtures("_mist")
def test_an_effect_is_there_as_soon_as_one_of_its_values_is() -> None:
    scene = keyframes.scene({"MIST_TINT_G": 0.75})
    assert torch.equal(scene.mist.tint, torch.tensor([0.1, 0.75, 0.3]))
    assert float(scene.mist.amount) == 0.5
    assert keyframes.values(scene) == {
        BRIGHT: 1.0,
        "MIST_AMOUNT": 0.5,
        "MIST_TINT_R": 0.1,
        "MIST_TINT_G": 0.75,
        "MIST_TINT_B": 0.3,
    }


@pytest.mark.parametrize(("values", "said"), [({"NO_SUCH": 1.0}, "unknown name"), ({HIGH: 91.0}, "allowed -90 to 90")])
def test_a_scene_of_wrong_values_is_refused(values: Mapping[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        keyframes.scene(values)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_scene_has_the_dtype_asked_for(dtype: torch.dtype) -> None:
    scene = keyframes.scene({}, dtype)
    assert scene.exposure.exposure.dtype == scene.sun.irradiance.dtype == dtype


def tensors(scene: Scene) -> list[Tensor]:
    return list(torch.utils._pytree.tree_leaves(scene))


@given(data=st.data())
@settings(derandomize=True, max_examples=20, deadline=None)
def test_a_float32_scene_comes_back_from_its_values_bit_for_bit(data: st.DataObject) -> None:
    given_values = {name: data.draw(st.floats(*known.file_bounds)) for name, known in weather_names().items()}
    scene = keyframes.scene(given_values)
    again = keyframes.scene(keyframes.values(scene))
    assert all(map(torch.equal, tensors(scene), tensors(again)))


@given(data=st.data())
@settings(derandomize=True, max_examples=20, deadline=None)
def test_a_float64_scene_comes_back_from_its_values_but_for_the_last_bit(data: st.DataObject) -> None:
    given_values = {name: data.draw(st.floats(*known.file_bounds)) for name, known in weather_names().items()}
    scene = keyframes.scene(given_values, torch.float64)
    again = keyframes.scene(keyframes.values(scene), torch.float64)
    for whole, twice in zip(tensors(scene), tensors(again), strict=True):
        assert bool(((twice - whole).abs() <= 2.0**-52 * whole.abs()).all())


@given(data=st.data())
@settings(derandomize=True, max_examples=20, deadline=None)
def test_decimals_come_back_from_a_scene_as_they_were_written(data: st.DataObject) -> None:
    given_values = {}
    for name, known in weather_names().items():
        mantissa, exponent = data.draw(st.integers(-999_999, 999_999)), data.draw(st.integers(-12, 6))
        value = float(f"{mantissa}e{exponent}")
        if known.file_bounds[0] <= value <= known.file_bounds[1]:
            given_values[name] = value
    found = keyframes.values(keyframes.scene(given_values))
    assert all(found[name] == value for name, value in given_values.items() if name in found)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("end", [0.0, 1.0])
def test_a_scene_at_its_bounds_has_values_at_theirs(dtype: torch.dtype, end: float) -> None:
    parts = {}
    for part, (_, kind, _) in keyframes._parts().items():
        known = keyframes.specifications(kind)
        shapes = {
            name: torch.zeros(3 if isinstance(one.default, tuple) else (), dtype=dtype) for name, one in known.items()
        }
        parts[part] = kind(**{name: one.from_unit(shapes[name] + end) for name, one in known.items()})
    for name, value in keyframes.values(Scene(**parts)).items():
        assert value in weather_names()[name].file_bounds


def test_a_scene_outside_its_bounds_makes_no_weather() -> None:
    scene = Scene(**{**vars(keyframes.scene({})), "exposure": Exposure(torch.tensor(-1.0))})
    found = keyframes.values(scene)
    assert found[BRIGHT] == -1.0
    with pytest.raises(InputError, match="EXPOSURE is -1; allowed"):
        weather([12.0], **{name: (value,) for name, value in found.items()})


def test_values_stand_in_drawing_order() -> None:
    found = list(keyframes.values(keyframes.scene({f"SUN_IRRADIANCE_{CHANNELS[0]}": 1.0})))
    assert found == [name for name in weather_names() if name in found]
