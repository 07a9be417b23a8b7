from datetime import datetime, timedelta, timezone

import numpy as np
import OpenEXR
import pytest

from fit import day_times
from fit.input_error import InputError

MORNING = datetime(2016, 8, 14, 6, 30, tzinfo=timezone(timedelta(hours=2)))


@pytest.fixture
def photo(tmp_path):
    def written(name, **header):
        path = tmp_path / name
        with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, {"RGB": np.ones((4, 8, 3), np.float32)}) as file:
            file.write(str(path))
        return path

    return written


@pytest.mark.parametrize(
    "name",
    ["2016-08-14T0630+0200.exr", "roof_20160814T063000+02:00_b.hdr", "2016-08-14_06:30+02:00", "20160814_0430Z.exr"],
)
def test_a_name_tells_its_time(name):
    assert day_times.of_name(name) == MORNING


@pytest.mark.parametrize("name", ["noon.exr", "IMG_20160814.exr", "20161399T0630+0200.exr", "123456789012345.exr"])
def test_a_name_without_a_time_tells_none(name):
    assert day_times.of_name(name) is None


def test_table_goes_before_header_and_header_before_name(photo):
    said = {"capDate": "2016:08:14 06:30:00", "utcOffset": -7200.0}
    named = "2016-08-14T0800+0200.exr"
    path = photo(named, **said)
    later = MORNING + timedelta(hours=5)
    assert day_times.of_photos([path], {named: later}) == [later]
    assert day_times.of_photos([path], {}) == [MORNING]
    assert day_times.of_photos([photo(named)], {}) == [MORNING + timedelta(hours=1.5)]


def test_a_table_is_read_with_and_without_head(tmp_path):
    table = tmp_path / "times.csv"
    table.write_text("photo,time\na.exr,2016-08-14T06:30+02:00\n\n")
    headed = day_times.read(table)
    table.write_text("\ufeffa.exr, 2016-08-14T06:30+02:00\r\n")
    assert headed == day_times.read(table) == {"a.exr": MORNING}
    table.write_text("\ufeffphoto;time\r\na.exr;2016-08-14T06:30+02:00\r\n")
    assert headed == day_times.read(table)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a.exr,2016-08-14T06:30", "row 1: 2016-08-14T06:30 has no zone"),
        ("photo,time\na.exr,noon", "row 2: time 'noon'"),
        ("a.exr,2016-08-14T06:30+02:00:30", "row 1: the zone of .* has seconds; give whole minutes"),
        ("a.exr,1500-08-14T06:30+02:00", "row 1: the year of .*; allowed are those from 1700 to 2199"),
        ("a.exr,12h", "row 1: time '12h'"),
        ("a.exr", "row 1: 'a.exr'"),
        ("a.exr,2016-08-14T06:30Z\na.exr,2016-08-14T06:30Z", "row 2: a.exr stands twice"),
    ],
)
def test_a_wrong_row_is_named(tmp_path, text, said):
    (tmp_path / "times.csv").write_text(text)
    with pytest.raises(InputError, match=said.replace("'", ".")):
        day_times.read(tmp_path / "times.csv")


def test_tables_that_are_none_are_refused(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    for name, said in (("missing.csv", "No such file"), ("binary", "not UTF-8")):
        with pytest.raises(InputError, match=said):
            day_times.read(tmp_path / name)


def test_photos_without_a_whole_time_are_refused(photo):
    with pytest.raises(InputError, match=r"noon.exr has no time.*--times"):
        day_times.of_photos([photo("noon.exr")], {})
    with pytest.raises(InputError, match="without a zone"):
        day_times.of_photos([photo("20160814_0630.exr")], {})
    with pytest.raises(InputError, match=r"row for other\.exr"):
        day_times.of_photos([photo("noon.exr")], {"other.exr": MORNING})
