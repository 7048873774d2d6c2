"""Which profiles the presets of the slicers on this computer name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_config_path

from hframe_post.printer.choice import VARIABLE

PROGRAMS = ("PrusaSlicer", "SuperSlicer", "OrcaSlicer")
PRESETS = ("*/*.ini", "user/*/*/*.json")  # of PrusaSlicer and SuperSlicer; of OrcaSlicer
MAX_SIZE = 1 << 20  # bytes
QUOTED = r'(?:\\*"(?P<quoted>[^"]+?)\\*"|(?P<plain>[^\s"\\;]+))'
NOTE = re.compile(rf'{VARIABLE}\s*=\s*(?:\\+")?(?P<plain>(?:[^"\\\n]|\\+(?![nr"]))+)')
HOOK = re.compile(rf"hframe-post.*?\s(?:-p|--printer)[ =]{QUOTED}")


@dataclass(frozen=True, slots=True)
class Preset:
    """A line of a slicer's preset that runs hframe-post. profile: empty if it names none."""

    place: str
    profile: str


def presets(folders: list[Path] | None = None) -> Iterator[Preset]:
    """Yield the presets that run hframe-post or name its profile. folders: of the slicers."""
    if folders is None:
        folders = [user_config_path(name, appauthor=False, roaming=True) for name in PROGRAMS]
    for folder in folders:
        for path in sorted(path for pattern in PRESETS for path in folder.glob(pattern)):
            yield from _in_file(path)


def _in_file(path: Path) -> Iterator[Preset]:
    try:
        if path.stat().st_size > MAX_SIZE:
            return
        lines = path.read_text("utf-8", "replace").splitlines()
    except OSError:  # another user's, or gone meanwhile
        return
    for number, line in enumerate(lines, start=1):
        found = NOTE.search(line) or HOOK.search(line)
        if found or "hframe-post" in line:
            groups = found.groupdict() if found else {}
            profile = (groups.get("quoted") or groups.get("plain") or "").strip()
            yield Preset(f"{path}:{number}", profile.replace("\\\\", "\\"))
