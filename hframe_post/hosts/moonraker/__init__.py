"""Moonraker's component: measure the printer and keep its model right.

Moonraker imports this folder through a link in its components folder. Whatever takes time runs as
a process (``recordings``) in Moonraker's Python, which in turn runs hframe-post: nothing of that is
imported here, and Moonraker's loop never waits. Klipper records its accelerometers while it plays
a file, and hframe-post computes the model.
"""

from __future__ import annotations

import asyncio
import contextlib
import html
import json
import shlex
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from . import recordings
from .recordings import FOLDER, NAME, Settings

GONE = ("uploads", "keep", "stale", "fresh")  # options of a component that converted uploads


class HframePost:
    """The component. ``command`` in its section runs hframe-post."""

    def __init__(self, config: Any) -> None:
        self.server = server = config.get_server()
        files = server.lookup_component("file_manager")
        gcodes = Path(files.get_directory("gcodes"))
        (gcodes / FOLDER).mkdir(exist_ok=True)
        files.add_reserved_path(NAME, gcodes / FOLDER, False)
        settings = Settings(
            str(gcodes), shlex.split(config.get("command")),
            config.get("recordings", tempfile.gettempdir()),
        )  # fmt: skip
        self._words = json.dumps(asdict(settings))
        if gone := [name for name in GONE if config.get(name, None) is not None]:
            server.add_warning(
                f"[{NAME}]: {', '.join(gone)} can be deleted: uploads are not converted any more. "
                "'hframe-post connect moonraker' lets Klipper compensate by itself"
            )
        self._processes = set[asyncio.subprocess.Process]()
        self._busy = False
        server.register_remote_method("hframe_calibrate", self._calibrate)
        server.register_remote_method("hframe_check", self._check)

    async def close(self) -> None:
        """End the processes, when Moonraker ends."""
        for process in self._processes:
            with contextlib.suppress(ProcessLookupError):
                process.kill()

    # ------------------------------------------------------------------ for Moonraker

    def _fail(self, text: str) -> None:
        self._show(f"hframe-post: {text}", True)

    def _show(self, text: str, failed: bool) -> None:
        """Show a message in the console of the web interface; a failure also as announcement.

        Mainsail, Fluidd and KlipperScreen read messages as markup: names are shown as they are.
        """
        text = html.escape(text, quote=False)
        self.server.send_event("server:gcode_response", f"!! {text}" if failed else f"// {text}")
        if failed:
            announcements = self.server.lookup_component("announcements")
            announcements.add_internal_announcement("hframe-post", text, "", "high", NAME)

    # ------------------------------------------------------------------ for Klipper's macros

    async def _calibrate(self, axis: str = "", **_: str) -> None:
        """Measure the printer. An older hframe.cfg passes more."""
        if axis in ("", "X", "Y"):
            await self._measure("calibration", axis)
        else:
            self._fail(f"AXIS is X or Y, not {axis}")

    async def _check(self) -> None:
        await self._measure("check")

    async def _measure(self, kind: str, axis: str = "") -> None:
        """Record and update the profile, one measurement at a time."""
        stats = self.server.lookup_component("job_state").get_last_stats()
        printing = stats.get("state") in ("printing", "paused")
        if self._busy or printing:
            why = "it is being measured already" if self._busy else "the printer prints"
            self._fail(f"nothing is measured: {why}. Try again once that has ended")
            return
        self._busy = True
        try:
            job, began = await self._run("prepare", kind, axis), time.time()
            if job and await self._played(job):
                await self._run("conclude", kind, job, repr(began))
        finally:
            self._busy = False

    async def _run(self, duty: str, *words: str) -> str:
        """Run a duty as a process, which ends in time, and show what it says; return its job."""
        process = await asyncio.create_subprocess_exec(
            sys.executable, recordings.__file__, duty, self._words, *words,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        self._processes.add(process)
        try:
            job, output = "", process.stdout
            assert output is not None
            while line := await output.readline():
                said = json.loads(line)
                job = said.get("job", job)
                if "text" in said:
                    self._show(said["text"], said["failed"])
            await process.wait()
            return job
        finally:
            self._processes.remove(process)
            if process.returncode is None:
                process.kill()

    async def _played(self, job: str) -> bool:
        """Let Klipper play a file, and return whether it came to its end."""
        klippy = self.server.lookup_component("klippy_apis")
        try:
            await klippy.run_gcode(f'_HFRAME_RECORD FILENAME="{job}"')
        except self.server.error as error:  # no sensor answers, for example
            self._fail(f"nothing is measured: {error}")
            return False
        try:
            ended = await asyncio.wait_for(self._ended(job), 3600.0)  # none takes so long
        except (self.server.error, asyncio.TimeoutError):  # noqa: UP041  Python 3.9
            ended = "interrupted"
        if ended != "complete":
            self._fail(f"nothing is measured: the recording was {ended}")
        return ended == "complete"

    async def _ended(self, job: str) -> str:
        """Wait until a job has ended, and return its state. Klipper has loaded it already."""
        klippy = self.server.lookup_component("klippy_apis")
        while True:
            stats = (await klippy.query_objects({"print_stats": None}))["print_stats"]
            if stats["filename"] != job:
                return "cancelled"  # and forgotten, or another file was begun
            if stats["state"] not in ("standby", "printing", "paused"):
                return str(stats["state"])
            await asyncio.sleep(0.5)


def load_component(config: Any) -> HframePost:
    return HframePost(config)
