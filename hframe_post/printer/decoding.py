"""Bytes of a profile or of printer.cfg → text, whatever editor or shell wrote them."""

from __future__ import annotations

import codecs

from hframe_post.errors import PrinterError

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # as PowerShell's > writes it


def decoded(content: bytes, source: str) -> str:
    """Return the text without a byte order mark. Raises PrinterError if it is not text."""
    try:
        return content.decode("utf-16" if content.startswith(UTF_16) else "utf-8-sig")
    except UnicodeError:
        cause = "cannot be read as text: save it as UTF-8"
        raise PrinterError(cause, source=source) from None
