"""The experiments on days, at their smallest size; a stand-in fits where only the experiment is tested."""

import importlib.util
import json
import os
import sys

import numpy as np
import pytest

from experiments import day_kills, day_panoramas, day_photos, day_workers, mitsuba_sky

# Writes as `fit day` does, after a moment in which it may be killed.
STAND_IN = """
import argparse, pathlib, time
parser = argparse.ArgumentParser()
parser.add_argument("--out", type=pathlib.Path)
out = parser.parse_known_args()[0].out
parts = out.parent / f"{out.name}.parts"
parts.mkdir(parents=True, exist_ok=True)
time.sleep(0.1)
(parts / "a.json").write_text("{}")
time.sleep(0.1)
out.mkdir(exist_ok=True)
for name in ("day.json", "report.html", "weather.csv"):
    (out / name).write_text(CONTENT)
"""


def stand_in(folder, content):
    script = folder / "stand_in.py"
    script.write_text(STAND_IN.replace("CONTENT", content))
    return sys.executable, str(script)


@pytest.mark.slow
@pytest.mark.parametrize(("content", "differing"), [("'same'", 0), ("str(time.time())", 3)])
def test_kills_tell_whether_resumed_runs_are_the_same(tmp_path, monkeypatch, content, differing):
    monkeypatch.setattr(day_kills, "COMMAND", stand_in(tmp_path, content))
    day_kills.main(["--size", "small", "--out", str(tmp_path)])
    records = json.loads((tmp_path / "day_kills.json").read_text())["records"]
    assert [len(record["differing"]) for record in records] == [differing] * 2


def test_photos_of_a_day_tell_their_times(tmp_path):
    paths = day_photos.write(tmp_path, 2, 32)
    assert [path.name for path in paths] == ["roof_20200621T060000+0200.exr", "roof_20200621T203000+0200.exr"]


@pytest.mark.slow
def test_workers_are_timed_and_weighed(tmp_path, monkeypatch, capsys):
    # Not the fit itself, which its own tests run.
    monkeypatch.setattr(day_workers, "weighed", lambda *_: (os.getpid(), 2**20))
    day_workers.main(["time", "--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "day_workers_time.json").read_text())
    assert [[record["jobs"] for record in one] for one in content["rounds"]] == [[1, 2]]
    assert content["ratio"]["median"] > 0.0
    assert "times as fast on two" in capsys.readouterr().out


# Panoramas


def photo(hour, value, weight=1.0):
    interval = [value - 0.01, value + 0.01]
    own = {"SKY_HAZINESS": {"value": value, "interval": interval, "determined": True}}
    return {"hour": hour, "parameters": own, "weight": weight}


def test_curves_are_compared_with_what_clean_panoramas_give():
    size = day_panoramas.Size(64, (8.0, 12.0, 16.0), 1, ())
    truth = {"photos": [photo(8.0, 0.6), photo(12.0, 0.7), photo(16.0, 0.8)]}
    curve = {"hours": [8.0, 16.0], "values": [0.6, 0.84], "low": [0.58, 0.82], "high": [0.62, 0.86]}
    day = {
        "photos": [photo(8.0, 0.63), photo(16.0, 0.77)],
        "curves": {"SKY_HAZINESS": {**curve, "keyframes": {"hours": [8.0], "values": [0.6]}}},
    }
    (found,) = day_panoramas.compared(day, truth, size)
    assert found.error == pytest.approx(np.sqrt((0.0 + 0.02**2 + 0.04**2) / 3.0))
    assert found.alone == pytest.approx(0.03)
    assert found.at_missing == pytest.approx(1.0)
    assert (found.within_one, found.within_two) == (pytest.approx(2.0 / 3.0, abs=0.34), pytest.approx(2.0 / 3.0))


def test_clouds_are_patches_that_spare_the_ground():
    picture = np.full((32, 64, 3), 0.2, np.float32)
    spoilt = day_panoramas.clouded(picture, np.random.default_rng(0))
    assert np.array_equal(spoilt[16:], picture[16:])
    assert spoilt[:16].max() > 1.3 * spoilt[:16].min()


@pytest.mark.slow
def test_a_day_rendered_by_mitsuba_is_drawn(tmp_path, monkeypatch):
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed (extra `experiments`)")
    try:
        mitsuba_sky.find_llvm()
    except FileNotFoundError as missing:
        pytest.skip(str(missing))

    def fitted(folder, _):
        names = sorted(path.name for path in folder.glob("*.exr"))
        photos = [photo(float(name[14:16]), 0.7) | {"photo": name, "refused": None, "heading": 101.0} for name in names]
        curve = {"hours": [8.0], "values": [0.7], "low": [0.6], "high": [0.8]}
        return {"photos": photos, "curves": {"SKY_HAZINESS": {**curve, "keyframes": {"hours": [8.0], "values": [0.7]}}}}

    monkeypatch.setattr(day_panoramas, "fitted_day", fitted)
    day_panoramas.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "day_panoramas.json").read_text())
    assert content["largest_heading_error_degrees"] == pytest.approx(1.0)
    assert len(content["weights"]) == 3
    assert (tmp_path / "day_panoramas.png").stat().st_size > 1000
