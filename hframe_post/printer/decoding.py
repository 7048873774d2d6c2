"""Files of settings → text, whatever editor or shell wrote them."""

from __future__ import annotations

import codecs
from pathlib import Path

from hframe_post.errors import PrinterError

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # as PowerShell's > writes it


def file_text(path: Path, most: int, hint: str) -> str:
    """Return a file's text without a byte order mark.

    Raises OSError, and PrinterError if it is larger than ``most`` bytes (then with the hint) or not
    text.
    """
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise PrinterError(f"larger than {most} bytes: {hint}", source=str(path))
    try:
        return content.decode("utf-16" if content.startswith(UTF_16) else "utf-8-sig")
    except UnicodeError:
        cause = "cannot be read as text: save it as UTF-8"
        raise PrinterError(cause, source=str(path)) from None
