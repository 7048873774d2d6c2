"""The pages in the browser: how the printer does, and what compensation does to a file."""

from __future__ import annotations

import asyncio
import contextlib
import html
from pathlib import Path
from typing import Any

from .interface import PAGE, page_of
from .originals import Originals, settings_of
from .upload import REFUSAL

# instead of a page: Moonraker would answer with JSON
NOTICE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark"><title>hframe-post</title>
<p style="font: 1.1em sans-serif; margin: 2em">{}</p></html>
"""


class Pages:
    """The endpoint of both. component: whose duty makes the first and which knows the files."""

    def __init__(self, component: Any, gcodes: Path, originals: Originals) -> None:
        self._component, self._gcodes, self._originals = component, gcodes, originals
        self._one_at_a_time = asyncio.Lock()

    def register(self, server: Any, kind: Any) -> None:
        """Let Moonraker answer requests of a kind."""
        server.register_endpoint(
            PAGE, kind, self._requested, ["http"], wrap_result=False,
            content_type="text/html; charset=UTF-8",
        )  # fmt: skip

    async def line_at_start(self, name: str) -> str:
        """Return what is said of a file when its print starts. name: one that Moonraker lists."""
        return str(await self._in_thread(self._describe, name))

    async def _requested(self, request: Any) -> str | bytes:
        """Return the page of a file, or that of the printer's state, as of now.

        Raises Moonraker's error.
        """
        name = request.get_str("file", "")
        if not name:
            return await self._of_printer()
        page = await self._in_thread(self._read, name) if self._component.knows(name) else None
        if page is None:
            return NOTICE.format(html.escape(
                f"{name} has no page: it is not here, not converted yet, or converted when there "
                "was too little disk space for pages. To convert a file again and make its page, "
                f'type HFRAME_CONVERT FILENAME="{name}"'
            ))  # fmt: skip
        content: bytes = page
        return content

    async def _of_printer(self) -> str:
        async with self._one_at_a_time:
            status, page = await self._component.run("page")
        if status != 0:
            raise self._component.server.error("the page was not made: the console says why", 500)
        made: str = page
        return made

    async def _in_thread(self, function: Any, name: str) -> Any:
        """Read from the disk, for which Moonraker's loop does not wait."""
        return await self._component.server.get_event_loop().run_in_thread(function, name)

    def _read(self, name: str) -> bytes | None:
        with contextlib.suppress(OSError):
            return self._originals.page_of(self._gcodes / name).read_bytes()
        return None

    def _describe(self, name: str) -> str:
        path = self._gcodes / name
        with contextlib.suppress(OSError), path.open("rb") as file:
            if settings_of(path):
                has_page = self._originals.page_of(path).exists()
                return f"{name} is compensated: {page_of(name)}" if has_page else ""
            if file.read(len(REFUSAL)) != REFUSAL.encode():
                return f"{name} is printed as sliced, without compensation"
        return ""
