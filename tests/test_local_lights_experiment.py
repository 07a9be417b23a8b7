import json

from experiments import hard_places, local_lights, local_lights_time, shadows


def test_culled_halls_are_drawn_and_compared(tmp_path, capsys):
    local_lights.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "local_lights.json").read_text())
    found = content["differences"]
    assert found["with_light"] == found["scenes"] == local_lights.SMALL_SCENES
    assert all(change < 1e-12 for change in found["largest_difference"].values())
    assert 0 < found["darker_by_shadows"] <= found["scenes"] / local_lights.EVERY
    assert 0.0 < found["mean_share_in_lists"] < 0.8
    assert content["picture"]["mean_in_cell"] < content["picture"]["mean_in_tile"] < 0.2 * local_lights.PICTURE_LAMPS
    assert (tmp_path / "local_lights.png").stat().st_size > 1000
    assert "largest differences" in capsys.readouterr().out


def test_local_lights_are_timed_against_their_number(tmp_path, capsys):
    local_lights_time.main(["--size", "small", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "local_lights_time.json").read_text())["times"]
    assert [row["lamps"] for row in rows] == list(local_lights_time.SMALL_COUNTS)
    assert all(row["seconds"][name]["median"] > 0.0 for row in rows for name in ("tiles", "clusters", "all lights"))
    assert (tmp_path / "local_lights_time.png").stat().st_size > 1000
    assert "all over clusters" in capsys.readouterr().out


def test_hard_lamps_are_as_many_as_the_examples():
    shapes = {name: seen.places.position.shape for name, seen in hard_places.hard_inputs("local lights").items()}
    assert len(shapes) == 5
    assert len(set(shapes.values())) == 1


def test_shadows_of_lamps_and_the_sun_are_held_against_rays(tmp_path, capsys):
    shadows.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "shadows.json").read_text())
    for name in ("lamps", "sun"):
        coarse, fine = content[name]
        assert fine["soft"]["mean_error"] < coarse["soft"]["mean_error"]
        assert 0.0 < fine["soft"]["differs"] < 0.5 * fine["dark"]
    assert (tmp_path / "shadows.png").stat().st_size > 1000
    assert "soft differs" in capsys.readouterr().out
