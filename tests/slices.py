"""Small prints in the dialects of many slicers, of tests/dialects.

Each is three layers of a square, short enough to follow by eye. They differ in what makes
conversion hard: headers, object labels, layer and feature comments, lifts, modes, wipe towers,
firmware commands, and the wording of print times.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

LAYERS = 3
FOLDER = Path(__file__).with_name("dialects")


@dataclass(frozen=True)
class Slice:
    """A file, the macros named in the user's profile, and beginnings of lines with print times."""

    name: str
    harmless: tuple[str, ...] = ()
    returns: tuple[str, ...] = ()
    times: tuple[str, ...] = ()
    folder: Path = FOLDER

    @property
    def lines(self) -> list[bytes]:
        return (self.folder / f"{self.name}.gcode").read_bytes().splitlines(keepends=True)


KNOWN = tomllib.loads((FOLDER / "slices.toml").read_text())


def _words(name: str, key: str) -> tuple[str, ...]:
    return tuple(KNOWN[name].get(key, ()))


SLICES = {
    name: Slice(name, _words(name, "harmless"), _words(name, "returns"), _words(name, "times"))
    for name in KNOWN
}
