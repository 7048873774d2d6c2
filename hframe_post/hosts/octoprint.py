"""OctoPrint's plugin: convert each file of G-code that is uploaded, before it is stored.

``hframe-post octoprint-plugin`` copies this file into OctoPrint's folder of plugins, with COMMAND.
"""

from __future__ import annotations

import os
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


class Converted:
    """An uploaded file that is converted when it is stored."""

    def __init__(self, source: Any) -> None:
        self.filename, self._source = source.filename, source

    def save(self, path: str, permissions: int | None = None) -> None:
        """Store the converted file. Raises UnprocessableEntity, with which the upload fails."""
        util = import_module("octoprint.filemanager.util")
        util.DiskFileWrapper(self.filename, self._converted()).save(path, permissions)

    def stream(self) -> IO[bytes]:
        """Return the converted file, opened. Raises UnprocessableEntity."""
        path = self._converted()
        file = open(path, "rb")  # noqa: SIM115  the caller closes it
        os.unlink(path)
        return file

    def _converted(self) -> str:
        handle, path = tempfile.mkstemp(suffix=".gcode")
        os.close(handle)
        try:
            self._source.save(path)
            done = subprocess.run(
                [*COMMAND, "-q", path], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE, text=True, errors="replace", check=False,
            )  # fmt: skip
        except OSError as error:
            os.unlink(path)
            raise refused(f"{COMMAND[0]} cannot be run: {error.strerror}") from None
        if done.returncode != 0:
            os.unlink(path)
            raise refused(" ".join(done.stderr.splitlines()[-1:]).removeprefix("Error: "))
        return path


def refused(reason: str) -> Exception:
    text = f"hframe-post did not convert this file: {reason}"
    error: Exception = import_module("werkzeug.exceptions").UnprocessableEntity(text)
    return error


def convert(path: str, file_object: Any, *_: Any, **__: Any) -> Any:
    return Converted(file_object) if path.lower().endswith(SUFFIXES) else file_object


__plugin_hooks__ = {"octoprint.filemanager.preprocessor": convert}
