"""The experiments on hostile files, kills and sameness, at their smallest size."""

import json
import sys

import numpy as np
import pytest
from exr_files import random, save

from experiments import fork_server, hostile_files, kills, mutations, sameness, whole_results

# Writes what it is given, as the command does, after a moment in which it may be killed.
STAND_IN = """
import argparse, pathlib, time
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder
parser = argparse.ArgumentParser()
parser.add_argument("given", type=pathlib.Path)
parser.add_argument("--out", type=pathlib.Path)
given = parser.parse_known_args()[0]
with whole_folder(given.out, last="fit.json") as aside:
    for path in sorted((given.given.parent / "good").iterdir()):
        write_bytes(aside / path.name, path.read_bytes())
        time.sleep(0.02)
"""


@pytest.fixture
def good(tmp_path):
    """Folder of whole results."""
    folder = tmp_path / "good"
    folder.mkdir()
    save(folder / "fitted.exr", {"RGB": random(32, 32, 3)})
    (folder / "fit.json").write_text('{"parameters": {}}')
    (folder / "report.html").write_text("<html></html>\n")
    (folder / "weather.csv").write_text("# weather 1\nTIME_OF_DAY,12\nSKY_HAZINESS,0.5\n")
    (folder / "mask.png").write_bytes(hostile_files.hostile_samples.png.encoded(np.ones((2, 2, 1), np.uint8)))
    return folder


def test_whole_results_have_no_fault_and_cut_ones_have(good):
    assert whole_results.faults(good) == []
    for name in whole_results.FILES:
        whole = (good / name).read_bytes()
        (good / name).write_bytes(whole[:-9])
        assert whole_results.faults(good) == [f"{name} is not whole"]
        (good / name).unlink()
        assert whole_results.faults(good) == [f"{name} is missing"]
        (good / name).write_bytes(whole)


@pytest.mark.parametrize("kind", [mutations.ANY, mutations.EXR, mutations.TEXT], ids=["any", "exr", "text"])
def test_mutations_repeat_and_change_something(tmp_path, kind):
    content = save(tmp_path / "a.exr", {"RGB": random(8, 8, 3)}).read_bytes()
    first, second = ([mutations.mutated(content, kind, np.random.default_rng(n)) for n in range(50)] for _ in range(2))
    assert first == second
    assert sum(changed != content for changed, _ in first) > 40
    mutations.mutated(b"", kind, np.random.default_rng(0))


def test_attributes_of_a_header_are_found(tmp_path):
    content = save(tmp_path / "a.exr", {"RGB": random(8, 8, 3)}).read_bytes()
    found = {content[a.name]: content[a.kind] for a in mutations.attributes(content)}
    assert found[b"dataWindow"] == b"box2i"
    assert found[b"channels"] == b"chlist"


ENDINGS = {
    "refused": ((2, "", "error: no\n", 1.0, 1), ""),
    "two lines": ((2, "", "error: no\nand more\n", 1.0, 1), "other words"),
    "traceback": ((1, "", "Traceback\nValueError: x\n", 1.0, 1), "complained: ValueError: x"),
    "crash": ((-11, "", "", 1.0, 1), "status -11"),
    "slow": ((2, "", "error: no\n", 11.0, 1), "took 11.0 s"),
    "large": ((2, "", "error: no\n", 1.0, 2 * 10**9), "took 2.00 GB"),
    "nothing written": ((0, "", "", 1.0, 1), "fit.json is missing"),
}


@pytest.mark.parametrize(("ending", "said"), ENDINGS.values(), ids=ENDINGS)
def test_what_should_not_be_is_called_a_fault(tmp_path, ending, said):
    fault = hostile_files.fault(fork_server.Ended(*ending), tmp_path / "out")
    assert fault.find(said) >= 0 if said else fault == ""


def test_a_refusal_that_leaves_something_is_a_fault(good):
    refused = fork_server.Ended(2, "", "error: no\n", 1.0, 1)
    assert hostile_files.fault(refused, good) == "refused, yet something is written"


@pytest.mark.slow
def test_hostile_files_are_read_or_refused(tmp_path, capsys):
    files = tmp_path / "given"
    files.mkdir()
    (files / "text").write_text("no picture")
    hostile_files.main(["--files", str(files), "--count", "8", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "hostile_files.json").read_text())
    assert content["cases"] == {"given": 2, "photo": 4, "weather": 4}
    assert content["faults"] == []
    assert "neither OpenEXR nor Radiance" in content["given"]["text"]
    assert "refused" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("good")
def test_killed_runs_leave_whole_files(tmp_path, monkeypatch, capsys):
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(kills, "COMMAND", (sys.executable, str(script)))
    monkeypatch.setattr(kills.tempfile, "TemporaryDirectory", lambda: Kept(tmp_path))
    kills.main(["--count", "8", "--out", str(tmp_path)])
    records = json.loads((tmp_path / "kills.json").read_text())["records"]
    assert [record["faults"] for record in records] == [[]] * 8
    assert any(record["aside"] for record in records)
    assert "while writing" in capsys.readouterr().out


class Kept:
    """Stands for a temporary folder, of a test that has put something into it."""

    def __init__(self, folder):
        self.folder = folder

    def __enter__(self):
        return str(self.folder)

    def __exit__(self, *_):
        return None


@pytest.mark.slow
def test_another_process_gives_the_same_bytes(tmp_path, capsys):
    sameness.main(["least-squares", "--runs", "2", "--out", str(tmp_path)])
    (record,) = json.loads((tmp_path / "sameness.json").read_text())["records"]
    assert record["differing"] == []
    assert "none" in capsys.readouterr().out
