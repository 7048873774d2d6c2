"""Run the command line in a process of its own, as its users do."""

from __future__ import annotations

import atexit
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

from hframe_post.process import CHILD
from tests.command_server import ask
from tests.conftest import ROOT, SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"
WAIT = 60.0  # s


def run(
    *arguments: str | Path, stdin: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[bytes]:
    """Run ``hframe-post`` with these arguments to its end.

    The process is a fork of one that has imported the package, which saves most of its time. Where
    ``environment`` changes how Python starts, it is a new process.
    """
    command = [sys.executable, "-m", "hframe_post", *map(str, arguments)]
    changed = {**os.environ, **environment}
    if any(name.startswith("PYTHON") for name in environment):
        return subprocess.run(command, input=stdin, capture_output=True, check=False, env=changed)
    with ExitStack() as stack:
        files = [stack.enter_context(tempfile.TemporaryFile()) for _ in range(3)]
        files[0].write(stdin)
        files[0].seek(0)
        status = ask(_server(), command[3:], changed, [file.fileno() for file in files])
        for file in files[1:]:
            file.seek(0)
        return subprocess.CompletedProcess(command, status, files[1].read(), files[2].read())


@contextmanager
def started(*arguments: str | Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start ``hframe-post``; at the end of the block, or of this process, it is gone."""
    reading_end, writing_end = os.pipe()  # which closes with this process: see ``process``
    process = subprocess.Popen(
        [sys.executable, "-m", "hframe_post", *map(str, arguments)],
        stdin=reading_end, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, CHILD: "1"},
    )  # fmt: skip
    os.close(reading_end)
    with process:
        try:
            yield process
        finally:
            process.kill()
            os.close(writing_end)


@cache
def _server() -> socket.socket:
    """Start the process that forks commands; it ends with this one, which closes the socket."""
    ours, theirs = socket.socketpair()
    # Threads of BLAS wait for each other on a busy machine.
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.command_server", str(theirs.fileno())],
        pass_fds=[theirs.fileno()], cwd=ROOT, stdin=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    theirs.close()

    def end() -> None:
        ours.close()
        server.wait()

    atexit.register(end)
    return ours


def until(holds: Callable[[], bool]) -> None:
    """Wait until ``holds()`` is true; fail after a minute."""
    deadline = time.monotonic() + WAIT
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)
