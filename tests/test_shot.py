from datetime import datetime, timedelta, timezone

import pytest

from fit.input_error import InputError
from fit.shot import Shot

TIME = datetime(2016, 8, 14, 6, 30, 36, tzinfo=timezone(timedelta(hours=2)))
HEADER = {"time": TIME, "latitude": 10.0, "longitude": 20.0, "altitude": None}
NOTHING = dict.fromkeys(HEADER)


def test_nothing_known_places_no_sun():
    assert Shot().sun() is None
    assert Shot(heading=30.0).sun() is None


@pytest.mark.parametrize(
    "part", [Shot(latitude=1.0), Shot(longitude=1.0), Shot(time=TIME), Shot(1.0, 2.0), Shot(latitude=1.0, time=TIME)]
)
def test_a_part_of_place_and_time_is_refused(part):
    with pytest.raises(InputError, match=r"--latitude, --longitude and --time together"):
        part.sun()


@pytest.mark.slow
def test_heading_turns_the_sun_the_other_way():
    north, east = (Shot(-26.2, 27.9, TIME, heading).sun() for heading in (None, 90.0))
    assert north.azimuth - east.azimuth == pytest.approx(90.0)
    assert north.elevation == east.elevation


@pytest.mark.slow
def test_the_equator_has_the_sun_overhead_at_noon_of_an_equinox():
    noon = datetime(2024, 3, 20, 12, 7, tzinfo=timezone(timedelta(0)))  # the equation of time is -7 minutes
    assert Shot(0.0, 0.0, noon).sun().elevation == pytest.approx(90.0, abs=0.5)


def test_the_hour_is_local():
    assert Shot(time=TIME).hour == pytest.approx(6.51)
    assert Shot().hour is None


def test_a_header_fills_what_is_not_given():
    assert Shot(heading=5.0).completed(HEADER) == Shot(10.0, 20.0, TIME, 5.0)
    assert Shot().completed(NOTHING) == Shot()


def test_what_is_given_stands():
    given = Shot(-26.2, 27.9, TIME - timedelta(hours=1))
    assert given.completed(HEADER) == given


def test_latitude_and_longitude_come_from_one_source():
    assert Shot(latitude=1.0).completed(HEADER).longitude is None
    assert Shot().completed({**NOTHING, "latitude": 10.0}).latitude is None


def test_lines_say_what_is_known():
    assert Shot(-26.2, 27.9, TIME, 74.0).lines() == {
        "latitude": "-26.2",
        "longitude": "27.9",
        "date": "2016-08-14",
        "heading": "74",
    }
    assert Shot().lines() == {}


def test_single_precision_of_a_header_leaves_no_false_digits():
    assert Shot(-26.200000762939453, 27.899999618530273).lines() == {"latitude": "-26.2", "longitude": "27.9"}
