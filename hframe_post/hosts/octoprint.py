"""OctoPrint's plugin: convert each file of G-code that is uploaded, before it is stored.

``hframe-post octoprint-plugin`` copies this file into OctoPrint's folder of plugins, with COMMAND.
The summary of each conversion goes to octoprint.log and, as OctoPrint has no console of its own, to
the terminal tab: its warnings first.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import tempfile
from importlib import import_module  # of what only OctoPrint's Python has
from typing import IO, Any

__plugin_name__ = "hframe-post"
__plugin_version__ = "1.0"
__plugin_description__ = "Compensates racking and ringing in uploaded G-code"
__plugin_pythoncompat__ = ">=3.7,<4"

COMMAND = ["hframe-post"]
SUFFIXES = (".gcode", ".gco", ".g")
NICE = ["nice", "-n", "10"] if shutil.which("nice") else []  # OctoPrint may be printing


class Converted:
    """An uploaded file that is converted when it is stored."""

    def __init__(self, source: Any) -> None:
        self.filename, self._source = source.filename, source

    def save(self, path: str, permissions: int | None = None) -> None:
        """Store the converted file. Raises UnprocessableEntity, with which the upload fails."""
        util = import_module("octoprint.filemanager.util")
        converted = self._converted()
        try:
            util.DiskFileWrapper(self.filename, converted).save(path, permissions)
        finally:
            if os.path.exists(converted):  # it could not be moved
                os.unlink(converted)

    def stream(self) -> IO[bytes]:
        """Return the converted file, opened. Raises UnprocessableEntity."""
        path = self._converted()
        file = open(path, "rb")  # noqa: SIM115  the caller closes it
        os.unlink(path)
        return file

    def _converted(self) -> str:
        if shutil.which(COMMAND[0]) is None:
            advice = "run 'hframe-post octoprint-plugin' again"
            raise refused(self.filename, f"{COMMAND[0]} cannot be run: {advice}")
        try:
            handle, path = tempfile.mkstemp(suffix=".gcode")
            os.close(handle)
        except OSError as error:
            raise refused(self.filename, f"{tempfile.gettempdir()}: {error.strerror}") from None
        try:
            self._source.save(path)
            done = subprocess.run(
                [*NICE, *COMMAND, path], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE, text=True, errors="replace", check=False,
            )  # fmt: skip
        except OSError as error:
            os.unlink(path)
            raise refused(self.filename, f"{os.path.dirname(path)}: {error.strerror}") from None
        said = done.stderr.replace(f"{path}: ", "").replace(path, self.filename).splitlines()
        if done.returncode != 0:
            os.unlink(path)
            reason = " ".join(said[-1:]) or f"hframe-post ended with status {done.returncode}"
            raise refused(self.filename, reason.replace("Error: ", "", 1))
        show(self.filename, said)
        return path


def show(name: str, summary: list[str]) -> None:
    """Show a summary in the log, warnings as such, and in the terminal tab."""
    log = logging.getLogger("octoprint.plugins.hframe_post")
    for line in summary:
        level = logging.WARNING if line.startswith(("WARNING", "SLICER")) else logging.INFO
        log.log(level, "%s: %s", name, line)
    printer = import_module("octoprint.server").printer
    if printer is not None:  # OctoPrint has started
        printer.log_lines(*(f"hframe-post: {name}: {line}" for line in summary))


def refused(name: str, reason: str) -> Exception:
    """Return the exception with which the upload fails; its reason is logged and shown, too."""
    show(name, [f"WARNING          not converted: {reason}"])
    text = f"hframe-post did not convert this file: {reason}"
    error: Exception = import_module("werkzeug.exceptions").UnprocessableEntity(text)
    return error


def convert(path: str, file_object: Any, *_: Any, **__: Any) -> Any:
    return Converted(file_object) if path.lower().endswith(SUFFIXES) else file_object


__plugin_hooks__ = {"octoprint.filemanager.preprocessor": convert}
