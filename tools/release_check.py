"""Name what only the project's owner can fill in, and a first release would lack.

    python tools/release_check.py

Each line is one thing to do; CONTRIBUTING.md says what to write. Exit status 1 if there is any.
The workflow that releases a tag begins with it.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LABELS = ("Homepage", "Repository", "Changelog")  # OctoPrint and Moonraker show them
PAGES = ("README.md", "docs/start.md")
FROM_FOLDER = re.compile(
    r"(pipx|uv tool|pip) install (--force )?\.(?![\w/])|(not in an|in no) index"
)


def missing(root: Path) -> list[str]:
    """Return what is to be filled in, a line each."""
    urls = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]["urls"]
    found = [f"pyproject.toml: [project.urls] has no {each}" for each in LABELS if each not in urls]
    for page in PAGES:
        for number, line in enumerate((root / page).read_text("utf-8").splitlines(), 1):
            if FROM_FOLDER.search(line):
                found.append(f"{page}:{number}: speaks of a folder, not of the index: {line}")
            if re.match(r"!\[.*\]\((?!https:)", line):
                found.append(f"{page}:{number}: PyPI shows figures of absolute addresses only")
    return found


if __name__ == "__main__":
    lines = missing(ROOT)
    print("\n".join(lines) or "nothing is missing")
    sys.exit(bool(lines))
