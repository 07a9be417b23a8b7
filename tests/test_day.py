"""`fit day` from photos to files, on panoramas of our own renderer."""

import json
import math
import sys
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from synthetic_sky import HAZY_MORNING, save

from diffrender.atmosphere import sky as skies
from diffrender.rays import Equirectangular, Perspective
from diffrender.scene import weather_names
from fit import day, day_photo, day_results, day_sun, keyframes, photo, picture, sun, weather_file
from fit.asked import Options
from fit.day_curves import Observation
from fit.input_error import InputError
from fit.shot import sun_of_weather
from fit.solution import SunPlace

pytest_plugins = ["command_fixtures"]

ZONE = timezone(timedelta(hours=2))
PLACE = ("--latitude", "48", "--longitude", "11")
FILES = ["day.json", "report.html", "weather.csv"]


def time_at(hour):
    return datetime(2020, 6, 21, hour, tzinfo=ZONE)


def place_at(hour, heading):
    return sun.from_place(48.0, 11.0, time_at(hour), heading)


def drawn(hour, heading, camera, **values):
    place = place_at(hour, heading)
    whole = HAZY_MORNING | values | {"SUN_ELEVATION": place.elevation, "SUN_AZIMUTH": place.azimuth}
    seen = picture.draw(keyframes.scene(whole), camera)["sky"]
    return seen * np.random.default_rng(hour).lognormal(0.0, 0.02, seen.shape).astype(np.float32)


def with_disc(seen, camera, towards):
    """A picture in which the pixel of a direction, and those beside it, are a sun's."""
    x, y = (int(place) for place in camera.place(towards))
    seen = seen.copy()
    seen[y - 1 : y + 2, x - 1 : x + 2] = 3e4
    return seen


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Three panoramas of a day, hazier from one to the next, a night among them."""
    folder = tmp_path_factory.mktemp("day")
    for hour, haze in ((9, 3.0), (12, 5.0), (16, 8.0)):
        camera = Equirectangular(64, 32)
        save(folder / f"{time_at(hour):%Y%m%dT%H%M}+0200.exr", drawn(hour, 100.0, camera, SKY_MIE_SCALE=haze))
    save(folder / "20200621T0100+0200.exr", np.ones((32, 64, 3), np.float32))
    return folder


@pytest.fixture(scope="module")
def fitted(given, tmp_path_factory):
    """Those fitted once: the results' folder, and the words that were given."""
    out = tmp_path_factory.mktemp("out") / "day"
    return out, ("day", *sorted(given.glob("*.exr")), *PLACE, "--heading", "100", "--jobs", "1", "--out", out)


@pytest.fixture
def done(run, fitted):
    out, words = fitted
    if not out.exists():
        assert run(*words)[0] == 0
    return out, words


@pytest.mark.slow
def test_a_day_becomes_one_weather_file(done):
    out, _ = done
    weather = weather_file.read(out / "weather.csv")
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert {"SUN_ELEVATION", "SUN_AZIMUTH"} & weather.values.keys() == set()
    assert {name: weather.header[name] for name in ("date", "zone", "heading")} == {
        "date": "2020-06-21", "zone": "+02:00", "heading": "100",
    }  # fmt: skip
    haze = [keyframes.at(weather, hour)["SKY_MIE_SCALE"] for hour in (9.0, 12.0, 16.0)]
    assert haze == sorted(haze)
    assert haze[2] > 1.5 * haze[0]
    assert sum(cell is not None for cell in weather.values["SKY_OZONE"]) == 1


@pytest.mark.slow
def test_a_night_is_left_out_and_said(done):
    photos = json.loads((done[0] / "day.json").read_text())["photos"]
    assert [photo["refused"] is None for photo in photos] == [False, True, True, True]
    assert "night" in photos[0]["refused"]
    assert all(photo["error_at_curve"] < 2.25 * photo["error"] for photo in photos[1:])  # half as far off again
    assert "below the horizon" in (done[0] / "report.html").read_text()


@pytest.mark.slow
def test_a_resumed_run_fits_nothing_again_and_gives_the_same_bytes(run, done, monkeypatch):
    out, words = done
    before = {name: (out / name).read_bytes() for name in FILES}
    monkeypatch.setattr(day_photo, "_estimate", lambda *_: pytest.fail("fitted again"))
    assert run(*words, "--resume", "--quiet") == (0, "", "")
    assert {name: (out / name).read_bytes() for name in FILES} == before


@pytest.mark.slow
def test_what_has_changed_or_is_damaged_is_fitted_again(run, done, monkeypatch):
    out, words = done
    parts = sorted(out.parent.glob("day.parts/*.json"))
    parts[2].write_text(parts[2].read_text()[:-100])
    again = []
    estimate = day_photo._estimate
    monkeypatch.setattr(day_photo, "_estimate", lambda view, *rest: again.append(view) or estimate(view, *rest))
    assert run(*words, "--resume")[0] == 0
    assert len(again) == 1
    assert parts == sorted(out.parent.glob("day.parts/*.json"))


@pytest.mark.slow
def test_drawing_a_day_places_the_sun_by_its_header(run, done, tmp_path):
    weather = weather_file.read(done[0] / "weather.csv")
    expected = place_at(9, 100.0)
    placed = sun_of_weather(weather.header, 9.0)
    assert (placed.elevation, placed.azimuth) == (expected.elevation, expected.azimuth)
    assert run("render", done[0] / "weather.csv", "--hour", "9", "--size", "32x16", "--out", tmp_path / "a.exr")[0] == 0
    place = f"{expected.elevation},{expected.azimuth}"
    words = ("render", done[0] / "weather.csv", "--hour", "9", "--size", "32x16", "--sun", place)
    assert run(*words, "--out", tmp_path / "b.exr")[0] == 0
    first, second = (photo.read(tmp_path / name).radiance for name in ("a.exr", "b.exr"))
    assert np.array_equal(first, second)


def test_a_header_without_a_zone_places_no_sun_and_a_strange_one_is_refused():
    header = {"latitude": "48", "longitude": "11", "date": "2020-06-21"}
    assert sun_of_weather(header, 9.0) is None
    with pytest.raises(InputError, match=r"zone: here.*zone such as"):
        sun_of_weather(header | {"zone": "here"}, 9.0)
    plain, turned = (sun_of_weather(header | {"zone": "+02:00"}, 9.0, heading) for heading in (None, 90.0))
    assert (plain.azimuth - turned.azimuth) % 360.0 == pytest.approx(90.0)


# Bad input


@pytest.fixture
def among_files(folder, monkeypatch):
    """In a folder of files that are no photos of a day, where dask is not installed."""
    monkeypatch.chdir(folder)
    monkeypatch.setitem(sys.modules, "distributed", None)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["jpeg.exr"], "is a JPEG"),
        (["sky.exr"], "has no time"),
        (["sky.exr", "sky.exr"], "two photos are named sky.exr"),
        (["sky.exr", "--times", "broken.csv"], "row 1"),
        (["sky.exr", "--jobs", "0"], "--jobs 0"),
        (["sky.exr", "--solver", "guess"], "guess"),
        (["sky.exr", "--scheduler", "tcp://127.0.0.1:1"], "needs dask"),
    ],
)
@pytest.mark.usefixtures("among_files")
def test_what_cannot_be_used_is_one_line_before_any_fit(run, tmp_path, words, said):
    status, out, err = run("day", *words, *PLACE, "--out", tmp_path / "out")
    assert (status, out) == (2, "")
    assert said in err
    assert err.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_a_day_of_nothing_but_nights_is_refused(run, given, tmp_path):
    status, _, err = run("day", given / "20200621T0100+0200.exr", *PLACE, "--jobs", "1", "--out", tmp_path / "out")
    assert status == 2
    assert "none of 1 photos can be used" in err


# How a photo was turned


def seen_at(tmp_path, hour, seen, turned):
    path = tmp_path / "seen.exr"
    save(path, seen)
    return day_sun.seen(path, replace(place_at(hour, 0.0), how="by astronomy"), turned, Options())


def test_a_disc_tells_the_heading(tmp_path):
    camera = Equirectangular(128, 64)
    seen = with_disc(drawn(10, 100.0, camera), camera, sun.to_sun(place_at(10, 100.0)))
    view = seen_at(tmp_path, 10, seen, day_sun.Turned())
    assert view.heading == pytest.approx(100.0, abs=3.0)
    assert abs(view.heading - 100.0) < 3.0 * view.heading_error
    assert not view.is_searched
    assert view.off < view.tolerance


def test_a_disc_far_from_where_it_should_be_is_doubtful(tmp_path):
    camera = Equirectangular(128, 64)
    seen = with_disc(drawn(10, 100.0, camera), camera, sun.to_sun(place_at(10, 100.0)))
    view = seen_at(tmp_path, 12, seen, day_sun.Turned())  # a clock two hours ahead
    assert view.off > view.tolerance
    assert day_photo.Estimate("a", "", 1.0, 1.0, off=view.off, tolerance=view.tolerance).is_doubtful


def test_a_disc_tells_pitch_and_heading_of_a_perspective_camera(tmp_path):
    camera = Perspective(120, 90, math.radians(70.0), math.radians(25.0))
    seen = with_disc(np.full((90, 120, 3), 0.5, np.float32), camera, sun.to_sun(place_at(9, 80.0)))
    view = seen_at(tmp_path, 9, seen, day_sun.Turned(field_of_view=70.0))
    assert view.pitch == pytest.approx(25.0, abs=1.5)
    assert view.heading == pytest.approx(80.0, abs=1.5)
    assert (view.pitch_error, view.off) == (pytest.approx(0.6, abs=0.4), pytest.approx(0.0, abs=view.tolerance / 2.0))


# What a photo says


def test_text_of_an_estimate_reads_back_bit_by_bit():
    noise = np.random.default_rng(0).normal(size=(2, 2))
    said = day_photo.Estimate(
        "a.exr", "", 20.0, 120.0, ("SKY_HAZINESS", "SKY_OVERCAST"), noise[0], noise, noise.T,
        direction=noise.astype(np.float32).repeat(3, 1)[:, :3], log_radiance=np.ones((2, 3), np.float32), floor=0.1,
    )  # fmt: skip
    text = day_photo._text(said)
    back = day_photo.of_text(text)
    assert day_photo._text(back) == text
    assert np.array_equal(back.noise, said.noise)
    assert (back.names, back.heading_error, math.isnan(back.error)) == (said.names, None, True)


def test_turning_leans_and_directions_leaves_the_clouds_where_they_are():
    names, turn = ("SKY_HAZINESS", *day_photo.LEANS), math.radians(70.0)
    lean = np.array([0.0, 2.0, -1.0])
    turned = day_photo._turning(names, turn) @ lean
    direction = torch.nn.functional.normalize(torch.randn(20, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    sample = day_photo.Sample(direction, direction, 0.0)
    there = torch.from_numpy(day_photo._turned(sample, turn))

    def share(lean, direction):
        record = keyframes.scene({"SKY_OVERCAST": 0.4, "SKY_OVERCAST_AHEAD": lean[1], "SKY_OVERCAST_LEFT": lean[2]}).sky
        return skies.overcast_share(record, direction)

    assert torch.allclose(share(turned, there), share(lean, direction), atol=1e-5)
    # A sun to the right of the middle by an angle, in a picture that looks so much further right, is at their sum.
    towards = sun.to_sun(SunPlace(10.0, 20.0, "", visible=False))[None]
    moved = torch.from_numpy(day_photo._turned(day_photo.Sample(towards, towards, 0.0), turn))
    assert torch.allclose(moved[0], sun.to_sun(SunPlace(10.0, 90.0, "", visible=False)), atol=1e-6)


@pytest.fixture
def fake_skies(monkeypatch):
    """Fits that would be best at a pitch of 20 and a sun at 90 to the right.

    They are better still where sky is lost, and where what stands below it is high in the sky.
    """

    def pixels(tilted, *_):
        pitch = math.degrees(tilted.camera.pitch)
        if pitch > 50.0:
            raise InputError("no sky")
        used = torch.ones(100, 1, dtype=torch.bool)
        used[: 50 if pitch < -5.0 else 0] = False
        used[-1] = False
        up = torch.full((100, 1), math.sin(tilted.camera.pitch))
        return SimpleNamespace(used=used, pitch=pitch, direction=torch.stack([torch.zeros_like(up)] * 2 + [up], -1))

    def solve(pixels, place, _):
        away = abs(place.azimuth - 90.0)
        error = 0.01 + 1e-6 * (pixels.pitch - 20.0) ** 2 + 1e-5 * away
        found = error if -5.0 < pixels.pitch < 35.0 else 1e-6
        return SimpleNamespace(parameters={"SUN_AZIMUTH": SimpleNamespace(value=place.azimuth)}, error=found)

    monkeypatch.setattr(day_sun, "sky_pixels", pixels)
    monkeypatch.setattr(day_sun.sky, "solve", solve)


@pytest.mark.usefixtures("fake_skies")
@pytest.mark.parametrize("heading", [None, 30.0])
def test_without_a_disc_the_likeliest_sky_tells_the_pitch(tmp_path, heading):
    plain = np.full((30, 40, 3), 0.5, np.float32)
    view = seen_at(tmp_path, 9, plain, day_sun.Turned(heading=heading, field_of_view=50.0))
    assert (view.pitch, view.is_searched, view.off) == (20.0, heading is None, None)
    # To the first order in the pitch's rise: 10 degrees beside it the error grows by 0.25 %.
    assert 1.4 < view.pitch_error < 40.0
    bearing = place_at(9, 0.0).azimuth % 360.0
    assert view.heading == pytest.approx((bearing - 90.0) % 360.0 if heading is None else heading)


def test_names_of_the_pool_need_most_photos_and_all_others_one():
    def said(*names):
        return Observation(12.0, names, np.zeros(len(names)), np.eye(len(names)))

    spoken = [said("SKY_HAZINESS", "SKY_OZONE"), said("SKY_OZONE", "SKY_GROUND_ALBEDO"), said()]
    assert day._with_curves(spoken) == ["SKY_HAZINESS", "SKY_OZONE"]


def test_gains_of_a_photo_are_its_exposed_sun():
    seen = day._gained(day.Judged((2.0, 1.0, 0.5), 0.01), 12.0)
    values = dict(zip(seen.names, seen.point, strict=True))
    red, green = (
        float(weather_names()[name].from_unit(torch.tensor(values[name], dtype=torch.float64)))
        for name in day.GAINS[1:3]
    )
    assert red / green == pytest.approx(2.0)


def estimates_of(haziness):
    names = ("SKY_HAZINESS", "SKY_MIE_SCALE")
    noise = np.diag([0.01, 0.02]) ** 2
    return [
        day_photo.Estimate(
            f"{index}.exr", "", 40.0, 180.0, names, np.array([haze, 0.4]), noise, 2.0 * noise, names, 0.01
        )
        for index, haze in enumerate(haziness)
    ]


def test_a_photo_far_from_what_the_others_foretell_is_fitted_again_from_there(tmp_path):
    asked = day_photo.Asked(48.0, 11.0, day_sun.Turned())
    first = estimates_of([0.70, 0.71, 0.70, 0.99, 0.70, 0.69])
    tasks = [(tmp_path / one.photo, time_at(hour), asked) for one, hour in zip(first, range(8, 14), strict=True)]
    again = day._again(tasks, first)
    start = again[3][2].start
    assert start["SKY_HAZINESS"] == pytest.approx(0.70 * 0.99, abs=0.02)  # a share of its bounds
    assert not {"SUN_ELEVATION", "EXPOSURE", *day_photo.LEANS} & start.keys()
    assert again[3][:2] == tasks[3][:2]
    assert len(again) < len(first)
    assert day._again(tasks[:3], first[:3]) == {}


def test_a_second_fit_takes_the_place_of_the_first_where_the_photo_is_as_well_told():
    first, again = estimates_of([0.99] * 3), estimates_of([0.7] * 3)
    worse, refused = replace(again[1], error=0.02), replace(again[2], refused="not finite")
    chosen = day._likelier(first, {0: replace(again[0], error=0.0102), 1: worse, 2: refused})
    assert [one.point[0] for one in chosen] == [0.7, 0.99, 0.99]
    assert chosen[0].held is None


def test_photos_of_several_dates_are_told_of():
    night = day_photo.Estimate("a.exr", "a night", -20.0, 0.0)
    times = (time_at(1), time_at(2) + timedelta(days=30))
    several = SimpleNamespace(used=list, times=times, estimates=(night, night), keyframes={})
    assert "photos of 2 dates, 2020-06-21 to 2020-07-21, taken for one day" in day_results.summary(Path("out"), several)
    one = SimpleNamespace(used=list, times=times[:1], estimates=(night,), keyframes={})
    assert "dates" not in day_results.summary(Path("out"), one)
