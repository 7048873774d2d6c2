"""Read lines of G-code into items, moves and end points."""

from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, Moves, Passthrough

HOME = ["G90", "M83", "G1 X0 Y0 Z0 F6000"]  # verbatim; all is known after it


def items(*lines: str, firmware: str = "klipper", file_limits: bool = True) -> list[Item]:
    options = ReadOptions(FIRMWARES[firmware].dialect, "file-all" if file_limits else "printer")
    return list(read([line.encode() + b"\n" for line in lines], options))


def moves(*lines: str, firmware: str = "klipper", file_limits: bool = True) -> list[Moves]:
    found = items(*HOME, *lines, firmware=firmware, file_limits=file_limits)
    return [item for item in found if isinstance(item, Moves)]


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
