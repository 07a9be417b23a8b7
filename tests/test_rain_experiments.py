import json

import pytest
import torch

from diffrender.weather.rain_landing import height_under
from experiments import rain, rain_street, rain_time


@pytest.mark.slow
def test_rain_is_counted_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(rain, "RATE", 1000.0)
    rain.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "rain.json").read_text())
    assert content["alive"]["mean"] == pytest.approx(content["alive"]["expected"], rel=0.05)
    assert [row["below_the_roof"] for row in content["sheltered"]] == [0, 0]
    assert all(row["over_the_shelter"] > 2 for row in content["sheltered"])
    assert content["streak_length"]["mean"] == pytest.approx(content["streak_length"]["expected"], rel=1e-3)
    assert content["warp"]["shifted"] < 1e-3 < content["warp"]["left_behind"]
    assert content["errors"]["rungs"]["splashes"] < content["errors"]["rungs"]["hard"] < 1.0
    assert (tmp_path / "rain.png").stat().st_size > 1000


@pytest.mark.slow
def test_times_of_rain_are_written_as_ratios(tmp_path, monkeypatch):
    monkeypatch.setattr(rain_time, "peak", lambda rung, *_: 100 if rung == "copy" else 100 + 12 * 16 * 9)
    rain_time.main(["--size", "small", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "rain_time.json").read_text())["records"]
    assert [row["rung"] for row in rows] == ["hard", "soft", "splashes"]
    assert all(row["time"]["median"] > 1.0 and row["pictures"] == 1.0 for row in rows)


def test_one_picture_is_drawn_for_its_memory(monkeypatch):
    drawn = []
    monkeypatch.setattr(rain_time, "work_of", lambda *given: lambda: drawn.append(given))
    rain_time.main(["--once", "hard", "500", "16", "9"])
    assert drawn == [("hard", 500.0, (16, 9))]


def test_the_map_of_the_street_has_the_heights_that_its_picture_shows():
    eye = torch.tensor(rain_street.EYE)
    seen = rain_street.street(32, 18, eye).screen
    there = (seen.direction * seen.distance[..., None])[seen.distance < 30.0]
    some_rain = rain.rain_of({})
    ground = rain_street.obstacles(some_rain.depth_map_radius)
    over = there[:, 2] - height_under(some_rain, ground, eye, there)
    is_ground = there[:, 2] < 0.01 - eye[2]
    is_open, is_sheltered = ((over + top).abs() < 0.01 for top in (0.0, rain_street.SHELTER.high[2]))
    assert min(int((is_ground & one).sum()) for one in (is_open, is_sheltered)) > 10
    # Of the rest, the map knows edges to half a cell.
    assert float((is_open | is_sheltered)[is_ground].float().mean()) > 0.95
