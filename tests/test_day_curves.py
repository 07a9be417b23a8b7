"""Curves through normal distributions, and their keyframes, without a picture."""

import math

import numpy as np
import pytest

from diffrender.scene import weather_names
from fit import keyframes
from fit.day_curves import FREEDOM, Observation, curves, nodes
from fit.day_keyframes import Keyframes, fewest
from fit.weather_file import Weather

SPREAD = {"a": 0.1, "b": 0.1}
HOURS = np.arange(24.0)
NOISE = np.array([[4e-4, 2e-4], [2e-4, 2e-4]])


def swinging(hour):
    return np.array([0.5 + 0.1 * np.sin(2.0 * np.pi * hour / 24.0), 0.3])


def day(seed=0, spoilt=(), hours=HOURS):
    generator = np.random.default_rng(seed)
    points = [swinging(hour) + generator.multivariate_normal(np.zeros(2), NOISE) for hour in hours]
    for index in spoilt:
        points[index] = points[index] + 0.3
    return [Observation(float(hour), ("a", "b"), point, NOISE) for hour, point in zip(hours, points, strict=True)]


@pytest.fixture(scope="module")
def found():
    return curves(day(spoilt=(5, 16)), SPREAD)


def test_clouds_count_little_and_curves_are_found_through_them(found):
    assert found.weights[[5, 16]].max() < 0.1
    assert np.median(found.weights) == 1.0
    away = found.values - np.stack([swinging(hour) for hour in found.hours], 1)
    assert np.sqrt((away**2).mean(1)).tolist() < [0.6 * math.sqrt(NOISE[0, 0]), 0.3 * math.sqrt(NOISE[1, 1])]
    assert np.abs(away / found.errors).max() < 3.5


def test_what_swings_is_held_less_than_what_stays(found):
    assert found.strengths["a"] > 10.0 * found.strengths["b"]
    assert found.score <= min(found.scores.values())


def test_a_photo_left_out_is_as_if_it_were_not_there():
    # The distance by formula against that from curves that never saw the photo.
    every = day(spoilt=(5, 16))
    strict = curves(every, SPREAD)
    for index in (3, 5):
        hour, point = every[index].hour, every[index].point
        others = curves(every, SPREAD, silent=[index])
        assert others.weights[index] == 0.0
        drawn = others.hours.index(hour)
        rows = [drawn, len(others.hours) + drawn]
        wanted = point - others.at(hour)
        whole = others.covariance[np.ix_(rows, rows)] / others.scale**2 + NOISE
        square = wanted @ np.linalg.solve(whole, wanted) / 2.0
        assert strict.distances[index] == pytest.approx(math.sqrt(square), rel=0.15)


def test_a_gap_is_bridged_with_wider_errors():
    gap = [one for one in day() if not 9.0 < one.hour < 15.0]
    found = curves([*gap, Observation(12.0, (), np.zeros(0), np.zeros((0, 0)))], SPREAD)
    middle = found.hours.index(12.0)
    assert found.errors[0, middle] > 1.5 * found.errors[0, found.hours.index(3.0)]
    assert abs(found.values[0, middle] - 0.5) < 2.0 * found.errors[0, middle]
    assert np.isnan(found.distances[-1])


def test_a_single_photo_is_its_own_curve():
    found = curves(day(hours=HOURS[:1]), SPREAD)
    assert found.values[:, 0] == pytest.approx(day(hours=HOURS[:1])[0].point, abs=1e-3)
    assert {name: keys.hours for name, keys in fewest(found, 1).items()} == {"a": (0.0,), "b": (0.0,)}


def test_scatter_beyond_the_error_bars_widens_the_curve():
    honest = day(hours=np.repeat(HOURS[::3], 4))  # of photos at one hour, between which no drift can pass for scatter
    proud = [Observation(one.hour, one.names, one.point, one.covariance / 25.0) for one in honest]
    one, other = curves(honest, SPREAD), curves(proud, SPREAD)
    assert one.scale < 1.5
    assert 3.0 < other.scale < 7.0
    assert other.errors.mean() > 0.5 * one.errors.mean()


def test_nodes_are_half_an_hour_apart_over_midnight_too():
    assert nodes([23.9, 0.0, 12.0, 12.2, 12.6]) == (0.0, 12.0, 12.6)


def test_degrees_of_freedom_keep_one_photo_from_all_say():
    assert FREEDOM > 2.0  # below, Student's distribution has no variance


# Keyframes


def test_a_constant_is_one_keyframe_and_a_swing_is_few(found):
    keys = fewest(found, 24)
    assert len(keys["b"].hours) == 1
    assert 2 < len(keys["a"].hours) < 12
    away = keys["a"].at(found.hours) - found.values[0]
    assert np.abs(away / found.errors[0]).max() < 2.0


def test_keyframes_are_drawn_as_a_weather_file_draws_them():
    keys = Keyframes((3.0, 9.0, 17.5), (0.2, 0.7, 0.4))
    low, high = weather_names()["SKY_HAZINESS"].file_bounds
    values = tuple(low + value * (high - low) for value in keys.values)
    weather = Weather(keys.hours, {"SKY_HAZINESS": values}, {})
    hours = np.linspace(0.0, 23.9, 50)
    drawn = [(keyframes.at(weather, hour)["SKY_HAZINESS"] - low) / (high - low) for hour in hours]
    assert keys.at(hours) == pytest.approx(drawn, abs=1e-12)
