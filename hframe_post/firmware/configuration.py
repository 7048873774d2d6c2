"""What a firmware's own files say of a printer, for `setup` and `doctor`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hframe_post.printer.new_profile import Tables
from hframe_post.printer.settings import Printer


@dataclass(frozen=True, slots=True)
class Finding:
    """A difference from the profile. wrong: the printer would not move as computed."""

    wrong: bool
    text: str


class Source(ABC):
    """Files that describe a printer. possible: its kinematics, the safest first; decided: why.

    warnings: what the owner must know before a print. sensors: accelerometers that are known.
    alone: why `setup` takes a single file and no --bed, if it does. no_travel: why the ranges of x
    and y are not known, if they are not.
    """

    path: Path
    possible: tuple[str, ...]
    decided: str
    warnings: list[str]
    sensors: str
    alone: str = ""
    no_travel: str = ""

    @abstractmethod
    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        """Return the settings of a new profile. Raises HframeError if a number is missing.

        bed: width and depth, mm, if the owner said them.
        """

    def companions(self, profile: Printer) -> dict[str, str]:
        """Return texts by name of the files that the printer needs next to its own."""
        return {}

    @abstractmethod
    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        """Return what to do after `setup` has written the profile.

        quoted: returns a path as a shell takes it.
        """
