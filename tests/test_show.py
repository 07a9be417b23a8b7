"""`fit show`: the table and the plots, in a terminal and as a page."""

import io
import json
import sys
from html.parser import HTMLParser

import pytest

from diffrender.scene import weather_names
from experiments import weather_files
from fit import keyframes, terminal, weather_file, weather_page
from fit.weather_file import Weather
from fit.weather_text import ASCII, BRAILLE, text

pytest_plugins = ["command_fixtures"]

DAY = Weather(
    (5.0, 6.5, 12.0, 18.25),
    {
        "SKY_HAZINESS": (0.76, None, 0.3, 0.62),
        "SKY_OZONE": (None, None, 1.25, None),
        "SUN_AZIMUTH": (60.0, 80.0, -180.0, -80.0),
        "HEIGHT_FOG_EXTINCTION": (0.001, 0.05, 0.0004, 0.002),
        "AA_SHARPENING": (None, None, None, None),
    },
    {"origin": "fit, photo dawn.exr"},
)


@pytest.fixture
def day(tmp_path):
    path = tmp_path / "day.csv"
    weather_file.write(path, DAY)
    return path


def long_day():
    hours = tuple(quarter / 4 for quarter in range(96))
    ends = {name: known.file_bounds for name, known in weather_names().items()}
    return Weather(hours, {name: (low, high) * 48 for name, (low, high) in ends.items()}, {})


def block(shown, name):
    """Lines of a parameter's plot."""
    return next(part for part in shown.split("\n\n")[1:] if part.startswith(name)).split("\n")


# In a terminal


def test_the_table_holds_names_units_and_keyframes():
    lines = [line.split() for line in text(DAY, 100, BRAILLE).split("\n")]
    assert ["TIME_OF_DAY", "h", "5", "6.5", "12", "18.25"] in lines
    assert ["SUN_AZIMUTH", "degrees", "to", "the", "right", "60", "80", "-180", "-80"] in lines
    assert ["HEIGHT_FOG_EXTINCTION", "1/m", "0.001", "0.05", "0.0004", "0.002"] in lines
    assert ["SKY_OZONE", "1.25"] in lines
    assert lines[0] == ["origin:", "fit,", "photo", "dawn.exr"]


def test_every_cell_stands_under_its_hour():
    head, row = (next(x for x in text(DAY, 100, ASCII).split("\n") if x.startswith(n)) for n in ("TIME", "SKY_HAZ"))
    assert head.index("12") + 2 == row.index("0.3") + 3


@pytest.mark.parametrize("width", [1, 20, 50, 80, 300])
def test_a_long_table_is_cut_into_blocks_that_fit_and_lose_nothing(width):
    weather = long_day()
    shown = text(weather, width, ASCII)
    assert sum(line.split().count("TIME_OF_DAY") for line in shown.split("\n")) == shown.count("TIME_OF_DAY")
    table = shown.partition("\nEXPOSURE, logarithmic")[0]
    assert max(map(len, table.split("\n"))) <= max(width, 51)  # a name and its unit are not cut
    row = [line for line in shown.split("\n\n") if "TIME_OF_DAY" in line]
    hours = [cell for part in row for cell in part.split("\n")[0 if width >= 80 else 1].split() if cell[0].isdigit()]
    assert list(map(float, hours)) == list(weather.hours)


@pytest.mark.parametrize("letters", [BRAILLE, ASCII])
def test_a_plot_runs_through_its_keyframes(letters):
    shown = text(DAY, 12 + 49, letters)  # two letters an hour, from 0 to 24
    title, *rows, axis, numbers = block(shown, "HEIGHT_FOG_EXTINCTION  1/m, log")
    assert title == "HEIGHT_FOG_EXTINCTION  1/m, logarithmic"
    assert [rows[0].split()[0], rows[-1].split()[0]] == ["0.05", "0.0004"]
    marks = [place for place, letter in enumerate(axis[12:]) if letter == letters.axis[1]]
    assert marks == [10, 13, 24, 36]
    assert [numbers[12 + 2 * hour :].split()[0] for hour in (0, 6, 12, 18, 24)] == ["0", "6", "12", "18", "24"]
    drawn = [row[12:].ljust(49) for row in rows]
    assert drawn[0][13] != " "  # the highest at 6.5
    assert drawn[3][24] != " "  # the lowest at noon
    assert all(any(row[place] != " " for row in drawn) for place in range(49))


def test_a_steep_curve_is_not_torn():
    weather = Weather((11.99, 12.0), {"SKY_OZONE": (0.0, 6.0)}, {})
    rows = [line[12:] for line in block(text(weather, 80, ASCII), "SKY_OZONE")[1:5]]
    steep = [row.ljust(80)[33:36].strip() for row in rows]
    assert all(steep)


def test_a_direction_that_passes_the_back_is_plotted_over_its_whole_circle():
    plot = block(text(DAY, 80, ASCII), "SUN_AZIMUTH")
    assert [plot[1].split()[0], plot[4].split()[0]] == ["180", "-180"]
    assert not any("|||" in line for line in plot)
    # Not joined from one end to the other: no column is drawn from top to bottom.
    columns = zip(*(line[12:].ljust(68) for line in plot[1:5]), strict=True)
    assert max(sum(letter != " " for letter in column) for column in columns) <= 2


def test_a_constant_is_one_level_line():
    title, line = block(text(DAY, 40, ASCII), "SKY_OZONE")
    assert title == "SKY_OZONE"
    assert line == f"{'1.25':>10}  {28 * '-'}"


def test_what_has_no_keyframe_is_named():
    assert "without a value:\n  AA_SHARPENING" in text(DAY, 80, ASCII)
    assert text(Weather((12.0,), {}, {}), 80, ASCII) == "TIME_OF_DAY  h  12"


# The command


def test_the_command_prints_in_letters_that_the_terminal_has(run, day, monkeypatch):
    monkeypatch.setattr(terminal.locale, "setlocale", lambda _: "C.UTF-8")
    monkeypatch.setenv("COLUMNS", "60")
    assert run("show", day) == (0, text(weather_file.read(day), 60, BRAILLE) + "\n", "")
    monkeypatch.setattr(terminal.locale, "setlocale", lambda _: "C")
    status, told, complained = run("show", day)
    assert (status, complained, told.isascii()) == (0, "", True)


def test_plain_letters_come_out_of_a_pipe_that_knows_no_others(run, day, monkeypatch):
    monkeypatch.setattr(terminal.locale, "setlocale", lambda _: "C.UTF-8")
    pipe = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", pipe)
    assert run("show", day) == (0, "", "")
    told = pipe.buffer.getvalue()
    assert b"HEIGHT_FOG_EXTINCTION" in told
    assert b"?" not in told


def test_a_closed_output_is_no_error(run, day, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    assert run("show", day) == (0, "", "")


class Closed:
    """Standard output whose reader has gone, or whose disk is full."""

    encoding = "utf-8"

    def __init__(self, error, number):
        self.error, self.number = error, number

    def write(self, _):
        raise self.error

    def flush(self):
        raise self.error

    def fileno(self):
        return self.number


def test_a_pipe_that_is_closed_early_is_no_error(run, day, monkeypatch, tmp_path):
    with (tmp_path / "nothing").open("w") as file:
        monkeypatch.setattr(sys, "stdout", Closed(BrokenPipeError(32, "Broken pipe"), file.fileno()))
        assert run("show", day) == (0, "", "")
        monkeypatch.setattr(sys, "stdout", Closed(OSError(28, "No space left on device"), file.fileno()))
        status, _, complained = run("show", day)
    assert status == 2
    assert complained == "error: standard output fails (No space left on device); give it another place\n"


def test_hostile_headers_do_not_reach_the_terminal(run, tmp_path):
    path = tmp_path / "day.csv"
    path.write_text("# weather 1\n# origin: \x1b[2J\u202e<script>\nTIME_OF_DAY,6\nSKY_OZONE,1\n", encoding="utf-8")
    status, told, complained = run("show", path, "--out", tmp_path / "day.html")
    assert (status, complained) == (0, "")
    assert all(line.isprintable() for line in told.split("\n"))
    page = (tmp_path / "day.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert page.replace("\n", "").isprintable()


@pytest.mark.parametrize("name", ["day.png", "day", "day.csv"])
def test_a_page_of_another_kind_is_refused(run, day, tmp_path, name):
    out = tmp_path / "out" / name
    status, told, complained = run("show", day, "--out", out)
    assert (status, told, complained.count("\n")) == (2, "", 1)
    assert "give a name that ends in .html" in complained
    assert not out.exists()


# The page


class Page(HTMLParser):
    """Paths, dots with what they say, and whatever would be loaded."""

    def __init__(self, html):
        super().__init__()
        self.paths, self.dots, self.loads, self.cells = [], [], [], 0
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.loads += [given[name] for name in ("src", "href") if name in given]
        if tag == "path":
            self.paths.append(given["d"])
        elif tag == "circle":
            self.dots.append((float(given["cx"]), float(given["cy"])))
        elif tag == "td":
            self.cells += 1


def test_the_page_has_a_curve_through_every_keyframe():
    page = Page(weather_page.page("day.csv", DAY))
    assert page.loads == []
    assert len(page.paths) == 4
    assert len(page.dots) == 12
    assert page.cells == 20
    for path in page.paths:
        points = [tuple(map(float, point[1:].split(","))) for point in path.split()]
        assert [points[0][0], points[-1][0]] == [0.0, weather_page.WIDTH]
        assert all(0.0 <= down <= weather_page.HEIGHT for _, down in points)
    every = {point[1:] for path in page.paths for point in path.split()}
    assert all(f"{right:.2f},{down:.2f}" in every for right, down in page.dots)
    assert sum(path.count("M") for path in page.paths) == 5  # the azimuth passes the back once


def test_curves_are_what_is_drawn():
    hours = [0.0, 6.5, 11.0, 23.0]
    over = keyframes.over(DAY, hours)
    assert [dict(zip(over, values, strict=True)) for values in zip(*over.values(), strict=True)] == [
        keyframes.at(DAY, hour) for hour in hours
    ]


# The experiment


def test_weather_files_are_read_or_refused(tmp_path, capsys):
    weather_files.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "weather_files.json").read_text())
    assert content["faults"] == []
    assert set(content["same_bits"].values()) == {content["files"]}
    assert content["content"]["subnormal numbers"] > 0
    assert len(content["refusals"]) >= 20
    assert "same bits" in capsys.readouterr().out


def test_the_experiment_finds_what_is_wrong(monkeypatch, tmp_path):
    monkeypatch.setitem(weather_files.DIALECTS, "tabs", lambda text: text.replace("1", "2"))
    _, faults = weather_files.round_trips(tmp_path, 3, 0)
    assert {fault.partition(": ")[0] for fault in faults} == {"0, tabs", "1, tabs", "2, tabs"}
    good = weather_files.Ending(2, "", "error: no such thing\n")
    assert good.fault("no such") == ""
    assert good.fault("something") == "another reason"
    assert weather_files.Ending(1, "", "error: no\n").fault("no") == "ended with status 1"
    assert weather_files.Ending(2, "", "error: no\nTraceback\n").fault("no") == "more or less than one line"
