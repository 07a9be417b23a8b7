import json

import pytest
import torch

from diffrender.shading.wetness import render
from experiments import hard_places, wet_scenes, wetness


def test_wet_ground_is_drawn_and_compared_with_optics(tmp_path, capsys):
    wetness.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "wetness.json").read_text())
    assert [row["dry"] for row in content["albedos"]] == list(wetness.ALBEDOS)
    assert all(row["lagarde"] < row["lekner_dorf"] < row["dry"] for row in content["albedos"])
    assert all(row["table"] <= 1.0 for row in content["furnace"])
    rough = [row for row in content["furnace"] if row["roughness"] >= 0.5]  # what so few directions tell of
    assert all(row["table"] == pytest.approx(row["summed"], abs=2e-3) for row in rough)
    assert (tmp_path / "wetness.png").stat().st_size > 1000
    assert "lekner_dorf" in capsys.readouterr().out


def test_rain_makes_a_street_darker_and_puddles_mirror_the_house():
    view = wet_scenes.street(wet_scenes.puddle_camera(24, 16), wet_scenes.Weather())
    dry, soaked, flooded = (wetness.rain(**wetness.FLOODS[row]) for row in (0, 1, 3))
    darker = (wet_scenes.radiance(soaked, view) / wet_scenes.radiance(dry, view))[8:]
    assert darker.median() < 0.9
    house = wet_scenes.around(view.position, view.to_eye * torch.tensor([-1.0, -1.0, 1.0]).double(), view.sky)[..., 0]
    changes = (wet_scenes.radiance(flooded, view) / render(flooded, view))[..., 0]
    stone, window = house < 0.2, house > 2.0
    assert (stone.sum(), window.sum()) > (20, 5)
    assert changes[stone].mean() < 0.9
    assert changes[window].mean() > 1.1
    assert (wet_scenes.radiance(dry, view) / render(dry, view) - 1.0).abs().max() < 0.05


def test_hard_surfaces_are_as_many_as_the_examples():
    shapes = {name: seen.position.shape for name, seen in hard_places.hard_inputs("wetness").items()}
    assert len(shapes) == 5
    assert len(set(shapes.values())) == 1
