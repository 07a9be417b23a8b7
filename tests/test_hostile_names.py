"""File names and metadata that are made to harm whoever reads the results."""

import json
import os
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from synthetic_sky import radiance

from fit import exr, png, weather_file
from fit.input_error import InputError

pytest_plugins = ["command_fixtures"]

QUICK = ("--sun", "20,30", "--seconds", "0.001")  # ends after its first evaluation, not converged
PART = "\"'><script>part()</script>{{ 7 * 7 }}"
NAMES = {
    "markup": "\"'><script>alert(1)<&lt;{{ 7 * 7 }}{% raw %} =1+1,=cmd|' !A0,.exr",
    "lines and terminal": (
        "a\r\nSKY_HAZINESS,0.1\n# latitude: 90\x0b\x85\u2028# date: 2000-01-01\n"
        "\x1b]0;title\x07\x1b[2J\x9b31m \u202egpj.\u2066exr"
    ),
    "long": "x" * 251 + ".exr",
}
NO_TEXT = os.fsdecode(b"\xff\xfe\xc3(")


class Page(HTMLParser):
    """Elements of a page, and its text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[str] = []
        self.text = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append(f"{tag} {sorted(name for name, _ in attributes)}")

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """A photo in the second of two parts, whose names are hostile too."""
    path = tmp_path_factory.mktemp("content") / "sky.exr"
    parts = [({"Z": np.ones((64, 128), np.float32)}, "depth"), ({"RGB": radiance()}, PART)]
    with OpenEXR.File([OpenEXR.Part({"type": OpenEXR.scanlineimage}, *part) for part in parts]) as file:
        file.write(str(path))
    return path.read_bytes()


def fitted(run, folder, name, content):
    """Photo and results of a fit, with a mask whose name is as hostile; standard output."""
    folder.mkdir()
    photo, mask, out = folder / name, folder / f"{Path(name).stem}.png", folder / "out"
    photo.write_bytes(content)
    mask.write_bytes(png.encoded(np.repeat([255, 0], 32).astype(np.uint8)[:, None, None].repeat(128, 1)))
    status, told, complained = run("sky", photo, "--mask", mask, *QUICK, "--out", out)
    assert (status, complained) == (1, "")
    return photo, out, told


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Folder, and what a photo with a plain name gave."""
    return {"folder": tmp_path_factory.mktemp("plain") / "plain"}


@pytest.fixture
def plain(run, kept, content):
    """Results of a photo with a plain name, and standard output; fitted once."""
    if "fitted" not in kept:
        kept["fitted"] = fitted(run, kept["folder"], "sky.exr", content)
    return kept["fitted"][1:]


@pytest.mark.slow
@pytest.mark.parametrize("name", [NAMES["markup"], NAMES["lines and terminal"]], ids=["markup", "lines and terminal"])
def test_a_hostile_name_stays_a_name(run, tmp_path, content, plain, name):
    plain, plainly_told = plain
    photo, out, told = fitted(run, tmp_path / "hostile", name, content)
    # On the terminal: as many lines, nothing that moves its cursor or its direction of reading.
    assert told.count("\n") == plainly_told.count("\n")
    assert all(line.isprintable() for line in told.split("\n"))
    # In the page: the same elements, and nothing that is no text.
    page = Page((out / "report.html").read_text("utf-8"))
    assert page.elements == Page((plain / "report.html").read_text("utf-8")).elements
    assert all(line.isprintable() for line in page.text.replace("\t", " ").split("\n"))
    # In the weather file: the same lines, one of which tells the origin.
    weather, plain_weather = (weather_file.read(folder / "weather.csv") for folder in (out, plain))
    assert weather.values == plain_weather.values
    assert weather.header.keys() == plain_weather.header.keys() == {"origin", "time"}
    lines = [(folder / "weather.csv").read_bytes().splitlines() for folder in (out, plain)]
    assert [line for line in lines[0] if b"origin" not in line] == [line for line in lines[1] if b"origin" not in line]
    # In fit.json and in the picture: the name itself, in letters that every reader takes.
    account = (out / "fit.json").read_bytes()
    assert account.isascii()
    assert json.loads(account)["photo"] == photo.name
    assert json.loads(exr.read(out / "fitted.exr").header["diffrender"])["photo"] == photo.name


@pytest.mark.parametrize("name", [*NAMES.values(), NO_TEXT], ids=[*NAMES, "no text"])
def test_a_hostile_name_that_is_refused_is_one_line(run, tmp_path, name):
    photo = tmp_path / name
    photo.write_text("this is no picture\n")
    assert_one_line(run("sky", photo, "--out", tmp_path / "out"))


def test_names_that_are_no_text_are_refused_for_that_reason(run, tmp_path, content, folder):
    photo, hdr, mask = (tmp_path / f"{NO_TEXT}.{kind}" for kind in ("exr", "hdr", "png"))
    photo.write_bytes(content)
    hdr.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 64 +X 128\n" + bytes(4 * 64 * 128))
    mask.write_bytes(png.encoded(np.full((64, 128, 1), 255, np.uint8)))
    good, weather = folder / "sky.exr", folder / "day.csv"
    for words in (
        ("sky", photo, "--out", tmp_path / "out"),
        ("sky", hdr, "--out", tmp_path / "out"),
        ("sky", good, "--mask", mask, "--out", tmp_path / "out"),
        ("sky", good, *QUICK, "--out", tmp_path / NO_TEXT),
        ("render", weather, "--size", "8x4", "--out", tmp_path / NO_TEXT / "drawn.exr"),
    ):
        ended = run(*words)
        assert_one_line(ended)
        assert any(reason in ended[2] for reason in ("no UTF-8", "No such file"))
    assert sorted(tmp_path.iterdir()) == sorted((photo, hdr, mask))


def test_a_name_longer_than_any_file_s_is_one_line(tmp_path):
    with pytest.raises(InputError, match="File name too long"):
        exr.read(tmp_path / ("x" * 300))


def assert_one_line(ended):
    status, told, complained = ended
    assert (status, told, complained.count("\n")) == (2, "", 1)
    assert complained.startswith("error: ")
    assert complained.rstrip("\n").isprintable()
