"""Processes: children that end with their parent, signals, standard streams, and memory."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import io
import os
import signal
import subprocess  # nosec B404  only this tool itself is started
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import TextIO

from hframe_post.writers.temporary import give_up

CHILD = "HFRAME_POST_CHILD"  # set in the environment of a ChildProcess
FATAL_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU")
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
SHOW_CURSOR = b"\x1b[?25h\n"  # progress bars hide it


def processor_count() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def own_command() -> list[str]:
    """Return the first words of a command that runs this tool in another process.

    -P: a folder of the same name where the command runs, as that of the sources, is not the tool.
    """
    return [sys.executable, "-P", "-m", "hframe_post"]


def program_words() -> list[str]:
    """Return the words by which another program runs this tool: its installed command, if any."""
    for name in ("hframe-post", "hframe-post.exe"):
        if (installed := Path(sys.executable).parent / name).is_file():
            return [str(installed)]
    return own_command()


def program() -> str:
    """Return these words as one text: a path, or a command with quotes."""
    python, *rest = program_words()
    return " ".join((f'"{python}"', *rest)) if rest else python


class ChildProcess:
    """A process of this tool that ends, and cleans up, when its parent ends for any reason.

    Its standard input is a pipe that nobody writes to. Only the parent holds the other end, so
    the pipe closes when the parent is gone. Its two outputs are piped to the parent.
    """

    def __init__(self, command: Sequence[str]) -> None:
        reading_end, self._writing_end = os.pipe()
        try:
            # restored, SIGPIPE would end a child before its Python ignores it, as this one does
            self._process = subprocess.Popen(  # nosec B603  no shell, a list
                command, stdin=reading_end, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                env={**os.environ, CHILD: "1"}, restore_signals=False,
            )  # fmt: skip
        finally:
            os.close(reading_end)

    def wait(self) -> tuple[int, bytes, bytes]:
        """Wait for the end; return the exit status (-n: signal n), stdout and stderr."""
        try:
            output, error = self._process.communicate()
            return self._process.returncode, output, error
        finally:
            os.close(self._writing_end)

    def stop(self) -> None:
        """Ask the process to end; it removes its temporary files."""
        self._process.terminate()


def end_with_parent() -> None:
    """Start watching the parent if this process is a ``ChildProcess``."""
    if os.environ.get(CHILD):
        end_after(lambda: os.read(0, 1))  # which returns when the parent is gone


def end_after(wait: Callable[[], object]) -> None:
    """End this process once a function has returned, which waits in a thread."""

    def end() -> None:
        wait()
        while not give_up():  # let files finish that are being moved into place
            time.sleep(0.01)
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def clean_up_when_killed() -> None:
    """Remove temporary files when a signal ends this process.

    The handler ends the process itself: an exception could be lost in a library's callback, and
    would wait for threads.
    """
    for name in FATAL_SIGNALS:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _die)


def _die(number: int, _: FrameType | None) -> None:
    if give_up():
        with contextlib.suppress(OSError, ValueError):
            if sys.stderr.isatty():
                os.write(sys.stderr.fileno(), SHOW_CURSOR)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)


class Interruption:
    """The first of the signals that would end the process, put off until a command has reported.

    A second signal ends the process at once. number: of the first one; 0: none yet.
    """

    def __init__(self) -> None:
        self.number = 0

    @contextlib.contextmanager
    def put_off(self, stop: Callable[[], None]) -> Iterator[None]:
        """Call ``stop`` at the first signal within the block."""

        def first(number: int, frame: FrameType | None) -> None:
            if self.number:
                _die(number, frame)
            self.number = number
            stop()

        numbers = [getattr(signal, name) for name in FATAL_SIGNALS if hasattr(signal, name)]
        ours = [number for number in numbers if signal.getsignal(number) is _die]
        for number in ours:
            signal.signal(number, first)
        try:
            yield
        finally:
            for number in ours:
                signal.signal(number, _die)

    def end(self) -> None:
        """End the process as the signal would have, if there was one."""
        if self.number:
            flush_streams()
            _die(self.number, None)


def open_closed_streams() -> None:
    """Replace closed standard streams by streams on the null device.

    Otherwise the next file to be opened would take a stream's number, and receive what is printed.
    The null device is opened the wrong way round, so that reading input or writing output fails.
    """
    for descriptor, mode in ((0, os.O_WRONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, mode)  # takes the lowest free number: this one
    if sys.stdin is None:
        sys.stdin = _text_stream(0, "r")
    if sys.stdout is None:
        sys.stdout = _text_stream(1, "w")
    if sys.stderr is None:
        sys.stderr = _text_stream(2, "w")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # file names may hold any bytes


def _text_stream(descriptor: int, mode: str) -> TextIO:
    raw = io.FileIO(descriptor, mode)  # `open` would refuse a stream that cannot be written
    buffered = io.BufferedReader(raw) if mode == "r" else io.BufferedWriter(raw)
    return io.TextIOWrapper(buffered, encoding="utf-8")


def flush_streams() -> OSError | ValueError | None:
    """Flush standard output and error; return why output failed, None if it did not.

    A stream that cannot be flushed is redirected to the null device, so that Python does not
    complain about it at exit.
    """
    failure: OSError | ValueError | None = None
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError) as error:
            if stream is sys.stdout:
                failure = error
            with contextlib.suppress(OSError, ValueError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
    return failure


def keep_memory() -> None:
    """Let the allocator keep what this process frees, up to 64 MB, for the next chunk.

    Otherwise it returns each chunk to the system and gets it back page by page. Garbage is
    collected less often: few of the many objects of a conversion refer to each other in a circle.
    """
    gc.freeze()
    gc.set_threshold(50_000)  # new objects; 700 by default
    allocate = _c_function("mallopt")
    if allocate is not None:
        allocate(M_MMAP_THRESHOLD, 1 << 25)
        allocate(M_TRIM_THRESHOLD, 1 << 26)


def release_memory() -> None:
    """Return freed memory to the system, which the allocator keeps for this process."""
    gc.collect()
    trim = _c_function("malloc_trim")
    if trim is not None:
        trim(0)


def _c_function(name: str) -> Callable[..., int] | None:
    """Return a function of glibc; other C libraries do not have it."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
