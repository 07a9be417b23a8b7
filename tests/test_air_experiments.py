import json
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere.far_fog import FarFog
from diffrender.atmosphere.height_fog import HeightFog
from experiments import distant_air, far_fog_conversion


@pytest.mark.slow
def test_far_fog_is_converted_both_ways_and_drawn(tmp_path):
    far_fog_conversion.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "far_fog_conversion.json").read_text())
    assert all(0.01 < row["root_mean_square"] < 0.2 for row in content["far_as_height"])
    assert all(row["largest"] < 1e-6 for row in content["height_as_far"])
    assert (tmp_path / "far_fog_conversion.png").stat().st_size > 1000


def test_a_far_fog_that_is_a_height_fog_is_found_again():
    rays = far_fog_conversion.columns((2.0, 60.0), (300.0, 2e3, 2e4))
    near = replace(rays, length=rays.length.clamp(max=9e4))  # within its end
    even = {"znear": 0.0, "zfar": 1e5, "distance_decay": 0.0, "standard_height": far_fog_conversion.LOWEST}
    far = far_fog_conversion.changed(FarFog, {**even, "thickness": 5e4, "height_decay": 0.01})
    found = far_fog_conversion.to_height_fog(far, near)
    assert found.largest < 1e-6
    torch.testing.assert_close(found.fog.scale_height, torch.tensor(100.0, dtype=torch.float64), rtol=1e-4, atol=0.0)
    torch.testing.assert_close(found.fog.extinction, torch.tensor(5e-4, dtype=torch.float64), rtol=1e-4, atol=0.0)


def test_no_column_falls_below_the_lowest_ground_or_to_the_sky_below():
    rays = far_fog_conversion.columns(far_fog_conversion.EYES, far_fog_conversion.LENGTHS)
    end = rays.origin[:, 2] + rays.direction[:, 2].clamp(max=0.0) * rays.length.clamp(max=1e9)
    assert end.min() >= far_fog_conversion.LOWEST
    assert (rays.direction[rays.length.isinf(), 2] >= 0.0).all()
    assert (rays.direction[:, 2] < 0.0).any()


def test_a_height_fog_thinner_than_far_fog_can_be_is_met_at_the_bound():
    thin = far_fog_conversion.changed(HeightFog, {"scale_height": 5.0})
    found = far_fog_conversion.to_far_fog(thin, far_fog_conversion.columns((2.0,), (300.0, 2e3)))
    assert 0.09 < found.fog.height_decay <= 0.1
    assert 0.01 < found.largest < 0.5


@pytest.mark.slow
def test_distant_air_is_compared_and_drawn(tmp_path):
    distant_air.main(["--size", "small", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "distant_air.json").read_text())["records"]
    assert [row["rays"] for row in rows] == list(distant_air.CLIMBS)
    assert all(row["three_tables"]["root_mean_square"] < row["two_tables"]["root_mean_square"] for row in rows)
    assert (tmp_path / "distant_air.png").stat().st_size > 1000
