import json
import resource
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO
import pytest

from fit import exr
from fit.input_error import InputError

HEIGHT, WIDTH = 6, 8
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


def random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape, dtype=np.float32) + 0.5


def save(path: Path, channels: Mapping[str, np.ndarray], **header: Any) -> Path:
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)) as file:
        file.write(str(path))
    return path


def save_parts(path: Path, *parts: tuple[str, Mapping[str, np.ndarray], dict[str, Any]]) -> Path:
    with OpenEXR.File([OpenEXR.Part(dict(header), dict(channels), name) for name, channels, header in parts]) as file:
        file.write(str(path))
    return path


def attribute(name: str, kind: str, value: bytes) -> bytes:
    return b"\0".join([name.encode(), kind.encode(), struct.pack("<i", len(value)) + value])


def by_hand(channels: Mapping[str, np.ndarray], size: tuple[int, int], *extra: bytes) -> bytes:
    """Uncompressed file of float channels, which may have fewer rows and columns than the picture."""
    height, width = size
    names = sorted(channels)
    steps = {name: (height // channels[name].shape[0], width // channels[name].shape[1]) for name in names}
    table = b"".join(name.encode() + struct.pack("<xiBxxxii", 2, 0, steps[name][1], steps[name][0]) for name in names)
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<ii", 20000630, 2) + b"".join(
        [
            attribute("channels", "chlist", table + b"\0"),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
            *extra,
            b"\0",
        ]
    )
    lines = []
    for y in range(height):
        shown = [name for name in names if y % steps[name][0] == 0]
        line = b"".join(channels[name][y // steps[name][0]].astype("<f4").tobytes() for name in shown)
        lines.append(struct.pack("<ii", y, len(line)) + line)
    starts = len(head) + 8 * height + np.cumsum([0, *map(len, lines)])[:-1]
    return head + starts.astype("<u8").tobytes() + b"".join(lines)


def declared(width: int, height: int, channels: int) -> bytes:
    """Header of a file that would be as large, and nothing behind it."""
    names = {f"c{index}": np.zeros((1, 1)) for index in range(channels - 1)} | {"Y": np.zeros((1, 1))}
    content = by_hand(names, (1, 1))
    return content.replace(struct.pack("<5i", 16, 0, 0, 0, 0), struct.pack("<5i", 16, 0, 0, width - 1, height - 1))


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# Writing


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


def deep() -> np.ndarray:
    samples = np.empty((HEIGHT, WIDTH), dtype=object)
    for index in np.ndindex(HEIGHT, WIDTH):
        samples[index] = np.ones(2, np.float32)
    return samples


DEEP_HEADER = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}


def test_a_deep_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is deep.*flatten"):
        exr.read(save(tmp_path / "a.exr", {"Y": deep()}, **DEEP_HEADER))


def test_a_flat_picture_beside_a_deep_one_is_read(tmp_path: Path) -> None:
    picture = random(HEIGHT, WIDTH, 3)
    path = save_parts(tmp_path / "a.exr", ("deep", {"Y": deep()}, DEEP_HEADER), ("flat", {"RGB": picture}, {}))
    assert np.array_equal(exr.read(path).radiance, picture)


def test_a_file_without_colours_or_luminance_is_refused(tmp_path: Path) -> None:
    channels = {"Z": random(HEIGHT, WIDTH), "diffuse.R": random(HEIGHT, WIDTH)}
    with pytest.raises(InputError, match=r"has the channels Z, diffuse\.R; needed are R, G and B, or Y"):
        exr.read(save(tmp_path / "a.exr", channels))


SMALL, FULL = random(HEIGHT // 2, WIDTH // 2), random(HEIGHT, WIDTH)


@pytest.mark.parametrize(
    "channels",
    [
        {"R": SMALL, "G": FULL, "B": SMALL},
        {"Y": SMALL, "RY": SMALL, "BY": SMALL},
        {"Y": SMALL},
        {"Y": FULL, "Z": SMALL},
    ],
    ids=",".join,
)
def test_channels_of_fewer_pixels_are_refused(tmp_path: Path, channels: dict[str, np.ndarray]) -> None:
    (tmp_path / "a.exr").write_bytes(by_hand(channels, (HEIGHT, WIDTH)))
    with pytest.raises(InputError, match="full resolution"):
        exr.read(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("width", "height", "channels", "match"),
    [(100_000, 100_000, 1, "at most 64,000,000 pixels"), (8000, 7900, 12, "holds 3.0 GB of pixels")],
)
def test_size_is_checked_before_pixels_are_read(
    tmp_path: Path, width: int, height: int, channels: int, match: str
) -> None:
    (tmp_path / "a.exr").write_bytes(declared(width, height, channels))
    with pytest.raises(InputError, match=match):
        exr.read(tmp_path / "a.exr")


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.999])
def test_a_cut_off_file_is_one_line(tmp_path: Path, share: float) -> None:
    whole = save(tmp_path / "whole.exr", {"RGB": random(64, 64, 3)}).read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"cut\.exr") as caught:
        exr.read(tmp_path / "cut.exr")
    assert "\n" not in str(caught.value)


def test_a_file_with_one_damaged_part_is_refused_whole(tmp_path: Path) -> None:
    parts = [(name, {"RGB": random(64, 64, 3)}, {}) for name in ("first", "second")]
    whole = save_parts(tmp_path / "whole.exr", *parts).read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[:-1000])
    with pytest.raises(InputError, match="damaged"):
        exr.read(tmp_path / "cut.exr")


def test_names_that_are_no_text_are_refused(tmp_path: Path) -> None:
    channels, size = {"Y": random(HEIGHT, WIDTH), "side": random(HEIGHT, WIDTH)}, (HEIGHT, WIDTH)
    owner = by_hand(channels, size, attribute("owner", "string", b"\x9c\xff"))
    channel = by_hand(channels, size).replace(b"side\0", b"s\xee\xee\xee\0")
    for content in (owner, channel):
        (tmp_path / "a.exr").write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            exr.read(tmp_path / "a.exr")


def test_damaged_files_are_read_or_refused_in_silence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole = np.frombuffer(save(tmp_path / "a.exr", {"RGB": random(32, 32, 3)}).read_bytes(), np.uint8)
    generator, refusals = np.random.default_rng(0), []
    for _ in range(60):
        damaged = whole.copy()
        damaged[generator.integers(0, 600, 4)] = generator.integers(0, 256, 4)
        (tmp_path / "a.exr").write_bytes(damaged.tobytes())
        try:
            exr.read(tmp_path / "a.exr")
        except InputError as error:
            refusals.append(str(error))
    assert refusals
    assert not any("\n" in refusal for refusal in refusals)
    assert capfd.readouterr() == ("", "")


def test_output_goes_on_after_a_damaged_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.exr").write_bytes(exr.MAGIC + b"nothing")
    with pytest.raises(InputError):
        exr.read(tmp_path / "a.exr")
    print("still here", flush=True)  # noqa: T201
    assert capfd.readouterr().out == "still here\n"


def test_text_is_no_picture_whatever_its_name(tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_text("some text\n")
    with pytest.raises(InputError, match="not an OpenEXR file"):
        exr.read(tmp_path / "a.exr")


@pytest.mark.parametrize(("name", "match"), [("missing.exr", "No such file"), ("", "is a folder"), ("0", "is empty")])
def test_what_is_no_file_is_one_line(tmp_path: Path, name: str, match: str) -> None:
    (tmp_path / "0").touch()
    with pytest.raises(InputError, match=match):
        exr.read(tmp_path / name)
