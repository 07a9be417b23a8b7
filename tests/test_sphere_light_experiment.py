import importlib.util
import json

import pytest

from diffrender.shading.sphere_light import EFFECT
from experiments import hard_places, mitsuba_lamp, sphere_light


def test_places_radiance_furnace_and_picture_are_told(tmp_path, capsys):
    sphere_light.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "sphere_light.json").read_text())
    places = {(row["sine"], row["directions"], row["way"]): row for row in content["places"]}
    for sine, directions in sphere_light.SETS:
        karis, talk, guarded = (places[sine, directions, way] for way in sphere_light.STEPS)
        assert guarded["mean"] < talk["mean"] < karis["mean"]
        assert guarded["worse_than_karis"] == 0.0
        assert guarded["largest"] < karis["largest"]
    assert max(row["worse_than_karis"] for row in content["places"]) > 0.05
    errors = {
        (row["sine"], row["roughness"], row["metallic"], row["rung"]): (row["error"], row["largest_whole"])
        for row in content["radiance"]
    }
    last = list(EFFECT.rungs)[-1]
    # Sums of the small size have too few nodes for smoother surfaces.
    ours = {at[:3]: found for at, found in errors.items() if at[3] == last and at[1] >= 0.1}
    assert max(error for error, _ in ours.values()) < 0.4
    assert max(largest for _, largest in ours.values()) < 0.04
    assert ours[0.2, 0.2, 1.0][0] < 0.05 * errors[0.2, 0.2, 1.0, "Karis' point"][0]
    assert all(0.1 < row["share"] < 1.002 for row in content["furnace"])
    assert all(row["share"] > 0.95 for row in content["furnace"] if row["roughness"] == 0.0 and row["elevation"] > 5.0)
    assert (tmp_path / "sphere_light.png").stat().st_size > 1000
    assert "worse than Karis" in capsys.readouterr().out


def test_sums_agree_with_mitsuba_within_its_noise(tmp_path):
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed (extra `experiments`)")
    mitsuba_lamp.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "mitsuba_lamp.json").read_text())
    rows = content["records"]
    assert len(rows) == 75
    assert all(abs(row["summed"] - row["mitsuba"]) < 5.0 * row["noise"] + 1e-4 * row["summed"] for row in rows)
    assert all(row["within"] == row["places"] for row in content["classes"] if row["is_whole"])


def test_hard_lamps_are_as_many_as_the_examples():
    shapes = {name: seen.position.shape for name, seen in hard_places.hard_inputs("sphere light").items()}
    assert len(shapes) == 5
    assert len(set(shapes.values())) == 1
