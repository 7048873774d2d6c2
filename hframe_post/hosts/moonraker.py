"""Moonraker's component: convert each new file of G-code before Moonraker reads its metadata.

Moonraker imports this file through a link in its components folder, and runs it as a program for
each new file. Both happen in Moonraker's Python, so hframe-post runs as a process.

While a file is converted it is in FOLDER, and its place is taken by a line of G-code that Klipper
answers with an error. If Moonraker is stopped meanwhile, it finds that line when it starts again
and converts the file then. A file that cannot be converted gets such a line, with the reason, in
front: no interface can print it.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import quote

NAME = "hframe_post"
FOLDER = ".hframe_post"  # in the folder of G-code, so that moving a file copies nothing
ENDPOINT = "/server/hframe_post/report"
TIMEOUT = 4 * 3600.0  # s, for one file
STAMP = r"^; processed by hframe-post (?P<version>[^\s,]+)"
# Klipper's answer to an unknown name is an error that shows it, and an error ends the print
REFUSAL = 'RESTORE_GCODE_STATE NAME="hframe-post: '
CONVERTING = "not converted yet: try again later, or upload the file again"
LOG = re.compile(r"\s*\d+\.\d{3} s  (?P<text>.*)")  # of hframe-post -v
PERCENT = re.compile(r"\d+ % is read")
QUIET = 5.0  # s between two reports of progress


class HframePost:
    """The component. ``command`` in its section runs hframe-post."""

    def __init__(self, config: Any) -> None:
        common = import_module("moonraker.common")
        self.server = config.get_server()
        command = shlex.split(config.get("command"))
        files = self.server.lookup_component("file_manager")
        gcodes = Path(files.get_directory("gcodes"))
        (gcodes / FOLDER).mkdir(exist_ok=True)
        files.add_reserved_path(NAME, gcodes / FOLDER, False)
        arguments = [str(gcodes), self.server.get_app_args()["unix_socket_path"], *command]
        processor = {
            "name": NAME,
            "command": [sys.executable, __file__, "{gcode_file_path}", *arguments],
            "timeout": TIMEOUT,
            "ident": {"regex": STAMP, "location": "header"},
        }
        files.get_metadata_storage().register_gcode_processor(NAME, processor)
        self.server.register_endpoint(ENDPOINT, common.RequestType.POST, self._report)

    async def _report(self, request: Any) -> str:
        """Show a message in the console of the web interface; a failure also as announcement."""
        text, failed = request.get_str("text"), request.get_boolean("failed")
        self.server.send_event("server:gcode_response", f"!! {text}" if failed else f"// {text}")
        if failed:
            announcements = self.server.lookup_component("announcements")
            announcements.add_internal_announcement("Not converted", text, "", "high", NAME)
        return "ok"


def load_component(config: Any) -> HframePost:
    return HframePost(config)


# ---------------------------------------------------------------------- the program


class FailureError(Exception):
    """The reason why a file is not converted."""


class Upload:
    """A file of G-code at ``path``, and its place ``work`` while it is converted."""

    def __init__(self, path: Path, gcodes: Path) -> None:
        name = quote(os.path.relpath(path, gcodes), safe="")[-200:]
        self.path, self.work = path, gcodes / FOLDER / f"{name}.sliced"

    def take(self) -> None:
        """Let ``work`` be the slicer's file and put a refusal in its place."""
        with self.path.open("rb") as file:
            if not file.readline().startswith(REFUSAL.encode()):
                self._keep()
            elif file.peek(1):
                with self._new() as new, new.open("wb") as copy:
                    shutil.copyfileobj(file, copy)
                    new.replace(self.work)
            elif not self.work.exists():
                raise FailureError("its conversion was interrupted: upload it again")
        self.refuse(CONVERTING)

    def _keep(self) -> None:
        self.work.unlink(missing_ok=True)
        try:
            os.link(self.path, self.work)  # moved away, the file would be reported as deleted
            if self.path.is_symlink() or self.work.stat().st_nlink > 2:
                raise OSError("the file has other names, which keep it")
        except OSError:  # also on another file system
            with self._new() as new:
                shutil.copyfile(self.path, new)
                new.replace(self.work)

    def refuse(self, reason: str, in_front: bool = False) -> None:
        """Replace the file by a line that Klipper refuses, or put that line in front of it."""
        said = re.sub(r'["\\#*;]+', "'", " ".join(reason.split()))
        with self._new() as new:
            with new.open("wb") as file:
                file.write(f'{REFUSAL}{said}"\n'.encode())
                if in_front:
                    with self.work.open("rb") as work:
                        shutil.copyfileobj(work, file)
            shutil.move(new, self.path)
        if in_front:
            self.work.unlink()

    def give_back(self) -> None:
        """Put the converted file where the slicer's was."""
        shutil.move(self.work, self.path)

    @contextlib.contextmanager
    def _new(self) -> Iterator[Path]:
        new = self.work.with_suffix(".new")
        try:
            yield new
        finally:
            new.unlink(missing_ok=True)


class Interface:
    """The web interface, reached through Moonraker's socket."""

    def __init__(self, address: str, name: str) -> None:
        self._address, self._name, self._last = address, name, time.monotonic()

    def progress(self, text: str) -> None:
        if time.monotonic() - self._last > QUIET:
            self.report(text)

    def report(self, text: str, failed: bool = False) -> None:
        self._last = time.monotonic()
        params = {"text": f"hframe-post: {self._name}: {text}", "failed": failed}
        request = {
            "jsonrpc": "2.0",
            "method": "server.hframe_post.report",
            "params": params,
            "id": 1,
        }
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(10.0)
            connection.connect(self._address)
            connection.sendall(json.dumps(request).encode() + b"\x03")
            connection.recv(4096)


def converted(work: Path, command: list[str], interface: Interface) -> str:
    """Convert a file in place and return the summary. Raises FailureError with the reason."""
    try:
        process = subprocess.Popen(
            [*command, "-v", str(work)], text=True, errors="replace",
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            env={**os.environ, "HFRAME_POST_CHILD": "1"},  # ends when its standard input closes
        )  # fmt: skip
    except OSError as error:
        raise FailureError(f"{command[0]} cannot be run: {error.strerror}") from None
    shown = []
    with process:
        assert process.stderr is not None
        for line in process.stderr:
            logged = LOG.match(line)
            if logged is None:
                shown.append(line.rstrip())
            elif PERCENT.match(logged["text"]):
                interface.progress(logged["text"])
        status = process.wait()
    if status != 0:
        raise FailureError(" ".join(shown[-1:]) or f"hframe-post ended with status {status}")
    left_alone = shown and shown[0].startswith(f"{work}: ")
    return shown[0].removeprefix(f"{work}: ") if left_alone else "\n".join(["converted", *shown])


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other conversion runs, such as one of a Moonraker that was killed."""
    import fcntl  # which Windows has not, where setup reads this file

    lock = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def main(path: str, gcodes: str, address: str, *command: str) -> int:
    """Convert a file and return the exit status. If it fails, the file cannot be printed."""
    os.nice(10)  # Klipper may be printing
    upload, interface = Upload(Path(path), Path(gcodes)), Interface(address, Path(path).name)
    with alone(upload.work.parent):
        try:
            upload.take()
            summary = converted(upload.work, list(command), interface)
            upload.give_back()
        except (FailureError, OSError) as error:
            reason = f"not converted: {str(error).removeprefix('Error: ')}"
            interface.report(reason, failed=True)
            refuse(upload, reason)
            return 1
    interface.report(summary)
    return 0


def refuse(upload: Upload, reason: str) -> None:
    """Make sure that a file is not printed. Nothing is lost: on a full disk ``work`` stays."""
    if not upload.work.exists():  # it could not even be read
        return
    for in_front in (True, False):  # where the file does not fit a second time, a line may
        with contextlib.suppress(OSError):
            return upload.refuse(reason, in_front)
    with contextlib.suppress(OSError):
        upload.path.unlink()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
