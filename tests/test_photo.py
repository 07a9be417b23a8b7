import math
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
import torch

from diffrender import rays
from diffrender.colour import rec709_from
from fit import photo
from fit.input_error import InputError

PHOTOS = sorted((Path(__file__).parent.parent / "experiments" / "photos").glob("*.exr"))
EMPTY_CELLS = {"lying": rays.CROSS_LYING, "standing": rays.CROSS_STANDING}


def random(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, 3), dtype=np.float32) + 0.5


def save(path: Path, picture: np.ndarray, **header: Any) -> Path:
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, {"RGB": picture}) as file:
        file.write(str(path))
    return path


def cross(layout: tuple[tuple[str | None, ...], ...], side: int) -> np.ndarray:
    shown = np.array([[face is not None for face in line] for line in layout]).repeat(side, 0).repeat(side, 1)
    return random(*shown.shape) * shown[..., None].astype(np.float32)


def radiance_file(path: Path, *lines: str, size: str = "-Y 4 +X 8", pixels: int = 32) -> Path:
    """Uncompressed Radiance file whose pixels are (1, 0.5, 0.25)."""
    head = "\n".join(["#?RADIANCE", *lines, "", size, ""])
    path.write_bytes(head.encode() + bytes([128, 64, 32, 129]) * pixels)
    return path


FORMAT = "FORMAT=32-bit_rle_rgbe"


# Real photos


@pytest.mark.parametrize("path", PHOTOS, ids=lambda path: path.stem)
def test_real_panoramas_are_recognised(path: Path) -> None:
    read = photo.read(path)
    assert read.camera == rays.Equirectangular(read.radiance.shape[1], read.radiance.shape[0])
    assert any("full equirectangular panorama" in note for note in read.notes)
    # The sky is the upper half, and brighter than the ground by day.
    radiance = read.band(slice(None))
    height = len(radiance)
    assert read.valid(slice(0, height // 2)).float().mean() > 0.99
    assert radiance[: height // 2].mean() > radiance[height // 2 :].mean()


@pytest.mark.parametrize("path", PHOTOS[:2], ids=lambda path: path.stem)
def test_counts_add_up_over_the_picture(path: Path) -> None:
    read = photo.read(path)
    counts = read.counts()
    assert int(read.valid(slice(None)).sum()) + sum(counts.values()) == read.camera.width * read.camera.height
    assert counts["negative"] == int((read.radiance < 0).any(-1).sum())


# Projections


@pytest.mark.parametrize(
    ("picture", "camera"),
    [
        (random(8, 16), rays.Equirectangular(16, 8)),
        (random(4, 16), rays.Equirectangular(16, 4, lowest=0.0)),
        (cross(rays.CROSS_LYING, 4), rays.Cubemap(4, rays.CROSS_LYING)),
        (cross(rays.CROSS_STANDING, 4), rays.Cubemap(4, rays.CROSS_STANDING)),
        (random(4, 24), rays.Cubemap(4, rays.STRIP_LYING)),
        (random(24, 4), rays.Cubemap(4, rays.STRIP_STANDING)),
    ],
    ids=["2:1", "4:1", "4:3", "3:4", "6:1", "1:6"],
)
def test_a_shape_gives_its_projection_away(tmp_path: Path, picture: np.ndarray, camera: rays.Camera) -> None:
    read = photo.read(save(tmp_path / "a.exr", picture))
    assert read.camera == camera
    assert (read.camera.height, read.camera.width) == picture.shape[:2]
    assert len([note for note in read.notes if "taken as" in note]) == 1


def test_an_envmap_attribute_goes_before_the_shape(tmp_path: Path) -> None:
    cube = photo.read(save(tmp_path / "a.exr", random(24, 4), envmap=OpenEXR.ENVMAP_CUBE))
    assert cube.camera == rays.Cubemap(4, rays.STRIP_OPENEXR)
    sphere = photo.read(save(tmp_path / "a.exr", random(7, 16), envmap=OpenEXR.ENVMAP_LATLONG))
    assert sphere.camera == rays.Equirectangular(16, 7)


@pytest.mark.parametrize("envmap", [1, "cube", ["a", "b"], np.array([1.0, 2.0], np.float32)])
def test_an_envmap_of_another_kind_is_left_aside(tmp_path: Path, envmap: Any) -> None:
    read = photo.read(save(tmp_path / "a.exr", random(8, 16), envmap=envmap))
    assert read.camera == rays.Equirectangular(16, 8)


def test_a_cube_in_the_wrong_shape_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wrong projection for cubemap"):
        photo.read(save(tmp_path / "a.exr", random(8, 16), envmap=OpenEXR.ENVMAP_CUBE))


def test_a_picture_of_4_to_3_without_black_corners_is_no_cube(tmp_path: Path) -> None:
    path = save(tmp_path / "a.exr", random(12, 16))
    with pytest.raises(InputError, match="--fov"):
        photo.read(path)
    assert photo.read(path, field_of_view=60.0).camera == rays.Perspective(16, 12, math.radians(60.0))
    assert photo.read(path, projection="cubemap").camera == rays.Cubemap(4, rays.CROSS_LYING)


def test_a_field_of_view_makes_any_shape_a_perspective_picture(tmp_path: Path) -> None:
    path = save(tmp_path / "a.exr", random(8, 16))
    expected = rays.Perspective(16, 8, math.radians(50.0), math.radians(-10.0))
    assert photo.read(path, field_of_view=50.0, pitch=-10.0).camera == expected
    assert photo.read(path, "perspective", 50.0, -10.0).camera == expected


@pytest.mark.parametrize(
    ("projection", "shape"),
    [("equirectangular", (8, 12)), ("hemisphere", (8, 16)), ("cubemap", (8, 16)), ("cubemap", (5, 7))],
)
def test_a_projection_that_contradicts_the_shape_is_refused(
    tmp_path: Path, projection: str, shape: tuple[int, int]
) -> None:
    with pytest.raises(InputError, match=f"{shape[1]} x {shape[0]}, which is the wrong projection for {projection}"):
        photo.read(save(tmp_path / "a.exr", random(*shape)), projection)


@pytest.mark.parametrize("projection", ["equirectangular", "hemisphere"])
def test_an_upper_half_goes_by_both_names(tmp_path: Path, projection: str) -> None:
    path = save(tmp_path / "a.exr", random(4, 16))
    assert photo.read(path, projection).camera == rays.Equirectangular(16, 4, lowest=0.0)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"projection": "fisheye"}, "--projection fisheye is unknown; allowed are equirectangular, hemisphere"),
        ({"field_of_view": 0.0}, "--fov 0; allowed"),
        ({"field_of_view": 180.0}, "--fov 180; allowed"),
        ({"field_of_view": math.nan}, "--fov nan; allowed"),
        ({"field_of_view": 60.0, "pitch": 91.0}, "--pitch 91; allowed"),
        ({"pitch": 10.0}, "is equirectangular; leave them out"),
        ({"projection": "equirectangular", "field_of_view": 60.0}, "is equirectangular; leave them out"),
        ({"projection": "perspective"}, "--fov DEGREES"),
    ],
)
def test_options_that_do_not_suit_are_refused(tmp_path: Path, options: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        photo.read(save(tmp_path / "a.exr", random(8, 16)), **options)


def test_a_screen_window_is_a_field_of_view_unless_it_is_the_default(tmp_path: Path) -> None:
    read = photo.read(save(tmp_path / "a.exr", random(8, 12), screenWindowWidth=2.0))
    assert read.camera == rays.Perspective(12, 8, math.radians(90.0))
    assert "field of view of 90 degrees taken from its screenWindowWidth" in read.notes
    with pytest.raises(InputError, match="--fov"):
        photo.read(save(tmp_path / "a.exr", random(8, 12), screenWindowWidth=1.0))


def test_a_shifted_screen_window_is_said_to_be_left_aside(tmp_path: Path) -> None:
    path = save(tmp_path / "a.exr", random(8, 12), screenWindowCenter=np.array([0.5, 0.0], np.float32))
    assert any("screenWindowCenter" in note for note in photo.read(path, field_of_view=40.0).notes)


def test_a_frame_of_oblong_pixels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="square pixels"):
        photo.read(save(tmp_path / "a.exr", random(8, 12), pixelAspectRatio=1.5), field_of_view=40.0)


# Pixels


def test_half_radiance_is_kept_and_read_out_as_float(tmp_path: Path) -> None:
    picture = random(8, 16).astype(np.float16)
    read = photo.read(save(tmp_path / "a.exr", picture))
    assert read.radiance.dtype == np.float16
    assert read.band(slice(2, 5)).dtype == torch.float32
    assert np.array_equal(read.band(slice(2, 5)).numpy(), picture[2:5].astype(np.float32))


def test_a_band_is_a_copy(tmp_path: Path) -> None:
    read = photo.read(save(tmp_path / "a.exr", random(8, 16)))
    read.band(slice(None)).zero_()
    assert (read.radiance > 0).all()


def test_bad_pixels_are_masked_and_counted(tmp_path: Path) -> None:
    picture = random(410, 820)
    picture[0, 0, 1], picture[300, 7], picture[409, 819, 2] = np.nan, np.inf, -np.inf
    picture[1, 1, 0], picture[400, 3] = -1e-6, -2.0
    picture[2, 2] = 0.0  # black is a colour
    read = photo.read(save(tmp_path / "a.exr", picture))
    wrong = [[0, 0], [1, 1], [300, 7], [400, 3], [409, 819]]
    assert torch.argwhere(~read.valid(slice(None))).tolist() == wrong
    assert torch.argwhere(~read.valid(slice(300, 401))).tolist() == [[0, 7], [100, 3]]
    assert read.counts() == {"nonfinite": 3, "negative": 2}


@pytest.mark.parametrize("layout", EMPTY_CELLS.values(), ids=EMPTY_CELLS.keys())
def test_empty_cells_of_a_cross_are_masked(tmp_path: Path, layout: tuple[tuple[str | None, ...], ...]) -> None:
    read = photo.read(save(tmp_path / "a.exr", cross(layout, 4)))
    assert int(read.valid(slice(None)).sum()) == 6 * 4 * 4
    assert not read.valid(slice(0, 1))[0, 0]


def test_what_the_data_window_does_not_reach_is_masked(tmp_path: Path) -> None:
    header = {"dataWindow": ((0, 2), (15, 7)), "displayWindow": ((0, 0), (15, 7))}
    read = photo.read(save(tmp_path / "a.exr", random(6, 16), **header))
    assert read.camera == rays.Equirectangular(16, 8)
    assert read.valid(slice(None)).any(1).tolist() == [False] * 2 + [True] * 6


def test_distance_is_kept(tmp_path: Path) -> None:
    distance = random(8, 16)[..., 0].copy()
    with OpenEXR.File({}, {"RGB": random(8, 16), "Z": distance}) as file:
        file.write(str(tmp_path / "a.exr"))
    read = photo.read(tmp_path / "a.exr").distance
    assert read is not None
    assert np.array_equal(read, distance)


# The shot


def test_utc_offset_is_added_to_local_time(tmp_path: Path) -> None:
    header = {"capDate": "2004:01:04 18:10:00", "utcOffset": 28800.0, "latitude": 37.75, "longitude": -122.5}
    read = photo.read(save(tmp_path / "a.exr", random(8, 16), altitude=274.5, **header))
    assert read.header["time"] == datetime(2004, 1, 5, 2, 10, tzinfo=UTC)
    assert isinstance(read.header["time"], datetime)
    assert read.header["time"].utcoffset() == timedelta(hours=-8)
    assert (read.header["latitude"], read.header["longitude"], read.header["altitude"]) == (37.75, -122.5, 274.5)


def test_what_a_file_does_not_say_is_none(tmp_path: Path) -> None:
    header = photo.read(save(tmp_path / "a.exr", random(8, 16))).header
    assert header == {"time": None, "latitude": None, "longitude": None, "altitude": None}


@pytest.mark.parametrize(
    "wrong",
    [
        {"capDate": "2004:01:04 18:10:00"},
        {"capDate": "yesterday", "utcOffset": 0.0},
        {"capDate": "2004:01:04 18:10:00", "utcOffset": 1e6},
        {"capDate": "2004:01:04 18:10:00", "utcOffset": math.nan},
        {"capDate": "2004:01:04 18:10:00", "utcOffset": "west"},
        {"latitude": 91.0},
        {"longitude": math.inf},
        {"altitude": "high"},
    ],
)
def test_a_time_or_place_that_cannot_be_is_left_aside(tmp_path: Path, wrong: dict[str, Any]) -> None:
    read = photo.read(save(tmp_path / "a.exr", random(8, 16), **wrong))
    assert set(read.header.values()) == {None}
    assert any(f"its {next(iter(wrong))} is left aside" in note for note in read.notes)


# Radiance


def test_radiance_pixels_are_mantissa_times_exponent(tmp_path: Path) -> None:
    read = photo.read(radiance_file(tmp_path / "a.hdr", FORMAT))
    assert np.array_equal(read.radiance, np.broadcast_to(np.float32([1, 0.5, 0.25]), (4, 8, 3)))
    assert read.camera == rays.Equirectangular(8, 4)
    assert read.notes == ("8 x 4 picture taken as a full equirectangular panorama",)


def test_compressed_radiance_is_read(tmp_path: Path) -> None:
    path, picture = str(tmp_path / "a.hdr"), random(32, 64)
    output = OpenImageIO.ImageOutput.create(path)
    assert output.open(path, OpenImageIO.ImageSpec(64, 32, 3, "float"))
    assert output.write_image(picture)
    output.close()
    # Eight bits of mantissa for the largest of three channels.
    assert photo.read(Path(path)).radiance == pytest.approx(picture, abs=2.0 / 256)


@pytest.mark.parametrize("name", ["a.exr", "a.jpg", "a", "photo of the sky.HDR"])
def test_a_format_is_told_by_content(tmp_path: Path, name: str) -> None:
    assert photo.read(radiance_file(tmp_path / name, FORMAT)).radiance[0, 0, 0] == 1.0
    picture = random(8, 16)
    save(tmp_path / "b.exr", picture).rename(tmp_path / name)
    assert np.array_equal(photo.read(tmp_path / name).radiance, picture)


def test_radiance_lines_that_change_its_meaning_are_said(tmp_path: Path) -> None:
    read = photo.read(radiance_file(tmp_path / "a.hdr", "EXPOSURE=2.0", "COLORCORR=1 1 2", FORMAT))
    assert [note.split()[1] for note in read.notes[:2]] == ["EXPOSURE", "COLORCORR"]
    assert read.radiance[0, 0].tolist() == [1.0, 0.5, 0.25]


def test_primaries_of_radiance_are_converted(tmp_path: Path) -> None:
    own = (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, 1 / 3, 1 / 3)  # of the Radiance programs
    read = photo.read(radiance_file(tmp_path / "a.hdr", "PRIMARIES= " + " ".join(map(str, own)), FORMAT))
    assert read.radiance[0, 0] == pytest.approx(rec709_from(own).numpy() @ [1.0, 0.5, 0.25], rel=1e-5)
    assert any("primaries are converted" in note for note in read.notes)


@pytest.mark.parametrize("primaries", ["0 0 0 0 0 0 0 0", "0.64 0.33 0.3 0.6 0.15 0.06 0.3127 0.329"])
def test_unknown_and_rec709_primaries_change_nothing(tmp_path: Path, primaries: str) -> None:
    read = photo.read(radiance_file(tmp_path / "a.hdr", f"PRIMARIES={primaries}", FORMAT))
    assert read.radiance[0, 0].tolist() == [1.0, 0.5, 0.25]


@pytest.mark.parametrize(
    ("lines", "layout", "match"),
    [
        ([FORMAT], {"size": "+Y 4 +X 8"}, "turned or mirrored"),
        ([FORMAT], {"size": "+X 8 -Y 4"}, "turned or mirrored"),
        ([FORMAT], {"size": "-Y 60000 +X 60000"}, "at most 64,000,000 pixels"),
        ([FORMAT], {"size": "-Y 0 +X 8"}, "damaged or cut off"),
        ([FORMAT], {"size": "4 by 8"}, "damaged or cut off"),
        ([FORMAT], {"pixels": 31}, "damaged or cut off"),
        ([FORMAT], {"pixels": 0}, "damaged or cut off"),
        (["FORMAT=32-bit_rle_xyze"], {}, "32-bit_rle_xyze.*ra_xyze"),
        ([], {}, "FORMAT"),
        ([FORMAT, "PRIMARIES=a b c"], {}, "PRIMARIES"),
        ([FORMAT, "PRIMARIES=1 2 3"], {}, "PRIMARIES"),
        ([FORMAT, "PRIMARIES=.3 .3 .3 .3 .3 .3 .3 .3"], {}, "chromaticities"),
    ],
)
def test_radiance_that_cannot_be_read_is_one_line(
    tmp_path: Path, lines: list[str], layout: dict[str, Any], match: str
) -> None:
    with pytest.raises(InputError, match=match) as caught:
        photo.read(radiance_file(tmp_path / "a.hdr", *lines, **layout))
    assert "\n" not in str(caught.value)


def test_a_radiance_header_without_end_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\n" + b"x" * 200_000)
    with pytest.raises(InputError, match="damaged or cut off"):
        photo.read(tmp_path / "a.hdr")


@pytest.mark.slow
def test_a_cut_off_radiance_file_prints_nothing_but_our_line(tmp_path: Path) -> None:
    radiance_file(tmp_path / "cut.hdr", FORMAT, pixels=31)
    radiance_file(tmp_path / "none.hdr", FORMAT, pixels=0)
    program = (
        "import sys, pathlib\nfrom fit import photo\nfrom fit.input_error import InputError\n"
        "for name in sys.argv[1:]:\n    try: photo.read(pathlib.Path(name))\n    except InputError: pass\n"
    )
    names = [str(tmp_path / name) for name in ("cut.hdr", "none.hdr")]
    root = Path(__file__).parent.parent
    run = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True, cwd=root, check=True)
    assert (run.stdout, run.stderr) == ("", "")


# Files that are no HDR picture


@pytest.mark.parametrize(
    ("first", "name"),
    [
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "a JPEG"),
        (b"\x89PNG\r\n\x1a\n", "a PNG"),
        (b"II*\0\x08\0\0\0", "a TIFF or camera raw"),
        (b"MM\0*\0\0\0\x08", "a TIFF or camera raw"),
        (b"\0\0\0\x18ftypcrx \0\0", "a HEIF or camera raw"),
        (b"FUJIFILMCCD-RAW ", "a camera raw"),
        (b"RIFF\0\0\0\0WEBP", "a WebP"),
        (b"some text\n", "neither OpenEXR nor Radiance"),
    ],
)
@pytest.mark.parametrize("suffix", [".exr", ".jpg"])
def test_other_formats_say_how_to_get_hdr(tmp_path: Path, first: bytes, name: str, suffix: str) -> None:
    path = (tmp_path / "photo").with_suffix(suffix)
    path.write_bytes(first + bytes(100))
    with pytest.raises(InputError, match=f"photo{suffix} is {name}.*merge a bracketed series") as caught:
        photo.read(path)
    assert "\n" not in str(caught.value)


def test_missing_empty_and_folders_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.exr").touch()
    for name, match in (("missing.exr", "No such file"), ("empty.exr", "is empty"), ("", "is a folder")):
        with pytest.raises(InputError, match=match):
            photo.read(tmp_path / name)
    with pytest.raises(InputError, match="no file"):
        photo.read(Path("/dev/zero"))
