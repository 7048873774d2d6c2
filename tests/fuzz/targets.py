"""What guided fuzzing feeds with bytes; each must be taken, or refused with a clean error.

A file that was a defect is kept in ``found``, in a folder named as its target.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.identification.recordings import accelerometer
from hframe_post.printer.profile import parse, shipped
from tests.conftest import SAMPLES
from tests.fuzz import cases, files, oracle

FOUND = Path(__file__).with_name("found")
RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes()
LINES = 40  # of a seed: a short one is tried more often


def check(target: str, data: bytes) -> str:
    """Feed a target; return "taken" or "refused". A defect raises anything but HframeError."""
    try:
        TARGETS[target](data)
    except HframeError as error:
        oracle.check_error(error)
        return "refused"
    return "taken"


def _read(data: bytes) -> None:
    for name in oracle.FIRMWARES:
        options = ReadOptions(FIRMWARES[name].dialect, "file-all")
        for _ in read(data.splitlines(keepends=True), options):
            pass


def _profile(data: bytes) -> None:
    printer = replace(parse(data.decode("latin-1"), "fuzzed"), name="fuzzed", invented=False)
    for _ in GcodeConversion(RECTANGLE.splitlines(keepends=True)[:LINES], printer, Options("fbs")):
        pass


def _second(data: bytes) -> None:
    """Convert what was converted: without its stamp it is a file like any other."""
    first = oracle.converted(data, "klipper", Options("fbs"))
    again = first.split(b"\n", 1)[1]
    second = oracle.converted(again, "klipper", Options("fbs"))
    oracle.check_same_print(again, second, "klipper")


def _file(suffix: str, reader: files.Reader) -> Callable[[bytes], None]:
    def target(data: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"a.{suffix}")
            path.write_bytes(data)
            reader(path)

    return target


TARGETS: dict[str, Callable[[bytes], None]] = {
    "reader": _read,
    "bgcode": _file("bgcode", files.READERS["bgcode"]),
    "profile": _profile,
    "cfg": _file("cfg", files.READERS["cfg"]),
    "recording": _file("csv", accelerometer.read),
    "second": _second,
}


@cache
def seeds(target: str) -> list[bytes]:
    """Return files to begin with."""
    lines = RECTANGLE.splitlines(keepends=True)
    head = b"".join(lines[:LINES])
    return {
        "reader": [
            head,
            *(
                each.read_bytes()
                for each in sorted((SAMPLES.parent / "tests" / "quirks").iterdir())
            ),
        ],
        "bgcode": [files.originals()["bgcode"]],
        "profile": [text.encode() for text in shipped().values()],
        "cfg": [files.originals()["cfg"]],
        "recording": [b"".join(cases.tables()[0].splitlines(keepends=True)[: 4 * LINES])],
        "second": [head],
    }[target]
