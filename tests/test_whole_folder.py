import os
import resource
import subprocess
import sys

import pytest

from fit.input_error import InputError
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder


def write(folder, **contents):
    with whole_folder(folder, last="b") as aside:
        for name, content in contents.items():
            write_bytes(aside / name, content)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_files_take_their_places_when_the_block_ends(tmp_path):
    with whole_folder(tmp_path / "out", last="b") as aside:
        write_bytes(aside / "a", b"1")
        assert not (tmp_path / "out" / "a").exists()
    assert names(tmp_path / "out") == ["a"]


def test_folders_on_the_way_are_made(tmp_path):
    write(tmp_path / "x" / "y" / "z", a=b"1")
    assert names(tmp_path / "x" / "y" / "z") == ["a"]


def test_same_names_are_replaced_and_others_stay(tmp_path):
    (tmp_path / "a").write_bytes(b"a longer text of before")
    (tmp_path / "mine").write_bytes(b"kept")
    write(tmp_path, a=b"1")
    assert (tmp_path / "a").read_bytes() == b"1"
    assert (tmp_path / "mine").read_bytes() == b"kept"
    assert names(tmp_path) == ["a", "mine"]


def test_the_last_file_takes_its_place_last(tmp_path, monkeypatch):
    order = []
    replace = os.replace
    path_type = type(tmp_path)
    monkeypatch.setattr(path_type, "replace", lambda self, to: (order.append(to.name), replace(self, to)))
    write(tmp_path / "out", b=b"1", a=b"1", c=b"1")
    assert [name for name in order if not name.endswith(".part")][-1] == "b"


class AccidentError(Exception):
    pass


def interrupted_write(folder, accident):
    with whole_folder(folder, last="b") as aside:
        write_bytes(aside / "a", b"after")
        raise accident


@pytest.mark.parametrize("accident", [AccidentError, KeyboardInterrupt])
def test_when_the_block_raises_nothing_has_changed(tmp_path, accident):
    (tmp_path / "a").write_bytes(b"before")
    with pytest.raises(accident):
        interrupted_write(tmp_path, accident)
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_bytes() == b"before"


def test_folders_made_for_a_failing_write_are_removed_again(tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(AccidentError):
        interrupted_write(tmp_path / "there" / "x" / "y", AccidentError)
    assert names(tmp_path / "there") == []


def test_no_file_is_replaced_when_one_of_them_cannot_be(tmp_path):
    (tmp_path / "a").write_bytes(b"before")
    (tmp_path / "c").mkdir()
    with pytest.raises(InputError, match="c is not a file"):
        write(tmp_path, a=b"after", c=b"after")
    assert (tmp_path / "a").read_bytes() == b"before"
    assert names(tmp_path) == ["a", "c"]


def test_a_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match="out cannot be written to"):
        write(tmp_path / "file" / "out", a=b"1")
    assert names(tmp_path) == ["file"]


def test_the_error_names_the_file_by_its_own_place(tmp_path):
    with pytest.raises(InputError) as caught, whole_folder(tmp_path / "out", last="b") as aside:
        write_bytes(aside / "missing" / "a", b"1")
    assert str(tmp_path / "out" / "missing" / "a") in str(caught.value)
    assert ".part" not in str(caught.value)


KILLED = """
import os, signal, sys
from pathlib import Path
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder
with whole_folder(Path(sys.argv[1]), last="b") as aside:
    write_bytes(aside / "a", b"after")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_leaves_does_not_stay(tmp_path):
    (tmp_path / "a").write_bytes(b"before")
    mine = tmp_path / ".mine.part"
    mine.mkdir()
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    left = next(path for path in tmp_path.iterdir() if path.name not in ("a", ".mine.part"))
    assert (tmp_path / "a").read_bytes() == b"before"
    write(tmp_path, c=b"1")
    assert left.exists()  # it might be another run's, at work right now
    for path in (left, mine):
        os.utime(path, (0, 0))
    write(tmp_path, c=b"2")
    assert names(tmp_path) == [".mine.part", "a", "c"]


FULL_DISK = """
import resource, sys
from pathlib import Path
from fit.input_error import InputError
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with whole_folder(Path(sys.argv[1]), last="b") as aside:
        write_bytes(aside / "a", bytes(10))
        write_bytes(aside / "c", bytes(5000))
except InputError as error:
    print(error)
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit on the size of files here")
def test_a_full_disk_leaves_nothing(tmp_path):
    run = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path / "out")], capture_output=True, text=True, check=True
    )
    assert "c cannot be written" in run.stdout
    assert run.stderr == ""
    assert names(tmp_path) == []
