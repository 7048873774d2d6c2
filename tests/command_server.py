"""A process that has imported the package and forks for each command it is asked to run."""

from __future__ import annotations

import json
import os
import pkgutil
import signal
import socket
import struct
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

LENGTH = struct.Struct("=q")  # of the request
ANSWER = struct.Struct("=qd")  # status, and processor time, s
_spent = [0.0]


def spent() -> float:
    """Return the processor time of all commands so far, s."""
    return _spent[0]


def ask(
    server: socket.socket, arguments: list[str], environment: dict[str, str], streams: Sequence[int]
) -> int:
    """Have a command run with these standard streams; return its exit status."""
    request = json.dumps([arguments, environment, os.getcwd()]).encode()
    socket.send_fds(server, [LENGTH.pack(len(request))], streams)
    server.sendall(request)
    status, seconds = ANSWER.unpack(_received(server, ANSWER.size))
    _spent[0] += seconds
    return int(status)


def _received(connection: socket.socket, count: int) -> bytes:
    text = b""
    while len(text) < count:
        piece = connection.recv(count - len(text))
        if not piece:
            raise EOFError
        text += piece
    return text


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


def _run(request: tuple[list[str], dict[str, str], str], streams: Sequence[int]) -> NoReturn:
    """Do in this process, a fork, what ``python -m hframe_post`` does in a new one."""
    status = 1
    try:
        arguments, environment, folder = request
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        sys.stdin = os.fdopen(0)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        sys.argv = ["hframe-post", *arguments]
        import_module("hframe_post.__main__").main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else bool(end.code)
    finally:
        os._exit(status)


def main() -> None:
    """Import all modules of the package, then serve the socket whose number is the argument."""
    import hframe_post

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends this process through its tests
    for module in pkgutil.walk_packages(hframe_post.__path__, "hframe_post."):
        if not module.name.startswith(("hframe_post.hosts.", "hframe_post.__main__")):
            import_module(module.name)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    serve(socket.socket(fileno=int(sys.argv[1])))


if __name__ == "__main__":
    main()
