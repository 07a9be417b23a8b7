import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from synthetic_sky import CAMERA, HAZY_MORNING, radiance

from diffrender import rays
from fit import __main__ as command
from fit import photo as photos
from fit import png, weather_file
from fit.objective import SkyObjective
from fit.weather_file import of_photo

PHOTOS = Path(__file__).parents[1] / "experiments" / "photos"
FILES = ["fit.json", "fitted.exr", "mask.png", "report.html", "weather.csv"]
SUN = "20,30"
QUICK = ("--sun", SUN, "--seconds", "0.001")  # ends after its first evaluation, not converged


@pytest.fixture(autouse=True)
def threads():
    """The command sets the number of threads of its process, which here is that of all tests."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture
def run(monkeypatch, capfd):
    """Run the command in this process: exit status, standard output, standard error."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["fit", *map(str, words)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            command.main()
        told = capfd.readouterr()
        return ended.value.code or 0, told.out, told.err

    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A photo of a known sky, masks for it, and files that are no photos."""
    folder = tmp_path_factory.mktemp("given")
    save(folder / "sky.exr", radiance())
    save(folder / "black.exr", np.zeros((64, 128, 3), np.float32))
    save(folder / "odd.exr", radiance()[:50])
    save(folder / "depth_only.exr", Z=np.ones((64, 128), np.float32))
    whole = (folder / "sky.exr").read_bytes()
    (folder / "truncated.exr").write_bytes(whole[: len(whole) // 2])
    (folder / "text.exr").write_text("this is no picture\n")
    (folder / "empty.exr").write_bytes(b"")
    (folder / "jpeg.exr").write_bytes(b"\xff\xd8\xff\xe0" + bytes(100))
    (folder / "folder.exr").mkdir()
    (folder / "black.png").write_bytes(png.encoded(np.zeros((64, 128, 1), np.uint8)))
    (folder / "small.png").write_bytes(png.encoded(np.full((32, 64, 1), 255, np.uint8)))
    (folder / "text.png").write_text("this is no picture\n")
    (folder / "broken.csv").write_text("# weather 1\nTIME_OF_DAY,12\nSKY_HAZINESS,much\n")
    (folder / "no_sky.csv").write_text("# weather 1\nTIME_OF_DAY,12\nEXPOSURE,1\n")
    weather_file.write(folder / "day.csv", of_photo(HAZY_MORNING, None, {}))
    return folder


@pytest.fixture
def inside(folder, monkeypatch):
    """The same folder, as the one the command runs in."""
    monkeypatch.chdir(folder)
    return folder


def save(path, picture=None, **channels):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels or {"RGB": picture}) as file:
        file.write(str(path))


def layer(path, index):
    with OpenEXR.File(str(path)) as file:
        return file.parts[index].channels["RGB"].pixels


def assert_refused(ended, *said):
    status, out, err = ended
    assert status == 2
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    for text in said:
        assert text in err


# Bad input


BAD = {
    "missing file": (("missing.exr",), "missing.exr", "No such file"),
    "directory": (("folder.exr",), "is a folder"),
    "text": (("text.exr",), "neither OpenEXR nor Radiance"),
    "empty": (("empty.exr",), "is empty"),
    "JPEG": (("jpeg.exr",), "is a JPEG", "merge a bracketed series"),
    "truncated": (("truncated.exr",), "damaged or cut off"),
    "neither RGB nor Y": (("depth_only.exr",), "depth_only.exr"),
    "all black": (("black.exr",), "no light above the horizon"),
    "all black, sun given": (("black.exr", "--sun", SUN), "black.exr"),
    "wrong projection": (("sky.exr", "--projection", "cubemap"), "wrong projection for cubemap"),
    "no panorama": (("odd.exr",), "--fov"),
    "unknown projection": (("sky.exr", "--projection", "fisheye"), "fisheye", "allowed are equirectangular"),
    "fov of a panorama": (("sky.exr", "--projection", "equirectangular", "--fov", "60"), "--fov"),
    "fov too wide": (("odd.exr", "--fov", "180"), "--fov 180"),
    "pitch too steep": (("odd.exr", "--fov", "60", "--pitch", "100"), "--pitch 100"),
    "all masked": (("sky.exr", "--mask", "black.png"), "black everywhere"),
    "mask of another size": (("sky.exr", "--mask", "small.png"), "64 x 32", "128 x 64"),
    "mask not a picture": (("sky.exr", "--mask", "text.png"), "text.png"),
    "mask missing": (("sky.exr", "--mask", "missing.png"), "missing.png"),
    "unknown name in --fix": (("sky.exr", "--fix", "SKY_OZOME=1"), "nearest known one is SKY_OZONE"),
    "unknown name in --free": (("sky.exr", "--free", "SKY_OZOME"), "nearest known one is SKY_OZONE"),
    "value out of bounds": (("sky.exr", "--fix", "SKY_HAZINESS=2"), "SKY_HAZINESS is 2; allowed 0 to 0.99"),
    "--fix without =": (("sky.exr", "--fix", "SKY_OZONE"), "give NAME=VALUE"),
    "--fix of a gain": (("sky.exr", "--fix", "EXPOSURE=2"), "EXPOSURE"),
    "--sun": (("sky.exr", "--sun", "high"), "--sun 'high'; give ELEVATION,AZIMUTH"),
    "--sun of one number": (("sky.exr", "--sun", "20"), "give ELEVATION,AZIMUTH"),
    "--latitude alone": (("sky.exr", "--latitude", "50"), "--latitude, --longitude and --time together"),
    "--latitude too large": (("sky.exr", "--latitude", "91"), "--latitude"),
    "--time that is none": (("sky.exr", "--sun", SUN, "--time", "noon"), "--time 'noon'; give date, time and zone"),
    "--time without zone": (
        ("sky.exr", "--latitude", "50", "--longitude", "8", "--time", "2020-06-01T12:00"),
        "has no zone",
    ),
    "--heading": (("sky.exr", "--sun", SUN, "--heading", "400"), "--heading"),
    "--solver": (("sky.exr", "--solver", "magic"), "'magic' does not exist; use least-squares"),
    "--solver of nlopt": (("sky.exr", "--solver", "nlopt:LD_SLSQQ"), "LD_SLSQP"),
    "--seed negative": (("sky.exr", "--seed", "-1"), "--seed"),
    "--seed no number": (("sky.exr", "--seed", "x"), "--seed"),
    "--seconds 0": (("sky.exr", "--seconds", "0"), "--seconds"),
    "--seconds negative": (("sky.exr", "--seconds", "-3"), "--seconds"),
    "--seconds nan": (("sky.exr", "--seconds", "nan"), "--seconds"),
    "--start missing": (("sky.exr", "--start", "missing.csv"), "missing.csv"),
    "--start broken": (("sky.exr", "--start", "broken.csv"), "broken.csv, row 3, column 2"),
    "--start without sky": (("sky.exr", "--start", "no_sky.csv"), "holds no sky"),
    "no photo": ((), "photo"),
    "unknown option": (("sky.exr", "--magic"), "--magic"),
}


@pytest.mark.parametrize(("words", "said"), [(w, s) for w, *s in BAD.values()], ids=BAD)
def test_bad_input_is_one_line_and_leaves_nothing(run, inside, tmp_path, words, said):
    before = sorted(inside.iterdir())
    assert_refused(run("sky", *words, "--out", tmp_path / "out"), *said)
    assert not any(tmp_path.iterdir())
    assert sorted(inside.iterdir()) == before


BAD_RENDER = {
    "missing file": (("missing.csv",), "missing.csv"),
    "broken file": (("broken.csv",), "broken.csv, row 3, column 2"),
    "no sky": (("no_sky.csv",), "holds no sky"),
    "--size": (("day.csv", "--size", "big"), "--size big; give WIDTHxHEIGHT"),
    "--size of no shape": (("day.csv", "--size", "100x99"), "no shape of a panorama"),
    "--hour": (("day.csv", "--hour", "25"), "--hour"),
    "--hour nan": (("day.csv", "--hour", "nan"), "--hour"),
    "--projection": (("day.csv", "--projection", "fisheye"), "fisheye"),
    "--latitude alone": (("day.csv", "--latitude", "50"), "--latitude, --longitude and --time together"),
}


@pytest.mark.parametrize(("words", "said"), [(w, s) for w, *s in BAD_RENDER.values()], ids=BAD_RENDER)
@pytest.mark.usefixtures("inside")
def test_bad_input_of_render_is_one_line_and_leaves_nothing(run, tmp_path, words, said):
    assert_refused(run("render", *words, "--out", tmp_path / "out.exr"), *said)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("words", [(), ("fog_",), ("--magic",)])
def test_usage_errors_are_one_line(run, words):
    assert_refused(run(*words), "--help says what is allowed")


def test_names_with_control_characters_do_not_reach_the_terminal(run, tmp_path):
    ended = run("sky", tmp_path / "a\x1b[31m\nb.exr", "--out", tmp_path / "out")
    assert_refused(ended)
    assert "\x1b" not in ended[2]


# Results that cannot be written


def test_a_file_in_the_place_of_the_folder_is_refused(run, folder, tmp_path):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert_refused(run("sky", folder / "sky.exr", *QUICK, "--out", out), "is not a folder; give another --out")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_folder_in_the_place_of_a_file_is_refused(run, folder, tmp_path):
    (tmp_path / "report.html").mkdir()
    assert_refused(run("sky", folder / "sky.exr", *QUICK, "--out", tmp_path), "report.html is not a file")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_render_does_not_write_to_devices_and_folders(run, folder, tmp_path):
    for out in ("/dev/full", tmp_path):
        assert_refused(run("render", folder / "day.csv", "--size", "8x4", "--out", out), "cannot be replaced")
    assert_refused(run("render", folder / "day.csv", "--size", "8x4", "--out", tmp_path / "no" / "a.exr"), "cannot be")
    assert not any(tmp_path.iterdir())


FULL_DISK = """
import resource, sys
from fit.__main__ import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
sys.argv[1:2] = []
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(("room", "name"), [(100, ""), (10_000, "new")])  # not even the first file; not the picture
def test_a_full_disk_leaves_the_results_of_before(folder, tmp_path, room, name):
    (tmp_path / "weather.csv").write_text("of before")
    words = [room, "sky", folder / "sky.exr", *QUICK, "--out", tmp_path / name]
    ended = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *map(str, words)], capture_output=True, text=True, check=False
    )
    assert_refused((ended.returncode, ended.stdout, ended.stderr), "cannot be written", str(tmp_path / name))
    assert ".part" not in ended.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["weather.csv"]
    assert (tmp_path / "weather.csv").read_text() == "of before"


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


@pytest.mark.slow
def test_a_summary_that_no_one_can_read_is_one_line(folder, tmp_path):
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "fit", "sky", str(folder / "sky.exr"), *QUICK, "--out", str(tmp_path)],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert_refused((ended.returncode, "", ended.stderr), "the results are written")
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES


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
try:
    main()
finally:
    print(*{name.split(".")[0] for name in sys.modules}, file=sys.stderr)
"""


def loaded(*words):
    ended = subprocess.run(
        [sys.executable, "-c", LOADED, *map(str, words)], capture_output=True, text=True, check=False
    )
    return set(ended.stderr.split())


@pytest.mark.parametrize("words", [("--help",), ("sky", "--help"), ("render", "--help")])
def test_help_starts_without_the_heavy_libraries(words):
    assert loaded(*words) & NOT_FOR_HELP == set()


@pytest.mark.slow
def test_a_fit_loads_only_what_it_needs(folder, tmp_path):
    modules = loaded("sky", folder / "sky.exr", *QUICK, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "fit.json").exists()
    assert modules & NOT_FOR_SKY == set()


@pytest.mark.slow
def test_a_terminal_that_knows_few_letters_is_no_error(folder, tmp_path):
    ended = subprocess.run(
        [sys.executable, "-m", "fit", "sky", str(folder / "sky.exr"), *QUICK, "--out", str(tmp_path / "Zürich")],
        capture_output=True, check=False, env={"PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert (ended.returncode, ended.stderr) == (1, b"")
    assert (tmp_path / "Zürich" / "fit.json").exists()


@pytest.mark.slow
def test_a_real_photo_is_fitted_from_end_to_end(run, tmp_path):
    status, out, err = run("sky", PHOTOS / "rooitou_park.exr", "--out", tmp_path / "out")
    assert (status, err) == (0, "")
    assert "found in the picture" in out
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["error"] < 0.05
