"""What the host's accelerometer commands record of our motions: their start, and their file."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.firmware.klipper.macros import macros
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.recordings.clock import Clock, known_start
from hframe_post.identification.recordings.names import parsed
from hframe_post.identification.recordings.resonance_test import ResonanceTest
from hframe_post.identification.recordings.runs import gcode
from hframe_post.identification.recordings.strokes import runs
from hframe_post.printer.profile import parse
from hframe_post.printer.settings import Printer
from hframe_post.writers.print_time import Deferred
from tests.klipper.host import TEMPLATE, Playback, play
from tests.quantities import below
from tests.recordings import read

pytestmark = pytest.mark.klipper
SENSORS = "\n[adxl345]\nrate: 3200\n[adxl345 bed]\nrate: 394\n"
# motors that allow no more than `setup` does: Klipper is then latest
WEAK = 'extends = "example-voron"\n[motors]\nbelt_acceleration = 28284.0\nbelt_velocity = 430.0\n'
UNUSED = {"adxl345-hframe-unused.csv", "adxl345-bed-hframe-unused.csv"}


def macro(printer: Printer) -> str:
    found = re.search(r"\[gcode_macro _HFRAME_RECORDED\]\n(.+\n)+", macros(printer))
    assert found
    return found[0]


def played(folder: Path, sections: str, seconds: float) -> tuple[Array, Playback]:
    """Return the command of strokes and what the host played while two sensors recorded."""
    printer = parse(WEAK, "weak")
    (run,) = runs(printer, [(140.0, 150.0)], seconds)
    pieces = gcode(printer, [run], ("adxl345", "bed"), 10.0)
    text = b"".join(p.text if isinstance(p, Deferred) else p for p in pieces)
    (folder / "measure.gcode").write_bytes(b"G28\n" + text)
    return run.command, play(folder / "measure.gcode", workdir=folder, sections=sections)


def begun(command: Array, playback: Playback) -> float:
    """Return the print time at which the host began to play a command."""
    moves = playback.moves
    first = int(np.flatnonzero((np.diff(command, axis=0) != 0.0).any(axis=1))[0])
    there = np.abs(moves["start"][:, :2] - command[0]).max(axis=1) < 1e-6
    moving = np.abs(moves["ratio"][:, :2]).max(axis=1) > 0.0
    lasting = moves["accel_t"] + moves["cruise_t"] + moves["decel_t"] > 0.0
    return float(moves["print_time"][there & moving & lasting][0]) - first * TS


def starts(folder: Path, command: Array) -> dict[float, Clock]:
    """Return the starts that the recordings show, by the rate of their sensor."""
    found = {}
    for path in folder.glob("*measure-at-*.csv"):
        recording = read(path)
        ended = parsed(path.name).ended
        rate = 394.0 if "-bed-" in path.name else 3200.0
        found[rate], notes = known_start(recording, len(command), ended)
        assert notes == ()
    return found


def test_the_macro_tells_the_start_to_some_microseconds(tmp_path: Path) -> None:
    command, playback = played(tmp_path, SENSORS + macro(parse(WEAK, "weak")), 4.0)
    assert playback.warnings == ()
    written = {path.name for path in tmp_path.glob("*.csv")}
    assert {re.sub(r"-t\d+", "", name) for name in written - UNUSED} == {
        "adxl345-measure-at-140.csv", "adxl345-bed-measure-at-140.csv"
    }  # fmt: skip
    true = begun(command, playback)
    found = starts(tmp_path, command)
    assert found.keys() == {3200.0, 394.0}
    for start in found.values():
        assert start.is_exact
        below(abs(start.start - true), 30e-6, "error of the start, s")
    # and at all times the motion is that of the command
    t = true + np.arange(len(command)) * TS
    off = playback.position(t)[:, :2] - command
    below(float(np.sqrt((off**2).mean())), 0.002, "RMS distance from the command, mm")
    velocity = np.gradient(command, TS, axis=0)
    for part in np.array_split(np.arange(len(t)), 2):
        late = -(off[part] * velocity[part]).sum() / (velocity[part] ** 2).sum()
        below(abs(float(late)), 50e-6, "lateness, s")


pytestmark = pytest.mark.klipper
SECTION = """
[resonance_tester]
accel_chip: none
probe_points: 140, 147, 10
"""
SLIP = 1e-6  # s a reversal: the host does not stop entirely where the speed changes its sign


def expected(folder: Path, direction: tuple[float, float], options: str) -> ResonanceTest:
    """Return the test of the host's printer.cfg with options of its section."""
    path = folder / "expected.cfg"
    path.write_text(TEMPLATE.read_text() + SECTION + options)
    test = ResonanceTest.from_config(KlipperConfig(path), direction)
    kalico: dict[str, Any] = {"accel_per_hz": 75.0, "sweeping_period": 0.0}
    return replace(test, **{key: usual for key, usual in kalico.items() if key not in options})


def played_test(folder: Path, lines: str, options: str = "") -> Playback:
    path = folder / "test.gcode"
    path.write_text(f"G28\nG1 Z10 F600\nG1 X140 Y147 F3000\n{lines}\n")
    return play(path, workdir=folder, sections=SECTION + options)


def largest_difference(playback: Playback, test: ResonanceTest, seconds: float) -> float:
    """Return the greatest distance, mm, from the host's motion in the first seconds of the test."""
    moves = playback.moves
    at_point = np.abs(moves["start"] - (140.0, 147.0, 10.0)).max(axis=1) < 1e-6
    lasts = moves["accel_t"] + moves["cruise_t"] + moves["decel_t"] > 0.0
    command = test.command()[: round(seconds / TS)]
    t = moves["print_time"][at_point & lasts][0] + np.arange(len(command)) * TS
    return float(np.abs(playback.position(t)[:, :2] - command).max())


@pytest.mark.parametrize(
    ("axis", "direction", "options"),
    [
        ("1,-0.5", (1.0, -0.5), "max_freq: 20\nhz_per_sec: 2\nsweeping_period: 1.2\n"),
        pytest.param("x", (1.0, 0.0), "max_freq: 140\nmin_freq: 10\n", marks=pytest.mark.slow),
        pytest.param(
            "y", (0.0, 1.0), "sweeping_accel: 200\nsweeping_period: 1.2\naccel_per_hz: 90\n",
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_each_step(tmp_path: Path, axis: str, direction: tuple[float, float], options: str) -> None:
    test = expected(tmp_path, direction, options)
    host = played_test(tmp_path, f"TEST_RESONANCES AXIS={axis} OUTPUT=raw_data", options)
    # Kalico brakes from the wrong speed at the end, as Klipper did until July 2026
    found = largest_difference(host, test, test.seconds - 0.1)
    reversals = 2.0 * test.seconds / test.sweeping_period if test.sweeping_period else 0.0
    speed = 0.3 * test.sweeping_accel * test.sweeping_period + 0.25 * test.accel_per_hz
    below(found, 1e-8 + SLIP * reversals * speed, "greatest difference of the motion, mm")


def test_motion_before_december_2024(tmp_path: Path) -> None:
    """Earlier versions moved out and back, now on one side of the point, then on the other."""
    test = ResonanceTest((1.0, 0.0), (140.0, 147.0), 5.0, 20.0, 2.0, 75.0, 400.0, 0.0,
                         around_point=True)  # fmt: skip
    lines = ["G4 P500", "SET_VELOCITY_LIMIT ACCEL=10000 MINIMUM_CRUISE_RATIO=0"]
    for k, hz in enumerate(test.half_cycles()):
        quarter, accel = 0.25 / hz, 75.0 * hz
        out = 140.0 + (-1.0) ** k * 0.5 * accel * quarter**2
        feed = 60.0 * accel * quarter
        lines += [f"M204 S{accel:.9f}", *(f"G1 X{x:.12f} F{feed:.9f}" for x in (out, 140.0))]
    host = played_test(tmp_path, "\n".join(lines))
    found = largest_difference(host, test, test.seconds)
    below(found, 1e-3, "greatest difference of a motion of 0.5 mm, mm")
