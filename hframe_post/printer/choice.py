"""Which printer's profile, and why: asked for, named by the slicer, by the environment, by `use`.

The user's default is a line of ``config.toml`` in the platform's configuration folder: the
profile's place, not a copy, so that what `tune` or `identify` change is what is used.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hframe_post.errors import HframeError, one_line

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer

VARIABLE = "HFRAME_PRINTER"
FALLBACK = "paper"
_NOTE = re.compile(r"^\s*HFRAME_PRINTER\s*=\s*(\S.*)", re.MULTILINE)
_ESCAPE = re.compile(r"\\(.)")  # as the slicers write text of several lines into one


@dataclass(frozen=True, slots=True)
class Choice:
    """A shipped profile's name or a file, and what chose it."""

    profile: str
    why: str

    def as_text(self) -> str:
        """A line of the summary."""
        return f"profile     {one_line(self.profile)} ({self.why})"

    def as_json(self) -> dict[str, str]:
        """What the summary has of it."""
        return {"profile": self.profile, "profile_chosen_by": self.why}


def config_file() -> Path:
    """Where the user's default is kept."""
    from platformdirs import user_config_path

    return user_config_path("hframe-post", appauthor=False) / "config.toml"


def users_default() -> str | None:
    """What `use` has chosen, None if nothing. Raises HframeError."""
    path = config_file()
    try:
        document = tomllib.loads(path.read_text("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise HframeError(f"{path}: cannot be read: {error}") from None
    printer = document.get("printer")
    if not isinstance(printer, str):
        raise HframeError(f"{path}: has no printer = \"…\"; run 'hframe-post use' again")
    return printer


def choose(asked: str | None, environ: Mapping[str, str]) -> Choice:
    """The most particular choice there is. Raises HframeError.

    A line ``HFRAME_PRINTER=my.toml`` in the notes of the slicer's printer is particular to that
    printer, the variable of that name to the slicer or shell.
    """
    if asked is not None:
        return Choice(asked, "as asked for with -p")
    notes = _ESCAPE.sub(
        lambda match: {"n": "\n", "r": "\n"}.get(match[1], match[1]),
        environ.get("SLIC3R_PRINTER_NOTES", ""),
    )
    if note := _NOTE.search(notes):
        return Choice(note[1].strip().strip('"'), "the notes of the slicer's printer")
    if environ.get(VARIABLE):
        return Choice(environ[VARIABLE], f"the variable {VARIABLE}")
    if default := users_default():
        if os.path.isabs(default) and not Path(default).is_file():
            raise HframeError(
                f"{default}: the profile chosen with 'hframe-post use' is not there any more; "
                "choose one again"
            )
        return Choice(default, "chosen with 'hframe-post use'")
    return Choice(FALLBACK, "the paper's printer, NOT YOURS: see 'hframe-post use'")


def proof(profile: Printer) -> str:
    """A line of the summary: whether `verify` has shown what the profile does on the machine."""
    mark = profile.verified
    if mark is None:
        return "NOT VERIFIED on a machine: 'hframe-post verify' shows whether this profile helps"
    less = f"{100.0 * mark.reduction:.0f} % less contour error measured on the machine"
    return f"verified    {less}, {one_line(mark.date)}, {one_line(mark.firmware)}"
