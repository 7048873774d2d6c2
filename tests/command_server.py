"""Processes that have imported what commands need, and fork for each that they are asked to run."""

import atexit
import gc
import json
import os
import pkgutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).parent.parent
LENGTH = struct.Struct("=q")  # of the request
ANSWER = struct.Struct("=qd")  # status, and processor time, s
_spent = [0.0]


def spent() -> float:
    """Return the processor time of all commands so far, s."""
    return _spent[0]


def call(
    module: str, argv: Sequence[str], environment: Mapping[str, str], *, stdin: bytes = b"",
    folder: Path | None = None, prepared: str = __name__, timeout: float | None = None,
    terminal: int | None = None,
) -> subprocess.CompletedProcess[bytes]:  # fmt: skip
    """Run what ``python -m module`` runs, in a fork of a process that has imported its modules.

    prepared: the module whose ``prepare`` imports them. terminal: its standard input, in place
    of ``stdin``. Raises TimeoutError after ``timeout`` s.
    """
    with ExitStack() as stack:
        files = [stack.enter_context(tempfile.TemporaryFile()) for _ in range(3)]
        files[0].write(stdin)
        files[0].seek(0)
        request = [module, list(argv), dict(environment), str(folder or Path.cwd())]
        text, server = json.dumps(request).encode(), _server(prepared)
        server.settimeout(timeout)
        streams = [file.fileno() for file in files]
        streams[0] = streams[0] if terminal is None else terminal
        socket.send_fds(server, [LENGTH.pack(len(text))], streams)
        server.sendall(text)
        status, seconds = ANSWER.unpack(_received(server, ANSWER.size))
        _spent[0] += seconds
        for file in files[1:]:
            file.seek(0)
        return subprocess.CompletedProcess(argv, int(status), files[1].read(), files[2].read())


@cache
def _server(prepared: str) -> socket.socket:
    """Start the process that forks; it ends with this one, which closes the socket."""
    ours, theirs = socket.socketpair()
    # -P: no folder's modules get in the way. Threads of BLAS wait for each other on a busy machine.
    server = subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, str(theirs.fileno()), prepared],
        pass_fds=[theirs.fileno()], cwd=ROOT, stdin=subprocess.DEVNULL, process_group=0,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "PYTHONHOME": ""},
    )  # fmt: skip
    theirs.close()

    def end() -> None:
        ours.close()
        os.killpg(server.pid, signal.SIGTERM)  # a command that did not end, too
        server.wait()

    atexit.register(end)
    return ours


def _received(connection: socket.socket, count: int) -> bytes:
    text = b""
    while len(text) < count:
        piece = connection.recv(count - len(text))
        if not piece:
            raise EOFError
        text += piece
    return text


def prepare() -> None:
    """Import all modules of the package."""
    import hframe_post

    for module in pkgutil.walk_packages(hframe_post.__path__, "hframe_post."):
        if not module.name.startswith(("hframe_post.hosts.", "hframe_post.__main__")):
            import_module(module.name)


def serve(connection: socket.socket) -> None:
    """Run what is asked for until the other end is closed."""
    while True:
        head, streams, _, _ = socket.recv_fds(connection, LENGTH.size, 3)
        if not head:
            return
        request = json.loads(_received(connection, LENGTH.unpack(head)[0]))
        pid = os.fork()
        if pid == 0:
            connection.close()
            _run(request, streams)
        for stream in streams:
            os.close(stream)
        _, status, used = os.wait4(pid, 0)
        seconds = used.ru_utime + used.ru_stime
        connection.sendall(ANSWER.pack(os.waitstatus_to_exitcode(status), seconds))


def _run(request: tuple[str, list[str], dict[str, str], str], streams: Sequence[int]) -> NoReturn:
    """Do in this process, a fork, what ``python -m module`` does in a new one."""
    status = 1
    try:
        module, sys.argv, environment, folder = request
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        sys.stdin = os.fdopen(0)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        import_module(module).main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else bool(end.code)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def main() -> None:
    """Import what the second argument prepares, then serve the socket of the first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends this process through its tests
    import_module(sys.argv[2]).prepare()
    gc.freeze()  # no fork searches these modules for garbage
    signal.signal(signal.SIGINT, signal.default_int_handler)
    serve(socket.socket(fileno=int(sys.argv[1])))


if __name__ == "__main__":
    main()
