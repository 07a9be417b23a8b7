import subprocess
import sys
from pathlib import Path

import pytest

pytest_plugins = ["command_fixtures"]

FILES = ["fit.json", "fitted.exr", "mask.png", "report.html", "weather.csv"]
SUN = "20,30"
QUICK = ("--sun", SUN, "--seconds", "0.001")  # ends after its first evaluation, not converged


@pytest.fixture
def inside(folder, monkeypatch):
    """The same folder, as the one the command runs in."""
    monkeypatch.chdir(folder)
    return folder


def assert_refused(ended, *said):
    status, out, err = ended
    assert status == 2
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    for text in said:
        assert text in err


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


@pytest.mark.slow
def test_a_summary_that_no_one_can_read_is_one_line(folder, tmp_path):
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "fit", "sky", str(folder / "sky.exr"), *QUICK, "--out", str(tmp_path)],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert_refused((ended.returncode, "", ended.stderr), "the results are written")
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
