"""The section of moonraker.conf, as the component passes it to its processes."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from .conversion import said
from .disk import FOLDER, NAME, FailureError
from .history import HISTORY
from .originals import SETTINGS, Originals

START = 120.0  # s that the shortest command may take, on a slow host that prints


@dataclass(frozen=True)
class Settings:
    """gcodes: the folder of G-code. socket: Moonraker's. command: that converts. keep: bytes of
    sliced files. recordings: the folder into which Klipper writes those of accelerometers.
    """

    gcodes: str
    socket: str
    command: list[str]
    keep: int
    recordings: str

    @classmethod
    def from_json(cls, text: str) -> Settings:
        return cls(**json.loads(text))

    def as_json(self) -> str:
        return json.dumps(asdict(self))

    @property
    def folder(self) -> Path:
        return Path(self.gcodes) / FOLDER

    @property
    def history(self) -> Path:
        return self.folder / HISTORY

    @property
    def originals(self) -> Originals:
        return Originals(Path(self.gcodes), self.keep)

    def present(self) -> str:
        """Return the hash of the present settings. Raises FailureError if the profile is unusable.

        It is that of the first line of a file that the command would convert now.
        """
        lines = said([*self.command, "--stamp"], START)
        found = [SETTINGS.match(f"{line}\n".encode()) for line in lines]
        for one in found:
            if one is not None:
                return one["settings"].decode()
        raise FailureError(" ".join(lines[-1:]) or "hframe-post says nothing of its settings")

    def program_and_profile(self) -> tuple[list[str], Path]:
        """Return the command's words before -p, and the profile after it. Raises FailureError."""
        for option in ("-p", "--printer"):
            if option in self.command[1:-1]:
                place = self.command.index(option)
                return self.command[:place], Path(self.command[place + 1])
        raise FailureError(
            f"command in [{NAME}] of moonraker.conf names no profile. Add -p and the profile's path"
        )
