"""Run a duty of the component as a process: ``python THIS_FOLDER DUTY SETTINGS [WORD]...``.

Here the folder is not part of a package: its modules are imported by its own name.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path

DUTIES = ("upload", "again", "stale", "tidy", "prepare", "conclude", "page")


def main(duty: str, settings: str, *words: str) -> int:
    """Run a duty and return its exit status."""
    here = Path(__file__).resolve().parent
    sys.path[0] = str(here.parent)
    duties = import_module(f"{here.name}.duties")
    os.nice(10)  # Klipper may be printing
    return int(getattr(duties, duty)(duties.Settings.from_json(settings), *words))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) if sys.argv[1:2] and sys.argv[1] in DUTIES else 2)
