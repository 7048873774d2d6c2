"""What Moonraker calls: endpoints, methods of Klipper's macros, and what begins a print."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shlex
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

from .answering import Answering, Pages
from .conversion import ENDPOINT, Settings, as_html
from .disk import FOLDER, NAME
from .measuring import FRESH, STALE, Freshness, Measuring
from .originals import STAMP

PROGRAM = str(Path(__file__).resolve().parent)
CONVERT, CANCEL, STATUS = (f"/server/{NAME}/{word}" for word in ("convert", "cancel", "status"))
PROCESS_S = 4 * 3600.0  # s, for a process
UPLOADS = ("convert", "leave")
METADATA_S = 60.0  # s, in which Moonraker reads those of a file
MEGABYTE = 1_000_000
IDENTIFY = "'hframe-post identify FOLDER --printer-cfg printer.cfg -o printer.toml'"
TIDY_S = 5.0  # s after the start, and after files are deleted


class HframePost:
    """The component. ``command`` in its section runs hframe-post."""

    def __init__(self, config: Any) -> None:
        self.server = config.get_server()
        self._files = self.server.lookup_component("file_manager")
        gcodes = Path(self._files.get_directory("gcodes"))
        (gcodes / FOLDER).mkdir(exist_ok=True)
        self._files.add_reserved_path(NAME, gcodes / FOLDER, False)
        settings = Settings(
            str(gcodes), self.server.get_app_args()["unix_socket_path"],
            shlex.split(config.get("command")), MEGABYTE * config.getint("keep", 1000, minval=0),
            config.get("recordings", tempfile.gettempdir()),
        )  # fmt: skip
        self._gcodes, self._command = gcodes, [sys.executable, PROGRAM]
        self.checked = gcodes / FOLDER / "check"  # changed by each check
        self._words = settings.as_json()
        self._processes: dict[asyncio.subprocess.Process, str] = {}  # with their duties
        self._tidying = False
        self.pages = Pages(self, gcodes, settings.originals)
        self.measuring = Measuring(self.server, self.run, self.say)
        self._freshness = Freshness(
            self,
            config.getchoice("stale", {name: name for name in STALE}, STALE[0]),
            config.getchoice("fresh", {name: name for name in FRESH}, FRESH[0]),
        )
        self._storage = self._files.get_metadata_storage()
        uploads = {name: name for name in UPLOADS}
        self._converts = config.getchoice("uploads", uploads, UPLOADS[0]) == UPLOADS[0]
        self._connect()

    def _connect(self) -> None:
        """Let Moonraker call what this component does."""
        processor = {
            "name": NAME,
            "command": [*self._command, "upload", self._words, "{gcode_file_path}"],
            "timeout": PROCESS_S,
            "ident": {"regex": f"^{STAMP}", "location": "header"},
        }
        if self._converts:  # otherwise Klipper compensates
            self._storage.register_gcode_processor(NAME, processor)
        self._delete_file, self._files.delete_file = self._files.delete_file, self._stop_and_delete
        Answering(self._files, self._gcodes, self.say)
        klippy, server = self.server.lookup_component("klippy_apis"), self.server
        self._start_print, klippy.start_print = klippy.start_print, self._start_fresh
        kinds = import_module("moonraker.common").RequestType
        server.register_endpoint(ENDPOINT, kinds.POST, self._report)
        server.register_endpoint(CONVERT, kinds.POST, self._convert_requested)
        server.register_endpoint(CANCEL, kinds.POST, self._cancel_requested)
        server.register_endpoint(STATUS, kinds.GET, self._status_requested)
        self.pages.register(server, kinds.GET)
        server.register_remote_method("hframe_calibrate", self._calibrate)
        server.register_remote_method("hframe_check", self._check)
        server.register_remote_method("hframe_convert", self._convert_typed)
        server.register_event_handler("file_manager:filelist_changed", self._files_changed)
        server.register_event_handler("job_state:state_changed", self._freshness.job_changed)
        server.get_event_loop().delay_callback(TIDY_S, self._tidy)

    async def close(self) -> None:
        """End the processes, when Moonraker ends. What they leave is removed at its next start."""
        for process in self._processes:
            with contextlib.suppress(ProcessLookupError):
                process.kill()

    # ------------------------------------------------------------------ for the other modules

    async def run(self, duty: str, *words: str) -> tuple[int, str]:
        """Run a duty as a process; return its exit status and what it printed."""
        process = await asyncio.create_subprocess_exec(
            *self._command, duty, self._words, *words,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        self._processes[process] = duty
        try:
            output, _ = await asyncio.wait_for(process.communicate(), PROCESS_S)
            return process.returncode or 0, output.decode()
        finally:
            del self._processes[process]
            if process.returncode is None:
                process.kill()

    def say(self, text: str, failed: bool = False) -> None:
        """Show a message in the console of the web interface; a failure also as announcement."""
        self.show(f"hframe-post: {text}", failed)

    def show(self, text: str, failed: bool) -> None:
        text = as_html(text)
        self.server.send_event("server:gcode_response", f"!! {text}" if failed else f"// {text}")
        if failed:
            announcements = self.server.lookup_component("announcements")
            announcements.add_internal_announcement("hframe-post", text, "", "high", NAME)

    def prints(self) -> str:
        """Return the name of the file that is printed, also while it is paused; empty: none."""
        stats = self.server.lookup_component("job_state").get_last_stats()
        return str(stats["filename"]) if stats.get("state") in ("printing", "paused") else ""

    def knows(self, name: str) -> bool:
        """Return whether Moonraker lists a file: no other name is ever made a path."""
        return self._storage.get(name) is not None

    async def convert(self, *names: str) -> bool:
        """Convert files again, and let Moonraker read them. Names are Moonraker's own.

        Returns whether all were converted.
        """
        status, _ = await self.run("again", *names)
        for name in names:
            with contextlib.suppress(OSError, asyncio.TimeoutError):
                info = self._files.get_path_info(self._gcodes / name, "gcodes")
                read = self._storage.parse_metadata(name, info)
                await asyncio.wait_for(read.wait(), METADATA_S)
        return status == 0

    def cancel(self) -> None:
        """End conversions of files that were converted before. These stay as they are."""
        again = [process for process, duty in self._processes.items() if duty == "again"]
        for process in again:
            process.kill()  # hframe-post ends with it
        self.say(
            "cancelled; files stay as they are"
            if again
            else "no file is converted again. To "
            "stop the conversion of an upload, refresh the list of files and delete it there"
        )

    # ------------------------------------------------------------------ for Moonraker

    async def _start_fresh(self, filename: str, *arguments: Any, **named: Any) -> Any:
        try:
            await self._freshness.before(filename.lstrip("/"))
        except (OSError, ValueError, asyncio.TimeoutError) as error:  # noqa: UP041  Python 3.9
            self.say(f"{filename} is printed as it is: {error}", True)
        return await self._start_print(filename, *arguments, **named)

    async def _stop_and_delete(self, path: str) -> Any:
        """Delete a file in Moonraker's way, but at once if it is being converted.

        Moonraker deletes nothing until an upload is finished. Without its file, it soon is.
        """
        root, _, name = os.path.normpath(path).strip("/").partition("/")
        converting = root == "gcodes" and self._storage.is_file_processing(name)
        if not converting or self.prints() == name:
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
        self.show(request.get_str("text"), request.get_boolean("failed"))
        return "ok"

    async def _convert_requested(self, request: Any) -> dict[str, Any]:
        """Begin to convert a file again, or all that are stale; the console says how it goes."""
        names = await self._to_convert(request.get_str("filename", ""))
        if names:
            self.server.get_event_loop().register_callback(self.convert, *names)
        return {"converting": names}

    async def _cancel_requested(self, _: Any) -> str:
        self.cancel()
        return "ok"

    async def _status_requested(self, _: Any) -> dict[str, Any]:
        """Return which files are stale, and whether the printer is being measured."""
        status, output = await self.run("stale")
        stale = json.loads(output)["kept"] if status == 0 else []
        return {"measuring": self.measuring.busy, "stale": stale, "profile_usable": status == 0}

    async def _to_convert(self, name: str) -> list[str]:
        """Return a file's name if Moonraker knows it, or without one those of all stale files.

        Raises Moonraker's error.
        """
        if name:
            if not self.knows(name):
                raise self.server.error(f"there is no file {name}", 404)
            names = [name]
        else:
            status, output = await self.run("stale")
            names = json.loads(output)["kept"] if status == 0 else []
        if self.prints() in names:
            names.remove(self.prints())
            self.say(f"{self.prints()} is printed now: it can be converted again afterwards")
        return names

    async def _files_changed(self, changed: dict[str, Any]) -> None:
        if changed["action"].startswith("delete") and not self._tidying:
            self._tidying = True
            self.server.get_event_loop().delay_callback(TIDY_S, self._tidy)

    async def _tidy(self) -> None:
        self._tidying = False
        await self.run("tidy")

    # ------------------------------------------------------------------ for Klipper's macros

    async def _calibrate(self, axis: str = "", recordings: str = "") -> None:
        if axis not in ("", "X", "Y"):
            self.say(f"AXIS is X or Y, not {axis}", True)
            return
        if recordings:  # of an older hframe.cfg
            self.say(f"RECORDINGS is gone: {IDENTIFY} takes recordings that you have made", True)
            return
        if await self.measuring.measure("calibration", axis):
            stale = (await self._status_requested(None))["stale"]
            if stale:
                when = "HFRAME_CONVERT converts them now"
                self.say(f"{len(stale)} files here were converted with an older model: {when}")

    async def _check(self) -> None:
        if self.prints():
            self.say(
                f"no check during a print: fresh in [{NAME}] of moonraker.conf makes one before"
            )
            return
        await self.measuring.measure("check")

    async def _convert_typed(self, filename: str = "", cancel: str = "") -> None:
        if cancel:
            self.cancel()
            return
        try:
            names = await self._to_convert(filename)
        except self.server.error as error:
            self.say(str(error), True)
            return
        self.say(f"{len(names)} files to convert again")
        if names:
            await self.convert(*names)
