import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from synthetic_sky import CAMERA, radiance, save

from diffrender import rays
from fit import photo as photos
from fit import weather_file
from fit.objective import SkyObjective

pytest_plugins = ["command_fixtures"]

PHOTOS = Path(__file__).parents[1] / "experiments" / "photos"
FILES = ["fit.json", "fitted.exr", "mask.png", "report.html", "weather.csv"]
SUN = "20,30"
QUICK = ("--sun", SUN, "--seconds", "0.001")  # ends after its first evaluation, not converged


def layer(path, index):
    with OpenEXR.File(str(path)) as file:
        return file.parts[index].channels["RGB"].pixels


# What is told


@pytest.fixture(scope="module")
def fitted(folder, tmp_path_factory):
    """Results of a whole fit, and what was told of it, by a process of its own."""
    out = tmp_path_factory.mktemp("fitted") / "out"
    words = [sys.executable, "-m", "fit", "sky", str(folder / "sky.exr"), "--sun", SUN, "--out", str(out)]
    return out, subprocess.run(words, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_fit_writes_five_files_and_says_what_it_found(fitted):
    out, ended = fitted
    assert ended.returncode == 0
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert ended.stderr == ""
    assert "SKY_HAZINESS" in ended.stdout
    assert f"written to {out}" in ended.stdout
    account = json.loads((out / "fit.json").read_text())
    assert account["converged"]
    assert account["sun"]["elevation"] == 20.0
    assert (out / "weather.csv").read_text().splitlines()[2] == "# time: unknown"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_weather_byte_for_byte(run, folder, fitted, tmp_path):
    assert run("sky", folder / "sky.exr", "--sun", SUN, "--out", tmp_path, "--quiet") == (0, "", "")
    assert (tmp_path / "weather.csv").read_bytes() == (fitted[0] / "weather.csv").read_bytes()


@pytest.mark.slow
def test_a_fit_that_did_not_converge_says_so_and_writes(run, folder, tmp_path):
    status, out, err = run("sky", folder / "sky.exr", *QUICK, "--out", tmp_path)
    assert (status, err) == (1, "")
    assert "not converged" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    assert json.loads((tmp_path / "fit.json").read_text())["converged"] is False


@pytest.mark.slow
def test_quiet_prints_nothing(run, folder, tmp_path):
    assert run("sky", folder / "sky.exr", *QUICK, "--out", tmp_path, "--quiet") == (1, "", "")


@pytest.mark.slow
def test_place_and_time_are_written_down(run, folder, tmp_path):
    place = ("--latitude", "50", "--longitude", "8", "--time", "2020-06-01T06:30+02:00", "--heading", "10")
    run("sky", folder / "sky.exr", *place, "--seconds", "0.001", "--out", tmp_path)
    weather = weather_file.read(tmp_path / "weather.csv")
    assert weather.hours == (6.5,)
    assert {name: weather.header[name] for name in ("latitude", "longitude", "date", "heading")} == {
        "latitude": "50", "longitude": "8", "date": "2020-06-01", "heading": "10",
    }  # fmt: skip
    assert "time" not in weather.header
    assert 5.0 < weather.values["SUN_ELEVATION"][0] < 20.0  # an hour after sunrise


@pytest.mark.slow
def test_progress_is_shown_on_a_terminal_s_standard_error_alone(run, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    _, out, err = run("sky", folder / "sky.exr", *QUICK, "--out", tmp_path)
    assert "fitting" in err
    assert "fitting" not in out


# Interrupts


@pytest.mark.slow
def test_an_interrupted_solve_writes_the_best_so_far(run, folder, tmp_path, monkeypatch):
    jacobian, calls = SkyObjective.jacobian, []

    def interrupted(self, point):
        calls.append(point)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return jacobian(self, point)

    monkeypatch.setattr(SkyObjective, "jacobian", interrupted)
    status, out, err = run("sky", folder / "sky.exr", "--sun", SUN, "--out", tmp_path)
    assert (status, err) == (130, "")
    assert "interrupted" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    account = json.loads((tmp_path / "fit.json").read_text())
    assert (account["converged"], account["reason"]) == (False, "interrupted")


def test_an_interrupted_reading_writes_nothing(run, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(photos, "read", lambda *_: signal.raise_signal(signal.SIGINT))
    assert run("sky", folder / "sky.exr", "--out", tmp_path / "out") == (130, "", "")
    assert not any(tmp_path.iterdir())


# Render


CAMERAS = {
    "equirectangular": (CAMERA, ()),
    "hemisphere": (rays.Equirectangular(128, 32, lowest=0.0), ()),
    "cross": (rays.Cubemap(24, rays.CROSS_LYING), ("--projection", "cubemap")),
    "standing strip": (rays.Cubemap(24, rays.STRIP_STANDING), ()),
    "perspective": (rays.Perspective(96, 64, np.radians(70.0), np.radians(35.0)), ("--fov", "70", "--pitch", "35")),
}


@pytest.mark.slow
@pytest.mark.parametrize(("camera", "words"), CAMERAS.values(), ids=CAMERAS)
def test_rendering_a_fit_s_own_weather_gives_its_picture(run, tmp_path, camera, words):
    save(tmp_path / "photo.exr", radiance(camera=camera))
    assert run("sky", tmp_path / "photo.exr", *QUICK, *words, "--out", tmp_path / "out")[0] == 1
    size = f"{camera.width}x{camera.height}"
    drawn = tmp_path / "drawn.exr"
    assert run("render", tmp_path / "out" / "weather.csv", "--size", size, *words, "--out", drawn) == (0, "", "")
    for part in (0, 1):
        assert np.array_equal(layer(drawn, part), layer(tmp_path / "out" / "fitted.exr", part))


def test_a_sun_that_is_given_takes_the_place_of_the_weather_s(run, folder, tmp_path):
    for name, sun in (("own", ()), ("same", ("--sun", SUN)), ("other", ("--sun", "60,30"))):
        assert run("render", folder / "day.csv", "--size", "16x8", *sun, "--out", tmp_path / name)[0] == 0
    own, same, other = (layer(tmp_path / name, 0) for name in ("own", "same", "other"))
    assert np.array_equal(own, same)
    assert not np.allclose(own, other, rtol=0.1)


# Start and help


HELP = {
    "sky": "--out --mask --sun --latitude --longitude --time --heading --projection --fov --pitch --start --fix --free "
    "--solver --seconds --seed --quiet",
    "render": "--out --hour --size --sun --latitude --longitude --time --heading --projection --fov --pitch",
}


@pytest.mark.parametrize("name", HELP)
def test_help_names_every_option(run, name):
    status, out, _ = run(name, "--help")
    assert status == 0
    words = out.split()
    assert [option for option in HELP[name].split() if option not in words] == []


NOT_FOR_HELP = {"torch", "numpy", "scipy", "rich", "OpenEXR", "pvlib"}
NOT_FOR_SKY = {"kornia", "pvlib", "pandas", "skimage", "matplotlib", "rich"}
LOADED = """
import sys
from fit.__main__ import main
listing = sys.argv.pop(1)
try:
    main()
finally:
    with open(listing, "w") as file:
        print(*{name.split(".")[0] for name in sys.modules}, file=file)
"""


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """Run the command in a process of its own, in a terminal that knows few letters: what it told, what it loaded."""
    listing = tmp_path_factory.mktemp("elsewhere") / "modules"

    def run(*words):
        command = [sys.executable, "-c", LOADED, str(listing), *map(str, words)]
        ended = subprocess.run(command, capture_output=True, check=False, env={"PYTHONIOENCODING": "ascii"})
        return ended, set(listing.read_text().split())

    return run


@pytest.fixture(scope="module")
def fitted_elsewhere(elsewhere, folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "Zürich"
    return out, *elsewhere("sky", folder / "sky.exr", *QUICK, "--out", out)


@pytest.mark.parametrize("words", [("--help",), ("sky", "--help"), ("render", "--help")])
def test_help_starts_without_the_heavy_libraries(elsewhere, words):
    ended, modules = elsewhere(*words)
    assert ended.returncode == 0
    assert modules & NOT_FOR_HELP == set()


@pytest.mark.slow
def test_a_fit_loads_only_what_it_needs(fitted_elsewhere):
    out, _, modules = fitted_elsewhere
    assert (out / "fit.json").exists()
    assert modules & NOT_FOR_SKY == set()


@pytest.mark.slow
def test_a_terminal_that_knows_few_letters_is_no_error(fitted_elsewhere):
    out, ended, _ = fitted_elsewhere
    assert (ended.returncode, ended.stderr) == (1, b"")
    assert (out / "fit.json").exists()


@pytest.mark.slow
def test_a_real_photo_is_fitted_from_end_to_end(run, tmp_path):
    status, out, err = run("sky", PHOTOS / "rooitou_park.exr", "--out", tmp_path / "out")
    assert (status, err) == (0, "")
    assert "found in the picture" in out
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["error"] < 0.05
