import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_sky import HAZY_MORNING

from diffrender.scene import places
from fit import keyframes
from fit.search_space import SearchSpace, put, value

FREE = ("SKY_HAZINESS", "SKY_MIE_SCALE", "SKY_OVERCAST_TRANSMITTANCE_G", "SUN_AZIMUTH")
SPACE = SearchSpace(keyframes.scene(HAZY_MORNING, torch.float64), FREE)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=len(FREE), max_size=len(FREE)))
def test_a_point_becomes_a_scene_and_comes_back(point):
    scene = SPACE.scene(torch.tensor(point, dtype=torch.float64))
    assert SPACE.point(scene) == pytest.approx(point, abs=1e-12)


def test_what_is_not_free_keeps_the_values_of_the_start():
    moved = keyframes.values(SPACE.scene(torch.full((len(FREE),), 0.123, dtype=torch.float64)))
    before = keyframes.values(SPACE.start)
    assert {name for name in before if moved[name] != before[name]} == set(FREE)


@pytest.mark.parametrize("end", [0, 1])
def test_the_faces_of_the_cube_are_the_bounds(end):
    scene = SPACE.scene(torch.full((len(FREE),), float(end), dtype=torch.float64))
    found = [float(value(scene, places()[name])) for name in FREE]
    assert found == [places()[name].specification.bounds[end] for name in FREE]


def test_a_log_parameter_is_at_the_geometric_middle_of_its_bounds_half_way():
    scene = SPACE.scene(torch.full((len(FREE),), 0.5, dtype=torch.float64))
    low, high = places()["SKY_MIE_SCALE"].specification.bounds
    assert float(scene.sky.mie_scale) == pytest.approx((low * high) ** 0.5)


def test_each_coordinate_has_a_slope_on_its_own_parameter_alone():
    point = torch.full((len(FREE),), 0.3, dtype=torch.float64)

    def found(at):
        scene = SPACE.scene(at)
        return torch.stack([value(scene, places()[name]) for name in FREE])

    slopes = torch.autograd.functional.jacobian(found, point)
    assert torch.equal(slopes != 0.0, torch.eye(len(FREE)) != 0.0)
    assert np.all(slopes.diagonal().numpy() > 0.0)


def test_putting_a_value_leaves_the_scene_it_was_put_into():
    place = places()["SKY_OVERCAST_TRANSMITTANCE_B"]
    before = SPACE.start.sky.overcast_transmittance.clone()
    after = put(SPACE.start, place, torch.tensor(2.0, dtype=torch.float64))
    assert torch.equal(SPACE.start.sky.overcast_transmittance, before)
    assert after.sky.overcast_transmittance.tolist() == [*before[:2].tolist(), 2.0]


def test_without_free_parameters_there_is_one_point_and_one_scene():
    fixed = SearchSpace(SPACE.start, ())
    assert fixed.point(SPACE.start).shape == (0,)
    assert keyframes.values(fixed.scene(torch.zeros(0, dtype=torch.float64))) == keyframes.values(SPACE.start)
