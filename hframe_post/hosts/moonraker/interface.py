"""What processes of the component say in the web interface, through Moonraker's socket."""

from __future__ import annotations

import contextlib
import html
import json
import os
import re
import socket
import time

ENDPOINT, PAGE = "/server/hframe_post/report", "/server/hframe_post/page"
LINK = re.compile(rf"{PAGE}(\?file=[a-z0-9%./~-]+)?")
# capitals are encoded, too: Fluidd puts links of its own around those that are a command
PLAIN = frozenset(b"abcdefghijklmnopqrstuvwxyz0123456789./~-")
QUIET = 5.0  # s between two reports of progress
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
