"""`fit show LAMP.ies`: what a photometric file says, in a terminal and as a page."""

import math
from html.parser import HTMLParser

import pytest
from test_light_profile import GOOD, LOWER, WHOLE, beam, constant, cosine, lamp, one_sided

from fit import ies, lamp_page, lamp_sheet

pytest_plugins = ["command_fixtures"]
FINE = list(range(0, 91))


@pytest.fixture
def told(tmp_path):
    def told(*given, **changes):
        path = tmp_path / "lamp.ies"
        path.write_text(lamp(*given, **changes), encoding="latin-1")
        return lamp_sheet.sheet(ies.read(path))

    return told


def test_beam_and_field_are_those_of_the_formula(told):
    for plane in told(beam, FINE, [0]).planes:
        assert plane.beam == pytest.approx(2.0 * math.degrees(math.acos(0.5 ** (1 / 8))), abs=0.1)
        assert plane.field == pytest.approx(2.0 * math.degrees(math.acos(0.1 ** (1 / 8))), abs=0.1)


def test_an_uplight_is_as_wide_as_the_downlight_that_it_mirrors(told):
    up = told(lambda down, turn: beam(math.pi - down, turn), list(range(90, 181)), [0])
    down = told(beam, FINE, [0])
    assert [plane.beam for plane in up.planes] == [plane.beam for plane in down.planes]


@pytest.mark.parametrize(
    ("intensity", "angles", "symmetry"),
    [
        (cosine, [0], "round"),
        (cosine, [0, 45, 90], "alike in its quadrants"),
        (one_sided, list(range(0, 181, 15)), "alike to both sides"),
        (one_sided, list(range(0, 361, 15)), "none"),
    ],
)
def test_symmetry_is_told(told, intensity, angles, symmetry):
    assert told(intensity, WHOLE, angles).facts["symmetry"] == symmetry


def test_flux_stands_beside_what_the_file_states(told):
    assert told(cosine, LOWER, [0], lumens=2.0 * math.pi).facts["flux"] == (
        "3.14 lm; the file states 6.283 lm of bare lamps, of which this is 50.0%"
    )
    assert "states none" in told(cosine, LOWER, [0], lumens=-1).facts["flux"]


def test_what_a_file_says_under_a_figures_name_stands_beside_the_figure(told):
    facts = told(cosine, LOWER, [0], head="[FLUX] 9 lm\n[Lamp] LED\nTILT=NONE\n").facts
    assert (facts["[FLUX]"], facts["lamp"], facts["flux"][:7]) == ("9 lm", "LED", "3.14 lm")


def test_a_dark_lamp_has_no_angles(told):
    sheet = told(lambda down, turn: 0.0 * constant(down, turn), [0, 90], [0])
    assert sheet.facts["peak"] == "0 cd: it is dark"
    assert sheet.planes[0].beam is None
    middle = lamp_page.SIZE / 2.0
    for points in Paths(lamp_page.html("dark.ies", sheet)).paths:
        assert set(points) == {(middle, middle)}


class Paths(HTMLParser):
    def __init__(self, html):
        super().__init__()
        self.paths, self.loads = [], []
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.loads += [given[name] for name in ("src", "href") if name in given]
        if tag == "path":
            self.paths.append([tuple(map(float, point.split(","))) for point in given["d"][1:].split(" L")])


def test_the_command_prints_and_writes_a_page_whose_curves_are_the_lamps(run, tmp_path):
    path, out = tmp_path / "LAMP.IES", tmp_path / "lamp.html"
    path.write_text(lamp(cosine, FINE, [0], head="[TEST] <script>\nTILT=NONE\n"))
    status, told, complained = run("show", path, "--out", out)
    assert (status, complained) == (0, "")
    assert "beam angle" in told
    assert f"written to {out}" in told.replace("\n", " ")
    html = out.read_text(encoding="utf-8")
    assert "<script" not in html
    page = Paths(html)
    assert page.loads == []
    middle = lamp_page.SIZE / 2.0
    for points in page.paths:
        # A cosine's curve is a circle that touches the lamp.
        lit = [(right - middle, down - middle) for right, down in points if down > middle + 1.0]
        assert len(lit) > 100
        assert all(math.hypot(right, down - lamp_page.RADIUS / 2.0) == pytest.approx(lamp_page.RADIUS / 2.0, rel=1e-3)
                   for right, down in lit)  # fmt: skip


def test_a_bad_file_is_refused_in_one_line(run, tmp_path):
    path = tmp_path / "lamp.ies"
    path.write_text(GOOD.replace("TILT=NONE", "TILT=INCLUDE"))
    status, told, complained = run("show", path)
    assert (status, told, complained.count("\n")) == (2, "", 1)
    assert "allowed is TILT=NONE" in complained


def test_the_faintest_lamp_is_drawn_as_a_bright_one(told):
    faint, bright = (lamp_page.html("a.ies", told(constant, WHOLE, [0], multiplier=by)) for by in ("1e-320", "1000"))
    assert len(Paths(faint).paths) == 2
    assert Paths(faint).paths == Paths(bright).paths


def test_the_page_never_replaces_the_file_that_it_shows(run, tmp_path):
    path = tmp_path / "weather.html"
    path.write_text("# weather 1\nTIME_OF_DAY,12\nSKY_HAZINESS,0.5\n")
    content = path.read_bytes()
    status, told, complained = run("show", path, "--out", tmp_path / "." / "weather.html")
    assert (status, told, complained.count("\n")) == (2, "", 1)
    assert "is the file that is shown" in complained
    assert path.read_bytes() == content


def test_a_lamp_of_another_name_is_told_how_to_be_named(run, tmp_path):
    path = tmp_path / "lamp.txt"
    path.write_text(GOOD)
    status, told, complained = run("show", path)
    assert (status, told, complained.count("\n")) == (2, "", 1)
    assert "must be named .ies" in complained
