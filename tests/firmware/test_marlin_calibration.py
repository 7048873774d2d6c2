"""The calibration file, played by the simulation of each board: what it tells."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.errors import PrinterError
from hframe_post.firmware.marlin.calibration import Calibration, calibration
from hframe_post.printer.profile import load
from tests.command_line import run
from tests.conftest import few
from tests.marlin.planner import Build, Machine

PART = 60.0  # s, more than any approach


@pytest.fixture(scope="module")
def found() -> Calibration:
    return calibration(load("paper-marlin"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planner", "tick"),
    few([
        ("2.0", False), ("2.1", False), ("2.1-dev", False), ("ft-motion", False),
        ("2.0", True), ("2.1", True), ("2.1-dev", True),  # fixed-time motion counts no ticks
    ], 2),
)  # fmt: skip
def test_parts_take_as_long_as_the_table_says(found: Calibration, planner: str, tick: bool) -> None:
    steps = load("paper-marlin").steps
    assert steps is not None
    machine = Machine(Build(steps.belt, steps.z, steps.e, planner=planner, extra_tick=tick))
    parts = [r.duration for r in machine.read(b"".join(found.lines)) if r.duration > PART]
    board = f'planner = "{planner}"' + (", timer_extra_tick = true" if tick else "")
    np.testing.assert_allclose(parts, found.durations[board], rtol=5e-4)


def test_file_stays_on_the_bed_and_restores_the_settings(found: Calibration) -> None:
    printer = load("paper-marlin")
    x = [float(w[1:]) for line in found.lines for w in line.decode().split() if w[0] == "X"
         and line.startswith(b"G1")]  # fmt: skip
    assert printer.travel.x[0] < min(x)
    assert max(x) < printer.travel.x[1]
    assert b"M204 P3000 T3000 R3000\n" in found.lines[-12:]
    counts = [line for line in found.lines if line.startswith(b"G92")]
    assert counts == [b"G92 E0\n"]  # x, y and z are where homing has put them


def test_no_uneven_block_reaches_its_fast_speed(found: Calibration) -> None:
    printer, part = load("paper-marlin"), b"".join(found.lines).split(b"M118 uneven")[1]
    rows = [[float(word[1:]) for word in row.split()[1:]]
            for row in part.split(b"M75\n")[1].splitlines() if row.startswith(b"G1")]  # fmt: skip
    x, f = np.array(rows).T
    way, fast = abs(x[1] - x[0]), f.max() / 60.0
    assert fast < printer.limits.velocity
    assert fast == pytest.approx(np.sqrt(printer.limits.acceleration * way), rel=0.01), "mm/s"


def test_no_limit_of_the_file_slows_it_down() -> None:
    """Speeds and limits are rounded, each in its own way."""
    printer = load("paper-marlin")
    printer = replace(printer, limits=replace(printer.limits, velocity=150.4))
    words = [line.decode().split() for line in calibration(printer).lines]
    fastest = max(float(row[-1][1:]) for row in words if row[0] == "G1") / 60.0
    assert fastest >= 150.4, "mm/s"
    limits = [float(word[1:]) for row in words if row[0] == "M203" for word in row[1:]]
    assert min(limits[:2]) >= fastest, "mm/s"


def test_command_writes_the_file_and_prints_the_table(tmp_path: Path) -> None:
    out = tmp_path / "calibration.gcode"
    done = run("measure", "--for", "planner", "-o", out, "-p", "paper-marlin")
    assert done.returncode == 0
    assert b'planner = "2.1-dev", timer_extra_tick = true' in done.stderr
    assert out.read_bytes().count(b"M31\n") == 3
    assert out.read_bytes().index(b"M494 T0 X0 Y0 Z0 E0\n") < out.read_bytes().index(b"G1 ")
    assert b"(its seconds - 19.1 at 115200 baud or 8.8 at 250000 baud)" in done.stderr
    with pytest.raises(PrinterError) as refused:
        calibration(load("paper"))
    assert refused.value.key == "firmware.dialect"
