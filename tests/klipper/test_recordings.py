"""What the host's accelerometer commands record of our motions: their start, and their file."""

import re
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.firmware.klipper.macros import macros
from hframe_post.identification.recordings.clock import Clock, known_start
from hframe_post.identification.recordings.names import parsed
from hframe_post.identification.recordings.runs import gcode
from hframe_post.identification.recordings.strokes import runs
from hframe_post.printer.profile import parse
from hframe_post.printer.settings import Printer
from hframe_post.writers.print_time import Deferred
from tests.klipper.host import Playback, play
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
        below(start.sd or 1.0, 30e-6, "standard deviation of the start, s")
        below(abs(start.start - true), 30e-6, "error of the start, s")
    # and at all times the motion is that of the command
    t = true + np.arange(len(command)) * TS
    off = playback.position(t)[:, :2] - command
    below(float(np.sqrt((off**2).mean())), 0.002, "RMS distance from the command, mm")
    velocity = np.gradient(command, TS, axis=0)
    for part in np.array_split(np.arange(len(t)), 2):
        late = -(off[part] * velocity[part]).sum() / (velocity[part] ** 2).sum()
        below(abs(float(late)), 50e-6, "lateness, s")
