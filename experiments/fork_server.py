"""The command `fit` run over and over, each time in a process of its own that has torch imported already.

A server process imports what a fit needs, fits once, and then forks for every command, which so costs a tenth of a
second where a new interpreter would take seconds. Its child does all that a user's process does, but does not take the
interpreter down at its end. No server outlives the experiment: it ends when its input does.
"""

import contextlib
import gc
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import NoReturn

import OpenImageIO

from experiments.fit_command import MEMORY_UNIT
from fit import __main__ as command

LONGEST = 100.0  # seconds until a command that does not end is ended
# Of addresses, so that a hostile file cannot take the machine: torch alone has reserved 1 GB before it computes.
LARGEST_SPACE = 6 * 2**30


@dataclass(frozen=True)
class Ended:
    """A command that has ended.

    Attributes:
        status: exit status; negative where a signal ended it, -9 also where it did not end.
        told: what it wrote to standard output.
        complained: what it wrote to standard error.
        seconds: of the processor, which do not depend on what else the machine does.
        peak_bytes: most memory that it held at a time, with all that it shares with the server.
    """

    status: int
    told: str
    complained: str
    seconds: float
    peak_bytes: int


class Server:
    """Context in which commands can be run."""

    def __init__(self, folder: Path, warm_up: Sequence[str]) -> None:
        """Start a server in a folder, which runs one command to warm up."""
        # One thread: a forked process has none of the others.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "experiments.fork_server", *warm_up],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            cwd=folder,
            text=True,
        )

    def __enter__(self) -> "Server":
        """The server itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let the server end."""
        self._process.communicate()

    def run(self, words: Sequence[str]) -> Ended:
        """`fit` with these words, in the server's folder.

        Raises:
            RuntimeError: when the server itself has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps(list(words)), file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the server ended with status {self._process.wait()}")
        return Ended(**json.loads(answer))


# In the server


def serve(words: Iterator[str]) -> Iterator[str]:
    """Answers to lines of words."""
    for line in words:
        yield json.dumps(asdict(_forked(json.loads(line))))


def _forked(words: Sequence[str]) -> Ended:
    streams = [os.memfd_create(name) for name in ("told", "complained")]
    child = os.fork()
    if child == 0:
        _run(words, streams)
    status, usage = _waited(child, time.monotonic() + LONGEST)
    told, complained = (_text(stream) for stream in streams)
    return Ended(status, told, complained, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * MEMORY_UNIT)


def _run(words: Sequence[str], streams: Sequence[int]) -> NoReturn:
    """What the child does: the command and nothing after it."""
    status = 1
    try:
        resource.setrlimit(resource.RLIMIT_AS, (LARGEST_SPACE, LARGEST_SPACE))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for stream, number in zip(streams, (1, 2), strict=True):
            os.dup2(stream, number)
        sys.argv = ["fit", *words]
        command.main()
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        # OpenImageIO prints at the end of a process what nobody has fetched.
        print(OpenImageIO.geterror(), end="", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _waited(child: int, until: float) -> tuple[int, resource.struct_rusage]:
    """Status and use of resources of a child, which is ended when its time is over."""
    while True:
        found, status, usage = os.wait4(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status), usage
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)


def _text(stream: int) -> str:
    with open(stream, "rb") as file:
        file.seek(0)
        return file.read().decode(errors="replace")


def main() -> None:
    """Warm up, then answer standard input on standard output."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    if sys.argv[1:]:
        sys.argv[0] = "fit"
        with contextlib.suppress(SystemExit):
            command.main()
    gc.collect()
    gc.freeze()  # a collection in a child would copy all that it shares with the server
    with contextlib.suppress(BrokenPipeError):  # the experiment has been ended
        for answer in serve(iter(sys.stdin.readline, "")):
            print(answer, file=answers, flush=True)
    gc.unfreeze()  # what is left uncollected at the end, OpenImageIO reports as leaked


if __name__ == "__main__":
    main()
