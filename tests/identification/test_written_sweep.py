"""Sweeps of moves as written: played by a simulated board, recorded by anything, identified."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import LimitError
from hframe_post.identification.recordings.accelerometer import GRAVITY
from hframe_post.identification.recordings.clock import acceleration, aligned
from hframe_post.identification.recordings.formats import read_command
from hframe_post.identification.recordings.runs import QUIET
from hframe_post.identification.recordings.written_sweep import played
from hframe_post.printer.profile import load
from tests.command_line import run
from tests.conftest import few
from tests.marlin.planner import Build, xy
from tests.marlin.planner import Machine as Board
from tests.printers import JERK, M503, ender
from tests.quantities import below, near
from tests.resonance_recordings import SENSORS
from tests.simulator import Axis, Chip, Machine, Mode

MACHINE = Machine(Axis((Mode(42.0, 0.06),)), Axis((Mode(27.0, 0.09),)), kinematics="cartesian")
FINE = 20  # samples of a board a millisecond


def at(axis: int, *place: float) -> tuple[str, int, tuple[float, float]]:
    return "run", axis, (place[0], place[1])


def motion(text: bytes, planner: str = "2.1", jerk: bool = False) -> Array:
    """Return x and y (m, 2), mean of the ms around each, as a board of 80 steps/mm plays a file."""
    build = Build(1 / 80, 1 / 400, 1 / 93, planner=planner, cartesian=True, classic_jerk=jerk)
    board = Board(build)
    longest = max(board.read(text), key=lambda one: one.duration)
    assert not board.merged
    t = (np.arange(round(longest.duration / TS) * FINE) + 0.5) * TS / FINE - TS / 2.0
    return np.asarray(xy(longest.cells(t), board.build).reshape(-1, FINE, 2).mean(axis=1))


@pytest.mark.parametrize(
    ("planner", "jerk"),
    few(
        [("2.1", True), ("2.0", False), ("2.1-dev", False), ("ft-motion", False)], 1,
    ),
)  # fmt: skip
@pytest.mark.parametrize("acceleration", few([1500.0, 500.0], 1))
def test_a_board_plays_the_command(planner: str, jerk: bool, acceleration: float) -> None:
    """What a sweep is compared to is within a step of 12.5 µm, from start to end."""
    one, lines = played(
        ender(acceleration, planner=planner, **(JERK if jerk else {})), *at(0, 110.0, 110.0), 10.0
    )
    # strokes of z fill the real board's queue first; this one always plans ahead
    text = "\n".join(line for line in lines if " Z" not in line)
    made = motion(text.encode(), planner, jerk)
    command = one.command[QUIET:-QUIET]
    assert len(made) == pytest.approx(len(command), abs=2)
    n = min(len(made), len(command))
    off = np.linalg.norm(made[:n] - command[:n], axis=1)
    below(float(off.max()), 0.01, "distance, mm")


def test_the_file_stays_near_its_place_and_restores_the_settings() -> None:
    one, lines = played(ender(), *at(1, 110.0, 190.0), 12.0)
    assert np.ptp(one.command[:, 0]) == 0.0
    assert 165.0 - 1e-9 <= one.command[:, 1].min() < one.command[:, 1].max() <= 215.0 + 1e-9
    moves = [line for line in lines if line.startswith("G1 Y")]
    assert len(moves) / one.seconds < 200.0
    # builds of 2026 do not plan the moves before it
    assert lines.index("M494 T0 X0 Y0 Z0 E0") < lines.index("G1 Z12 F300")
    assert lines[0] == "; hframe-post: off"  # a slicer's hook must not compensate it
    assert "M204 P500 T500 R1000" in lines[-6:]
    assert not any("ACCELEROMETER" in line for line in lines)
    with pytest.raises(LimitError, match="room to either side"):
        played(ender(), *at(1, 110.0, 218.0), 12.0)


def test_fixed_time_motion_is_busy_before_the_first_move() -> None:
    """It would stop at the end of each line that comes before the next is planned."""
    lines = played(ender(planner="ft-motion"), *at(0, 110.0, 110.0), 12.0)[1]
    wait = lines.index("G4 P5000")
    up, back = (line.split() for line in lines[wait + 2 : wait + 4])
    assert float(up[1].removeprefix("Z")) > 12.0
    assert back[1] == "Z12"
    assert lines[wait + 5].startswith("G1 X")


def record(folder: Path, name: str, kind: str, seed: int) -> None:
    """Write what a sensor of a kind records while the machine plays a file, as time, x, y, z in g.

    It was started by hand, its clock is 1.5 % off, and it is turned.
    """
    (gcode,) = folder.glob(f"sweep.{name}.gcode")
    still = np.ones((2000, 1))
    made = motion(gcode.read_bytes())
    whole = np.vstack([still * made[0], made, still * made[-1]])
    chip = replace(SENSORS[kind], lead=3.0, drift=0.015, turned=(90.0, 3.0, 0.0))
    found = chip.record(MACHINE, whole, seed)
    rows = np.column_stack([found.t - found.t[0], found.a / GRAVITY])
    recordings = folder / "recordings"
    recordings.mkdir(exist_ok=True)
    np.savetxt(recordings / f"{name}.csv", rows, "%.6f", ",", header="time,x,y,z", comments="")


@pytest.mark.parametrize("drift", few([0.01, -0.018], 0))
def test_a_clock_that_is_far_off_is_found(drift: float) -> None:
    printer = ender(3000.0)
    assert printer.steps is not None
    printer = replace(
        printer,
        steps=replace(printer.steps, belt=1 / 48.54),
        sweep=replace(printer.sweep, amplitude=2142.0),
    )
    command = played(printer, *at(1, 110.0, 110.0), 10.0)[0].command
    chip = Chip(noise=20.0, rate=800.0, rate_error=drift, drift=drift, lead=3.0, filtered=True)
    recording = chip.record(replace(MACHINE, y=Axis((Mode(52.6, 0.13),))), command, 0)
    found = aligned(acceleration(command[:, 1:]), recording)
    assert found.clock.start == pytest.approx(3.0 * (1.0 + drift) + recording.t[0], abs=0.05)
    assert found.clock.drift == pytest.approx(drift, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "drift"), [("lis2dw-394", 9.3e-4), ("adxl345", -4.34e-3)])
def test_a_clock_is_found_where_late_windows_are_lost_in_noise(sensor: str, drift: float) -> None:
    """A soft bed hardly follows them. What is left of the drift is refined, also below 20 ms."""
    command = played(ender(500.0), *at(1, 110.0, 110.0), 10.0)[0].command
    soft = replace(MACHINE, y=Axis((Mode(18.8, 0.12),)))
    chip = replace(SENSORS[sensor], lead=3.0, drift=drift)
    found = aligned(acceleration(command[:, 1:]), chip.record(soft, command, 11))
    near(found.clock.drift, chip.drift, 1e-4, "drift")


@pytest.mark.slow
def test_a_marlin_owner_measures_a_bed_slinger(tmp_path: Path) -> None:
    """With an ADXL345 on the head for x, and for y a telephone (394 samples a second) on a bed."""
    own = tmp_path / "printer.toml"
    home = str(tmp_path / "config")
    for words in (
        ("setup", M503, "-o", tmp_path),
        ("measure", "-p", own, "-o", tmp_path / "sweep.gcode"),
    ):
        done = run(*words, XDG_CONFIG_HOME=home)
        assert done.returncode == 0, done.stderr
    assert b"the accelerometer to the bed for y" in done.stderr
    for name, kind, seed in (("x-at-117_5", "adxl345", 1), ("y-at-117_5", "lis2dw-394", 2)):
        record(tmp_path, name, kind, seed)
        command = tmp_path / f"sweep.{name}.csv"
        assert read_command(command).shape[1] == 2
        command.rename(tmp_path / "recordings" / command.name)
    done = run("identify", tmp_path / "recordings", "-p", own, "-o", own)
    assert done.returncode == 0, done.stderr
    profile = load(str(own))
    assert not profile.invented
    assert profile.firmware.dialect == "marlin"
    for G, axis in ((profile.plant.Gxx, MACHINE.x), (profile.plant.Gyy, MACHINE.y)):
        hz = np.arange(10.0, 80.0, 0.05)
        peak = float(hz[np.argmax(np.abs(G.response(2.0 * np.pi * TS * hz)))])
        near(peak, axis.modes[0].hz, 0.01 * axis.modes[0].hz, "main resonance, Hz")
