import doctest
import importlib
import importlib.util
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from shot_fixtures import NAME, SUN

from experiments import (
    automatic_mask,
    coverage,
    enlarged,
    fit_accuracy,
    fit_command,
    log_error,
    mitsuba_sky,
    peer_time,
    plots,
    shots,
    stored_tables,
    timing,
)

pytest_plugins = ["shot_fixtures"]

ROOT = Path(__file__).parents[1]

# Draws a sky of one colour as wide as the photo, and tells of a solve of 2 s.
STAND_IN = """
import argparse, json, pathlib, sys
import numpy as np, OpenEXR, OpenImageIO
parser = argparse.ArgumentParser()
parser.add_argument("photo")
for name in ("--mask", "--sun", "--out"):
    parser.add_argument(name, required=name == "--out")
parser.add_argument("--quiet", action="store_true")
given = parser.parse_args()
assert (given.mask is None) == (given.sun is None)
spec, mask = (OpenImageIO.ImageBuf(name).spec() for name in (given.photo, given.mask or given.photo))
if (spec.width, spec.height) != (mask.width, mask.height):
    sys.exit("error: mask of another size")
out = pathlib.Path(given.out)
out.mkdir(parents=True, exist_ok=True)
sky = np.full((spec.height, spec.width, 3), 0.25, np.float32)
OpenEXR.File({}, {"RGB": sky}).write(str(out / "fitted.exr"))
white = np.zeros((spec.height, spec.width, 1), np.uint8)
white[: spec.height // 4] = 255
OpenImageIO.ImageBuf(white).write(str(out / "mask.png"))
errors = {"elevation_standard_error": None, "azimuth_standard_error": 0.5}
sun = {"elevation": 10.54, "azimuth": 36.99, "visible": False, **errors}
account = {"converged": True, "sun": sun, "seconds": {"read": 1.0, "solve": 2.0, "errors": 0.5, "write": 1.0}}
(out / "fit.json").write_text(json.dumps(account))
"""


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """A command in place of `fit sky`, so that only the experiment is tested."""
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(fit_command, "COMMAND", (sys.executable, str(script)))


@pytest.mark.parametrize("path", sorted((ROOT / "experiments").glob("*.py")), ids=lambda path: path.stem)
def test_examples_in_docstrings_hold(path):
    module = importlib.import_module("experiments" if path.stem == "__init__" else f"experiments.{path.stem}")
    assert doctest.testmod(module).failed == 0


@pytest.mark.usefixtures("stand_in")
def test_automatic_mask_in_its_smallest_size(photos, sky, tmp_path):
    automatic_mask.main(["--photos", str(photos), "--size", "small", "--out", str(tmp_path)])
    (row,) = json.loads((tmp_path / "automatic_mask.json").read_text())["records"]
    found = np.zeros_like(sky.mask)
    found[: sky.mask.shape[0] // 4] = True
    assert row["iou"] == pytest.approx((found & sky.mask).sum() / (found | sky.mask).sum())
    assert row["sun_apart"] == pytest.approx(math.cos(math.radians(SUN[0])), abs=1e-2)
    assert row["ratio"] == 1.0  # the stand-in draws one sky whatever it is told
    assert (row["sun_seen"], row["sun_seen_by_peers"], row["sun_errors"]) == (False, True, [None, 0.5])
    assert (tmp_path / "automatic_mask.png").stat().st_size > 1000
    assert (tmp_path / "automatic_masks.png").stat().st_size > 1000


# shots


def test_shots_are_the_photos_that_are_there_with_the_better_peer(photos, shot):
    found = shots.read_shots(photos, photos / "masks", photos / "PEERS.csv")
    assert [one.name for one in found] == [NAME]
    assert (shot.sun, shot.peer_error) == (SUN, 0.02)


def test_an_unknown_photo_is_refused_with_the_known_ones(photos, capsys):
    with pytest.raises(SystemExit):
        shots.ask("", ["--photos", str(photos), "nowhere"])
    assert f"no nowhere that suits in {photos}; known: {NAME}" in capsys.readouterr().err


# timing


def test_spread_of_one_measurement_is_that():
    assert timing.spread([2.0]) == timing.Spread(2.0, 2.0, 2.0, (2.0,))


def test_two_works_take_turns_and_the_first_round_does_not_count():
    seconds, order = iter([100.0, 1.0, 1.0, 4.0, 2.0, 4.0]), []

    def work(name):
        order.append(name)
        return next(seconds)

    found = timing.interleaved(lambda: work("a"), lambda: work("b"), rounds=2)
    assert order == list("ababab")
    assert found.ratio.each == (4.0, 2.0)
    assert found.first.each == (1.0, 2.0)


# fit_command


def test_a_process_is_weighed_by_itself():
    idle = fit_command.run([sys.executable, "-c", "print('done')"])
    busy = fit_command.run([sys.executable, "-c", "held = bytearray(600_000_000)"])
    assert idle.told == "done\n"
    assert busy.peak_bytes > 600_000_000
    assert idle.peak_bytes < busy.peak_bytes


def test_a_fit_without_files_is_no_fit(shot, tmp_path, monkeypatch):
    (tmp_path / "fit.json").write_text("{}")
    monkeypatch.setattr(fit_command, "COMMAND", (sys.executable, "-c", "raise SystemExit('crash')"))
    with pytest.raises(RuntimeError, match="status 1: crash"):
        fit_command.fit_sky(shot.photo, shot.mask, shot.sun, tmp_path)


def test_a_command_that_fails_tells_its_last_line():
    with pytest.raises(RuntimeError, match=r"status 2: error: bad mask"):
        fit_command.run_well(
            [sys.executable, "-c", "import sys; print('error: bad mask', file=sys.stderr); sys.exit(2)"]
        )


# fit_accuracy


@pytest.mark.slow
@pytest.mark.usefixtures("stand_in")
def test_fit_accuracy_judges_what_the_command_wrote(photos, tmp_path, sky, capsys):
    fit_accuracy.main(["--photos", str(photos), "--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "fit_accuracy.json").read_text())
    (row,) = content["records"]
    assert row["error"] == pytest.approx(log_error.log_error(sky, np.ones((*sky.mask.shape, 3))).error, rel=1e-5)
    assert row["ratio"] == pytest.approx(row["error"] / 0.02)
    assert row["solve_seconds"] == 2.0
    assert content["geometric_means"]["ratio"] == pytest.approx(row["ratio"])
    assert (tmp_path / "fit_accuracy.png").stat().st_size > 1000
    assert "geometric mean" in capsys.readouterr().out


@pytest.mark.slow
def test_fit_accuracy_runs_the_real_command(shot):
    assert 0.0 < fit_accuracy.accuracy(shot).ratio < 1.0


# coverage


@pytest.mark.slow
def test_coverage_counts_what_intervals_hold(photos, tmp_path, capsys):
    coverage.main(["--photos", str(photos), "--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "coverage.json").read_text())
    *each, together = content["records"]
    (noise,) = content["noise"]
    assert together["determined"] == sum(row["determined"] for row in each) == noise["determined"]
    for row in content["records"]:
        assert 0.0 <= row["within_one"] <= row["within_two"] <= 1.0
        assert row["median_standard_error"] > 0.0
    assert noise["name"] == NAME
    assert (tmp_path / "coverage.png").stat().st_size > 1000
    assert "68 %" in capsys.readouterr().out


def test_skies_are_drawn_inside_their_bounds_and_each_is_another():
    drawn = [coverage.truth(np.random.default_rng(seed)) for seed in range(20)]
    assert len({sky["SKY_OZONE"] for sky in drawn}) == 20
    assert all(0.0 < place < 1.0 for sky in drawn for place in sky.values())


# peer_time


def test_an_enlarged_photo_is_the_same_when_reduced(shot, tmp_path):
    large = enlarged.enlarged(shot, 1024, tmp_path)
    assert np.array_equal(log_error.read_picture(large.photo), log_error.read_picture(shot.photo))
    assert np.array_equal(log_error.read_mask(large.mask), log_error.read_mask(shot.mask))
    with pytest.raises(ValueError, match="give a multiple"):
        enlarged.enlarged(shot, 1000, tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("stand_in")
def test_peer_time_compares_what_both_sides_tell(photos, tmp_path, monkeypatch):
    told = mitsuba_sky.PeerFit(0.03, 6.0, (1.0, 2.0, 3.0), 1.5, 120, 3.0, (0.0, 0.5, 1.0), (1.0, 1.0, 1.0))
    monkeypatch.setattr(peer_time, "peer_fit", lambda _: told)
    peer_time.main(["--photos", str(photos), "--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "peer_time.json").read_text())
    (beside,), (grown,) = content["peer"], content["growth"]
    assert [beside[name]["median"] for name in ("ours", "peer", "ratio")] == [2.0, 6.0, 3.0]
    assert (grown["photo"], grown["ratio"]["median"]) == (NAME, 1.0)
    assert grown["read_seconds"]["median"] == 1.0
    assert grown["peak_mebibytes"] > 10.0
    assert content["geometric_mean_ratio"] == pytest.approx(3.0)
    assert content["geometric_mean_ratio_with_errors"] == pytest.approx(6.0 / 2.5)
    assert (tmp_path / "peer_time.png").stat().st_size > 1000


def test_named_llvm_goes_before_others(monkeypatch):
    monkeypatch.setenv(mitsuba_sky.LLVM_VARIABLE, "named.so")
    assert mitsuba_sky.find_llvm() == "named.so"


def test_missing_llvm_is_told(monkeypatch, tmp_path):
    monkeypatch.delenv(mitsuba_sky.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(mitsuba_sky, "LIBRARIES", tmp_path)
    with pytest.raises(FileNotFoundError, match="install libllvm19"):
        mitsuba_sky.find_llvm()


@pytest.mark.slow
def test_the_peer_follows_the_sky(shot, sky):
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed (extra `experiments`)")
    try:
        mitsuba_sky.find_llvm()
    except FileNotFoundError as missing:
        pytest.skip(str(missing))
    found = peer_time.peer_fit(shot)
    constant = log_error.log_error(sky, np.ones((*sky.mask.shape, 3))).error
    assert 0.0 < found.error < 0.1 * constant
    assert found.seconds == pytest.approx(sum(found.seconds_each))


@pytest.mark.slow
def test_stored_tables_are_compared_and_drawn(tmp_path):
    stored_tables.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "stored_tables.json").read_text())
    assert [row["share"] for row in content["blends"]] == list(stored_tables.SHARES)
    assert all(row["blended"]["largest"] < row["light_blended"]["largest"] for row in content["blends"])
    assert (tmp_path / "stored_tables.png").stat().st_size > 100


def test_plots_are_drawn_from_json_alone(tmp_path):
    row = {"photo": "dawn", "ratio": 0.3, "floor_ratio": 0.1}
    (tmp_path / "fit_accuracy.json").write_text(json.dumps({"records": [row], "geometric_means": {"ratio": 0.3}}))
    plots.fit_accuracy(tmp_path / "fit_accuracy.json")
    assert (tmp_path / "fit_accuracy.png").stat().st_size > 1000
