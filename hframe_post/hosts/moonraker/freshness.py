"""Before a print: check the printer if that is due, and convert a file that is stale."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

STALE = ("convert", "print")  # what to do with a file of an older model; the first is the default
FRESH = ("never", "weekly", "always")  # when to check the printer before a print
WEEK = 7 * 24 * 3600.0  # s


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
        return age > {"never": float("inf"), "weekly": WEEK, "always": 0.0}[self._fresh]
