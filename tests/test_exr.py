import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
from exr_files import ACES, HEIGHT, WIDTH, attribute, by_hand, largest_file, random, save, save_parts

from fit import exr
from fit.input_error import InputError


@pytest.mark.parametrize("layout", ["contiguous", "channels first", "upside down", "of four channels", "float64"])
def test_what_is_written_is_read_back_bit_for_bit(tmp_path: Path, layout: str) -> None:
    picture = {
        "contiguous": random(HEIGHT, WIDTH, 3),
        "channels first": random(3, HEIGHT, WIDTH).transpose(1, 2, 0),
        "upside down": random(HEIGHT, WIDTH, 3)[::-1, ::-1],
        "of four channels": random(HEIGHT, WIDTH, 4)[..., :3],
        "float64": random(HEIGHT, WIDTH, 3).astype(np.float64),
    }[layout]
    exr.write(tmp_path / "a.exr", {"sky": {"RGB": picture, "Z": picture[..., 1]}}, {})
    read = exr.read(tmp_path / "a.exr")
    assert np.array_equal(read.radiance, picture)
    assert read.distance is not None
    assert np.array_equal(read.distance, picture[..., 1])
    assert read.radiance.dtype == np.float32
    assert read.radiance.flags.c_contiguous
    assert read.notes == ()


def test_parts_keep_their_names_and_the_metadata(tmp_path: Path) -> None:
    sky, sun = random(HEIGHT, WIDTH, 3), random(HEIGHT, WIDTH, 3, seed=1)
    exr.write(tmp_path / "a.exr", {"sky": {"RGB": sky}, "sun": {"RGB": sun}}, {"origin": "fit", "of": [1, 2.5]})
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        assert [part.name() for part in file.parts] == ["sky", "sun"]
        assert np.array_equal(file.parts[1].channels["RGB"].pixels, sun)
        assert json.loads(file.parts[0].header["diffrender"]) == {"origin": "fit", "of": [1, 2.5]}
        assert file.parts[0].header["chromaticities"] == pytest.approx(exr.REC709)
    assert np.array_equal(exr.read(tmp_path / "a.exr").radiance, sky)
    assert exr.read(tmp_path / "a.exr").notes == ("part 1 of 2 taken, named 'sky'",)


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "fitted.exr"
    exr.write(path, {"sky": {"RGB": random(HEIGHT, WIDTH, 3)}}, {})
    old = path.read_bytes()
    with largest_file(20_000), pytest.raises(InputError, match=r"fitted\.exr cannot be written \(File too large\)"):
        exr.write(path, {"sky": {"RGB": random(100, 100, 3)}}, {})
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


# What can be read


@pytest.mark.parametrize(
    ("stored", "read"), [(np.float16, np.float16), (np.float32, np.float32), (np.uint32, np.float32)]
)
def test_halves_stay_halves_and_all_else_is_float(tmp_path: Path, stored: Any, read: Any) -> None:
    values = (random(HEIGHT, WIDTH, 3) * 100).astype(stored)
    path = save(tmp_path / "a.exr", {name: values[..., i].copy() for i, name in enumerate("RGB")})
    assert exr.read(path).radiance.dtype == read
    assert np.array_equal(exr.read(path).radiance, values.astype(read))


def test_channels_of_different_types_are_read_as_float(tmp_path: Path) -> None:
    red, green, blue = random(3, HEIGHT, WIDTH)
    channels = {"R": red, "G": green.astype(np.float16), "B": (blue * 9).astype(np.uint32)}
    radiance = exr.read(save(tmp_path / "a.exr", channels)).radiance
    assert radiance.dtype == np.float32
    assert np.array_equal(radiance, np.stack([*channels.values()], -1).astype(np.float32))


def test_tiles_are_put_together(tmp_path: Path) -> None:
    path, picture = str(tmp_path / "a.exr"), random(40, 50, 3)
    spec = OpenImageIO.ImageSpec(50, 40, 3, "float")
    spec.tile_width = spec.tile_height = 16
    output = OpenImageIO.ImageOutput.create(path)
    assert output.open(path, spec)
    assert output.write_image(picture)
    output.close()
    assert np.array_equal(exr.read(tmp_path / "a.exr").radiance, picture)


def test_of_several_resolutions_the_finest_is_read(tmp_path: Path) -> None:
    picture = random(64, 128, 3)
    made = OpenImageIO.ImageBufAlgo.make_texture(
        OpenImageIO.MakeTxTexture, OpenImageIO.ImageBuf(picture), str(tmp_path / "a.exr"), OpenImageIO.ImageSpec()
    )
    assert made, OpenImageIO.geterror()
    read = exr.read(tmp_path / "a.exr")
    assert read.header["tiles"].mode == OpenEXR.MIPMAP_LEVELS
    assert np.array_equal(read.radiance, picture)


def test_luminance_alone_is_grey(tmp_path: Path) -> None:
    grey = random(HEIGHT, WIDTH).astype(np.float16)
    read = exr.read(save(tmp_path / "a.exr", {"Y": grey}))
    assert np.array_equal(read.radiance, np.stack([grey] * 3, -1))
    assert read.radiance.flags.c_contiguous
    assert read.notes == ("luminance alone taken as grey",)


def test_alpha_is_left_aside_and_said_so(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 4)
    read = exr.read(save(tmp_path / "a.exr", {"RGBA": picture}))
    assert np.array_equal(read.radiance, picture[..., :3])
    assert read.notes == ("its alpha channel is left aside",)


def test_the_first_part_with_a_picture_is_taken(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 3)
    parts = [
        ("depth", {"Z": picture[..., 0].copy()}, {}),
        ("beauty", {"RGB": picture}, {}),
        ("l", {"RGB": -picture}, {}),
    ]
    read = exr.read(save_parts(tmp_path / "a.exr", *parts))
    assert np.array_equal(read.radiance, picture)
    assert read.notes == ("part 2 of 3 taken, named 'beauty'",)


def test_of_two_views_the_first_is_taken(tmp_path: Path) -> None:
    left, right = random(2, HEIGHT, WIDTH)
    read = exr.read(save(tmp_path / "a.exr", {"Y": left, "right.Y": right}, multiView=["left", "right"]))
    assert np.array_equal(read.radiance[..., 0], left)
    assert "view 'left' taken, of 2 views" in read.notes


def test_of_two_views_in_parts_the_first_is_taken(tmp_path: Path) -> None:
    left, right = random(2, HEIGHT, WIDTH, 3)
    parts = [("l", {"RGB": left}, {"view": "left"}), ("r", {"RGB": right}, {"view": "right"})]
    read = exr.read(save_parts(tmp_path / "a.exr", *parts))
    assert np.array_equal(read.radiance, left)
    assert "view 'left' taken, of 2 views" in read.notes


@pytest.mark.parametrize("header", [{"multiView": "left,right"}, {"view": 1.0}, {"view": ["left", "right"]}])
def test_views_of_another_kind_are_left_aside(tmp_path: Path, header: dict[str, Any]) -> None:
    parts = [(name, {"RGB": random(HEIGHT, WIDTH, 3)}, header) for name in ("a", "b")]
    assert exr.read(save_parts(tmp_path / "a.exr", *parts)).notes == ("part 1 of 2 taken, named 'a'",)


# Colours


def test_chroma_is_turned_back_into_colours(tmp_path: Path) -> None:
    # Colours that change along straight lines, so that halved chroma loses nothing but at the far borders.
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    luminance, red_share, blue_share = 1.0 + 0.1 * x, 0.5 + 0.05 * y, -0.3 + 0.02 * x + 0.01 * y
    channels = {"Y": luminance, "RY": red_share[::2, ::2], "BY": blue_share[::2, ::2]}
    (tmp_path / "a.exr").write_bytes(by_hand(channels, (HEIGHT, WIDTH)))
    radiance = exr.read(tmp_path / "a.exr").radiance[:-1, :-1]
    inside = luminance[:-1, :-1]
    assert radiance[..., 0] == pytest.approx(inside * (1 + red_share[:-1, :-1]), rel=1e-6)
    assert radiance[..., 2] == pytest.approx(inside * (1 + blue_share[:-1, :-1]), rel=1e-6)
    assert radiance @ [0.2126, 0.7152, 0.0722] == pytest.approx(inside, rel=1e-4)


def test_a_grey_of_luminance_and_chroma_is_neutral_under_any_primaries(tmp_path: Path) -> None:
    none = np.zeros((HEIGHT // 2, WIDTH // 2))
    chromaticities = attribute("chromaticities", "chromaticities", struct.pack("<8f", *ACES))
    luminance = random(HEIGHT, WIDTH)
    (tmp_path / "a.exr").write_bytes(by_hand({"Y": luminance, "RY": none, "BY": none}, (HEIGHT, WIDTH), chromaticities))
    radiance = exr.read(tmp_path / "a.exr").radiance
    assert radiance == pytest.approx(np.stack([luminance] * 3, -1), rel=1e-5)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_neutral_colours_of_other_primaries_stay_neutral(tmp_path: Path, dtype: Any) -> None:
    grey = np.repeat(random(300, 4, 1).astype(dtype), 3, -1)
    read = exr.read(save(tmp_path / "a.exr", {"RGB": grey}, chromaticities=ACES))
    assert read.radiance == pytest.approx(grey.astype(np.float32), rel=1e-5)
    assert read.notes == ("its primaries are converted to those of Rec. 709",)


def test_colours_of_a_wide_gamut_are_converted(tmp_path: Path) -> None:
    # ITU-R BT.2087: from BT.2020 to BT.709.
    rec2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
    matrix = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    picture = random(HEIGHT, WIDTH, 3)
    radiance = exr.read(save(tmp_path / "a.exr", {"RGB": picture}, chromaticities=rec2020)).radiance
    assert radiance == pytest.approx(picture @ matrix.T, abs=3e-4)


def test_tristimulus_values_are_taken_as_they_are(tmp_path: Path) -> None:
    # Rows are X, Y, Z of the Rec. 709 primaries at the luminances that they have in white (IEC 61966-2-1).
    primaries = np.array([[[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]]], np.float32)
    path = save(tmp_path / "a.exr", {"RGB": primaries}, chromaticities=(1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3))
    assert exr.read(path).radiance[0] == pytest.approx(np.eye(3), abs=3e-4)


def test_rec709_chromaticities_change_no_bit(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 3)
    read = exr.read(save(tmp_path / "a.exr", {"RGB": picture}, chromaticities=exr.REC709))
    assert np.array_equal(read.radiance, picture)
    assert read.notes == ()


@pytest.mark.parametrize(
    "chromaticities", [(0.3,) * 8, (0.0,) * 8, (np.nan,) * 8, (*exr.REC709[:6], 0.3, 0.0), (*exr.REC709[:6], 5.0, 5.0)]
)
def test_impossible_chromaticities_are_refused(tmp_path: Path, chromaticities: tuple[float, ...]) -> None:
    path = save(tmp_path / "a.exr", {"RGB": random(HEIGHT, WIDTH, 3)}, chromaticities=chromaticities)
    with pytest.raises(InputError, match=r"a\.exr: chromaticities"):
        exr.read(path)


def test_chromaticities_of_another_kind_are_refused(tmp_path: Path) -> None:
    wrong = attribute("chromaticities", "string", b"as usual")
    (tmp_path / "a.exr").write_bytes(by_hand({"Y": random(HEIGHT, WIDTH)}, (HEIGHT, WIDTH), wrong))
    with pytest.raises(InputError, match="damaged"):
        exr.read(tmp_path / "a.exr")


def test_impossible_chromaticities_of_chroma_are_refused(tmp_path: Path) -> None:
    none = np.zeros((HEIGHT // 2, WIDTH // 2))
    impossible = attribute("chromaticities", "chromaticities", struct.pack("<8f", *[0.3] * 8))
    content = by_hand({"Y": random(HEIGHT, WIDTH), "RY": none, "BY": none}, (HEIGHT, WIDTH), impossible)
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(InputError, match="chromaticities"):
        exr.read(tmp_path / "a.exr")


def test_values_that_are_no_numbers_survive_conversion(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 3)
    picture[0, 0] = np.inf
    picture[1, 1, 0] = np.nan
    radiance = exr.read(save(tmp_path / "a.exr", {"RGB": picture}, chromaticities=ACES)).radiance
    wrong = ~np.isfinite(radiance).all(-1)
    assert np.argwhere(wrong).tolist() == [[0, 0], [1, 1]]


# Windows


def test_the_display_window_is_cut_out_of_a_larger_data_window(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 3)
    header = {"dataWindow": ((-2, -1), (WIDTH - 3, HEIGHT - 2)), "displayWindow": ((0, 0), (3, 2))}
    read = exr.read(save(tmp_path / "a.exr", {"RGB": picture, "Z": picture[..., 0].copy()}, **header))
    assert np.array_equal(read.radiance, picture[1:4, 2:6])
    assert read.radiance.flags.c_contiguous
    assert read.distance is not None
    assert np.array_equal(read.distance, picture[1:4, 2:6, 0])


def test_what_the_data_does_not_reach_is_nan(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 3).astype(np.float16)
    header = {"dataWindow": ((3, 2), (WIDTH + 2, HEIGHT + 1)), "displayWindow": ((0, 0), (WIDTH - 1, HEIGHT - 1))}
    read = exr.read(save(tmp_path / "a.exr", {"RGB": picture}, **header))
    assert read.radiance.shape == picture.shape
    assert np.array_equal(read.radiance[2:, 3:], picture[:-2, :-3])
    assert np.isnan(read.radiance).all(-1).sum() == HEIGHT * WIDTH - (HEIGHT - 2) * (WIDTH - 3)
    assert any("masked" in note for note in read.notes)


def test_data_outside_the_display_window_is_refused(tmp_path: Path) -> None:
    header = {"dataWindow": ((20, 20), (27, 25)), "displayWindow": ((0, 0), (7, 5))}
    with pytest.raises(InputError, match="outside its display window"):
        exr.read(save(tmp_path / "a.exr", {"RGB": random(HEIGHT, WIDTH, 3)}, **header))


# Refusals
