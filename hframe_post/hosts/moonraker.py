"""Moonraker's component: convert each new file of G-code before Moonraker reads its metadata.

Moonraker imports this file through a link in its components folder, and runs it as a program for
each new file. Both happen in Moonraker's Python, so hframe-post runs as a process.

While a file is converted it is in FOLDER, and its place is taken by a line of G-code that Klipper
answers with an error, and a comment that names the kept file. If Moonraker is stopped meanwhile, it
finds these lines when it starts again and converts the file then, also under another name. A file
that cannot be converted gets such a line, with the reason, in front: no interface can print it.
If the user deletes the file, its conversion stops.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import secrets
import shlex
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import IO, Any

NAME = "hframe_post"
FOLDER = ".hframe_post"  # in the folder of G-code, so that moving a file copies nothing
ENDPOINT = "/server/hframe_post/report"
TIMEOUT = 4 * 3600.0  # s, for one file
STAMP = r"^; processed by hframe-post (?P<version>[^\s,]+)"
# Klipper's answer to an unknown name is an error that shows it, and an error ends the print
REFUSAL = 'RESTORE_GCODE_STATE NAME="hframe-post: '
KEPT = b"; hframe-post keeps the sliced file as "  # the line below a refusal that stands alone
KEPT_NAME = re.compile(rb"[0-9a-f]{64}-[0-9a-f]{16}\.sliced")
LONGEST = 1 << 16  # bytes of a refusal that stands alone
CONVERTING = "not converted yet: try again later, or upload the file again"
INTERRUPTED = "its conversion was interrupted: upload it again"
LOG = re.compile(r"\s*\d+\.\d{3} s  (?P<text>.*)")  # of hframe-post -v
PERCENT = re.compile(r"\d+ % is read")
QUIET = 5.0  # s between two reports of progress
WATCH = 0.3  # s between two looks whether the user has deleted the file
SETTLED = 1.0  # s without a change, after which a file is complete


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
        self._storage = files.get_metadata_storage()
        self._storage.register_gcode_processor(NAME, processor)
        self._gcodes, self._delete_file = gcodes, files.delete_file
        files.delete_file = self._stop_and_delete
        self.server.register_endpoint(ENDPOINT, common.RequestType.POST, self._report)

    async def _stop_and_delete(self, path: str) -> Any:
        """Delete a file in Moonraker's way, but at once if it is being converted.

        Moonraker deletes nothing until an upload is finished. Without its file, it soon is.
        """
        root, _, name = os.path.normpath(path).strip("/").partition("/")
        print_job = self.server.lookup_component("job_state").get_last_stats()
        printing = print_job.get("state") in ("printing", "paused")
        if (
            root != "gcodes"
            or not self._storage.is_file_processing(name)
            or (printing and print_job.get("filename") == name)
        ):
            return await self._delete_file(path)
        (self._gcodes / name).unlink(missing_ok=True)
        with contextlib.suppress(self.server.error):  # the file is gone already
            return await self._delete_file(path)
        item = {"path": name, "root": root, "size": 0, "modified": 0, "permissions": ""}
        deleted = {"action": "delete_file", "item": item}
        # interfaces hear of the upload a second after it
        self.server.get_event_loop().delay_callback(
            2.0, self.server.send_event, "file_manager:filelist_changed", deleted
        )
        return deleted

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


class GoneError(Exception):
    """The user has deleted, renamed or replaced the file."""


class Upload:
    """A file of G-code at ``path``, and its place ``work`` while it is converted."""

    def __init__(self, path: Path, gcodes: Path) -> None:
        relative = os.fsencode(os.path.relpath(path, gcodes))
        self.path, self._gcodes = path, gcodes
        self._hash = hashlib.sha256(relative).hexdigest()
        # never the same name twice, so that a refusal can only mean the file that it stands for
        self.work = gcodes / FOLDER / f"{self._hash}-{secrets.token_hex(8)}.sliced"
        self._refusal: tuple[int, ...] = ()

    def take(self) -> None:
        """Let ``work`` be the slicer's file and put a refusal in its place."""
        kept = kept_for(self.path)
        with self.path.open("rb") as file:
            if kept:
                self._find(self.work.with_name(kept))
            elif not file.readline().startswith(REFUSAL.encode()):
                self._keep()
            elif file.peek(1):
                with self._new() as new:
                    write(new, b"", file)
                    new.replace(self.work)
            else:
                raise FailureError(INTERRUPTED)
        self.refuse(CONVERTING)
        self._forget()

    def _find(self, kept: Path) -> None:
        """Let ``work`` be the file that the refusal names."""
        if not kept.exists():
            raise FailureError(INTERRUPTED)
        if all(path == self.path for path in refusals(self._gcodes, kept.name)):
            self.work = kept
            return
        with self._new() as new, kept.open("rb") as file:  # somebody copied the refusal
            write(new, b"", file)
            new.replace(self.work)

    def _keep(self) -> None:
        try:
            os.link(self.path, self.work)  # moved away, the file would be reported as deleted
            if self.path.is_symlink() or self.work.stat().st_nlink > 2:
                raise OSError("the file has other names, which keep it")
        except OSError:  # also on another file system
            with self._new() as new, self.path.open("rb") as file:
                write(new, b"", file)
                new.replace(self.work)

    def _forget(self) -> None:
        """Remove what earlier uploads of this name left, unless a refusal still names it."""
        for old in self.work.parent.glob(f"{self._hash}-*"):
            if old != self.work and not any(refusals(self._gcodes, old.name)):
                old.unlink(missing_ok=True)

    def refuse(self, reason: str, in_front: bool = False) -> None:
        """Replace the file by a line that Klipper refuses, or put that line in front of it."""
        said = re.sub(r'["\\#*;]+', "'", " ".join(reason.split()))
        line = f'{REFUSAL}{said}"\n'.encode(errors="replace")
        with self._new() as new:
            if in_front:
                with self.work.open("rb") as work:
                    write(new, line, work)
            else:
                write(new, line + KEPT + self.work.name.encode() + b"\n")
            self._place(new)
        self._refusal = stamp(self.path)
        if in_front:
            self.work.unlink()

    def give_back(self) -> None:
        """Put the converted file where the slicer's was. Raises GoneError."""
        if self.is_gone():
            raise GoneError
        self._place(self.work)

    def is_gone(self) -> bool:
        """Return whether anything but the refusal is in the file's place."""
        return bool(self._refusal) and stamp(self.path) != self._refusal

    def let_go(self) -> str:
        """Remove ``work`` if nobody needs it; return what became of the file."""
        if stamp(self.path):
            self.work.unlink(missing_ok=True)
            return "replaced"
        if any(refusals(self._gcodes, self.work.name)):
            return "renamed"
        self.work.unlink(missing_ok=True)
        return "deleted"

    def _place(self, new: Path) -> None:
        """Move a file to ``path``, where it is complete as soon as it is there."""
        try:
            new.replace(self.path)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            near = self.path.with_name(f".{self.work.stem}")
            try:
                with new.open("rb") as file:
                    write(near, b"", file)
                near.replace(self.path)
            finally:
                near.unlink(missing_ok=True)
            new.unlink()

    @contextlib.contextmanager
    def _new(self) -> Iterator[Path]:
        new = self.work.with_suffix(".new")
        try:
            yield new
        finally:
            new.unlink(missing_ok=True)


def write(path: Path, head: bytes, rest: IO[bytes] | None = None) -> None:
    """Write a file that is complete even if the power fails right after its renaming."""
    with path.open("wb") as file:
        file.write(head)
        if rest is not None:
            shutil.copyfileobj(rest, file)
        file.flush()
        os.fsync(file.fileno())


def stamp(path: Path) -> tuple[int, ...]:
    """Return numbers that change if a file is replaced or written to; empty if it is gone."""
    try:
        found = path.lstat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def kept_for(path: Path) -> str:
    """Return the name of the kept file that a refusal in its place names; empty: none."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        refusal, comment, *more = [*file.read(LONGEST).split(b"\n"), b""]
        name = comment.removeprefix(KEPT)
        if refusal.startswith(REFUSAL.encode()) and comment.startswith(KEPT) and not any(more):
            return name.decode() if KEPT_NAME.fullmatch(name) else ""
    return ""


def refusals(gcodes: Path, kept: str) -> Iterator[Path]:
    """Yield the files that stand for a kept file: more than one if one was copied."""
    seen = set()
    for folder, folders, files in os.walk(gcodes, followlinks=True):
        here = os.path.realpath(folder)
        folders[:] = [] if here in seen else [name for name in folders if name != FOLDER]
        seen.add(here)
        for path in (Path(folder, name) for name in files):
            with contextlib.suppress(OSError):
                if path.stat().st_size < LONGEST and kept_for(path) == kept:
                    yield path


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


def converted(upload: Upload, command: list[str], interface: Interface) -> str:
    """Convert a file in place and return the summary.

    Raises FailureError with the reason, GoneError if the user has deleted the file meanwhile.
    """
    work = str(upload.work)
    try:
        process = subprocess.Popen(
            [*command, "-v", work], text=True, errors="replace",
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            env={**os.environ, "HFRAME_POST_CHILD": "1"},  # ends when its standard input closes
        )  # fmt: skip
    except OSError as error:
        raise FailureError(
            f"{command[0]} cannot be run: {error.strerror}. Correct command in [{NAME}] of "
            "moonraker.conf"
        ) from None
    shown = []
    with process:
        assert process.stderr is not None
        threading.Thread(target=end_if_gone, args=(process, upload), daemon=True).start()
        for line in process.stderr:
            logged = LOG.match(line)
            if logged is None:
                shown.append(line.rstrip())
            elif PERCENT.match(logged["text"]):
                interface.progress(logged["text"])
        status = process.wait()
    if upload.is_gone():
        raise GoneError
    shown = [line.replace(work, upload.path.name) for line in shown]
    if status != 0:
        raise FailureError(" ".join(shown[-1:]) or f"hframe-post ended with status {status}")
    ours = f"{upload.path.name}: "
    left_alone = shown and shown[0].startswith(ours)
    return shown[0].removeprefix(ours) if left_alone else "\n".join(["converted", *shown])


def end_if_gone(process: subprocess.Popen[str], upload: Upload) -> None:
    """End a conversion, by closing its standard input, if the user deletes the file."""
    while process.poll() is None:
        if upload.is_gone() and process.stdin is not None:
            process.stdin.close()
            return
        time.sleep(WATCH)


def settle(path: Path) -> None:
    """Wait until nobody writes to a file any more."""
    before: tuple[int, ...] | None = None
    while (now := stamp(path)) != before:
        before = now
        time.sleep(SETTLED)


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
    interface = Interface(address, os.fsencode(Path(path).name).decode(errors="replace"))
    with alone(Path(gcodes) / FOLDER):
        while stamp(Path(path)):  # otherwise it was deleted while it waited
            upload = Upload(Path(path), Path(gcodes))
            try:
                upload.take()
                summary = converted(upload, list(command), interface)
                upload.give_back()
            except (FailureError, GoneError, OSError) as error:
                fate = upload.let_go() if upload.is_gone() else "failed"
                if fate == "replaced":  # Moonraker does not read a file while it reads it
                    settle(upload.path)
                    continue
                if fate == "failed":
                    reason = f"not converted: {cause(error)}"
                    interface.report(reason, failed=True)
                    refuse(upload, reason)
                else:
                    interface.report(f"its conversion was stopped, because it was {fate}")
                return 1
            interface.report(summary)
            return 0
    return 1


def cause(error: Exception) -> str:
    """Return what is wrong, where, and what to do."""
    if isinstance(error, OSError) and error.strerror:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        where = Path(error.filename).parent if full and error.filename else error.filename
        advice = ". Make room there, then upload the file again" if full else ""
        return ": ".join(str(part) for part in (where, error.strerror) if part) + advice
    return str(error).removeprefix("Error: ")


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
