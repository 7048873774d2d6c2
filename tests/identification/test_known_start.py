"""Recordings of strokes: found in a folder, on the clock of their command, along the printer."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import irfft, rfft, rfftfreq

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.measured import Run
from hframe_post.identification.gather import Gathered, gather
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.clock import Clock, Resampler
from hframe_post.identification.recordings.formats import command_csv
from hframe_post.identification.recordings.runs import PlannedRun
from hframe_post.identification.recordings.strokes import runs
from hframe_post.printer.profile import load
from tests.quantities import below
from tests.recordings import write_klipper
from tests.simulator import RATE, Axis, Chip, Machine, Mode

PRINTER = replace(load("paper"), kinematics=load("example-corexy").kinematics)
MACHINE = Machine(
    Axis((Mode(32.0, 0.05, 0.8), Mode(70.0, 0.05, 0.2)), delay=0.0013),
    Axis((Mode(41.0, 0.08),), delay=0.0021),
    kinematics="corexy",
)
BEGUN = 1234.5  # s of print time at the first row of a command, as the simulator has it
FAST = Chip(noise=4.0, rate=3200.0)
SLOW = Chip(noise=1.3, rate=394.0, filtered=True)
BAND = (2.0, 100.0)
WITHOUT_MACRO = 25.0  # % that the first sample's uncertainty costs


@dataclass(frozen=True)
class Folder:
    """A folder with commands and recordings."""

    path: Path

    def add(
        self, run: PlannedRun, recording: Recording, ended: bool = True, chip: str = "adxl345"
    ) -> str:
        """Write a run's two files; return the recording's name."""
        with (self.path / f"m.{run.name}.csv").open("wb") as file:
            file.writelines(command_csv(run.command))
        time = f"-t{round(1e6 * (BEGUN + run.seconds))}" if ended else ""
        name = f"{chip}-{run.name}{time}.csv"
        write_klipper(self.path / name, recording)
        return name

    def gathered(self) -> Gathered:
        return gather([self.path], None, PRINTER.travel)


@cache
def planned(seconds: float = 9.0, place: tuple[float, float] = (140.0, 147.5)) -> PlannedRun:
    (run,) = runs(PRINTER, [place], seconds)
    return run


def mounted(recording: Recording, axes: Array) -> Recording:
    return replace(recording, a=recording.a @ axes.T)


def mounting(seed: int) -> Array:
    """Return a way in which a sensor may sit; half of them are left-handed, as owners' maps are."""
    rng = np.random.default_rng(seed)
    return np.asarray(np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3))


def with_gaps(recording: Recording, seconds: Sequence[float], lost: float) -> Recording:
    """Return a recording without ``lost`` s of samples after each of some times."""
    t = recording.t - recording.t[0]
    kept = ~np.any([(t >= at) & (t < at + lost) for at in seconds], axis=0)
    return replace(recording, t=recording.t[kept], a=recording.a[kept])


def renamed(path: Path) -> None:
    """Give a recording's columns other names than Klipper does."""
    path.write_text(path.read_text().replace("#time,accel_x,accel_y,accel_z", "time,ax,ay,az", 1))


def true_acceleration(run: PlannedRun, machine: Machine = MACHINE) -> Array:
    motion = machine.played(run.command, 1)
    t = np.arange(len(motion)) / RATE  # as Chip takes it
    a = np.column_stack([motion[:, 2:4], np.zeros(len(t))])
    return Resampler(t, a).resampled(Clock(0.0), len(run.command))[:, :2]


def along_axes(run: Run) -> Array:
    """Return the acceleration along x and y, (m, 2), that the recording shows."""
    return np.asarray(run.aligned().acceleration @ run.own_axes())


def error(found: Array, true: Array) -> Array:
    """Return the RMS error of x and y (2,) in BAND, as a percentage of the true RMS."""
    hz = rfftfreq(len(true), TS)
    outside = (hz < BAND[0]) | (hz > BAND[1])

    def rms(a: Array) -> Array:
        spectrum = rfft(a, axis=0)
        spectrum[outside] = 0.0
        return np.asarray(irfft(spectrum, len(a), axis=0)[50:-50].std(axis=0))

    return np.asarray(100.0 * rms(found[:, :2] - true) / rms(true))


@pytest.mark.parametrize(
    ("chip", "bound", "seed"), [(FAST, 1.5, 0), (SLOW, 1.0, 1)], ids=["3200", "394"]
)
def test_true_acceleration_is_found(tmp_path: Path, chip: Chip, bound: float, seed: int) -> None:
    run, folder = planned(), Folder(tmp_path)
    tilted = replace(chip, turned=(25.0 * seed - 30.0, 3.0, -4.0), jitter=1e-5)
    name = folder.add(run, mounted(tilted.record(MACHINE, run.command, seed), mounting(seed)))
    (found,) = folder.gathered().runs
    assert found.name == name
    assert found.axes == (0, 1)
    assert found.clock is not None
    below(abs(found.clock.start - BEGUN), 2e-6, "error of the start, s")
    off = error(along_axes(found), true_acceleration(run))
    below(float(off.max()), bound, "error of the acceleration, %")


def test_without_the_macro_the_first_sample_counts(tmp_path: Path) -> None:
    run, folder, chip = planned(), Folder(tmp_path), SLOW
    folder.add(run, chip.record(MACHINE, run.command, 5), ended=False)
    (found,) = folder.gathered().runs
    assert found.clock is not None
    below(abs(found.clock.start - BEGUN), 0.5 / chip.rate + 1e-5, "error of the start, s")
    assert found.clock.is_exact
    off = error(along_axes(found), true_acceleration(run))
    below(float(off.max()), WITHOUT_MACRO, "error of the acceleration, %")


def test_gaps_are_bridged(tmp_path: Path) -> None:
    run, folder = planned(), Folder(tmp_path)
    recording = with_gaps(SLOW.record(MACHINE, run.command, 2), (2.5, 4.2, 6.7), 0.008)
    folder.add(run, recording)
    gathered = folder.gathered()
    assert "are missing" in gathered.used[0].as_text()
    (found,) = gathered.runs
    off = error(along_axes(found), true_acceleration(run))
    below(float(off.max()), 4.0, "error of the acceleration, %")


def test_a_pair_that_the_owner_names_is_the_same_run(tmp_path: Path) -> None:
    run, folder = planned(), Folder(tmp_path)
    name = folder.add(run, FAST.record(MACHINE, run.command, 1))
    (one,) = folder.gathered().runs
    command = tmp_path / f"m.{run.name}.csv"
    (other,) = gather([], None, PRINTER.travel, pairs=[(command, tmp_path / name)]).runs
    assert other.clock == one.clock
    assert np.array_equal(along_axes(other), along_axes(one))


# ---------------------------------------------------------------------- what does not fit


def test_a_recording_of_another_place_is_left_aside(tmp_path: Path) -> None:
    here, there, folder = planned(), planned(place=(200.0, 147.5)), Folder(tmp_path)
    folder.add(here, FAST.record(MACHINE, here.command, 1))
    folder.add(there, FAST.record(MACHINE, here.command, 2), ended=False)
    gathered = folder.gathered()
    assert [run.name for run in gathered.runs] == [gathered.used[0].label]
    assert "measure-at-140" in gathered.used[0].label
    (aside,) = gathered.aside
    assert "does not follow the command" in aside.reason or "shorter" in aside.reason


def test_a_motion_that_stopped_in_between_is_refused(tmp_path: Path) -> None:
    """Where the queue of the firmware runs empty, the rest of the motion is late."""
    run, folder = planned(20.0), Folder(tmp_path)
    recording = FAST.record(MACHINE, run.command, 1)
    late = recording.t > BEGUN + 9.0
    t = recording.t + np.where(late, 0.25, 0.0)
    between = np.arange(recording.t[~late][-1], t[late][0], 1.0 / 3200.0)[1:]
    filled = np.concatenate([t[~late], between, t[late]])
    still = np.repeat(recording.a[:1], len(between), axis=0)
    a = np.concatenate([recording.a[~late], still, recording.a[late]])
    folder.add(run, Recording(filled, a, True))
    with pytest.raises(IdentificationError, match=r"stopped for 0\.25 s"):
        folder.gathered()


def test_a_time_that_something_else_moved_does_not_count(tmp_path: Path) -> None:
    run, folder = planned(), Folder(tmp_path)
    name = folder.add(run, FAST.record(MACHINE, run.command, 1))
    wrong = name.replace("-t", "-t9")
    (tmp_path / name).rename(tmp_path / wrong)
    gathered = folder.gathered()
    (found,) = gathered.runs
    assert found.clock is not None
    below(abs(found.clock.start - BEGUN), 0.5 / FAST.rate + 1e-5, "error of the start, s")
    assert "the sample counts" in gathered.used[0].as_text()


def test_a_start_that_is_a_little_off_is_known_less_well(tmp_path: Path) -> None:
    """As where a busy host lets the motion brake, so that the end of it is late."""
    run, folder = planned(), Folder(tmp_path)
    recording = FAST.record(MACHINE, run.command, 1)
    late = replace(recording, t=recording.t + 0.006)
    folder.add(run, late)
    gathered = folder.gathered()
    (found,) = gathered.runs
    assert found.clock is not None
    assert found.clock.start == pytest.approx(BEGUN, abs=1e-5)
    assert re.search(
        r"differ by (5\.[5-9]\d*|6(\.[0-4]\d*)?) ms: x, y and racking may be late .* by as much",
        gathered.used[0].as_text(),
    )


@pytest.mark.parametrize("cause", ["begins", "ends"])
def test_a_recording_that_lacks_an_end_is_left_aside(tmp_path: Path, cause: str) -> None:
    """The motion rests for a second at both ends, which need not be recorded."""
    run, folder = planned(), Folder(tmp_path)
    recording = FAST.record(MACHINE, run.command, 1)
    t = recording.t - recording.t[0]
    kept = t > 1.3 if cause == "begins" else t < t[-1] - 1.3
    name = folder.add(run, replace(recording, t=recording.t[kept], a=recording.a[kept]))
    if cause == "begins":  # by another program
        renamed(tmp_path / name)
    with pytest.raises(IdentificationError, match=rf"the recording {cause} 0\.3"):
        folder.gathered()


def test_a_recording_that_does_not_tell_its_start_is_left_aside(tmp_path: Path) -> None:
    run, folder = planned(), Folder(tmp_path)
    name = folder.add(run, FAST.record(MACHINE, run.command, 1), ended=False)
    renamed(tmp_path / name)
    with pytest.raises(IdentificationError, match="nothing tells when its motion began"):
        folder.gathered()
