"""Klipper's printer.cfg with its includes, read in the order in which Klipper reads it.

Klipper's rules: an include is read where it stands, a later value replaces an earlier one, and a
section that occurs twice is one section. What SAVE_CONFIG wrote at the end of the file holds
where nothing else gives the value; all of it is lost if anything else stands among or after it.
"""

from __future__ import annotations

import configparser
import glob
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hframe_post.errors import HframeError
from hframe_post.printer.firmware_tables import MACROS
from hframe_post.printer.schema import file_text

SAVED = "#*#"  # starts each line that SAVE_CONFIG wrote
HEADING = re.compile(r"#\*# <-+ SAVE_CONFIG -+>")
VOID = (
    "{}: because of this line Klipper ignores all that SAVE_CONFIG saved, such as z_offset, PID "
    "and mesh: move it, and all else that SAVE_CONFIG did not write, above the block that begins "
    "with '#*# <--- SAVE_CONFIG'"
)
MAX_FILES = 500
UNLIKE = "is it a printer.cfg?"
KINEMATICS = {  # ours, the safest first, by Klipper's name
    "corexy": ("corexy", "hbot"),
    "hybrid_corexy": ("hybrid-corexy",),
    "corexz": ("corexz",),
    "cartesian": ("cartesian",),
}
ACCELEROMETERS = ("adxl345", "lis2dw", "lis3dh", "mpu9250", "icm20948", "beacon", "cartographer")
SECTION = re.compile(r"\[([^]]+)\]")
OPTION = re.compile(r"([^\s:=][^:=]*?)\s*[:=]")


@dataclass(frozen=True, slots=True)
class ConfigLine:
    """A line of a file, without its comment. number counts from 1."""

    path: Path
    number: int
    text: str

    @property
    def place(self) -> str:
        return f"{self.path}:{self.number}"


class KlipperConfig:
    """A printer.cfg with its includes. Raises HframeError if it is not a printer.cfg.

    missing: a sentence for each include that finds no file. unsaved: why Klipper ignores all that
    SAVE_CONFIG wrote, and what to do; empty if it does not.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.missing: list[str] = []
        self._lines: dict[tuple[str, str], list[ConfigLine]] = {}  # of each section and option
        self._files = 0
        text = file_text(path, UNLIKE)
        regular, saved, void = _divided(_lines(path, text))
        self.unsaved = VOID.format(void.place) if void is not None else ""
        self._parser = configparser.RawConfigParser(
            strict=False, inline_comment_prefixes=("#", ";"), default_section="\0"
        )
        try:
            self._parse(saved)  # first, since all others count more
            self._read(regular, ())
        except _MalformedError as error:
            raise HframeError(_advice(path, text) or str(error)) from None
        if not self._parser.has_section("printer"):
            lacks = f"{path} has no section [printer]{self.lost or f': {UNLIKE}'}"
            raise HframeError(_advice(path, text) or lacks)

    def _read(self, lines: Sequence[ConfigLine], within: tuple[str, ...]) -> None:
        """Read lines and, where they stand, the includes among them. within: files around them."""
        begun = 0
        for k, line in enumerate(lines):
            header = SECTION.match(line.text)
            if header and header[1].startswith("include "):
                self._parse(lines[begun:k])
                begun = k + 1
                self._lines.setdefault((header[1], ""), []).append(line)
                self._include(line, header[1].removeprefix("include ").strip(), within)
        self._parse(lines[begun:])

    def _include(self, line: ConfigLine, pattern: str, within: tuple[str, ...]) -> None:
        inside = (*within, os.path.abspath(line.path))
        found = sorted(glob.glob(os.path.join(line.path.parent, pattern)))
        files = [Path(name) for name in found if os.path.isfile(name)]
        self._files += len(files)
        if self._files > MAX_FILES:
            raise HframeError(f"{self.path} includes more than {MAX_FILES} files")
        if not files and os.path.basename(pattern) != MACROS:  # see `check_macros`
            self.missing.append(
                f"{line.place}: [include {pattern}] finds no file, so what it sets is not known "
                "here: copy the whole folder of printer.cfg from the printer"
            )
        for each in files:
            if os.path.abspath(each) in inside:
                raise HframeError(f"{line.place}: [include {pattern}] includes a file in itself")
            self._read(_lines(each, file_text(each, UNLIKE)), inside)

    def _parse(self, lines: Sequence[ConfigLine]) -> None:
        if not lines:
            return
        lines = [ConfigLine(line.path, line.number, line.text.partition("#")[0]) for line in lines]
        try:
            self._parser.read_string("\n".join(line.text for line in lines))
        except configparser.Error as error:
            number = getattr(error, "lineno", None) or getattr(error, "errors", [(1,)])[0][0]
            raise _MalformedError(
                f"{lines[number - 1].place} is neither a [section] nor an option of one: is "
                f"{lines[0].path} a printer.cfg?"
            ) from None
        section = ""
        for line in lines:
            if header := SECTION.match(line.text):
                section = header[1]
                self._lines.setdefault((section, ""), []).append(line)
            elif option := OPTION.match(line.text):
                self._lines.setdefault((section, option[1].lower()), []).append(line)

    @property
    def lost(self) -> str:
        """Return what an error adds where a file was not found, which may have what is missing."""
        return f"; {self.missing[0]}" if self.missing else ""

    def has(self, section: str) -> bool:
        return self._parser.has_section(section) or (section, "") in self._lines

    def lines(self, section: str, key: str = "") -> list[ConfigLine]:
        """Return the lines that begin a section or an option, the one that holds last."""
        return self._lines.get((section, key), [])

    def place(self, section: str, key: str) -> str:
        """Return the line of an option, or where its section begins if it is missing."""
        lines = self.lines(section, key) or self.lines(section)
        return lines[-1].place if lines else str(self.path)

    def macros(self, name: str) -> list[str]:
        """Return the sections of a macro, in the order of the file.

        There may be several: Klipper ignores case in the names of commands, not of sections.
        """
        wanted = ["GCODE_MACRO", name.upper()]
        return [each for each in self._parser.sections() if each.upper().split() == wanted]

    def text(self, section: str, key: str, default: str = "") -> str:
        return (self._parser.get(section, key, fallback=None) or default).strip()

    def number(self, section: str, key: str, default: float = math.nan) -> float:
        """Return a value, or the default if there is none. Raises HframeError."""
        text = self.text(section, key)
        if not text:
            return default
        try:
            return float(text)
        except ValueError:
            where = f"{self.place(section, key)}: [{section}] {key}"
            raise HframeError(f"{where}: {text[:80]!r} is not a number") from None

    def sections(self, *kinds: str) -> list[str]:
        """Return the sections whose name begins with one of these words, in order."""
        named = ((each, *each.split()) for each in self._parser.sections())
        return [each for each, *words in named if words and words[0] in kinds]

    def accelerometers(self) -> list[str]:
        """Return the names by which Klipper's commands know the accelerometers."""
        return [section.split()[-1] for section in self.sections(*ACCELEROMETERS)]

    def cruise_ratio(self) -> float:
        """Return minimum_cruise_ratio; Klipper computes it where max_accel_to_decel is given."""
        share = self.number("printer", "max_accel_to_decel") / self.number("printer", "max_accel")
        default = 0.5 if math.isnan(share) else 1.0 - min(1.0, share)
        return self.number("printer", "minimum_cruise_ratio", default)

    def step(self, section: str) -> float:
        """Return mm per step of a motor; nan if it cannot be computed."""
        gears = 1.0
        for pair in filter(None, self.text(section, "gear_ratio").split(",")):
            driven, _, driving = pair.partition(":")
            try:
                gears *= float(driven) / float(driving)
            except (ValueError, ZeroDivisionError):
                return math.nan
        steps = self.number(section, "full_steps_per_rotation", 200.0)
        steps *= self.number(section, "microsteps") * gears
        return self.number(section, "rotation_distance") / steps if steps else math.nan


MARLIN = re.compile(
    r"^\s*(#define\s|/\*\*|// )|\bM(92|203|205) +[A-Z]|FIRMWARE_NAME:", re.MULTILINE
)
PROFILE = re.compile(r"^\s*(extends\s*=|\[(compensation|plant|travel)\b)", re.MULTILINE)


class _MalformedError(HframeError):
    pass


def _lines(path: Path, text: str) -> list[ConfigLine]:
    rows = text.replace("\r\n", "\n").split("\n")
    return [ConfigLine(path, number, row) for number, row in enumerate(rows, start=1)]


def _divided(
    lines: list[ConfigLine],
) -> tuple[list[ConfigLine], list[ConfigLine], ConfigLine | None]:
    """Return what the owner wrote, what SAVE_CONFIG wrote, and the line that makes this void."""
    head = next((k for k, line in enumerate(lines) if HEADING.match(line.text)), len(lines))
    saved = [line for line in lines[head:] if line.text.strip()]
    stray = next((line for line in lines[:head] if line.text.startswith(f"{SAVED} ")), None)
    foreign = (line for line in saved if not line.text.startswith(SAVED))
    if (void := stray or next(foreign, None)) is not None:
        return lines, [], void
    rows = [ConfigLine(line.path, line.number, line.text[len(SAVED) + 1 :]) for line in saved]
    first = next((k for k, line in enumerate(rows) if SECTION.match(line.text)), len(rows))
    return lines[:head], rows[first:], None


def _advice(path: Path, text: str) -> str:
    """Return what to do with a file of another kind; nothing if it is unknown."""
    if PROFILE.search(text):
        return f"{path} is a profile of hframe-post: give Klipper's printer.cfg instead"
    if MARLIN.search(text):
        return (
            f"{path} is of Marlin, which has no printer.cfg: send M503 to the printer, save its "
            "answer, and run 'hframe-post setup m503.txt'"
        )
    return ""
