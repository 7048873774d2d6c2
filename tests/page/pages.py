"""What a page carries."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any


def data_of(html: bytes | Path) -> dict[str, Any]:
    """The data of a page, or of its file."""
    content = html.read_bytes() if isinstance(html, Path) else html
    found = re.search(rb'id="data">(.*?)</script>', content, re.DOTALL)
    assert found is not None
    printed: dict[str, Any] = json.loads(found[1])
    return printed
