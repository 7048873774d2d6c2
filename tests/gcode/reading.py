"""Read lines of G-code into items, moves and end points."""

from collections.abc import Iterable
from typing import Any

from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, MoveAtRest, Moves, Passthrough

HOME = ["G90", "M83", "G1 X0 Y0 Z0 F6000"]  # verbatim; all is known after it


def items(*lines: str, firmware: str = "klipper", **options: Any) -> list[Item]:
    """options: of ``ReadOptions``; all limits of the file are read where they say no other."""
    chosen = ReadOptions(FIRMWARES[firmware].dialect, **{"limits": "file-all", **options})
    return list(read([line.encode() + b"\n" for line in lines], chosen))


def moves(*lines: str, firmware: str = "klipper", **options: Any) -> list[Moves]:
    found = items(*HOME, *lines, firmware=firmware, **options)
    return [item for item in found if isinstance(item, Moves)]


def ends_by_line(lines: Iterable[bytes], options: ReadOptions) -> dict[int, list[float]]:
    """Return x, y and z at the end of each line that moves."""
    found: dict[int, list[float]] = {}
    for item in read(lines, options):
        if isinstance(item, Moves):
            found |= zip(item.line.tolist(), item.points[1:, :3].tolist(), strict=True)
        elif isinstance(item, MoveAtRest):
            found[item.line] = list(item.end[:3])
    return found


def ends(*lines: str, firmware: str = "klipper") -> list[list[float]]:
    blocks = moves(*lines, firmware=firmware)
    return [row for block in blocks for row in block.points[1:].round(9).tolist()]


def carried(found: list[Item]) -> list[bytes]:
    """Text of all that passes, marks among moves included, in order."""
    texts: list[bytes] = []
    for item in found:
        if isinstance(item, Moves | Marks):
            texts += [mark.text for mark in (item if isinstance(item, Marks) else item.marks)]
        elif isinstance(item, Passthrough):
            texts.append(item.text)
    return texts[:-1]  # the last is the end of the file
