"""OctoPrint's plugin: convert each file of G-code that is uploaded, before it is stored.

Two ways lead here: ``pip install hframe-post`` in OctoPrint's own environment, whose plugins it
finds by their entry point, and ``hframe-post connect octoprint``, which copies this folder into
OctoPrint's folder of plugins, with COMMAND and PROFILE, for a hframe-post that lives elsewhere.
"""

from __future__ import annotations

import sys
from importlib import import_module  # of what only OctoPrint's Python has
from typing import Any

from .upload import Converted, Settings, summary

COMMAND = [sys.executable, "-P", "-m", "hframe_post"]  # not what the working folder holds
PROFILE = ""

__plugin_name__ = "hframe-post"
__plugin_description__ = "Compensates racking and ringing in uploaded G-code"
__plugin_license__ = "GPL-3.0-or-later"
__plugin_pythoncompat__ = ">=3.7,<4"

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


__plugin_implementation__ = HframePost()
__plugin_hooks__ = {"octoprint.filemanager.preprocessor": __plugin_implementation__.convert}
