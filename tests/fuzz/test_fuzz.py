"""A few mutated files in every run, hundreds in ``make slow``, thousands in ``make fuzz``."""

from __future__ import annotations

import contextlib
import sys
from subprocess import run

import pytest

from hframe_post.conversion.options import Options
from tests.conftest import ROOT
from tests.fuzz.cases import KINDS
from tests.fuzz.klipper import play_both
from tests.fuzz.machine import Machine
from tests.fuzz.oracle import check_same_print, converted
from tests.fuzz.targets import FOUND, TARGETS, check, seeds

ORIGINAL = b"G28\nM83\nG1 X10 Y10 Z0.2\nG1 X20 E0.5\n;@1\nG91\nUNHEARD_OF @2\nG90\n;@3\n"

MARK = b"M117 @1\n"
SWING = (
    b"""M83
G0 F9000 X152.081 Y101.17
G1 F1800 X161.821 Y118.829 E631.26631
G0 F9000 X161.255 Y118.829
%bG1 F1800 X143.596 Y101.17 E631.68163
"""
    % MARK
)


def fuzzed(*arguments: str) -> None:
    done = run(
        [sys.executable, "-m", "tests.fuzz", *arguments], cwd=ROOT, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stdout.decode() + done.stderr.decode()


def test_a_few_of_each_kind() -> None:
    """In one process, which loads but once what all kinds need."""
    fuzzed("-n", "6", "--jobs", "1")


@pytest.mark.parametrize("target", TARGETS)
def test_guided_fuzzing_begins_with_what_is_taken(target: str) -> None:
    assert "taken" in {check(target, seed) for seed in seeds(target)[:3]}


def test_what_guided_fuzzing_found_stays_mended() -> None:
    for file in sorted(FOUND.glob("*/*")):
        assert check(file.parent.name, file.read_bytes()), file


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_hundreds_of_each_kind(kind: str) -> None:
    fuzzed("-n", "300", "--seed", "10000", "--kind", kind)


@pytest.mark.parametrize(
    ("change", "to", "message"),
    [
        (b"E0.5", b"E0.49", "filament at mark 1"),
        (b";@1\n", b"", "marks"),
        (b"G91\n", b"", "modes differ at mark 2"),
        (b"X20", b"X40", "place at mark 1"),
        (b"G90\n;@3", b";@3", "modes differ at the end"),
        (b"X20", b"X-20", "place at mark 1"),
    ],
)
def test_the_oracle_can_fail(change: bytes, to: bytes, message: str) -> None:
    check_same_print(ORIGINAL, ORIGINAL, "klipper")
    with pytest.raises(AssertionError, match=message):
        check_same_print(ORIGINAL, ORIGINAL.replace(change, to), "klipper")


@pytest.mark.parametrize("lines", [-1, 0, 2])
def test_for_marlin_a_mark_stands_before_the_segment_of_its_place(lines: int) -> None:
    """The command swings by less than a segment's fewest steps: one segment spans the travel."""
    written = converted(SWING, "marlin", Options("racking")).splitlines(keepends=True)
    at = written.index(MARK)
    written.insert(at + lines, written.pop(at))
    refused = pytest.raises(AssertionError, match="filament at mark 1 differs by")
    with refused if lines else contextlib.nullcontext():
        check_same_print(SWING, b"".join(written), "marlin")


@pytest.mark.parametrize("place", [b"G28\n", b"G28\nG1 X0 Y0 Z0.2\nUNHEARD_OF\n"])
def test_what_g92_makes_of_an_unknown_place_is_not_compared_with_klipper(place: bytes) -> None:
    """The command leads the nozzle past x = 10, where Klipper homed to 0, and would refuse it."""
    text = place + b"M83\nG92 X10 Y10\nG1 X10 Y10 F6000\nG1 X30 E1.5 F1800\nG1 Y30 E1.5\n"
    assert play_both(text, converted(text, "klipper", Options("fbs"))) == "not for Klipper"
    known = b"G28\nG1 X20 Y20 F6000\nG92 X0 Y0\nG1 X5 E1\n"
    assert not Machine("klipper").play(known).named


def test_the_machine_reads_as_firmware_does() -> None:
    machine = Machine("klipper").play(
        b"g1x10y10e6\nN 5 G1 X20 (Y3) ; Y9\nG20\nG1 X1\nG92 X0 E0\n;@1\nG91\nG1 X1\nG92\n;@2\n"
    )
    first, second = machine.stands
    assert (first.place, first.reported) == ((25.4, 10.0, None), (0.0, 10.0, None))
    assert first.filament == 6.0
    assert second.reported == (0.0, 0.0, None)
