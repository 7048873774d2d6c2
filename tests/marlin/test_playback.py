"""Converted files through a simulation of Marlin's planner and stepper: place, time, nozzle."""

import gzip
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.prediction.predict import judge
from hframe_post.printer.firmware_tables import MARLIN_PLANNERS
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder, Printer
from hframe_post.stream.chunks import join
from hframe_post.stream.types import Samples
from tests.conftest import few
from tests.gcode_tools import converted, layers, sample, sliced
from tests.printers import JERK, with_marlin
from tests.quantities import below, near, rms

from .planner import Build, FixedTimeRun, Machine, Run, xy

STREAMS = Path(__file__).parent / "streams"
LAPS = 15  # of the rectangle: half a minute
FINE = 2000  # steps to which lateness is searched, of the reach of the search
WINDOW, STEP = 500, 1000  # samples over which lateness is measured, and from one to the next


@dataclass
class Played:
    """Intended command (n, 2), and what the simulation made of the longest run."""

    command: Array
    build: Build
    run: Run | FixedTimeRun
    machine: Machine

    def at(self, t: NDArray[np.floating[Any]]) -> Array:
        """Return the command (m, 2) of the simulated firmware at its times t (m,)."""
        return xy(self.run.cells(np.asarray(t, dtype=np.float64)), self.build)

    def lateness(self, first: int, guess: float, reach: float) -> tuple[float, Array]:
        """Return the best-fit lateness (s) over a window, and residual distances (WINDOW,), mm."""
        command = self.command[first : first + WINDOW]
        fine = reach / FINE  # of which a millisecond is a whole number
        stride, most = round(TS / fine), FINE + 50
        steps = np.arange(-most, len(command) * stride + most)
        at = self.at(first * TS + guess + steps * fine)

        def residuals(late: int) -> Array:
            return at[most + late :: stride][: len(command)] - command

        best = 0
        for step in (FINE // 50, 1):
            tried = range(best - 50 * step, best + 51 * step, step)
            best = min(tried, key=lambda late: float(np.abs(residuals(late)).mean()))
        return guess + best * fine, np.hypot(*residuals(best).T)

    def track(self) -> tuple[Array, Array, Array]:
        """Return the first samples of the windows, lateness (s) in each, and residuals, mm."""
        late, _ = self.lateness(0, self.run.sets_out, 0.4)
        found, left, first = [], [], list(range(STEP, len(self.command) - WINDOW, STEP))
        for start in first:
            late, off = self.lateness(start, late, 0.1)
            found.append(late)
            left.append(off)
        return np.array(first), np.array(found), np.concatenate(left)


def built(printer: Printer, **how: object) -> Build:
    assert printer.steps is not None
    own = replace(Build(printer.steps.belt, printer.steps.z, printer.steps.e))
    return replace(own, **how)  # type: ignore[arg-type]


def intended(lines: list[bytes], printer: Printer) -> Array:
    """Return the command (n, 2) that is to be played."""
    options = Options(printer.compensation.strategy)
    blocks = WholeFile(iter(lines), printer, options).samples()
    return np.concatenate([b.commands[options.strategy] for b in blocks])


def played(lines: list[bytes], printer: Printer, **how: object) -> Played:
    text, command = converted(lines, printer)[0], intended(lines, printer)
    machine = Machine(build := built(printer, **how))
    run = max(machine.read(text), key=lambda r: r.duration)
    return Played(command, build, run, machine)


def laps(count: int = LAPS) -> list[bytes]:
    lines = sample("rectangle.gcode")
    return lines + lines[-4:] * (count - 1)


def drift(first: Array, late: Array) -> float:
    """Return the drift in ms a minute, by a straight line."""
    return float(np.polyfit(first * TS, late, 1)[0] * 60.0 * 1e3)


@pytest.fixture(scope="module")
def marlin() -> Printer:
    return load("paper-marlin")


# ---------------------------------------------------------------------- the simulation itself

# The rectangle of half a minute, as version 0.1.0 wrote it for a planner of its own belief, at
# 250 and 500 lines a second. Drift in ms a minute of whole firmware, built natively with its
# stepper interrupt on a virtual clock and every step stamped.
REAL = [
    ("laps-250", {"planner": "2.1"}, -46.2),
    ("laps-500", {"planner": "2.1"}, -154.0),
    ("laps-250", {"planner": "2.1-dev"}, 30.7),
    ("laps-250", {"planner": "ft-motion"}, -21.0),
    ("laps-250", {"planner": "2.1", "extra_tick": True}, 168.0),
    ("laps-250", {"planner": "2.0", "extra_tick": True}, 213.0),
    ("laps-250", {"planner": "2.1", "classic_jerk": True}, -62.4),
    ("laps-250", {"planner": "2.1", "s_curve": True}, -51.5),
]


@pytest.fixture(scope="module")
def command_of_laps() -> Array:
    """Return the commands of those streams, stored in µm."""
    with np.load(STREAMS / "laps.npz") as kept:
        return np.asarray(kept["um"] * 1e-3)


@pytest.mark.parametrize(("stream", "how", "real"), few(REAL, 1))
def test_simulation_drifts_as_the_real_firmware(
    marlin: Printer, command_of_laps: Array, stream: str, how: dict[str, object], real: float
) -> None:
    text = gzip.decompress((STREAMS / f"{stream}.gcode.gz").read_bytes())
    text = text.replace(b"T0 J0.3", b"T0 J0.3 X100 Y100 E50")
    machine = Machine(build := built(marlin, **how))
    run = max(machine.read(text), key=lambda r: r.duration)
    first, late, _ = Played(command_of_laps, build, run, machine).track()
    assert drift(first, late) == pytest.approx(real, rel=0.02, abs=0.5)


# ---------------------------------------------------------------------- what is written


@pytest.fixture(scope="module")
def rectangle(marlin: Printer) -> Played:
    return played(laps(), marlin)


BUILDS: list[tuple[dict[str, object], dict[str, object]]] = [
    ({"planner": "2.1"}, {}),
    ({"planner": "2.1-dev"}, {}),
    ({"planner": "ft-motion"}, {}),
    ({"planner": "2.0"}, {}),
    ({"planner": "2.1", "timer_extra_tick": True}, {"extra_tick": True}),
    ({"planner": "2.1-dev", "timer_hz": 25e6}, {"timer_hz": 25e6}),
    ({"planner": "2.1", "lines_per_second": 500.0}, {}),
    ({"planner": "2.1", "s_curve_acceleration": True}, {"s_curve": True}),
    ({"planner": "2.1-dev", **JERK}, {"classic_jerk": True}),
]


@pytest.mark.parametrize(("own", "how"), few(BUILDS, 1))
def test_rectangle_keeps_time_and_place(
    marlin: Printer, own: dict[str, object], how: dict[str, object]
) -> None:
    rectangle = played(laps(), with_marlin(marlin, **own), planner=own["planner"], **how)
    first, late, off = rectangle.track()
    assert rectangle.machine.merged == 0
    below(abs(drift(first, late)), 3.0, "drift, ms a minute")
    below(np.ptp(late), 2e-3, "range of the lateness, s")
    below(rms(off), 0.012, "RMS distance to the command, mm")
    below(off.max(), 0.06, "greatest distance to the command, mm")
    _, starting = rectangle.lateness(0, rectangle.run.sets_out, 0.4)
    below(starting[:100].max(), 0.0605, "distance in the first 0.1 s, mm")


@pytest.mark.slow
def test_steps_that_the_board_splits_are_counted(marlin: Printer) -> None:
    """Else the print is late by 430 ms a minute."""
    mine = with_marlin(marlin, planner="2.1", adaptive_step_smoothing=40_000.0)
    first, late, _ = played(laps(), mine, planner="2.1", smoothing_hz=40_000.0).track()
    below(abs(drift(first, late)), 8.0, "drift, ms a minute")


SWING = [b"M83\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 E2 F1800\n", b"G1 X130 Y93 E2 F1200\n"]


@pytest.mark.parametrize("planner", ["2.1", "2.1-dev", "ft-motion"])
def test_a_start_that_swings_by_a_few_steps_is_waited_for(marlin: Printer, planner: str) -> None:
    """The command swings by 50 µm before it sets out: as one long segment it is off by 204 µm."""
    start = played(SWING, with_marlin(marlin, planner=planner), planner=planner)
    away = np.hypot(*(start.command - start.command[0]).T) > 0.012
    first = int(away.argmax())
    _, off = start.lateness(first, start.run.sets_out - first * TS, 0.4)
    below(off[:100].max(), 0.06, "distance in the first 0.1 s, mm")


def test_while_fixed_time_motion_fills_its_queue_z_moves_by_six_steps_up(marlin: Printer) -> None:
    """With the acceleration of z it dips by 21 steps, and snaps back as x sets out."""
    run = played(laps(1), with_marlin(marlin, planner="ft-motion"), planner="ft-motion").run
    assert isinstance(run, FixedTimeRun)
    z = run.frames[:, Z] - run.frames[0, Z]
    assert z.min() > -0.5
    assert 5.5 < z.max() < 6.5
    below(run.sets_out, 0.55, "time before x and y move, s")


@pytest.mark.parametrize("planner", few(MARLIN_PLANNERS, 2))
def test_lifts_and_retractions_take_the_time_that_they_are_planned_to(
    marlin: Printer, planner: str
) -> None:
    """Each begins and ends at a speed that its neighbours decide, too."""
    lines = [b"M83\n", b"G1 X100 Y100 Z1 F6000\n"]
    for k in range(1, 9):
        lines += [
            b"G1 X%d E3 F2400\n" % (100 + 60 * (k % 2)), b"G1 E-2 F1800\n", b"G1 Z1.4 F600\n",
            b"G1 Y%d F6000\n" % (100 + 3 * k), b"G1 Z1.5 F600\n", b"G1 Z1\n", b"G1 E2 F1800\n",
        ]  # fmt: skip
    _, late, _ = played(lines, with_marlin(marlin, planner=planner), planner=planner).track()
    most = 5e-3 if planner == "2.0" else 2e-3  # 2.0 makes a first step after a turn in 8 ms
    below(np.ptp(late[1:]), most, "range of the lateness after the start, s")


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["2.1", "2.1-dev", "ft-motion"])
def test_cube_keeps_time_and_place_across_lifts_and_retractions(
    marlin: Printer, planner: str
) -> None:
    cube = played(layers("cube.gcode", 2), with_marlin(marlin, planner=planner), planner=planner)
    _, late, off = cube.track()
    below(np.ptp(late), 6e-3, "range of the lateness, s")
    below(rms(off), 0.011, "RMS distance to the command, mm")
    below(np.median(off), 0.012, "median distance to the command, mm")
    assert cube.machine.merged == 0


@pytest.mark.slow
@pytest.mark.parametrize("planner", MARLIN_PLANNERS)
def test_a_slow_board_takes_as_long_for_a_layer_as_sliced_as_is_told(planner: str) -> None:
    """At 500 mm/s², what its planner makes of ramps is up to 1 % of the time."""
    slinger = with_marlin(load("example-ender"), planner=planner)
    build = built(slinger, planner=planner, cartesian=True, junction_deviation=0.08)
    board, told = [], []
    for count in (1, 2):
        lines = layers("cube.gcode", count)
        runs = Machine(replace(build)).read(b"M201 X500 Y500 Z100 E5000\n" + b"".join(lines))
        board.append(sum(run.duration for run in runs))
        told.append(converted(lines, slinger, Options("none"))[1].time.before)
    layer = board[1] - board[0]
    near(told[1] - told[0], layer, 0.008 * layer, "a layer as sliced, s")


HOPS = [
    b"M203 Z10 E50\n", b"M204 R1000\n", b"M83\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 X120 E1 F3600\n",
    b"G1 E-5 F2700\n", b"G1 Z1.4 F600\n", b"G1 X100 Y110 F9000\n", b"G1 X100.01\n", b"G1 Z1\n",
    b"G1 E5 F2700\n", b"G1 X120 E1 F3600\n", b"G1 E-5 F2700\n", b"G1 X100 Y100 F9000\n",
    b"G1 E5 F2700\n",
]  # fmt: skip


@pytest.mark.parametrize("planner", few(["2.1", "2.0", "2.1-dev"], 1))
def test_retractions_and_lifts_cost_no_time_and_the_file_sets_their_limits(planner: str) -> None:
    """The board passes them at a corner speed, at M203 Z and E and with M204 R of the file."""
    slinger = with_marlin(load("example-ender"), planner=planner)
    own = replace(
        built(slinger, planner=planner, cartesian=True, junction_deviation=0.08),
        max_velocity=[500.0, 500.0, 5.0, 25.0], max_acceleration=[500.0, 500.0, 100.0, 5000.0],
        acceleration=500.0, travel_acceleration=500.0, retract_acceleration=500.0,
    )  # fmt: skip
    lines = HOPS[:4] + HOPS[4:] * 10

    def seconds(text: bytes) -> float:
        build = replace(
            own, max_velocity=[*own.max_velocity], max_acceleration=[*own.max_acceleration]
        )
        there = b"G92 X100 Y100 Z1\n"
        return sum(run.duration for run in Machine(build).read(there + text))

    sliced = seconds(b"".join(lines))
    text, report = converted(lines, slinger)
    near(report.sliced_s, sliced, 0.005 * sliced, "as sliced, s")
    near(report.duration, seconds(text), 0.005 * sliced, "as converted, s")
    below(report.duration, 1.015 * sliced, "as converted, s")


def contour(block: Samples, printer: Printer, name: str) -> float:
    """Return the RMS in µm, once it does not matter that the block begins in motion."""
    found = [j.contour[name][j.at >= 300] for j in judge([block], printer.plant, 1)]
    return 1e3 * rms(np.concatenate(found))


@pytest.mark.parametrize(
    "lines",
    [pytest.param(laps(5), id="rectangle"),
     pytest.param(sliced(1), id="cube", marks=pytest.mark.slow)],
)  # fmt: skip
def test_the_predicted_error_includes_whole_steps(marlin: Printer, lines: list[bytes]) -> None:
    options = Options("racking", ("none", "racking"))
    predicted = converted(lines, marlin, options)[1].contour["racking"]
    commands = WholeFile(iter(lines), marlin, options)
    one = played(lines, marlin)
    first, late, _ = one.track()
    whole = join([b for b in commands.samples() if len(b)])
    n, fed = len(whole), np.flatnonzero(np.diff(whole.xyze[:, E]) > 0.0)
    part = slice(int(first[0]), int(fed[-1]))  # after it, windows in which only z moves
    t = np.arange(n) * TS + np.interp(np.arange(n), first + WINDOW / 2, late)
    both = {"exact": whole.commands["racking"][part], "played": one.at(t)[part]}
    block = Samples(0, whole.xyze[part], whole.line[part], (), both)
    exact, theirs = (contour(block, marlin, name) ** 2 for name in both)
    told = 1e6 * (predicted.rms**2 - commands.report.contour["racking"].rms ** 2)
    near(np.sqrt(theirs - exact), np.sqrt(told), 0.1 * np.sqrt(told), "error of steps, µm RMS")


# ---------------------------------------------------------------------- the extruder


def asked_of_the_extruder(lines: list[bytes], printer: Printer) -> tuple[Array, Array]:
    """Return filament along the path (n,), and how far the extruder is to be ahead of it, (n,)."""
    found = [b for b in WholeFile(iter(lines), printer, Options("racking")).samples() if len(b)]
    none = np.zeros((1, 2))
    ahead = [none.repeat(len(b), axis=0) if b.advance is None else b.advance for b in found]
    return np.concatenate([b.xyze[:, E] for b in found]), np.concatenate(ahead)[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["2.1", "2.1-dev", "ft-motion"])
def test_the_extruder_is_ahead_as_computed_and_no_time_is_lost(
    marlin: Printer, planner: str
) -> None:
    """Its place is that of whole steps; the filament is that of the file, to a step.

    At this acceleration it can follow, so the path is planned as without advance.
    """
    lines, limits = laps(3), replace(marlin.limits, acceleration=8000.0)
    plain = replace(with_marlin(marlin, planner=planner), limits=limits)
    advanced = replace(plain, extruder=Extruder(0.05))
    without, one = (played(lines, each, planner=planner) for each in (plain, advanced))
    filament, ahead = asked_of_the_extruder(lines, advanced)
    assert ahead.max() > 0.2
    first, late, _ = one.track()
    part = slice(int(first[0]), int(first[-1]) + WINDOW)
    n = np.arange(len(filament))
    t = n * TS + np.interp(n, first + WINDOW / 2, late)
    step, fed = one.build.e, one.run.cells(t)[:, E] * one.build.e
    off = (fed - (filament + ahead))[part]
    below(rms(off - np.median(off)), step, "RMS distance of the extruder, mm")
    below(abs(fed[-1] - fed[0] - filament[-1] + filament[0]), 1.5 * step, "filament lost, mm")
    assert one.machine.merged == 0
    near(one.run.duration, without.run.duration, 2e-4 * one.run.duration, "duration, s")
