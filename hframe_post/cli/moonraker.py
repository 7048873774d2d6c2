"""``hframe-post setup --moonraker``: let Moonraker convert what is uploaded, or no longer."""

from __future__ import annotations

import json
import re
import shlex
import sys
from importlib import metadata
from pathlib import Path

from hframe_post.cli.integrations import program
from hframe_post.errors import HframeError
from hframe_post.hosts import moonraker
from hframe_post.hosts.moonraker.disk import NAME
from hframe_post.writers.files import Outputs

CONFIG = "moonraker.conf"
PLACES = ("moonraker/moonraker", "moonraker-env/lib/python3*/site-packages/moonraker")
UPDATES = f"update_manager {NAME}"
# a header and the lines below it, as far as the next empty line
SECTIONS = re.compile(
    r"(?:\n*^\[(?:update_manager )?hframe_post\].*(?:\n(?!\[)[^\r\n]+)*\n?)+", re.MULTILINE
)
RESTART = "Restart Moonraker: sudo systemctl restart moonraker"


class Moonraker:
    """Moonraker's configuration and code. Raises HframeError if either is not found.

    folder: that of printer.cfg.
    """

    def __init__(self, folder: Path) -> None:
        self.config = folder / CONFIG
        if not self.config.is_file():
            raise HframeError(
                f"{self.config} was not found. Run this on the printer's computer, with the "
                "printer.cfg next to moonraker.conf"
            )
        found = [place for name in PLACES for place in Path.home().glob(f"{name}/components")]
        if not found:
            raise HframeError(f"Moonraker was not found as {' or '.join(PLACES)} in {Path.home()}")
        self._components = found[0]

    def connect(self, outputs: Outputs, profile: Path) -> list[str]:
        """Link the component, add its section to the configuration, and return what was done."""
        files = self._components / "file_manager/file_manager.py"
        if not files.is_file() or "register_gcode_processor" not in files.read_text("utf-8"):
            raise HframeError("this Moonraker is older than February 2025: update it first")
        text, done = self._text(), [f"{self._link(create=True)}: linked"]
        command = f"{program()} -p {shlex.quote(str(profile.absolute()))}"
        installed = metadata.distribution("hframe-post")
        sections = ((NAME, f"command: {command}\n"), (UPDATES, update_lines(installed)))
        for name, lines in sections:
            if lines and not re.search(rf"^\[{name}\]", text, re.MULTILINE):
                text = f"{text.rstrip()}\n\n[{name}]\n{lines}"
                done.append(f"{self.config}: section [{name}] added")
        self._write(outputs, text)
        return [*done, "", RESTART]

    def disconnect(self, outputs: Outputs) -> list[str]:
        """Remove link and sections, and return what was done."""
        text, done = self._text(), [f"{self._link(create=False)}: removed"]
        self._write(outputs, SECTIONS.sub("\n", text))
        if SECTIONS.search(text):
            done.append(f"{self.config}: section [{NAME}] removed")
        return [*done, "", RESTART]

    def _text(self) -> str:
        return self.config.read_bytes().decode("utf-8", "surrogateescape")

    def _write(self, outputs: Outputs, text: str) -> None:
        if text != self._text():
            outputs.open(self.config).write(text.encode("utf-8", "surrogateescape"))

    def _link(self, create: bool) -> Path:
        link = self._components / NAME
        for old in (link, link.with_suffix(".py")):  # a file in earlier versions
            if old.is_symlink():
                old.unlink()
            elif old.exists():
                raise HframeError(f"{old} is not hframe-post's: remove it first")
        if create:
            component = Path(moonraker.__file__)
            if not component.is_file():
                raise HframeError("the single-file program has no component: install with pipx")
            link.symlink_to(component.parent, target_is_directory=True)
        return link


def update_lines(installed: metadata.Distribution) -> str:
    """Return what lets Moonraker update this installation, if pip took it from an index or Git."""
    origin = installed.read_text("direct_url.json")  # without one it is from an index
    updatable = origin is None or "vcs_info" in json.loads(origin)
    if not (updatable and installed.read_text("INSTALLER")):
        return ""
    return f"""\
type: python
project_name: hframe-post
virtualenv: {sys.prefix}
is_system_service: False
managed_services: moonraker
"""
