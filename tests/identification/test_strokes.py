"""``hframe-post measure``: a motion like a print's, in every direction and at every frequency."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from hframe_post.arrays import TS, Array
from hframe_post.errors import LimitError, PrinterError
from hframe_post.identification.recordings.formats import read_command
from hframe_post.identification.recordings.runs import PlannedRun
from hframe_post.identification.recordings.strokes import command, runs, within_limits
from hframe_post.printer.profile import load, parse
from hframe_post.printer.settings import Printer
from tests.command_line import run
from tests.conftest import few
from tests.quantities import below

KLIPPERS = ("paper", "example-corexy", "example-cartesian", "example-voron", "example-hbot")
BAND = (5.0, 100.0)  # Hz
DEEPEST = 20.0  # dB below the median in BAND


@cache
def planned(name: str) -> list[PlannedRun]:
    """Return what is measured on a shipped printer."""
    return runs(load(name))


def rates(motion: Array, order: int) -> Array:
    return np.diff(motion, n=order, axis=0) / TS**order


def rests(motion: Array) -> list[int]:
    """Return the samples of each standstill."""
    moves = (np.diff(motion, axis=0) != 0.0).any(axis=1)
    edges = np.flatnonzero(np.diff(moves.astype(int), prepend=1, append=1))
    found: list[int] = (edges[1::2] - edges[::2]).tolist()
    return found


@pytest.mark.parametrize("name", few(KLIPPERS, 2))
def test_no_frequency_is_missing_in_any_axis(name: str) -> None:
    for one in planned(name):
        moved = np.flatnonzero(np.ptp(one.command, axis=0) > 0.0)
        for axis in moved:
            hz, power = welch(rates(one.command, 2)[:, axis], 1.0 / TS, nperseg=1000)
            inside = power[(hz >= BAND[0]) & (hz <= BAND[1])]
            hole = 10.0 * np.log10(np.median(inside) / inside.min())
            below(hole, DEEPEST, f"deepest hole in {'xy'[axis]} of {one.name}, dB")


@pytest.mark.parametrize("name", few(KLIPPERS, 2))
def test_the_motion_is_that_of_prints(name: str) -> None:
    printer = load(name)
    limits = printer.limits
    for one in planned(name):
        below(abs(one.seconds - 62.0), 4.0, "distance of the duration from 62 s, s")
        speeds = np.hypot(*rates(one.command, 1).T)
        below(float(speeds.max()), limits.velocity * 1.0001, "speed, mm/s")
        assert speeds.max() > 0.75 * limits.velocity
        ringing = [n for n in rests(one.command) if n >= 400]
        assert len(ringing) >= 12
        assert ringing[0] >= 1000
        assert ringing[-1] >= 1000
        belts = printer.kinematics.belts(*(one.command - one.command[0]).T)
        for belt in belts:
            assert np.abs(np.diff(belt)).max() / TS <= printer.motors.belt_velocity
            assert np.abs(np.diff(belt, n=2)).max() / TS**2 <= printer.motors.belt_acceleration


@pytest.mark.parametrize("place", [(140.0, 147.5), (20.0, 288.0), (5.0, 5.0)])
def test_it_begins_and_ends_at_its_place_and_stays_on_the_bed(
    paper: Printer, place: tuple[float, float]
) -> None:
    motion = command(paper, place, seconds=20.0)
    assert motion[0].tolist() == motion[-1].tolist() == list(place)
    for at, (low, high) in zip(motion.T, (paper.travel.x, paper.travel.y), strict=True):
        assert low <= at.min() < at.max() <= high
    reach = [min(p - low, high - p, 40.0) for p, (low, high) in zip(
        place, (paper.travel.x, paper.travel.y), strict=True)]  # fmt: skip
    assert (np.abs(motion - place) <= np.array(reach) + 1e-6).all()
    assert (np.ptp(motion, axis=0) > 1.2 * np.array(reach)).all()


def test_a_bed_with_odd_digits_is_not_left(paper: Printer) -> None:
    travel = replace(paper.travel, x=(0.0, 12.00159), y=(-0.00051, 14.0))
    motion = command(replace(paper, travel=travel), (6.0, 7.0), seconds=20.0)
    for at, (low, high) in zip(motion.T, (travel.x, travel.y), strict=True):
        assert low <= at.min() < at.max() <= high


def test_figures_are_drawn_by_a_sequence_that_never_changes() -> None:
    """The first figures of a place are what they were in the first version."""
    motion = command(parse('extends = "example-corexy"\n', "fixed"), (150.0, 150.0), seconds=5.0)
    later = [[147.148, 179.272], [153.683, 183.066], [177.217, 183.749], [151.032, 151.345]]
    off = np.abs(motion[[1500, 2500, 3500, 4500]] - later).max()
    below(float(off), 0.002, "off what it was, mm")


def test_an_h_bot_is_measured_at_three_places_and_a_bed_slinger_axis_by_axis() -> None:
    hbot = [one.name for one in runs(load("example-hbot"), seconds=3.0)]
    assert hbot == ["measure-at-40", "measure-at-100", "measure-at-160"]
    assert [one.name for one in runs(load("example-corexy"), seconds=3.0)] == ["measure-at-150"]
    x, y = runs(load("example-cartesian"), seconds=3.0)
    assert [x.name, y.name] == ["measure-x-at-150", "measure-y-at-150"]
    assert np.ptp(x.command, axis=0)[1] == 0.0
    assert np.ptp(y.command, axis=0)[0] == 0.0


def test_weak_motors_and_klippers_own_limits_lower_it() -> None:
    weak = parse('extends = "paper"\n[motors]\nbelt_acceleration = 7000.0\n', "weak")
    assert within_limits(weak).limits.acceleration == pytest.approx(7000.0 / 2**0.5 / 2.5, rel=1e-3)
    slow = parse('extends = "paper"\n[firmware.klipper]\nvelocity = 60.0\n', "slow")
    (one,) = runs(slow, [(140.0, 147.5)], 4.0)
    below(float(np.hypot(*rates(one.command, 1).T).max()), 60.001, "speed, mm/s")


@pytest.mark.parametrize("place", [(-1.0, 100.0), (140.0, 294.0), (0.0, 100.0)])
def test_a_place_without_room_is_an_error(paper: Printer, place: tuple[float, float]) -> None:
    with pytest.raises(LimitError, match="--position"):
        runs(paper, [place])


def test_other_firmware_is_an_error() -> None:
    with pytest.raises(PrinterError, match="marlin records no accelerometers"):
        runs(load("paper-marlin"))


def test_writes_gcode_and_the_command(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"  # which is made
    out = folder / "m.gcode"
    done = run("measure", "-p", "paper", "-o", out, "--position", "80,100", "--chip", "hotend")
    assert done.returncode == 0, done.stderr
    names = ["measure-at-80"]
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        ["m.gcode", *(f"m.{name}.csv" for name in names)]
    )
    text = out.read_text()
    assert re.findall(r"_HFRAME_RECORDED CHIPS=hotend NAME=(.*)", text) == names
    assert re.findall(r"ACCELEROMETER_MEASURE CHIP=hotend NAME=(.*)", text) == names
    (one,) = runs(load("paper"), [(80.0, 100.0)])
    written = read_command(folder / f"m.{one.name}.csv")
    below(float(np.abs(written - one.command).max()), 1e-6, "off the command, mm")
    said = done.stderr.decode()
    assert "in all, of strokes as in a print of up to 300 mm/s and 10000 mm/s²" in said
    assert "hframe-post identify -p paper" in said
    assert f'*-measure-*.csv" {folder}' in said


def test_one_sensor_of_a_bed_slinger_is_moved_between_two_files(tmp_path: Path) -> None:
    done = run("measure", "-p", "example-cartesian", "-o", tmp_path / "m.gcode")
    assert done.returncode == 0, done.stderr
    assert {p.name for p in tmp_path.glob("*.gcode")} == {"m-x.gcode", "m-y.gcode"}
    assert b"move the sensor to the bed, print m-y.gcode" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--position", "80"], 2, b"is not X,Y"),
        (["--chip", "adxl345 hotend"], 2, b"write hotend"),
        (["--position", "500,100"], 1, b"x (mm) would be 500"),
        (["--position", "80,100", "--position", "80,100"], 1, b"twice"),
    ],
)
def test_mistakes_are_errors_and_nothing_is_written(
    tmp_path: Path, arguments: list[str], status: int, message: bytes
) -> None:
    done = run("measure", "-p", "paper", "-o", tmp_path / "out.gcode", *arguments)
    assert done.returncode == status
    assert message in done.stderr
    assert not list(tmp_path.iterdir())
