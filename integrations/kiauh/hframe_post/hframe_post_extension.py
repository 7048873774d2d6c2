"""KIAUH's extension: install hframe-post from the package index in an environment of its own.

KIAUH finds it once this folder is in kiauh/extensions.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

from core.logger import Logger
from extensions.base_extension import BaseExtension

ENVIRONMENT = Path.home() / "hframe-post-env"
PROGRAM = Path.home() / ".local/bin/hframe-post"
NEXT = "Next: hframe-post setup --moonraker"


class HframePostExtension(BaseExtension):
    """What KIAUH's menu calls."""

    def install_extension(self, **_: Any) -> None:
        """Install it, or a newer version, and link the program into the path."""
        if run("python3", "-m", "venv", ENVIRONMENT) and run(
            ENVIRONMENT / "bin/pip", "install", "--upgrade", "hframe-post"
        ):
            PROGRAM.parent.mkdir(parents=True, exist_ok=True)
            PROGRAM.unlink(missing_ok=True)
            PROGRAM.symlink_to(ENVIRONMENT / "bin/hframe-post")
            Logger.print_ok(f"hframe-post installed. {NEXT}")

    def update_extension(self, **_: Any) -> None:
        self.install_extension()

    def remove_extension(self, **_: Any) -> None:
        """Remove program and environment. Profiles stay."""
        if PROGRAM.is_symlink():
            PROGRAM.unlink()
        shutil.rmtree(ENVIRONMENT, ignore_errors=True)
        Logger.print_ok("hframe-post removed; --no-moonraker before that disconnects Moonraker")


def run(*command: str | Path) -> bool:
    """Run a command and return whether it succeeded; otherwise say what failed."""
    done = subprocess.run([str(word) for word in command], check=False)
    if done.returncode != 0:
        Logger.print_error(f"failed: {' '.join(map(str, command))}")
    return done.returncode == 0
