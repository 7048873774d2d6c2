"""Reports as HTML pages that contain their style, script and data, so that they work offline.

What comes from a file (names, lines, comments) is data: JSON with its angle brackets escaped, and
compressed bytes. A page's script puts it into text nodes only.
"""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

ESCAPED = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}

SCRIPTS = {"page": ("frame", "modes", "page"), "measured": ("frame", "measured")}


def filled(name: str, data: dict[str, Any], **more: str) -> bytes:
    """Return ``frame.html`` filled with ``name.html``, ``page.css``, the scripts and further parts.

    The name of a part stands in the template between two pairs of @. data: with name, version,
    warnings, notes, and facts as pairs.
    """
    content = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for character, escape in ESCAPED.items():
        content = content.replace(character, escape)
    folder = resources.files(__package__)
    parts = {
        "STYLE": (folder / "page.css").read_text("utf-8"),
        "SCRIPT": "".join((folder / f"{one}.js").read_text("utf-8") for one in SCRIPTS[name]),
        "DATA": content,
        **more,
    }
    frame, body = ((folder / f"{file}.html").read_text("utf-8") for file in ("frame", name))
    pieces = frame.replace("@@BODY@@", body).split("@@")
    return "".join(parts.get(piece, piece) for piece in pieces).encode("utf-8", "replace")
