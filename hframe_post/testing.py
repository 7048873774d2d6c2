"""For the tests of those who keep converted files: ``hframe_post.testing``.

from hframe_post.testing import assert_same_motion

def test_part() -> None:
    assert_same_motion("golden/part.gcode", "out/part.gcode", tolerance=0.001)
"""

from __future__ import annotations

from contextlib import ExitStack
from os import PathLike
from pathlib import Path

from hframe_post.firmware.registry import firmware_named
from hframe_post.gcode.lines import lines_of
from hframe_post.studies.print_comparison import Comparison, Tolerance, compare

Gcode = str | PathLike[str] | bytes  # a file's path, or a file's content


def assert_same_motion(
    expected: Gcode,
    actual: Gcode,
    tolerance: float = 1e-3,
    slack: float = 1e-3,
    firmware: str = "klipper",
) -> Comparison:
    """Raise AssertionError, with the first difference, unless both files ask for the same motion.

    expected, actual: paths or contents of G-code files. tolerance: mm in place and in
    filament; slack: s in time. All lines that are not moves must be equal. Returns the comparison.
    Raises HframeError or OSError if a file cannot be read.
    """
    __tracebackhide__ = True  # pytest shows the caller
    with ExitStack() as files:
        a, b = (
            each.splitlines(keepends=True)
            if isinstance(each, bytes)
            else lines_of(files.enter_context(Path(each).open("rb")))
            for each in (expected, actual)
        )
        dialect = firmware_named(firmware).dialect
        compared = compare(a, b, dialect, Tolerance(tolerance, slack))
    if not compared.same:
        raise AssertionError(compared.as_text())
    return compared
