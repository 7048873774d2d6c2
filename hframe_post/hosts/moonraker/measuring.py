"""Measuring jobs: Klipper plays a file while it records, then hframe-post updates the profile."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from typing import Any

JOB_S = 3600.0  # s
LOOK_S = 0.5  # s between two looks at a job


class Measuring:
    """Calibrations and checks, one at a time.

    run: runs a duty and returns its exit status and output. say: shows a line on the console.
    """

    def __init__(
        self, server: Any, run: Callable[..., Awaitable[tuple[int, str]]], say: Callable[..., None]
    ) -> None:
        self._server, self._run, self._say = server, run, say
        self._busy = False

    @property
    def busy(self) -> bool:
        """Return whether a measurement runs, during which nothing else can be printed."""
        return self._busy

    async def measure(self, kind: str, axis: str = "") -> bool:
        """Record and update the profile; return whether it was written."""
        printing = self._stats().get("state") in ("printing", "paused")
        if self._busy or printing:
            why = "it is being measured already" if self._busy else "the printer prints"
            self._say(f"nothing is measured: {why}. Try again once that has ended", True)
            return False
        self._busy = True
        try:
            status, output = await self._run("prepare", kind, axis)
            if status != 0:
                return False
            job, began = json.loads(output)["job"], time.time()
            if not await self._played(job):
                return False
            status, _ = await self._run("conclude", kind, job, repr(began))
            return status == 0
        finally:
            self._busy = False

    async def _played(self, job: str) -> bool:
        """Let Klipper play a file, and return whether it came to its end."""
        klippy = self._server.lookup_component("klippy_apis")
        try:
            await klippy.run_gcode(f'_HFRAME_RECORD FILENAME="{job}"')
        except self._server.error as error:  # no sensor answers, for example
            self._say(f"nothing is measured: {error}", True)
            return False
        try:
            ended = await asyncio.wait_for(self._ended(job), JOB_S)
        except (self._server.error, asyncio.TimeoutError):  # noqa: UP041  Python 3.9
            ended = "interrupted"
        if ended != "complete":
            self._say(f"nothing is measured: the recording was {ended}", True)
        return ended == "complete"

    async def _ended(self, job: str) -> str:
        """Wait until a job has ended, and return its state. Klipper has loaded it already."""
        klippy = self._server.lookup_component("klippy_apis")
        while True:
            stats = (await klippy.query_objects({"print_stats": None}))["print_stats"]
            if stats["filename"] != job:
                return "cancelled"  # and forgotten, or another file was begun
            if stats["state"] not in ("standby", "printing", "paused"):
                return str(stats["state"])
            await asyncio.sleep(LOOK_S)

    def _stats(self) -> dict[str, Any]:
        stats: dict[str, Any] = self._server.lookup_component("job_state").get_last_stats()
        return stats


# ----------------------------------------------------------------------
# Before a print: check the printer if that is due, and convert a file that is stale.

STALE = ("convert", "print")  # what to do with a file of an older model; the first is the default
FRESH = ("never", "weekly", "always")  # when to check the printer before a print
WEEK_S = 7 * 24 * 3600.0  # s


class Freshness:
    """The owner's choices. stale: one of STALE; fresh: one of FRESH."""

    def __init__(self, component: Any, stale: str, fresh: str) -> None:
        self._component, self._stale, self._fresh = component, stale, fresh
        self._one_at_a_time = asyncio.Lock()
        self._begun = ""  # the file that Moonraker itself is about to print

    async def before(self, name: str) -> None:
        """Make a file fresh before it prints. Whatever fails, it can be printed as it is."""
        component = self._component
        if component.prints() or component.measuring.busy or not component.knows(name):
            return
        async with self._one_at_a_time:
            if self._is_due():
                component.say(f"the printer is checked before {name} prints")
                await component.measuring.measure("check")
            self._begun = name
            old, kept = await self._age(name)
            if kept and self._stale == "convert":
                component.say(f"{name} is of an older model: it is converted again, then printed")
                old = not await component.convert(name)
            if old:
                self._warn(name, kept)

    async def job_changed(self, event: Any, _: dict[str, Any], now: dict[str, Any]) -> None:
        """Say how a file is printed that was begun, also elsewhere, such as at a display."""
        name = str(now.get("filename", ""))
        if event.name != "STARTED" or not self._component.knows(name):
            return
        if line := await self._component.pages.line_at_start(name):
            self._component.say(line)
        begun, self._begun = self._begun, ""
        if name != begun:
            old, kept = await self._age(name)
            if old:
                self._warn(name, kept)

    def _warn(self, name: str, kept: bool) -> None:
        how = f'HFRAME_CONVERT FILENAME="{name}"' if kept else "upload it again"
        self._component.say(
            f"{name} is printed as it is, converted with an older model. To change that: {how}"
        )

    async def _age(self, name: str) -> tuple[bool, bool]:
        """Return whether a file is of an older model, and whether it can be converted again."""
        status, output = await self._component.run("stale", name)
        found = json.loads(output) if status == 0 else {"old": [], "kept": []}
        return name in found["old"], name in found["kept"]

    def _is_due(self) -> bool:
        try:
            last = self._component.checked.stat().st_mtime
        except OSError:
            last = 0.0
        age: float = time.time() - last
        return age > {"never": float("inf"), "weekly": WEEK_S, "always": 0.0}[self._fresh]
