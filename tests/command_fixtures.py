"""Fixtures of the command line: the command run in this process, and a folder of what it may be given.

Not a conftest.py, which would import diffrender before its types can be checked at run time.
"""

import signal
import sys

import numpy as np
import pytest
from synthetic_sky import HAZY_MORNING, radiance, save

from fit import __main__ as command
from fit import png, weather_file


@pytest.fixture
def run(monkeypatch, capfd):
    """Run the command in this process: exit status, standard output, standard error."""
    # A shell ignores the interrupt for what it runs in the background, and a test run passes that on.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["fit", *map(str, words)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            command.main()
        told = capfd.readouterr()
        return ended.value.code or 0, told.out, told.err

    yield run
    signal.signal(signal.SIGINT, handler)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A photo of a known sky, masks for it, and files that are no photos."""
    folder = tmp_path_factory.mktemp("given")
    save(folder / "sky.exr", radiance())
    save(folder / "black.exr", np.zeros((64, 128, 3), np.float32))
    save(folder / "odd.exr", radiance()[:50])
    save(folder / "depth_only.exr", Z=np.ones((64, 128), np.float32))
    whole = (folder / "sky.exr").read_bytes()
    (folder / "truncated.exr").write_bytes(whole[: len(whole) // 2])
    (folder / "text.exr").write_text("this is no picture\n")
    (folder / "empty.exr").write_bytes(b"")
    (folder / "jpeg.exr").write_bytes(b"\xff\xd8\xff\xe0" + bytes(100))
    (folder / "folder.exr").mkdir()
    (folder / "black.png").write_bytes(png.encoded(np.zeros((64, 128, 1), np.uint8)))
    (folder / "small.png").write_bytes(png.encoded(np.full((32, 64, 1), 255, np.uint8)))
    (folder / "text.png").write_text("this is no picture\n")
    (folder / "broken.csv").write_text("# weather 1\nTIME_OF_DAY,12\nSKY_HAZINESS,much\n")
    (folder / "no_sky.csv").write_text("# weather 1\nTIME_OF_DAY,12\nEXPOSURE,1\n")
    weather_file.write(folder / "day.csv", weather_file.of_photo(HAZY_MORNING, None, {}))
    return folder
