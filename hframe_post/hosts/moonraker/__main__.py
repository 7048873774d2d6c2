"""Run a duty of the component as a process: ``python THIS_FOLDER DUTY SETTINGS [WORD]...``.

Here the folder is not part of a package: its modules are imported by its own name.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys
from importlib import import_module
from pathlib import Path

DUTIES = ("prepare", "conclude")
MEMORY_BYTES = 1_000_000_000  # of data of a process; 370 MB are the most that any has needed


def main(duty: str, settings: str, *words: str) -> int:
    """Run a duty and return its exit status."""
    here = Path(__file__).resolve().parent
    sys.path[0] = str(here.parent)
    duties = import_module(f"{here.name}.recordings")
    _stand_back()
    return int(getattr(duties, duty)(duties.Settings.from_json(settings), *words))


def _stand_back() -> None:
    """Give precedence to Klipper, which may be printing. Holds for all that is started, too."""
    os.nice(10)
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    memory = MEMORY_BYTES if most == resource.RLIM_INFINITY else min(MEMORY_BYTES, most)
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    with contextlib.suppress(OSError):  # the first that Linux ends if memory runs out
        Path("/proc/self/oom_score_adj").write_text("1000")


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) if sys.argv[1:2] and sys.argv[1] in DUTIES else 2)
