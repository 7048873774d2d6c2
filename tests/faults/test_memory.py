"""Memory: 200 MB at most for a process, whatever a file holds and however long it is."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import chain, repeat

import pytest

from tests.conftest import ROOT, SAMPLES

MOST = 200  # MB
HEAD = ("G28", "G90", "M83", "G1 X100 Y100 Z0.2 F6000", "G1 X150 E2 F6000")
TAIL = ("G1 X100 Y120 E2 F6000", "G28")
ALONE = """
import re, sys
from hframe_post.__main__ import main
try:
    main()
finally:
    [peak] = re.findall(r"VmHWM:\\s*(\\d+)", open("/proc/self/status").read())
    print("peak", peak, file=sys.stderr)
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="no /proc here"),
]


def peak(lines: Iterator[str], source: str = "-", *more: str) -> tuple[int, float, str]:
    """Exit status, the most memory that one process has had (MB), and what was said."""
    command = [sys.executable, "-c", ALONE, source, "-q", "-o", os.devnull, "--jobs", "1", *more]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, env=env, text=True
    )
    assert process.stdin is not None
    try:
        for line in lines:
            process.stdin.write(line + "\n")
    except BrokenPipeError:
        pass  # it has refused the file already
    _, printed = process.communicate()
    said, _, kilobytes = printed.rpartition("peak ")
    return process.returncode, int(kilobytes) / 1024.0, said


def sides(k: int, step: float = 0.01) -> str:
    """From side to side, a little further each time."""
    return f"G1 X{100 + 50 * (k % 2)} Y{100 + step * (k % 5000):.3f} E0.5 F6000"


def retraction(k: int) -> list[str]:
    return [
        "G1 E-1 F2400",
        f"G1 X{100 + 20 * (k % 2)} Y{100 + 0.01 * (k % 5000):.2f} F9000",
        "G1 E1",
    ]


def labelled(k: int) -> list[str]:
    return [f"EXCLUDE_OBJECT_START NAME=p_{k}", sides(k), f"EXCLUDE_OBJECT_END NAME=p_{k}"]


CONSTRUCTS: dict[str, Callable[[], Iterator[str]]] = {
    "ten hours of waiting": lambda: iter(["G4 P36000000"]),
    "40 minutes of lifts": lambda: (f"G1 Z{20 - 19.8 * (k % 2)} F60" for k in range(120)),
    "300 000 comments": lambda: repeat("; a comment that is neither long nor short", 300_000),
    "40 000 macros": lambda: repeat("A_MACRO OF=mine", 40_000),
    "M73 in a print that never stops": lambda: (
        line for k in range(5300) for line in (sides(k), *repeat("M73 P5 R10", 8))
    ),
    "moves a micrometre long": lambda: (
        f"G1 X{150 - 0.001 * (k % 40_000):.3f} E0.00001" for k in range(400_000)
    ),
    "4000 objects": lambda: chain.from_iterable(map(labelled, range(4000))),
    "20 000 retractions": lambda: chain.from_iterable(map(retraction, range(10_000))),
    "10 000 circles": lambda: (f"G2 X150 Y100 I-{5 + k % 9} E1" for k in range(10_000)),
}


@pytest.mark.parametrize("name", CONSTRUCTS)
def test_memory_is_bounded(name: str) -> None:
    status, most, said = peak(chain(HEAD, CONSTRUCTS[name](), TAIL))
    assert (status, said) == (0, "")
    assert most < MOST


def test_memory_is_bounded_when_the_quickest_print_is_sought() -> None:
    source = str(SAMPLES / "cube.gcode")
    status, most, said = peak(iter(()), source, "--max-error", "0.2mm")
    assert (status, said) == (0, "")
    assert most < MOST


def test_a_line_of_300_mb_is_refused_before_it_is_in_memory() -> None:
    status, most, said = peak(chain(HEAD, [";" + "x" * 300_000_000], TAIL))
    assert (status, said.count("\n")) == (1, 1)
    assert "line 6: a line of more than" in said
    assert most < MOST
