"""The answer to an upload, which Moonraker gives only after the conversion.

Mainsail, Fluidd and OrcaSlicer wait as long as it takes, but nginx, through which they reach
Moonraker, gives up after 60 s without an answer, and they show an error.
"""

from __future__ import annotations

import asyncio
import contextlib
import html
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .conversion import PAGE, page_of
from .originals import REFUSAL, Originals, settings_of

ANSWER_S = 30.0  # s that an upload waits for its conversion
LOOK_S = 1.0  # s between two looks whether the file is in its place


class Answering:
    """Moonraker's uploads, which are answered in time and go on after that.

    files: Moonraker's file manager. say: shows a line on the console.
    """

    def __init__(self, files: Any, gcodes: Path, say: Callable[..., None]) -> None:
        self._files, self._gcodes, self._say = files, gcodes, say
        self._upload, files.finalize_upload = files.finalize_upload, self.upload
        self._names: dict[asyncio.Future[dict[str, Any]], str] = {}  # of those that go on

    async def upload(self, form: dict[str, Any]) -> dict[str, Any]:
        """Upload a file in Moonraker's way; return what it answers. Raises its errors.

        A file that waits for another one is in no place yet, and is not answered.
        """
        name, answered = _name_in(form), time.monotonic() + ANSWER_S
        work: asyncio.Future[dict[str, Any]] = asyncio.ensure_future(self._upload(form))
        self._names[work] = name
        work.add_done_callback(self._names.pop)
        await asyncio.wait({work}, timeout=LOOK_S)
        if not (work.done() or self._is_converted(name)):
            self._say_it_waits(name)
        while not (work.done() or self._is_converted(name)):
            await asyncio.wait({work}, timeout=LOOK_S)
        await asyncio.wait({work}, timeout=answered - time.monotonic())
        if work.done():
            return work.result()
        work.add_done_callback(self._ended)
        then = " and printed then" if form.get("print") == "true" else ""
        self._say(f"{name} is still being converted{then}; it is uploaded")
        info = self._files.get_path_info(self._gcodes / name, "gcodes", raise_error=False)
        return {
            "item": {**info, "path": name, "root": "gcodes"}, "action": "create_file",
            "print_started": False, "print_queued": False,
        }  # fmt: skip

    def _is_converted(self, name: str) -> bool:
        converted: bool = self._files.get_metadata_storage().is_file_processing(name)
        return converted

    def _say_it_waits(self, name: str) -> None:
        for other in self._names.values():
            if self._is_converted(other):
                self._say(
                    f"{name} waits until {other} is converted; then it is uploaded. Nothing is "
                    "lost if the interface reports a timeout meanwhile"
                )
                return

    def _ended(self, work: asyncio.Future[dict[str, Any]]) -> None:
        if not work.cancelled() and work.exception() is not None:
            self._say(str(work.exception()), True)


def _name_in(form: dict[str, Any]) -> str:
    """Return the name that Moonraker will give to an upload."""
    name = os.path.join(form.get("path", "").lstrip("/"), form["filename"].strip().lstrip("/"))
    stem, ending = os.path.splitext(os.path.normpath(name))
    return f"{stem}.gcode" if ending.lower() == ".ufp" else f"{stem}{ending}"


# ----------------------------------------------------------------------
# The pages in the browser: what compensation does to a file.

# instead of a page: Moonraker would answer with JSON
NOTICE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark"><title>hframe-post</title>
<p style="font: 1.1em sans-serif; margin: 2em">{}</p></html>
"""


class Pages:
    """Their endpoint. component: which knows the files."""

    def __init__(self, component: Any, gcodes: Path, originals: Originals) -> None:
        self._component, self._gcodes, self._originals = component, gcodes, originals

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
        name = request.get_str("file", "")
        page = await self._in_thread(self._read, name) if self._component.knows(name) else None
        if page is None:
            return NOTICE.format(html.escape(
                f"{name} has no page: it is not here, not converted yet, or converted when there "
                "was too little disk space for pages. To convert a file again and make its page, "
                f'type HFRAME_CONVERT FILENAME="{name}"'
            ))  # fmt: skip
        content: bytes = page
        return content

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
