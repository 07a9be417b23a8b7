import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fit.input_error import InputError
from fit.whole_file import whole_file, write_bytes


def write_half(path: Path, then: BaseException | type[BaseException]) -> None:
    with whole_file(path) as aside:
        aside.write_bytes(b"half")
        raise then


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def test_the_content_is_there_and_nothing_beside_it(tmp_path: Path) -> None:
    write_bytes(tmp_path / "weather.csv", b"# weather 1\n")
    assert (tmp_path / "weather.csv").read_bytes() == b"# weather 1\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["weather.csv"]


def test_the_old_file_stands_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    write_bytes(path, b"old")
    with whole_file(path) as aside:
        aside.write_bytes(b"new")
        assert path.read_bytes() == b"old"
        assert aside.parent == tmp_path
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, ValueError, SystemExit, MemoryError])
def test_an_interrupted_write_leaves_the_old_file_alone(tmp_path: Path, interruption: type[BaseException]) -> None:
    path = tmp_path / "mask.png"
    write_bytes(path, b"old")
    with pytest.raises(interruption):
        write_half(path, interruption)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"report\.html cannot be written \(No space left") as caught:
        write_half(tmp_path / "report.html", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"weather\.csv cannot be written \(No such file or directory\)"):
        write_bytes(tmp_path / "nowhere" / "weather.csv", b"")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written_is_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="Permission denied"):
        write_bytes(tmp_path / "weather.csv", b"")
    tmp_path.chmod(0o700)


def test_a_folder_or_device_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "fitted.exr").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "fitted.exr", tmp_path / "pipe", Path(), Path("/dev/null")):
        with pytest.raises(InputError, match="not a file"):
            write_bytes(path, b"")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["fitted.exr", "pipe"]


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_permissions_follow_the_umask(tmp_path: Path, mask: int) -> None:
    with umask(mask):
        write_bytes(tmp_path / "weather.csv", b"")
    assert stat.S_IMODE((tmp_path / "weather.csv").stat().st_mode) == 0o666 & ~mask


def test_a_writer_may_make_the_file_anew(tmp_path: Path) -> None:
    with whole_file(tmp_path / "fitted.exr") as aside:
        aside.unlink()
        aside.write_bytes(b"by path")
    assert (tmp_path / "fitted.exr").read_bytes() == b"by path"


def test_the_longest_name_can_be_written(tmp_path: Path) -> None:
    write_bytes(tmp_path / ("n" * 251 + ".csv"), b"x")
    assert len(list(tmp_path.iterdir())) == 1
