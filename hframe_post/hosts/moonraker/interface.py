"""What processes of the component say in the web interface, through Moonraker's socket."""

from __future__ import annotations

import contextlib
import json
import socket
import time

ENDPOINT, PAGE = "/server/hframe_post/report", "/server/hframe_post/page"
QUIET = 5.0  # s between two reports of progress


class Interface:
    """The web interface's console. name: of the file that the reports are about."""

    def __init__(self, address: str, name: str = "") -> None:
        self._address, self._name, self._last = address, name, time.monotonic()

    def progress(self, text: str) -> None:
        if time.monotonic() - self._last > QUIET:
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
