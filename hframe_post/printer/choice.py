"""Which profile is used, and why: -p, the slicer, the environment or the user's default.

The default is a line of ``config.toml`` in the platform's configuration folder. It names the
profile's file rather than copying it, so changes by ``tune`` and ``identify`` take effect.
"""

from __future__ import annotations

import contextlib
import json
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
PROFILE = "printer.toml"  # as `setup` calls it
CHOICE = "hframe_post.choice"  # in the meta of a command's context
DEMONSTRATIONS = ("paper", "paper-marlin", "paper-strong")
OPTION = "option -p"
AGAIN = "run 'hframe-post setup PROFILE.TOML' again"


@dataclass(frozen=True, slots=True)
class Choice:
    """A shipped profile's name or a file, and what chose it."""

    profile: str
    why: str

    @property
    def demonstrates(self) -> bool:
        """Return whether the paper's printer was asked for by name."""
        return self.why == OPTION and self.profile in DEMONSTRATIONS

    def as_text(self) -> str:
        return f"profile          {one_line(self.profile)} ({self.why})"

    def as_json(self) -> dict[str, str]:
        return {"profile": self.profile, "profile_chosen_by": self.why}


def config_file() -> Path:
    from platformdirs import user_config_path

    return user_config_path("hframe-post", appauthor=False) / "config.toml"


def set_default(profile: str) -> None:
    """Make a profile the default. Raises OSError if the user's folder cannot be written."""
    path = config_file()
    with contextlib.suppress(HframeError, OSError):
        if _default() == profile:
            return
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    new.write_text(f"printer = {json.dumps(profile, ensure_ascii=False)}\n", "utf-8")
    new.replace(path)


def _default() -> str | None:
    path = config_file()
    try:
        document = tomllib.loads(path.read_text("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise HframeError(f"{path} cannot be read: {error}; {AGAIN}") from None
    printer = document.get("printer")
    if not isinstance(printer, str):
        raise HframeError(f'{path} has no line printer = "…": {AGAIN}')
    return printer


def choose(requested: str | None, environ: Mapping[str, str]) -> Choice:
    """Return the most specific choice there is. Raises HframeError.

    A line ``HFRAME_PRINTER=my.toml`` in the printer notes of the slicer holds for that printer, the
    variable of that name for the whole slicer or shell. A printer.toml in the present folder comes
    before the user's default.
    """
    if requested is not None:
        return Choice(requested, OPTION)
    notes = re.sub(  # slicers escape the line ends of notes
        r"\\(.)",
        lambda match: {"n": "\n", "r": "\n"}.get(match[1], match[1]),
        environ.get("SLIC3R_PRINTER_NOTES", ""),
    )
    if note := re.search(rf"^\s*{VARIABLE}\s*=\s*(\S.*)", notes, re.MULTILINE):
        return Choice(note[1].strip().strip('"'), "printer notes in the slicer")
    if environ.get(VARIABLE):
        return Choice(environ[VARIABLE], f"environment variable {VARIABLE}")
    if Path(PROFILE).is_file():
        return Choice(PROFILE, "of this folder")
    if default := _default():
        if os.path.isabs(default) and not Path(default).is_file():
            raise HframeError(
                f"{default}: the default profile does not exist any more; choose another with "
                "'hframe-post setup PROFILE.TOML'"
            )
        return Choice(default, "default set by 'hframe-post setup'")
    raise HframeError(
        "no printer is chosen: make its profile with 'hframe-post setup printer.cfg' (Marlin: "
        "m503.txt), or name one with -p (for a demonstration: -p paper)"
    )


def verification_as_text(printer: Printer) -> list[str]:
    """Return a line for the summary: what ``check`` measured, or how to see what this brings."""
    if (mark := printer.verified) is None:
        how = "print it, and the file as sliced, and compare"
        if printer.firmware.kind.records:
            how += "; or 'hframe-post measure --for check' measures it"
        return [] if printer.invented else [f"next             {how}"]
    less = f"{100.0 * mark.reduction:.0f} % less contour error on the printer as measured"
    return [f"verified         {less}, {one_line(mark.date)}, {one_line(mark.firmware)}"]
