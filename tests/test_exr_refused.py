import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from exr_files import HEIGHT, WIDTH, attribute, by_hand, declared, random, save, save_parts

from fit import exr
from fit.input_error import InputError


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


def save_declared(path: Path, **sizes: tuple[int, int]) -> Path:
    """A small good picture whose header names other sizes than it has."""
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    content = save(path, {"RGB": random(HEIGHT, WIDTH, 3)}, **header).read_bytes()
    for name, (width, height) in sizes.items():
        start = content.index(name.encode() + b"\0")
        kind, written = (b"tiledesc", (width, height)) if name == "tiles" else (b"box2i", (0, 0, width - 1, height - 1))
        at = content.index(kind + b"\0", start) + len(kind) + 5  # behind its type and length
        value = np.array(written, "<i4").tobytes()
        content = content[:at] + value + content[at + len(value) :]
    path.write_bytes(content)
    return path


def test_a_small_file_that_names_a_large_picture_is_refused_before_it_takes_room(tmp_path: Path) -> None:
    large, small = (8000, 4000), (WIDTH, HEIGHT)
    assert exr.read(save_declared(tmp_path / "a.exr", dataWindow=small, displayWindow=small, tiles=(64, 64)))
    for name, match in (("dataWindow", "unpack"), ("displayWindow", "unpack"), ("tiles", "unpack")):
        with pytest.raises(InputError, match=match):
            exr.read(save_declared(tmp_path / "a.exr", **{name: large}))
    with pytest.raises(InputError, match=r"holds 51\.5 GB"):  # of which OpenEXR would take 4.5
        exr.read(save_declared(tmp_path / "a.exr", tiles=(65_536, 65_536)))


CHUNKS = [("NO", OpenEXR.scanlineimage, 64), ("ZIP", OpenEXR.scanlineimage, 4), ("PIZ", OpenEXR.tiledimage, 4)]


@pytest.mark.parametrize(("compression", "kind", "count"), CHUNKS)
def test_a_lost_chunk_is_no_hole(tmp_path: Path, compression: str, kind: int, count: int) -> None:
    tiles = {"tiles": OpenEXR.TileDescription()} if kind == OpenEXR.tiledimage else {}
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": kind, **tiles}
    whole = save(tmp_path / "a.exr", {"RGB": random(64, 64, 3)}, **header).read_bytes()
    # The table of chunks ends where its first entry points to.
    (first,) = (at for at in range(len(whole) - 8) if whole[at : at + 8] == struct.pack("<q", at + 8 * count))
    end = first + 8 * count
    (last,) = struct.unpack("<q", whole[end - 8 : end])
    without_entry = whole[: end - 8] + bytes(8) + whole[end:]
    for content in (whole[:last], without_entry[:last], without_entry[:last] + bytes(len(whole) - last)):
        (tmp_path / "a.exr").write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            exr.read(tmp_path / "a.exr")
