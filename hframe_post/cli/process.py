"""What a process owes its surroundings: signals, standard streams, and an honest exit status."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import traceback
from types import FrameType
from typing import NoReturn, TextIO

import click

from hframe_post.cli.leash import end_with_parent
from hframe_post.writers.files.temporary import give_up

DEADLY = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGXCPU")
SHOW_CURSOR = b"\x1b[?25h\n"  # that the progress bar has hidden


def run(command: click.Command) -> NoReturn:
    """Runs a command and ends the process: 0 only if all went well, and all could be said."""
    _open_closed_streams()
    _clean_up_when_killed()
    end_with_parent()
    try:
        command()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except MemoryError:
        status = _failed("there is not enough memory; nothing was written")
    except OSError as error:  # of standard output, while click wrote there
        status = _failed(error.strerror or str(error))
    except Exception as error:  # a mistake of ours, not the user's
        status = _failed(_fault(error))
    sys.exit(_flushed(status))


def processors() -> int:
    """Those that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def itself() -> list[str]:
    """The beginning of a command that runs this tool in another process."""
    if getattr(sys, "frozen", False):  # one file, that needs no Python
        return [sys.executable]
    return [sys.executable, "-m", "hframe_post"]


def _failed(message: str) -> int:
    with contextlib.suppress(OSError):
        click.echo(f"Error: {message}", err=True)
    return 1


def _fault(error: Exception) -> str:
    """One line from which the fault can be found."""
    frames = traceback.extract_tb(error.__traceback__)[-3:]
    places = ", ".join(f"{os.path.basename(f.filename)}:{f.lineno}" for f in reversed(frames))
    told = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return f"this is a fault of hframe-post, please report it: {told} ({places})"


# ---------------------------------------------------------------------- streams


def _open_closed_streams() -> None:
    """Streams that are closed become ones that fail, or swallow what is said on errors.

    Otherwise the next file that is opened would take their place, and get what others print.
    """
    for descriptor, mode in ((0, os.O_WRONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, mode)  # the lowest number that is free: this one
    if sys.stdin is None:
        sys.stdin = _text(0, "r")
    if sys.stdout is None:
        sys.stdout = _text(1, "w")
    if sys.stderr is None:
        sys.stderr = _text(2, "w")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files are any bytes


def _text(descriptor: int, mode: str) -> TextIO:
    raw = io.FileIO(descriptor, mode)  # ``open`` would refuse what cannot be written
    buffered = io.BufferedReader(raw) if mode == "r" else io.BufferedWriter(raw)
    return io.TextIOWrapper(buffered, encoding="utf-8")


def _flushed(status: int) -> int:
    """The status, 1 where the last words did not get out; and nothing is left to say."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError) as error:
            if stream is sys.stdout and status == 0:
                status = 1 if isinstance(error, BrokenPipeError) else _failed(str(error))
            with contextlib.suppress(OSError, ValueError):  # what is left goes nowhere
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
    return status


# ---------------------------------------------------------------------- signals


def _clean_up_when_killed() -> None:
    """No temporary file outlives the process: it ends as by the signal, but tidily.

    The handler ends the process itself. An exception could be lost in a library's callback,
    and would wait for threads.
    """
    for name in DEADLY:
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
