"""Marlin's settings: saved answers to M503, M115 and M211, and headers of its build.

A log of any program that talks to the printer will do: what stands before the commands is
skipped, and a later line replaces an earlier one. Headers are Configuration.h and
Configuration_adv.h; they add what the answers leave out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from hframe_post.errors import HframeError
from hframe_post.model.kinematics import TYPES
from hframe_post.printer.new_profile import Known, as_float
from hframe_post.printer.schema import file_text

LINE = re.compile(r"(?:^|[\s:>])(M\d+)((?: +[A-Z](?:-?\d+\.?\d*)?(?=\s|$))+)")
WORD = re.compile(r"([A-Z])(-?\d+\.?\d*)?")
DEFINE = re.compile(r"^\s*#define\s+(\w+)(?:[ \t]+([^\s/]+))?", re.MULTILINE)
STEALTH = re.compile(r" - stealth \(.*\n.*")  # a Prusa's limits of its quieter mode, a line each
SECTION = re.compile(r"^\[\w", re.MULTILINE)  # of a printer.cfg
ANSWER = re.compile(r"\bM(92|20[1345]) +[A-Z]-?\d|FIRMWARE_NAME:")
VERSION = re.compile(
    r"FIRMWARE_NAME:(Marlin (?:bugfix-)?(\d+)\.(\d+)\.(\d+|x)\S*)(?: \((\w+ +\d+ \d+))?"
)
XYZ = r" *X *(-?\d+\.?\d*) +Y *(-?\d+\.?\d*) +Z *(-?\d+\.?\d*)"
ENDSTOPS = re.compile(rf"Min:{XYZ} +Max:{XYZ}")  # the answer to M211
ENDSTOPS_ON = re.compile(r"\bM211 S1\b|Soft endstops: *On\b", re.IGNORECASE)
CORNER = r"\{x:(-?\d+\.?\d*),y:(-?\d+\.?\d*)[^}]*\}"
BY_TOOL = ("M92", "M201", "M203")  # T in these is an extruder
MONTHS = "JanFebMarAprMayJunJulAugSepOctNovDec"
NEW_RAMPS = (2024, 10)  # year and month since which the development branch plans as "2.1-dev"
KINEMATICS = {  # ours, the safest first, by the name of the build's option
    "COREXY": ("corexy", "hbot"),
    "MARKFORGED_XY": ("hybrid-corexy",),
    "COREXZ": ("corexz",),
}
UNUSABLE = ("DELTA", "SCARA", "COREYZ", "COREYX", "MARKFORGED_YX", "POLAR", "MORGAN_SCARA")
ANY = tuple(reversed(TYPES))
M115 = "the answer to M115"
ASSUMED = "2.1"  # planner of a build whose version is not known
TWO_CARRIAGES = "DUAL_X_CARRIAGE"  # of Configuration_adv.h
HARMFUL = {  # options of a build, and what they do
    "SLOWDOWN": "it slows down where the queue is short, so starts and ends are off",
    "ADAPTIVE_STEP_SMOOTHING": "it rounds speeds four times as coarsely",
}


def text_in(path: Path) -> str:
    """Return a file's text. Raises HframeError if it is too large or not text."""
    return file_text(path, "it has no printer's settings")


def is_of_marlin(text: str) -> bool:
    """Return whether a text holds answers of Marlin or a header of its build."""
    return bool(ANSWER.search(text) or DEFINE.search(text)) and not SECTION.search(text)


class MarlinSettings:
    """What the files say. Raises HframeError if they hold no answer to M503.

    name: of the first file. firmware: its name and version; empty without an answer to M115.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self.name = paths[0].name
        text = "\n".join(text_in(path) for path in paths)
        self._words: dict[str, dict[str, float]] = {}
        for command, words in LINE.findall(STEALTH.sub("", text)):
            self._add(command, WORD.findall(words))
        self._defines: dict[str, str] = dict(DEFINE.findall(text))
        self._text = text
        missing = [c for c in ("M92", "M201", "M203", "M204", "M205") if c not in self._words]
        if missing:
            raise HframeError(
                f"{', '.join(map(str, paths))}: no values of {', '.join(missing)}. Send M503 to "
                "the printer and save its whole answer"
            )
        self._complete()
        found = VERSION.search(text)
        self.firmware = found[1] if found else ""
        self.planner = _planner(found)
        if self.defined("NO_STANDARD_MOTION"):
            self.planner = Known("ft-motion", "NO_STANDARD_MOTION of the build")

    def _add(self, command: str, words: Sequence[tuple[str, str]]) -> None:
        values = {letter: float(value) for letter, value in words if value}
        if command in BY_TOOL and values.pop("T", 0.0) > 0.0:
            return  # of a second extruder
        axes = [letter for letter, value in words if not value]  # M593 X F40: of one axis
        self._words.setdefault(" ".join([command, *axes]), {}).update(values)

    def _complete(self) -> None:
        """Add what older versions leave out: M205 Y, which is X, and P, R or T of M204."""
        jerk, accelerations = self._words["M205"], self._words["M204"]
        if "X" in jerk:
            jerk.setdefault("Y", jerk["X"])
        if "P" not in accelerations and "S" in accelerations:  # then T is for retractions
            usual = accelerations["S"]
            accelerations["R"] = accelerations.pop("T", usual)
            accelerations["P"] = accelerations["T"] = usual

    def word(self, command: str, letter: str, default: float | None = None) -> Known:
        """Return a value of M503. Raises HframeError if it is missing and has no default."""
        value = self._words.get(command, {}).get(letter, default)
        if value is None:
            raise HframeError(f"{self.name}: {command} has no {letter}: send M503 and save again")
        if not (-10.0 if command == "M208" else 0.0) <= value < 1e9:
            raise HframeError(f"{self.name}: {command} {letter}{value:g} is not possible")
        return Known(value, f"{command} {letter}")

    def words(self, command: str, letters: str, default: float | None = None) -> Known:
        """Return one value, or two as a pair; see ``word``."""
        found = [self.word(command, letter, default) for letter in letters]
        if len(found) == 1:
            return found[0]
        pair = tuple(as_float(each) for each in found)
        return Known(pair, f"{command} {' and '.join(letters)}")

    def defined(self, name: str) -> bool:
        return name in self._defines

    def number(self, name: str) -> float:
        """Return the number that a header gives for a name, or for what it stands for; else nan."""
        for _ in range(3):
            name = self._defines.get(name, name)
        try:
            return float(name.strip("()"))
        except ValueError:
            return math.nan

    def kinematics(self) -> tuple[tuple[str, ...], str]:
        """Return the kinematics that the printer may have, the safest first, and what says so.

        Raises HframeError for a kind that cannot be compensated.
        """
        unusable = [f"the build is for {name}" for name in UNUSABLE if self.defined(name)]
        if "M665" in self._words:
            unusable.append(f"{self.name} has M665, which only deltas and robot arms have")
        if unusable:
            raise HframeError(f"{unusable[0]}; hframe-post can only compensate {', '.join(ANY)}")
        for name, kinds in KINEMATICS.items():
            if self.defined(name):
                return kinds, f"{name} of the build"
        if self.defined("X_BED_SIZE"):  # Configuration.h was given, and names none of them
            return ("cartesian",), "the build"
        return ANY, ""

    def travel(self) -> dict[str, Known]:
        """Return the ranges of x and y; nothing if no file tells them."""
        if edges := self.soft_endstops():
            return {
                axis: Known(edge, "the answer to M211")
                for axis, edge in zip("xy", edges, strict=False)
            }
        for name in ("work", "full"):
            if found := re.search(rf"{name}:\{{min:{CORNER},max:{CORNER}", self._text):
                x_low, y_low, x_high, y_high = (float(text) for text in found.groups())
                return {"x": Known((x_low, x_high), M115), "y": Known((y_low, y_high), M115)}
        ranges = {}
        for axis in "XY":
            size = self.number(f"{axis}_BED_SIZE")
            ends = [self.number(f"{axis}_{end}_POS") for end in ("MIN", "MAX")]
            low, high = (b if math.isnan(a) else a for a, b in zip(ends, (0.0, size), strict=True))
            if not low < high:
                return {}
            ranges[axis.lower()] = Known(
                (low, high), f"{axis}_MIN_POS and {axis}_MAX_POS of the build"
            )
        return ranges

    def soft_endstops(self) -> tuple[tuple[float, float], ...]:
        """Return the ranges of x, y and z that M211 tells; none where it is off or not asked."""
        found = ENDSTOPS.search(self._text)
        if found is None or not ENDSTOPS_ON.search(self._text):
            return ()
        ends = [float(text) for text in found.groups()]
        edges = tuple(zip(ends[:3], ends[3:], strict=True))
        return edges if all(low < high for low, high in edges) else ()

    def warnings(self) -> list[str]:
        """Return what the owner must know or change before a print."""
        found = [
            f"turn {name} off in Marlin's build: {why}"
            for name, why in HARMFUL.items()
            if self.defined(name)
        ]
        if self.defined(TWO_CARRIAGES):
            found.append(
                f"{TWO_CARRIAGES}: a profile has the model of one carriage: what the other prints, "
                "after T1, is not compensated"
            )
        if STEALTH.search(self._text):
            found.append(
                "the limits are those of normal mode: in stealth mode the printer is slower than "
                "the file expects"
            )
        if not self.planner:
            found.append(
                f'the firmware\'s version is not known, so planner = "{ASSUMED}" is assumed. Add '
                "the answer to M115, or write firmware.marlin.planner into the profile"
            )
        return found


def _planner(found: re.Match[str] | None) -> Known | None:
    """Return the generation of the planner, by version and date of the build."""
    if found is None or int(found[2]) < 2:
        return None
    month, _, year = (found[5] or "").split() or ("", "", "0")
    name, origin = "2.1", found[1]
    if found[4] == "x":  # a branch: its date decides
        if not month:
            return None
        built = (int(year), MONTHS.find(month) // 3 + 1)
        name, origin = "2.1-dev" if built >= NEW_RAMPS else "2.1", f"{origin} of {month} {year}"
    elif (version := tuple(map(int, found.groups()[1:4]))) < (2, 1, 1):
        name = "2.0"
    elif version > (2, 1, 2):
        name = "2.1-dev"
    return Known(name, origin)
