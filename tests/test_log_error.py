import ast
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from shot_fixtures import picture_of, write_mask

from experiments import harmonics_floor, log_error

pytest_plugins = ["shot_fixtures"]


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
