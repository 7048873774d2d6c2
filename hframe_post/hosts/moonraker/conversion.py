"""hframe-post as a process: its conversion of a file, and its other commands."""

from __future__ import annotations

import contextlib
import html
import json
import os
import re
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from .disk import FOLDER, NAME, BeyondError, FailureError, GoneError
from .originals import PAGE_SUFFIX, SETTINGS, Originals

LOG = re.compile(r"\s*\d+\.\d{3} s  (?P<text>.*)")  # of hframe-post -v
PERCENT = re.compile(r"(?P<percent>\d+ %) is read")
SHORT = re.compile(  # also for the stack of a thread
    r"(not enough|lack of|cannot allocate) memory|memory allocation|start new thread", re.IGNORECASE
)
WATCH_S = 0.3  # s between two looks whether the user has deleted the file
ELSEWHERE = "Convert it on another computer, then upload it again"
MAX_HOURS = 2.0  # hours that a conversion may take
TITLE = "SLIC3R_PP_OUTPUT_NAME"  # the variable in which slicers tell the name of a temporary file


def converted(
    source: Path, target: Path, name: str, command: Sequence[str], interface: Interface,
    is_gone: Callable[[], bool], with_page: bool,
) -> tuple[str, bool]:  # fmt: skip
    """Convert a file; return the summary, and whether there was anything to convert.

    name: of the source for people. is_gone: whether the user has deleted the file meanwhile.
    with_page: also write its page next to the target, if that succeeds. Raises FailureError with
    the reason, BeyondError, GoneError.
    """
    deadline = time.monotonic() + 3600.0 * MAX_HOURS
    arguments = (source, target, name, command, interface, is_gone, deadline)
    if with_page and not any(word.startswith("--report") for word in command):
        with contextlib.suppress(FailureError):  # also of what a page needs more: memory, room
            return _converted(*arguments, ["--report", str(target.with_suffix(PAGE_SUFFIX))])
    return _converted(*arguments, [])


def _converted(
    source: Path, target: Path, name: str, command: Sequence[str], interface: Interface,
    is_gone: Callable[[], bool], deadline: float, more: Sequence[str],
) -> tuple[str, bool]:  # fmt: skip
    """Convert a file until a time. more: words of the command. Raises the same errors."""
    words = [*command, *more, "-v", "-o", str(target), str(source)]
    process = started(words, {TITLE: name} if more else {})
    shown, status = _followed(process, interface, lambda: is_gone() or time.monotonic() > deadline)
    shown = [line.replace(str(source), name) for line in shown if not line.startswith("file   ")]
    if is_gone():
        raise GoneError
    if status != 0:
        reason = " ".join(shown[-1:])
        if time.monotonic() > deadline:
            raise BeyondError(f"its conversion takes more than {MAX_HOURS:g} hours. {ELSEWHERE}")
        if SHORT.search(reason):
            raise BeyondError(f"its conversion takes more memory than it may. {ELSEWHERE}")
        if status < 0:
            raise BeyondError(f"its conversion was killed, perhaps for lack of memory. {ELSEWHERE}")
        raise FailureError(reason or f"hframe-post ended with status {status}")
    ours = f"{name}: "
    if shown and shown[0].startswith(ours):
        return shown[0].removeprefix(ours), False
    return "\n".join(["converted", *shown]), True


def _followed(
    process: subprocess.Popen[str], interface: Interface, is_over: Callable[[], bool]
) -> tuple[list[str], int]:
    """Report the progress of a conversion; return what else it printed and its exit status."""
    shown = []
    with process:
        assert process.stdout is not None
        threading.Thread(target=_end_if_over, args=(process, is_over), daemon=True).start()
        for line in process.stdout:
            logged = LOG.match(line)
            if logged is None:
                shown.append(line.rstrip())
            elif done := PERCENT.match(logged["text"]):
                interface.progress(f"being converted, {done['percent']} done")
        return shown, process.wait()


def said(command: Sequence[str], seconds: float) -> list[str]:
    """Run another command of hframe-post; return what it printed. Raises FailureError."""
    process = started(command)
    limit = threading.Timer(seconds, process.kill)
    limit.start()
    with process:
        assert process.stdout is not None
        lines = [line.rstrip() for line in process.stdout]
        status = process.wait()
    limit.cancel()
    if status < 0:
        raise FailureError(f"hframe-post {command[-1]} took more than {seconds:.0f} s")
    if status != 0:
        raise FailureError(" ".join(lines[-1:]) or f"hframe-post ended with status {status}")
    return lines


def started(
    command: Sequence[str], variables: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    """Start hframe-post, which ends when its standard input closes. Raises FailureError."""
    try:
        return subprocess.Popen(
            command, text=True, errors="replace",
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, "HFRAME_POST_CHILD": "1", **(variables or {})},
        )  # fmt: skip
    except OSError as error:
        raise FailureError(
            f"{command[0]} cannot be run: {error.strerror}. Correct command in [{NAME}] of "
            "moonraker.conf"
        ) from None


def _end_if_over(process: subprocess.Popen[str], is_over: Callable[[], bool]) -> None:
    """End a conversion, by closing its standard input, if nobody wants it any more."""
    while process.poll() is None:
        if is_over() and process.stdin is not None:
            process.stdin.close()
            return
        time.sleep(WATCH_S)


# ----------------------------------------------------------------------
# What processes of the component say in the web interface, through Moonraker's socket.

ENDPOINT, PAGE = "/server/hframe_post/report", "/server/hframe_post/page"
LINK = re.compile(rf"{PAGE}(\?file=[a-z0-9%./~-]+)?")
# capitals are encoded, too: Fluidd puts links of its own around those that are a command
PLAIN = frozenset(b"abcdefghijklmnopqrstuvwxyz0123456789./~-")
PROGRESS_S = 5.0  # s between two reports of progress
PAGE_SHOWS = "its page shows the predicted error, layer by layer"


def page_of(name: str) -> str:
    """Return the address of the page of a file. name: in Moonraker."""
    coded = (chr(byte) if byte in PLAIN else f"%{byte:02x}" for byte in os.fsencode(name))
    return f"{PAGE}?file={''.join(coded)}"


def as_html(text: str) -> str:
    """Return a text as consoles take it, with links to our pages.

    Mainsail, Fluidd and KlipperScreen read messages as markup. Names and lines of a file are shown
    as they are. Fluidd copies what is directly in a link to its command line, hence the ``b``.
    """
    link = r'<a href="\g<0>" target="_blank"><b>open the page</b></a>'
    return LINK.sub(link, html.escape(text, quote=False))


class Interface:
    """The web interface's console. name: of the file that the reports are about."""

    def __init__(self, address: str, name: str = "") -> None:
        self._address, self._name, self._last = address, name, time.monotonic()

    def progress(self, text: str) -> None:
        if time.monotonic() - self._last > PROGRESS_S:
            self.report(text)

    def report(self, text: str, failed: bool = False) -> None:
        self._last = time.monotonic()
        about = f"{self._name}: " if self._name else ""
        params = {"text": f"hframe-post: {about}{text}", "failed": failed}
        request = {
            "jsonrpc": "2.0",
            "method": ENDPOINT.strip("/").replace("/", "."),
            "params": params,
            "id": 1,
        }
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(10.0)
            connection.connect(self._address)
            connection.sendall(json.dumps(request).encode() + b"\x03")
            connection.recv(4096)


# ----------------------------------------------------------------------
# The section of moonraker.conf, as the component passes it to its processes.

COMMAND_S = 120.0  # s that the shortest command may take, on a slow host that prints


@dataclass(frozen=True)
class Settings:
    """gcodes: the folder of G-code. socket: Moonraker's. command: that converts. keep: bytes of
    sliced files. recordings: the folder into which Klipper writes those of accelerometers.
    """

    gcodes: str
    socket: str
    command: list[str]
    keep: int
    recordings: str

    @classmethod
    def from_json(cls, text: str) -> Settings:
        return cls(**json.loads(text))

    def as_json(self) -> str:
        return json.dumps(asdict(self))

    @property
    def folder(self) -> Path:
        return Path(self.gcodes) / FOLDER

    @property
    def originals(self) -> Originals:
        return Originals(Path(self.gcodes), self.keep)

    def present(self) -> str:
        """Return the hash of the present settings. Raises FailureError if the profile is unusable.

        It is that of the first line of a file that the command would convert now.
        """
        lines = said([*self.command, "--stamp"], COMMAND_S)
        found = [SETTINGS.match(f"{line}\n".encode()) for line in lines]
        for one in found:
            if one is not None:
                return one["settings"].decode()
        raise FailureError(" ".join(lines[-1:]) or "hframe-post says nothing of its settings")

    def program_and_profile(self) -> tuple[list[str], Path]:
        """Return the command's words before -p, and the profile after it. Raises FailureError."""
        for option in ("-p", "--printer"):
            if option in self.command[1:-1]:
                place = self.command.index(option)
                return self.command[:place], Path(self.command[place + 1])
        raise FailureError(
            f"command in [{NAME}] of moonraker.conf names no profile. Add -p and the profile's path"
        )
