"""OctoPrint's plugin: convert each file of G-code that is uploaded, before it is stored.

Two ways lead here: ``pip install hframe-post`` in OctoPrint's own environment, whose plugins it
finds by their entry point, and ``hframe-post connect octoprint``, which copies this folder into
OctoPrint's folder of plugins, with COMMAND and PROFILE, for a hframe-post that lives elsewhere.

The summary of each conversion goes to octoprint.log and, as OctoPrint has no console of its own, to
the terminal tab: its warnings first.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from importlib import import_module  # of what only OctoPrint's Python has
from typing import IO, Any, NamedTuple

COMMAND = [sys.executable, "-P", "-m", "hframe_post"]  # not what the working folder holds
PROFILE = ""

__plugin_name__ = "hframe-post"
__plugin_description__ = "Compensates racking and ringing in uploaded G-code"
__plugin_license__ = "GPL-3.0-or-later"
__plugin_pythoncompat__ = ">=3.7,<4"

CONVERTED = "; processed by hframe-post"
REFUSED = ";NOT COMPENSATED: hframe-post failed: "
COMMENT = "; hframe-post: "
SUFFIXES = (".gcode", ".gco", ".g")
base: Any = import_module("octoprint.plugin")


class HframePost(
    base.SettingsPlugin, base.TemplatePlugin, base.AssetPlugin, base.EventHandlerPlugin
):
    """The settings page, the conversion of uploads, and a line in the list of files."""

    def get_settings_defaults(self) -> dict[str, Any]:
        """Return the settings of a new installation: without a profile it converts nothing."""
        return {"enabled": bool(PROFILE), "profile": PROFILE, "nice": 10, "refused": "fail"}

    def get_template_configs(self) -> list[dict[str, Any]]:
        return [{"type": "settings", "name": __plugin_name__, "custom_bindings": False}]

    def is_template_autoescaped(self) -> bool:
        return True

    def get_assets(self) -> dict[str, list[str]]:
        return {"js": ["hframe_post.js"]}

    def convert(self, path: str, file_object: Any, *_: Any, **__: Any) -> Any:
        """Return the upload, to be converted when it is stored if the plugin is turned on."""
        settings = self._settings
        if not (path.lower().endswith(SUFFIXES) and settings.get_boolean(["enabled"])):
            return file_object
        profile = (settings.get(["profile"]) or "").strip()
        return Converted(
            file_object,
            Settings(
                [*COMMAND, *(["-p", profile] if profile else [])],
                nice=settings.get_int(["nice"], min=0, max=19),
                keep=settings.get(["refused"]) == "keep",
            ),
        )

    def on_event(self, event: str, payload: dict[str, Any]) -> None:
        """Note what the head of a new file says of its conversion, for the list of files."""
        if event != "FileAdded" or "machinecode" not in payload["type"]:
            return
        files, place = self._file_manager, (payload["storage"], payload["path"])
        found = summary(files.path_on_disk(*place)) if payload["storage"] == "local" else None
        if found:
            files.set_additional_metadata(*place, "hframe_post", found, overwrite=True)
        else:
            files.remove_additional_metadata(*place, "hframe_post")


# ----------------------------------------------------------------------
# Uploads: their conversion by a process, and what a converted file says of itself.


class Settings(NamedTuple):
    """How to convert. command: the tool with its options; keep: store what it refuses."""

    command: list[str]
    nice: int
    keep: bool


class RefusalError(Exception):
    """The reason why a file is not converted."""


class Converted:
    """An uploaded file that is converted when it is stored."""

    def __init__(self, source: Any, settings: Settings) -> None:
        self.filename, self._source, self._settings = source.filename, source, settings

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
        """Return the path of the converted file. Raises UnprocessableEntity."""
        with ExitStack() as undo:
            try:
                handle, path = tempfile.mkstemp(suffix=".gcode")
                undo.callback(os.unlink, path)
                os.close(handle)
                self._source.save(path)
                self._convert(path)
            except OSError as error:
                reason = f"{tempfile.gettempdir()}: {error.strerror}"
                raise failed(self.filename, reason) from None
            undo.pop_all()
        return path

    def _convert(self, path: str) -> None:
        """Convert the file in its place, or mark it if it is refused and to be kept."""
        try:
            show(self.filename, self._run(path))
        except RefusalError as refusal:
            if not self._settings.keep:
                raise failed(self.filename, str(refusal)) from None
            show_refusal(self.filename, str(refusal))
            mark(path, str(refusal))

    def _run(self, path: str) -> list[str]:
        """Convert the file in its place and return the summary. Raises RefusalError."""
        command, nice = self._settings.command, self._settings.nice
        if shutil.which(command[0]) is None:
            advice = "run 'hframe-post connect octoprint' again"
            raise RefusalError(f"{command[0]} cannot be run: {advice}")
        if nice and shutil.which("nice"):  # OctoPrint may be printing
            command = ["nice", "-n", str(nice), *command]
        done = subprocess.run(
            [*command, path], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, errors="replace", check=False,
        )  # fmt: skip
        said = done.stderr.replace(f"{path}: ", "").replace(path, self.filename).splitlines()
        if done.returncode != 0:
            reason = " ".join(said[-1:]) or f"hframe-post ended with status {done.returncode}"
            raise RefusalError(reason.replace("Error: ", "", 1))
        return said


def mark(path: str, reason: str) -> None:
    """Write the reason into the first line of a file that is stored as it was sliced."""
    whole = f"{path}.marked"
    try:
        with open(path, "rb") as source, open(whole, "wb") as target:
            target.write(f"{REFUSED}{reason}\n".encode())
            shutil.copyfileobj(source, target)
        os.replace(whole, path)
    finally:
        if os.path.exists(whole):
            os.unlink(whole)


def summary(path: str) -> dict[str, str] | None:
    """Return what a file's head says of its conversion: a line, and all, or None."""
    with open(path, "rb") as file:
        head = file.read(1 << 20).decode("utf-8", "replace")  # previews may precede it
    first = head.partition("\n")[0]
    if first.startswith(REFUSED):
        reason = first[len(REFUSED) :].partition("; ")[0]
        return {"line": f"NOT compensated: {reason}", "all": first[1:]}
    _, stamp, text = f"\n{head}".partition(f"\n{CONVERTED}")
    if not stamp:
        return None
    first, *lines = f"{CONVERTED[2:]}{text}".splitlines()
    said = [line[len(COMMENT) :].rstrip() for line in lines if line.startswith(COMMENT)]
    results = [line for line in said if line.startswith("result")] or ["result"]
    words = re.split("[;(]", results[0].partition("result")[2])[0].split()
    warnings = sum(line.startswith("WARNING") for line in said)
    counted = f"; {warnings} warning{'s' * (warnings > 1)}" if warnings else ""
    return {"line": " ".join(["Compensated:" if words else "Compensated", *words]) + counted,
            "all": "\n".join([first, *said])}  # fmt: skip


def show(name: str, lines: list[str]) -> None:
    """Show a summary in the log, warnings as such, and in the terminal tab."""
    log = logging.getLogger("octoprint.plugins.hframe_post")
    for line in lines:
        level = logging.WARNING if line.startswith(("WARNING", "SLICER")) else logging.INFO
        log.log(level, "%s: %s", name, line)
    printer = import_module("octoprint.server").printer
    if printer is not None:  # OctoPrint has started
        printer.log_lines(*(f"hframe-post: {name}: {line}" for line in lines))


def show_refusal(name: str, reason: str) -> None:
    show(name, [f"WARNING          not converted: {reason}"])


def failed(name: str, reason: str) -> Exception:
    """Return the exception with which the upload fails; its reason is logged and shown, too."""
    show_refusal(name, reason)
    text = f"hframe-post did not convert this file: {reason}"
    error: Exception = import_module("werkzeug.exceptions").UnprocessableEntity(text)
    return error


__plugin_implementation__ = HframePost()
__plugin_hooks__ = {"octoprint.filemanager.preprocessor": __plugin_implementation__.convert}
