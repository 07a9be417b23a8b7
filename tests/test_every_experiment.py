import ast
import csv
import doctest
import importlib
import importlib.util
import json
import math
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO
import pytest

from experiments import (
    automatic_mask,
    coverage,
    enlarged,
    fit_accuracy,
    fit_command,
    harmonics_floor,
    log_error,
    mitsuba_sky,
    peer_time,
    plots,
    shots,
    stored_tables,
    timing,
)

ROOT = Path(__file__).parents[1]
PHOTOS = ROOT / "experiments" / "photos"
NAME, SUN = "rooitou_park", (10.54, 35.99)  # where it is seen, in degrees

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
account = {"converged": True, "sun": sun, "seconds": {"read": 1.0, "solve": 2.0, "write": 1.0}}
(out / "fit.json").write_text(json.dumps(account))
"""


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Folder with one photo, a mask of its sky above the trees and away from the sun, and a table of peers."""
    folder = tmp_path_factory.mktemp("photos")
    (folder / f"{NAME}.exr").symlink_to(PHOTOS / f"{NAME}.exr")
    (folder / "masks").mkdir()
    picture = log_error.read_picture(PHOTOS / f"{NAME}.exr")
    seen = harmonics_floor.directions(np.ones(picture.shape[:2], dtype=bool))
    elevation, to_right = np.radians(SUN)
    to_sun = [math.cos(elevation) * math.cos(to_right), -math.cos(elevation) * math.sin(to_right), math.sin(elevation)]
    is_sky = (seen[:, 2] > math.sin(math.radians(15.0))) & (seen @ to_sun < math.cos(math.radians(8.0)))
    write_mask(folder / "masks" / f"{NAME}.png", is_sky.reshape(picture.shape[:2]))
    row = {
        "file": f"{NAME}.exr",
        "sun_visible": "True",
        "sun_elevation": SUN[0],
        "sun_azimuth_right_of_centre": SUN[1],
        "eps": 2e-4,
        "mitsuba_fixed_E3": 0.03,
        "lm_fixed_E3": 0.02,
    }
    with (folder / "PEERS.csv").open("w", newline="") as lines:
        table = csv.DictWriter(lines, row)
        table.writeheader()
        table.writerows([row, row | {"file": "not_there.exr"}])
    return folder


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """A command in place of `fit sky`, so that only the experiment is tested."""
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(fit_command, "COMMAND", (sys.executable, str(script)))


@pytest.fixture(scope="module")
def shot(photos):
    return shots.read_shots(photos, photos / "masks", photos / "PEERS.csv")[0]


@pytest.fixture(scope="module")
def sky(shot):
    return log_error.sky_under(log_error.read_mask(shot.mask), log_error.read_picture(shot.photo), shot.eps)


def write_mask(path, mask):
    output = OpenImageIO.ImageBuf(np.where(mask, 255, 0).astype(np.uint8)[..., None].copy())
    assert output.write(str(path))


def picture_of(sky, radiance):
    picture = np.zeros((*sky.mask.shape, 3))
    picture[sky.mask] = radiance
    return picture


@pytest.mark.parametrize("path", sorted((ROOT / "experiments").glob("*.py")), ids=lambda path: path.stem)
def test_examples_in_docstrings_hold(path):
    module = importlib.import_module("experiments" if path.stem == "__init__" else f"experiments.{path.stem}")
    assert doctest.testmod(module).failed == 0


# log_error


def test_the_judge_shares_no_code_with_the_judged():
    tree = ast.parse(Path(log_error.__file__).read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {name.split(".")[0] for name in imported} & {"fit", "diffrender", "experiments"}


def test_the_photo_itself_has_no_error_whatever_its_white_balance(shot, sky):
    gains = np.array([0.5, 1.0, 3.0])
    found = log_error.log_error(sky, log_error.read_picture(shot.photo) * gains)
    assert found.error == pytest.approx(0.0, abs=1e-15)
    assert found.gains == pytest.approx(tuple(1.0 / gains))


def test_a_sky_of_one_colour_leaves_the_variance_of_log_radiance(sky):
    mean = sky.weight @ sky.log_radiance
    variance = float(np.mean(sky.weight @ (sky.log_radiance - mean) ** 2))
    assert log_error.log_error(sky, np.ones((*sky.mask.shape, 3))).error == pytest.approx(variance)


def test_no_gain_is_better_than_the_one_found(sky):
    gradient = np.linspace(0.0, 1.0, sky.log_radiance.size).reshape(sky.log_radiance.shape)
    found = log_error.log_error(sky, picture_of(sky, gradient))

    def error(log_gain):
        fitted = np.log(np.exp(log_gain) * gradient + sky.eps)
        return float(np.mean(sky.weight @ (fitted - sky.log_radiance) ** 2))

    least = np.log(found.gains)
    assert error(least) == pytest.approx(found.error)
    assert min(error(least - 1e-3), error(least + 1e-3)) > found.error


def test_negative_radiance_counts_as_black(sky):
    radiance = np.exp(sky.log_radiance)
    radiance[:100] = -1.0
    black = radiance.clip(0.0)
    assert log_error.log_error(sky, picture_of(sky, radiance)) == log_error.log_error(sky, picture_of(sky, black))


def test_boxes_are_averaged_and_a_mask_needs_all_of_them():
    fine = np.arange(512.0 * 1024.0).reshape(512, 1024)
    assert log_error.reduced(fine)[0, 0] == (0.0 + 1.0 + 1024.0 + 1025.0) / 4.0
    assert log_error.reduced(fine).shape == (256, 512)


def test_a_mask_pixel_that_is_half_white_is_not_used(tmp_path):
    white = np.ones((512, 1024), dtype=bool)
    white[0, 1] = False
    write_mask(tmp_path / "mask.png", white)
    found = log_error.read_mask(tmp_path / "mask.png")
    assert (bool(found[0, 0]), int(found.sum())) == (False, 256 * 512 - 1)


def test_default_eps_is_a_thousandth_of_the_median(shot):
    mask, photo = log_error.read_mask(shot.mask), log_error.read_picture(shot.photo)
    assert log_error.sky_under(mask, photo, None).eps == pytest.approx(1e-3 * np.median(photo[mask]), rel=1e-2)


def test_what_cannot_be_judged_is_refused(shot, sky, tmp_path):
    photo = log_error.read_picture(shot.photo)
    with pytest.raises(ValueError, match="no white pixel"):
        log_error.sky_under(np.zeros(photo.shape[:2], dtype=bool), photo, None)
    with pytest.raises(ValueError, match="make them equal"):
        log_error.sky_under(sky.mask[:-1], photo, None)
    with pytest.raises(ValueError, match="mask them"):
        log_error.sky_under(sky.mask, np.full_like(photo, np.nan), None)
    with pytest.raises(ValueError, match="not finite"):
        log_error.log_error(sky, np.full_like(photo, np.nan))
    with pytest.raises(ValueError, match="rows and columns"):
        log_error.log_error(sky, photo[:-1])
    with pytest.raises(ValueError, match="cannot be halved"):
        log_error.reduced(np.zeros((257, 514)))
    with pytest.raises(ValueError, match="whole panoramas"):
        log_error.panorama(np.zeros((4, 4)), tmp_path)
    with pytest.raises(ValueError, match="cannot be read"):
        log_error.read_mask(tmp_path / "missing.png")
    OpenEXR.File({}, {"Y": np.ones((2, 4), np.float32)}).write(str(tmp_path / "grey.exr"))
    with pytest.raises(ValueError, match="no channel R"):
        log_error.read_picture(tmp_path / "grey.exr")


def test_log_error_prints_one_line(shot, capsys):
    log_error.main([str(shot.photo), str(shot.photo), str(shot.mask), "--eps", "1e-3"])
    assert capsys.readouterr().out.startswith("E3 0.000000  gains 1 1 1  eps 0.001")


# harmonics_floor


def test_harmonics_reach_whatever_is_a_polynomial_of_their_order(sky):
    x, y, z = harmonics_floor.directions(sky.mask).T
    smooth = np.stack([x * y * z * z, 0.5 + x - z**4, y**3 * z + 0.0 * x], -1)
    photo = picture_of(sky, np.exp(smooth))
    assert harmonics_floor.harmonics_floor(log_error.sky_under(sky.mask, photo, 0.0)).error < 1e-20


def test_harmonics_are_a_floor_for_a_sky_of_one_colour(sky):
    constant = log_error.log_error(sky, np.ones((*sky.mask.shape, 3))).error
    assert 0.0 < harmonics_floor.harmonics_floor(sky).error < constant


def test_harmonics_floor_writes_its_records(photos, tmp_path):
    harmonics_floor.main(["--photos", str(photos), "--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "harmonics_floor.json").read_text())
    (row,) = content["records"]
    assert row["ratio"] == pytest.approx(row["floor"] / 0.02)
    assert {"machine", "versions", "commit", "date"} <= content.keys()


# automatic_mask


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
