import math
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffrender.scene import weather_names
from fit import weather_file
from fit.input_error import InputError
from fit.weather_file import CLOSEST, Weather, check, of_photo, read, write

TEXT = """# weather 1
# origin: fit 0.1.0, photo spruit_sunrise.exr
# latitude: -26.2
# time: unknown
TIME_OF_DAY,6.5,12,18
EXPOSURE,0.25,,1e-07
SUN_ELEVATION,-0,45,
"""
WEATHER = Weather(
    hours=(6.5, 12.0, 18.0),
    values={"EXPOSURE": (0.25, None, 1e-7), "SUN_ELEVATION": (-0.0, 45.0, None)},
    header={"origin": "fit 0.1.0, photo spruit_sunrise.exr", "latitude": "-26.2", "time": "unknown"},
)


def bits(weather: Weather) -> object:
    """What tells -0.0 from 0.0, and the orders of rows and header lines apart."""

    def pack(cells: tuple[float | None, ...]) -> list[bytes | None]:
        return [None if cell is None else struct.pack("<d", cell) for cell in cells]

    rows = [(name, pack(cells)) for name, cells in weather.values.items()]
    return pack(weather.hours), rows, list(weather.header.items())


def read_text(folder: Path, text: str) -> Weather:
    file = folder / "storm.csv"
    file.write_bytes(text.encode())
    return read(file)


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as refused:
        read_text(folder, text)
    message = str(refused.value)
    assert message.isprintable()
    assert str(folder / "storm.csv") in message
    return message


@st.composite
def weathers(draw: st.DrawFn) -> Weather:
    hours: list[float] = []
    for hour in sorted(draw(st.sets(st.floats(0.0, 24.0, exclude_max=True), min_size=1, max_size=5))):
        if not hours or (hour - hours[-1] >= CLOSEST and hour - hours[0] <= 24.0 - CLOSEST):
            hours.append(hour)
    known = weather_names()
    values = {
        name: tuple(draw(st.none() | st.floats(*known[name].file_bounds)) for _ in hours)
        for name in draw(st.lists(st.sampled_from(sorted(known)), unique=True, max_size=4))
    }
    names = st.sampled_from(["origin", "a", "Date of photo", "x-1_"])
    texts = st.text("aB3 .,:;#'é", max_size=12).map(lambda text: text.strip(" ,;"))
    return Weather(tuple(hours), values, draw(st.dictionaries(names, texts, max_size=3)))


@given(weather=weathers())
@settings(derandomize=True, max_examples=20, deadline=None)
def test_reading_what_was_written_gives_the_same_bits(
    tmp_path_factory: pytest.TempPathFactory, weather: Weather
) -> None:
    file = tmp_path_factory.getbasetemp() / "round_trip.csv"
    write(file, weather)
    assert bits(read(file)) == bits(weather)


def test_the_text_is_the_one_of_the_design(tmp_path: Path) -> None:
    write(tmp_path / "weather.csv", WEATHER)
    assert (tmp_path / "weather.csv").read_bytes() == TEXT.encode()


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write(tmp_path / "absent" / "weather.csv", WEATHER)


@pytest.mark.parametrize(
    "text",
    [
        TEXT,
        "\ufeff" + TEXT,
        TEXT.replace("\n", "\r\n"),
        TEXT.replace("\n", "\r"),
        TEXT.rstrip("\n"),
        TEXT.replace("\n", "\n\n"),
        TEXT.replace("0.1.0,", "0.1.0;").replace(",", ";").replace("0.1.0;", "0.1.0,"),
        TEXT.replace(",", "\t").replace("0.1.0\t", "0.1.0,"),
        TEXT.replace(",", " , ").replace("0.1.0 ,  ", "0.1.0, "),
        "\n".join(line if line.startswith("#") else f'"{line}"'.replace(",", '","') for line in TEXT.split("\n")[:-1]),
        "\n".join(line + "," * (5 - line.count(",")) for line in TEXT.split("\n")),
        "\n".join(f'"{line}"' if line.startswith("#") else line for line in TEXT.split("\n")),
    ],
    ids=[
        "as written", "byte order mark", "Windows", "old Mac", "no last line end", "empty lines", "semicolons", "tabs",
        "spaces", "quoted cells", "rows filled up", "quoted header",
    ],
)  # fmt: skip
def test_what_spreadsheets_save_reads_the_same(tmp_path: Path, text: str) -> None:
    assert bits(read_text(tmp_path, text)) == bits(WEATHER)


def test_a_header_that_a_spreadsheet_has_cut_at_its_commas_is_whole_again(tmp_path: Path) -> None:
    for separator in ",;\t":
        lines = ["# weather 1", "# origin: a, b,c", "TIME_OF_DAY,6,12,18"]
        cut = "\n".join(line.replace(",", separator) + separator * (3 - line.count(",")) for line in lines)
        assert read_text(tmp_path, cut).header == {"origin": "a, b,c"}
    kept = '# weather 1\n"# origin: a; b";;\nTIME_OF_DAY;6;12\n'
    assert read_text(tmp_path, kept).header == {"origin": "a; b"}


TABLE = "# weather 1\n# origin: x\nTIME_OF_DAY,6,12\n"


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("", "row 1, column 1", "reads only '# weather 1'"),
        ("TIME_OF_DAY,6\n", "row 1, column 1", "reads only '# weather 1'"),
        (TABLE.replace("weather 1", "weather 2"), "row 1, column 1", "format '# weather 2'"),
        (TABLE.replace("weather 1", "weather 10"), "row 1, column 1", "format '# weather 10'"),
        (TABLE.replace("origin: x", "origin"), "row 2, column 1", "# name: value"),
        (TABLE.replace("# origin", "# origin: y\n# origin"), "row 3, column 1", "origin stands twice"),
        ("# weather 1\n", "", "no row TIME_OF_DAY"),
        ("# weather 1\nEXPOSURE,1\n", "row 2, column 1", "first row of the table is TIME_OF_DAY"),
        ("# weather 1\nTIME_OF_DAY\n", "row 2, column 1", "first row of the table is TIME_OF_DAY"),
        ("# weather 1\nTIME_OF_DAY,,\n", "row 2, column 2", "no hours"),
        ("# weather 1\nTIME_OF_DAY,6,,12\n", "row 2, column 3", "'' is not a finite number"),
        ("# weather 1\nTIME_OF_DAY,6,24\n", "row 2, column 3", "from 0 to below 24"),
        ("# weather 1\nTIME_OF_DAY,-1\n", "row 2, column 2", "from 0 to below 24"),
        ("# weather 1\nTIME_OF_DAY,6:30\n", "row 2, column 2", "for half past six, 6.5"),
        ("# weather 1\nTIME_OF_DAY,1e999\n", "row 2, column 2", "from 0 to below 24"),
        ("# weather 1\nTIME_OF_DAY,6,12,9\n", "row 2, column 4", "hours rise"),
        ("# weather 1\nTIME_OF_DAY,6,12,12\n", "row 2, column 4", "hour 12 stands twice"),
        ("# weather 1\nTIME_OF_DAY,6,12,6\n", "row 2, column 4", "hour 6 stands twice"),
        ("# weather 1\nTIME_OF_DAY,0,12,23.9999999\n", "row 2, column 4", "over midnight too"),
        (TABLE + "EXPOSUR,1,2\n", "row 4, column 1", "unknown name 'EXPOSUR'; the nearest known one is EXPOSURE"),
        (TABLE + "sun_elevation,1,2\n", "row 4, column 1", "the nearest known one is SUN_ELEVATION"),
        (TABLE + ",1,2\n", "row 4, column 1", "unknown name ''"),
        (TABLE + "EXPOSURE,1,2\nEXPOSURE,1,2\n", "row 5, column 1", "EXPOSURE stands twice"),
        (TABLE + "EXPOSURE,1\n", "row 4, column 3", "1 cells for 2"),
        (TABLE + "EXPOSURE,1,2,3\n", "row 4, column 4", "3 cells for 2"),
        (TABLE + "EXPOSURE,1,2,\n", "row 4, column 4", "3 cells for 2"),
        (TABLE + "EXPOSURE,0,5,2\n", "row 4, column 4", "decimals with a point"),
        (TABLE.replace("12\n", "12,\n") + "EXPOSURE,1,2,3\n", "row 4, column 4", "'3' stands under no hour"),
        (TABLE + 'EXPOSURE,1,"0,5"\n', "row 4, column 3", "decimal comma; write 0.5"),
        (TABLE.replace(",", ";") + "EXPOSURE;1;0,5\n", "row 4, column 3", "decimal comma; write 0.5"),
        (
            TABLE + 'EXPOSURE,1,"1,500"\n',
            "row 4, column 3",
            "decimal comma; write 1.500, or 1500 if it marks thousands",
        ),
        (TABLE + "EXPOSURE,1,nan\n", "row 4, column 3", "'nan' is not a finite number"),
        (TABLE + "EXPOSURE,1,-inf\n", "row 4, column 3", "'-inf' is not a finite number"),
        (TABLE + "EXPOSURE,1,1_0\n", "row 4, column 3", "'1_0' is not a finite number"),
        (TABLE + "EXPOSURE,1,\u0663\n", "row 4, column 3", "is not a finite number"),
        (TABLE + "EXPOSURE,1,1e999\n", "row 4, column 3", "EXPOSURE is inf; allowed"),
        (TABLE + "SUN_ELEVATION,1,90.5\n", "row 4, column 3", "SUN_ELEVATION is 90.5; allowed -90 to 90 degrees"),
        (TABLE + 'EXPOSURE,1,"2\n', "row 4, column 1", "check the quotes"),
        (TABLE + "# note: after the table\n", "row 4, column 1", "unknown name '# note"),
        (TABLE + "\x1b[31m,1,2\n", "row 4, column 1", "unknown name"),
        (TABLE + "X" * 100_000 + ",1,2\n", "row 4, column 1", "unknown name 'XXX"),
    ],
)
def test_an_error_names_file_row_and_column(tmp_path: Path, text: str, place: str, said: str) -> None:
    message = refusal(tmp_path, text)
    assert place in message
    assert said in message
    assert len(message) < len(str(tmp_path)) + 300


@pytest.mark.parametrize("name", sorted(weather_names()))
def test_values_just_outside_their_bounds_are_refused_with_the_allowed_range(tmp_path: Path, name: str) -> None:
    low, high = weather_names()[name].file_bounds
    head = "# weather 1\nTIME_OF_DAY,12\n"
    assert read_text(tmp_path, f"{head}{name},{low}\n").values[name] == (low,)
    assert read_text(tmp_path, f"{head}{name},{high}\n").values[name] == (high,)
    for outside in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf)):
        message = refusal(tmp_path, f"{head}{name},{outside}\n")
        assert f"{low!r}".removesuffix(".0") in message
        assert f"{high!r}".removesuffix(".0") in message


@pytest.mark.parametrize("name", sorted(weather_names()))
def test_a_misspelt_name_meets_the_known_one(tmp_path: Path, name: str) -> None:
    refused = refusal(tmp_path, f"# weather 1\nTIME_OF_DAY,12\n{name.lower()},1\n")
    assert refused.endswith(f"the nearest known one is {name}")


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "storm.csv"
    file.write_bytes(TEXT.encode("utf-16"))
    with pytest.raises(InputError, match=r"storm.csv, row 1, column 1: not UTF-8; save it as CSV in UTF-8"):
        read(file)
    file.write_bytes(TEXT.replace("spruit", "Tür").encode("latin-1"))
    with pytest.raises(InputError, match=r"storm.csv, row 2, column 1: not UTF-8"):
        read(file)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent.csv: No such file or directory; give a weather file"):
        read(tmp_path / "absent.csv")
    with pytest.raises(InputError, match="Is a directory"):
        read(tmp_path)


def test_the_largest_file_is_read_and_a_larger_one_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weather_file, "LARGEST", len(TEXT))
    assert bits(read_text(tmp_path, TEXT)) == bits(WEATHER)
    assert "more than" in refusal(tmp_path, TEXT + "\n")


@pytest.mark.parametrize(
    "evil", ["a\nEXPOSURE,5", "a\r\n# origin: b", 'a,"b', "a\u2028b", "a\x1b[2Jb", "a\udc80b", "a\tb"]
)
def test_hostile_header_texts_stay_on_their_line(tmp_path: Path, evil: str) -> None:
    write(tmp_path / "weather.csv", Weather((12.0,), {"EXPOSURE": (2.0,)}, {"origin": evil, "date": "2016-08-14"}))
    text = (tmp_path / "weather.csv").read_text(encoding="utf-8")
    assert text.replace("\n", "").isprintable()
    assert '"' not in text
    found = read(tmp_path / "weather.csv")
    assert found.values == {"EXPOSURE": (2.0,)}
    assert list(found.header) == ["origin", "date"]
    assert found.header["origin"].startswith("a")


@pytest.mark.parametrize("start", ["=", "+", "-", "@", " =", "\t="])
@pytest.mark.parametrize("separator", [",", ";", "\t,"])
def test_no_header_text_becomes_a_formula(tmp_path: Path, separator: str, start: str) -> None:
    write(tmp_path / "weather.csv", Weather((12.0,), {}, {"origin": f"photo a{separator}{start}cmd()"}))
    cells = (tmp_path / "weather.csv").read_text(encoding="utf-8").replace(";", ",").replace("\n", ",").split(",")
    assert not any(cell.strip().startswith(("=", "+", "-", "@")) for cell in cells)


def test_a_photo_of_unknown_time_stands_at_noon() -> None:
    weather = of_photo({"EXPOSURE": 2.0}, None, {"origin": "fit"})
    assert weather == Weather((12.0,), {"EXPOSURE": (2.0,)}, {"origin": "fit", "time": "unknown"})


def test_a_photo_of_known_time_stands_at_its_hour() -> None:
    weather = of_photo({"EXPOSURE": 2.0}, 6.5, {"origin": "fit"})
    assert weather == Weather((6.5,), {"EXPOSURE": (2.0,)}, {"origin": "fit"})


@pytest.mark.parametrize(
    ("hours", "values", "header"),
    [
        ((), {}, {}),
        ((24.0,), {}, {}),
        ((math.nan,), {}, {}),
        ((12.0, 6.0), {}, {}),
        ((12.0,), {"NO_SUCH_NAME": (1.0,)}, {}),
        ((12.0,), {"EXPOSURE": (1.0, 2.0)}, {}),
        ((12.0,), {"EXPOSURE": (math.nan,)}, {}),
        ((12.0,), {"EXPOSURE": (-1.0,)}, {}),
        ((12.0,), {}, {"a:b": ""}),
        ((12.0,), {}, {"a\nb": ""}),
        ((12.0,), {}, {"a ": ""}),
        ((12.0,), {}, {"": ""}),
    ],
)
def test_what_could_not_be_read_back_is_no_weather(
    hours: tuple[float, ...], values: dict[str, tuple[float | None, ...]], header: dict[str, str]
) -> None:
    with pytest.raises(InputError):
        Weather(hours, values, header)


def test_check_refuses_what_a_file_could_not_hold() -> None:
    check("SUN_ELEVATION", 90.0)
    with pytest.raises(InputError, match=r"^SUN_ELEVATION is 91; allowed -90 to 90 degrees$"):
        check("SUN_ELEVATION", 91.0)
    with pytest.raises(InputError, match=r"^unknown name 'SUN_ELEVATIO'; the nearest known one is SUN_ELEVATION$"):
        check("SUN_ELEVATIO", 1.0)
