"""A page that uses the npm package `three`, run by a headless Chromium in software, and what it leaves."""

import functools
import http.server
import json
import re
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SECONDS = 240  # that a page may take

IMPORTS = """<script type="importmap">
{"imports": {"three": "./build/three.module.js", "three/addons/": "./examples/jsm/"}}
</script>"""


def result(package: Path, files: Mapping[str, str]) -> Any:
    """JSON that a page leaves in its element `out`; it is the file `page.html`, and the package lies beside it.

    Raises:
        FileNotFoundError: when there is no Chromium.
        RuntimeError: when the page ends without a result.
    """
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        raise FileNotFoundError("no chromium on PATH; install it")
    with tempfile.TemporaryDirectory() as folder:
        for part in ("build", "examples"):
            (Path(folder) / part).symlink_to((package / part).resolve())
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        handler = functools.partial(Quiet, directory=folder)
        with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            address = f"http://127.0.0.1:{server.server_port}/page.html"
            options = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
            options += ["--virtual-time-budget=60000", f"--user-data-dir={folder}/profile", "--dump-dom"]
            options += ["--enable-logging=stderr"]
            told = subprocess.run(
                [chromium, *options, address], capture_output=True, text=True, check=False, timeout=SECONDS
            )
            server.shutdown()
    left = re.search('<pre id="out">({.*?})</pre>', told.stdout, re.DOTALL)
    if left is None:
        complaints = [line for line in told.stderr.splitlines() if "CONSOLE" in line]
        raise RuntimeError(f"the page left nothing: {told.stdout[-300:]} {' '.join(complaints)[:2000]}")
    return json.loads(left.group(1))


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Server of a folder that logs nothing."""

    def log_message(self, *_: object) -> None:
        """Nothing."""
