import json
import math
import os
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
import torch
from synthetic_sky import CAMERA, HAZY_MORNING, SUN, photo, radiance

from diffrender import rays
from diffrender.scene import weather_names
from fit import keyframes, picture, report, results, weather_file
from fit.input_error import InputError
from fit.minimum import INTERRUPTED, Minimum
from fit.shot import Shot
from fit.solution import Fitted, Solution, SunPlace

FILES = ["fit.json", "fitted.exr", "mask.png", "report.html", "weather.csv"]
SCENE = keyframes.scene(HAZY_MORNING, torch.float64)
USED = np.zeros((CAMERA.height, CAMERA.width), bool)
USED[4:20, 10:90] = True
PHOTO = photo(radiance())
SKY = partial(picture.draw, camera=CAMERA)


def fitted(name, value):
    known = weather_names()[name]
    return Fitted(value, known.file_unit, known.file_bounds, None, determined=False, why="default")


def made_up(**changes):
    """Account of a fit that never was."""
    parameters = {name: fitted(name, value) for name, value in keyframes.values(SCENE).items()}
    parameters["SKY_HAZINESS"] = replace(
        parameters["SKY_HAZINESS"], standard_error=0.012, determined=True, why="searched"
    )
    minimum = Minimum(
        np.zeros(1), 0.5, (2.0, math.inf, 0.5), converged=True, reason="done", iterations=2, evaluations=3
    )
    solution = Solution(
        effect="sky", photo="synthetic.exr", camera=CAMERA, notes=("synthetic",), scene=SCENE, parameters=parameters,
        correlated=("SKY_HAZINESS",), correlation=np.eye(1), sun=SUN, gains=(1.0, 2.0, 3.0), used=USED,
        pixels={"used": int(USED.sum()), "masked": int((~USED).sum()), "nonfinite": 0, "negative": 0},
        left_out={"SKY_OZONE": "not determined by the photo"}, error=0.01, minimum=minimum, solver="least-squares",
        seed=7, seconds={"read": 0.25, "solve": 0.5}, versions={"diffrender": "0.1.0"},
    )  # fmt: skip
    return replace(solution, **changes)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "new" / "folder"
    results.write(folder, PHOTO, made_up(), Shot(), SKY)
    return folder


def test_there_are_five_files_and_nothing_else(written):
    assert sorted(path.name for path in written.iterdir()) == FILES


def test_the_account_has_its_promised_fields(written):
    account = json.loads((written / "fit.json").read_text())
    assert account.keys() >= {
        "photo", "camera", "sun", "gains", "pixels", "solver", "seed", "versions", "converged", "iterations",
        "evaluations", "seconds", "loss", "left_out", "parameters",
    }  # fmt: skip
    assert account["pixels"].keys() == {"used", "masked", "nonfinite", "negative"}
    assert account["seconds"].keys() == {"read", "solve", "write"}
    for parameter in account["parameters"].values():
        assert parameter.keys() >= {"value", "unit", "bounds", "standard_error", "determined"}
    assert account["parameters"].keys() == keyframes.values(SCENE).keys()


def test_the_account_says_null_where_there_is_no_number(written):
    account = json.loads((written / "fit.json").read_text(), parse_constant=pytest.fail)
    assert account["parameters"]["SKY_OZONE"]["standard_error"] is None
    assert account["parameters"]["SKY_HAZINESS"]["standard_error"] == 0.012
    assert account["loss"] == [2.0, None, 0.5]


def test_the_mask_is_white_where_pixels_were_used(written):
    mask = OpenImageIO.ImageBuf(str(written / "mask.png")).get_pixels(OpenImageIO.UINT8)
    assert np.array_equal(mask[..., 0], np.where(USED, 255, 0))


def test_the_picture_is_the_weather_file_drawn(written):
    weather = weather_file.read(written / "weather.csv")
    drawn = picture.draw(keyframes.scene(keyframes.at(weather, 12.0)), CAMERA)
    with OpenEXR.File(str(written / "fitted.exr")) as file:
        assert np.array_equal(file.parts[0].channels["RGB"].pixels, drawn["sky"])
        assert np.array_equal(file.parts[1].channels["RGB"].pixels, drawn["sun"])


def test_the_report_is_a_page(written):
    assert "<html" in (written / "report.html").read_text("utf-8")


# Header of the weather file


def test_an_unknown_time_is_said(written):
    weather = weather_file.read(written / "weather.csv")
    assert weather.hours == (12.0,)
    assert weather.header == {"origin": "fit 0.1.0, photo synthetic.exr", "time": "unknown"}


def test_known_place_and_time_stand_in_the_header(tmp_path):
    time = datetime(2016, 8, 14, 6, 30, tzinfo=timezone(timedelta(hours=2)))
    results.write(tmp_path, PHOTO, made_up(), Shot(-26.2, 27.9, time, 74.0), SKY)
    weather = weather_file.read(tmp_path / "weather.csv")
    assert weather.hours == (6.5,)
    known = {"latitude": "-26.2", "longitude": "27.9", "date": "2016-08-14", "heading": "74"}
    assert weather.header == {"origin": "fit 0.1.0, photo synthetic.exr", **known}


# Cameras


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (rays.Equirectangular(8, 4), {"projection": "equirectangular", "width": 8, "height": 4}),
        (rays.Equirectangular(16, 4, lowest=0.0), {"projection": "hemisphere", "width": 16, "height": 4}),
        (
            rays.Perspective(8, 4, math.radians(63.7), math.radians(-12.3)),
            {"projection": "perspective", "width": 8, "height": 4, "fov_degrees": 63.7, "pitch_degrees": -12.3},
        ),
    ],
)
def test_the_camera_is_said_in_the_words_of_the_command_line(camera, said):
    assert results.record(made_up(camera=camera))["camera"] == said


def test_a_cubemap_names_its_faces():
    camera = results.record(made_up(camera=rays.Cubemap(4, rays.CROSS_LYING)))["camera"]
    assert json.loads(json.dumps(camera))["layout"][0] == [None, "up", None, None]


# Names of folders


def test_results_go_into_a_folder_of_the_photo_s_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert results.folder(None, tmp_path / "dusk.exr") == Path("tuned") / "dusk"
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["..exr", "...exr", "....exr"])
def test_no_name_of_a_photo_leads_out_of_the_folder(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert results.folder(None, Path(name)) == Path("tuned") / name


def test_a_folder_that_is_none_is_refused_before_the_fit(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    for place in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "file" / "far" / "below"):
        with pytest.raises(InputError, match="file is not a folder; give another --out"):
            results.folder(place, tmp_path / "dusk.exr")


def test_a_name_that_no_disk_takes_is_refused_before_the_fit(tmp_path):
    with pytest.raises(InputError, match="cannot be a folder"):
        results.folder(tmp_path / ("x" * 5000), tmp_path / "dusk.exr")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_refused_before_the_fit(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="may not be written to"):
        results.folder(tmp_path / "out", tmp_path / "dusk.exr")


# Failures


def test_no_result_is_replaced_when_the_last_cannot_be_written(tmp_path, monkeypatch):
    results.write(tmp_path, PHOTO, made_up(), Shot(), SKY)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(*_):
        raise InputError("fit.json cannot be written (No space left on device)")

    monkeypatch.setattr(results, "write_bytes", full)
    with pytest.raises(InputError, match="No space"):
        results.write(tmp_path, PHOTO, made_up(seed=8), Shot(heading=5.0), SKY)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


# Summary


def test_the_summary_says_what_was_found():
    text = results.summary(tmp := results.folder(None, PHOTO.path), made_up())
    assert "converged" in text
    assert "0.700 ± 0.012" in text
    assert "SKY_OZONE" not in text  # stands at its default
    assert text.endswith(str(tmp))


def test_a_searched_sun_has_its_errors_in_account_report_and_summary(tmp_path):
    sun = SunPlace(6.0, -100.0, "searched", visible=False, elevation_standard_error=0.25, azimuth_standard_error=1.5)
    solution = made_up(sun=sun)
    results.write(tmp_path / "out", PHOTO, solution, Shot(), SKY)
    account = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert (account["sun"]["elevation_standard_error"], account["sun"]["azimuth_standard_error"]) == (0.25, 1.5)
    assert "standard errors 0.25° and 1.5°" in (tmp_path / "out" / "report.html").read_text("utf-8")
    summary = results.summary(tmp_path, solution)
    assert "sun 6.00 ± 0.25 degrees high, −100.0 ± 1.5 to the right of the middle: searched" in summary


def test_the_summary_says_why_a_fit_did_not_converge():
    stopped = replace(made_up().minimum, converged=False, reason=INTERRUPTED)
    assert "not converged: interrupted" in results.summary(results.folder(None, PHOTO.path), made_up(minimum=stopped))


# Pictures of the report


@pytest.fixture
def shown(monkeypatch):
    """Pictures that a report is given."""

    def pictures(seen, camera, used):
        kept = []
        monkeypatch.setattr(report, "page", lambda _, given: kept.append(given) or "")
        monkeypatch.setattr(results, "whole_folder", None)
        with pytest.raises(TypeError):  # nothing is written
            results.write(seen.path, seen, made_up(camera=camera, used=used), Shot(), SKY)
        return kept[0]

    return pictures


def test_large_photos_are_shown_in_boxes(shown, monkeypatch):
    monkeypatch.setattr(results, "LARGEST_SHOWN", 64)
    pictures = shown(PHOTO, CAMERA, USED)
    assert pictures.photo.shape == pictures.fitted.shape == (32, 64, 3)
    assert np.allclose(pictures.photo[3, 5], PHOTO.radiance[6:8, 10:12].mean((0, 1)))
    assert np.array_equal(pictures.mask, USED.reshape(32, 2, 64, 2).all((1, 3)))


def test_standing_pictures_are_shown_as_small_as_lying_ones(shown, monkeypatch):
    monkeypatch.setattr(results, "LARGEST_SHOWN", 64)
    camera = rays.Perspective(32, 96, 0.5)
    seen = photo(np.ones((96, 32, 3), np.float32), camera)
    assert shown(seen, camera, np.ones((96, 32), bool)).photo.shape == (48, 16, 3)


def test_what_the_model_does_not_draw_is_marked(shown):
    pictures = shown(PHOTO, CAMERA, USED)
    assert np.isnan(pictures.fitted[CAMERA.height // 2 :]).all()
    assert np.isfinite(pictures.fitted[: CAMERA.height // 2 - 1]).all()


@pytest.mark.parametrize("strange", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_strange_pixels_do_not_stop_a_report(tmp_path, strange, kind):
    seen = PHOTO.radiance.astype(kind)
    seen[40, 3:9] = strange
    seen[41, 4] = -strange
    results.write(tmp_path, photo(seen), made_up(), Shot(), SKY)
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
