"""``hframe-post sweep``: the files that it writes, and how Klipper plays them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import HframeError, LimitError, PrinterError
from hframe_post.identification.recordings.excitation import peaks
from hframe_post.identification.recordings.sweep import SweepRun, gcode, positions, runs, summary
from hframe_post.printer import profile as profiles
from hframe_post.printer.settings import Printer
from hframe_post.writers.stream.print_time import DeferredLine
from tests.command_line import run
from tests.klipper.host import play

SHORT = """
extends = "paper"
[sweep]
start_hz = 4.0
end_hz = 100.0
rate_hz_per_s = 40.0
quiet = 0.3
"""


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


def text(printer: Printer, planned: list[SweepRun], chips: tuple[str, ...] = ("adxl345",)) -> str:
    pieces = gcode(printer, planned, chips, 10.0)
    return b"".join(p.line if isinstance(p, DeferredLine) else p for p in pieces).decode()


def table(path: Path) -> Array:
    assert path.read_text().startswith("t,x,y\n")
    return np.loadtxt(path, delimiter=",", skiprows=1)


# ---------------------------------------------------------------------- where and what


def test_places_lie_around_the_middle_of_x_only_where_the_printer_can_rack(paper: Printer) -> None:
    assert positions(paper, 0) == [(x, 147.5) for x in (80.0, 140.0, 200.0)]
    assert positions(paper, 1) == [(140.0, 147.5)]
    off = profiles.parse('extends = "paper"\n[plant]\nx_c = 230.0\n', "off")
    assert positions(off, 0) == positions(paper, 0)
    assert positions(profiles.load("example-corexy"), 0) == [(150.0, 150.0)]


@pytest.mark.parametrize(
    ("x", "places"), [(120.0, [7.0, 60.0, 113.0]), (36.0, [7.0, 18.0, 29.0]), (30.0, [15.0])]
)
def test_places_lie_inside_a_small_bed(x: float, places: list[float]) -> None:
    small = profiles.parse(f'extends = "paper"\n[travel]\nx = [0.0, {x}]\ny = [0.0, 120.0]\n', "s")
    assert positions(small, 0) == [(place, 60.0) for place in places]
    for one in runs(small, 0, positions(small, 0)):
        assert 0.0 <= one.command[:, 0].min() <= one.command[:, 0].max() <= x


def test_names_are_unique(paper: Printer) -> None:
    names = [r.name for r in runs(paper, 1, [(80.0, 100.0), (80.5, 100.0)])]
    assert names == ["y-at-80", "y-at-80_5"]
    names = [r.name for r in runs(paper, 0, [(80.0, 100.0), (80.0, 120.5)])]
    assert names == ["x-at-80-100", "x-at-80-120_5"]
    with pytest.raises(HframeError, match="twice"):
        runs(paper, 0, [(80.0, 100.0), (80.0, 100.0)])


@pytest.mark.parametrize("axis", [0, 1])
def test_one_axis_moves_within_travel_and_motors(paper: Printer, axis: int) -> None:
    (one,) = runs(paper, axis, [(3.0, 290.0)])
    assert (one.command[:, 1 - axis] == one.position[1 - axis]).all()
    for at, (low, high) in zip(one.command.T, (paper.travel.x, paper.travel.y), strict=True):
        assert low <= at.min() <= at.max() <= high
    for belt in paper.kinematics.belts(*(one.command - one.command[0]).T):
        _, v, a = peaks(belt)
        assert v <= paper.motors.belt_velocity
        assert a <= paper.motors.belt_acceleration


def test_the_summary_compares_the_time_with_test_resonances(paper: Printer) -> None:
    both = [run for axis in (0, 1) for run in runs(paper, axis, positions(paper, axis))]
    text = summary(paper, both)
    assert "2m 49s in all" in text
    assert "takes 4m 20s for x and y " in text
    assert all(f"{run.name}: 40 s, at most ±6.8" in text for run in both)
    assert "takes 2m 10s for x and" in summary(paper, both[:3])


def test_the_summary_warns_of_clipping_and_of_a_moving_bed(paper: Printer) -> None:
    hard = profiles.parse('extends = "paper"\n[sweep]\namplitude = 9000.0\n', "hard")
    assert "16 g" in summary(hard, runs(hard, 0, [(140.0, 150.0)]))
    assert "16 g" not in summary(paper, runs(paper, 0, [(140.0, 150.0)]))
    slinger = profiles.load("example-cartesian")
    both = [run for axis in (0, 1) for run in runs(slinger, axis, [(150.0, 150.0)])]
    assert "sensor on the bed for y" in summary(slinger, both)
    assert "sensor on the bed for y" not in summary(slinger, both[:1])


@pytest.mark.parametrize("table", ["limits", "firmware.klipper"])
def test_a_sweep_stays_within_the_printers_speed_and_acceleration(table: str) -> None:
    limits = f'extends = "paper"\n[{table}]\nvelocity = 60.0\nacceleration = 3000.0\n'
    gentle = profiles.parse(limits, "gentle")
    (one,) = runs(gentle, 0, [(140.0, 150.0)])
    _, v, a = peaks(one.command[:, 0])
    assert 50.0 < v <= 60.001
    assert 2900.0 < a <= 3000.001
    assert "lowered from 5000 to 3000 mm/s²" in summary(gentle, [one])


@pytest.mark.parametrize("place", [(-1.0, 100.0), (100.0, 296.0), (0.0, 100.0)])
def test_a_place_without_room_is_an_error(paper: Printer, place: tuple[float, float]) -> None:
    with pytest.raises(LimitError, match="--position"):
        runs(paper, 0, [place])


def test_a_sweep_leaves_the_motors_what_klipper_needs_to_be_in_time() -> None:
    weak = profiles.parse(
        'extends = "paper"\n[motors]\nbelt_acceleration = 7000.0\nbelt_velocity = 50.0\n', "weak"
    )
    (one,) = runs(weak, 0, [(140.0, 150.0)])
    _, v, a = peaks(one.command[:, 0])
    assert 40.0 < v <= 50.001
    assert a <= 7000.0 / 2**0.5 / 3.5
    assert "ACCEL=4949 " in text(weak, [one])


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        ("end_hz = 1.0", r"sweep: .*end_hz must be above"),
        ("amplitude = 0", r"sweep\.amplitude: must be above 0"),
        ("ampliude = 1", r"sweep\.ampliude: unknown key"),
        ('quiet = "long"', r"sweep\.quiet: must be a number"),
    ],
)
def test_a_bad_table_is_an_error_that_names_the_key(line: str, cause: str) -> None:
    with pytest.raises(PrinterError, match=cause):
        profiles.parse(f'extends = "paper"\n[sweep]\n{line}\n', "bad")


def test_the_table_must_be_one() -> None:
    with pytest.raises(PrinterError, match="sweep"):
        profiles.parse('sweep = 3\nextends = "paper"\n', "bad")


# ---------------------------------------------------------------------- the stream


def test_the_stream_begins_before_each_recording_and_ends_after_it(short: Path) -> None:
    """No M400 between two calls: it would let Klipper's queue run empty."""
    printer = profiles.load(str(short))
    planned = runs(printer, 0, [(80.0, 147.5), (140.0, 147.5)])
    lines = text(printer, planned, ("adxl345", "bed")).splitlines()
    calls = [k for k, line in enumerate(lines) if line.startswith("ACCELEROMETER_MEASURE")]
    assert [lines[k].removeprefix("ACCELEROMETER_MEASURE ") for k in calls] == [
        "CHIP=adxl345", "CHIP=bed", "CHIP=adxl345 NAME=x-at-80", "CHIP=bed NAME=x-at-80",
        "CHIP=adxl345", "CHIP=bed", "CHIP=adxl345 NAME=x-at-140", "CHIP=bed NAME=x-at-140",
    ]  # fmt: skip
    for first, last in ((calls[0], calls[2]), (calls[4], calls[6])):
        assert lines[first - 1].startswith("G4 P2000")
        assert all(line.startswith(("G1 ", "G4 ")) for line in lines[first + 2 : last])
    for k in (calls[3], calls[7]):
        assert lines[k + 1] == "G4 P0"
        assert lines[k + 2].startswith("SET_VELOCITY_LIMIT VELOCITY=300")
    assert lines[-1].startswith("RESTORE_GCODE_STATE")


def test_the_stream_is_allowed_no_more_than_the_sweep_needs(short: Path) -> None:
    """A cancelled file leaves its limits in force."""
    for macro in (
        "",
        '[firmware.klipper]\nbegin_macro = "_HFRAME_BEGIN"\nend_macro = "_HFRAME_END"\n',
    ):
        printer = profiles.parse(short.read_text() + macro, "short")
        (one,) = runs(printer, 0, [(140.0, 147.5)])
        _, v, a = peaks(one.command[:, 0])
        (limit,) = re.findall(
            r"VELOCITY=(\d+) ACCEL=(\d+) ", text(printer, [one]).split("NAME=x")[0]
        )
        assert v < float(limit[0]) < 1.2 * v < printer.limits.velocity
        assert 3.0 * a < float(limit[1]) < printer.motors.belt_acceleration
        assert ("_HFRAME_END" in text(printer, [one])) == bool(macro)


def test_a_file_that_records_is_for_klipper_only() -> None:
    printer = profiles.load("paper-marlin")
    with pytest.raises(PrinterError, match="marlin records no accelerometers"):
        list(gcode(printer, runs(printer, 0, [(140.0, 147.5)]), ("adxl345",), 10.0))


def test_equal_input_gives_equal_bytes(short: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert run("sweep", "-p", short, "-q", "-o", tmp_path / f"{name}.gcode").returncode == 0
    assert (tmp_path / "a.gcode").read_bytes() == (tmp_path / "b.gcode").read_bytes()


def check_played(folder: Path, printer: Printer, axis: int, place: tuple[float, float]) -> None:
    """Check that Klipper's motion from call to call is the command, and lasts as long.

    The harness has no accelerometer: each call is a G4 P0, which reads the time as a call does.
    """
    (planned,) = runs(printer, axis, [place])
    lines = ["G28", *text(printer, [planned]).splitlines()]
    calls = [k for k, line in enumerate(lines) if line.startswith("ACCELEROMETER_MEASURE")]
    dwell = [float(lines[k].removeprefix("G4 P")) * 1e-3 for k in (calls[0] + 1, calls[1] - 1)]
    for k in calls:
        lines[k] = "G4 P0"
    file = folder / "sweep.gcode"
    file.write_text("\n".join(lines) + "\n")
    playback = play(file, workdir=folder)
    assert playback.warnings == ()
    moves = playback.moves
    first = float(moves["print_time"][2])  # after the lift and the way to the place
    begin, end = first - dwell[0], playback.end + dwell[1]
    assert end - begin == pytest.approx(planned.seconds, abs=3e-5)
    t = begin + np.arange(len(planned.command)) * TS
    off = playback.position(t)[:, :2] - planned.command
    assert np.abs(off[:, 1 - axis]).max() < 1e-9
    assert np.sqrt((off[:, axis] ** 2).mean()) < 0.0003
    assert np.abs(off[:, axis]).max() < 0.005
    velocity = np.gradient(planned.command[:, axis], TS)
    for part in np.array_split(np.arange(len(t)), max(len(t) // 10_000, 1)):
        late = -(off[part, axis] @ velocity[part]) / (velocity[part] @ velocity[part])
        assert abs(late) < 3e-5  # s; 0.1 ms would be 3° at 80 Hz


@pytest.mark.klipper
@pytest.mark.parametrize("axis", [0, 1])
def test_klipper_plays_the_command(tmp_path: Path, short: Path, axis: int) -> None:
    check_played(tmp_path, profiles.load(str(short)), axis, (140.0, 150.0))


@pytest.mark.klipper
@pytest.mark.slow
def test_klipper_plays_the_whole_sweep(tmp_path: Path, paper: Printer) -> None:
    check_played(tmp_path, paper, 0, (80.0, 147.5))


# ---------------------------------------------------------------------- the command line


def test_writes_gcode_and_a_command_for_each_run(short: Path, tmp_path: Path) -> None:
    out = tmp_path / "my.sweep.gcode"
    places = ("--position", "80,100", "--position", "140,100")
    done = run("sweep", "-p", short, "-o", out, "--axis", "x", *places)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "my.sweep.gcode", "my.sweep.x-at-140.csv", "my.sweep.x-at-80.csv", "short.toml"
    ]  # fmt: skip
    printer = profiles.load(str(short))
    for planned in runs(printer, 0, [(80.0, 100.0), (140.0, 100.0)]):
        rows = table(tmp_path / f"my.sweep.{planned.name}.csv")
        assert np.allclose(rows[:, 0], np.arange(len(rows)) * TS, atol=1e-9)
        assert np.abs(rows[:, 1:] - planned.command).max() < 1e-6
        assert rows[0, 1:].tolist() == rows[-1, 1:].tolist() == list(planned.position)
        assert planned.name in done.stderr.decode()


def test_both_axes_are_swept_by_one_file(short: Path, tmp_path: Path) -> None:
    out = tmp_path / "my.gcode"
    assert run("sweep", "-p", short, "-q", "-o", out).returncode == 0
    names = re.findall(r"NAME=([xy]-.*)", out.read_text())
    assert names == ["x-at-80", "x-at-140", "x-at-200", "y-at-140"]
    assert all((tmp_path / f"my.{name}.csv").is_file() for name in names)


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--position", "80"], 2, b"is not X,Y"),
        (["--position", "nan,3"], 2, b"more than 10 m away"),
        (["--axis", "z"], 2, b"'z' is not one of"),
        (["--chip", "adxl345 hotend"], 2, b"type hotend"),
        (["--chip", ""], 2, b"is not a chip's name"),
        (["--position", "500,100"], 1, b"x (mm) would be 500"),
        (["--position", "80,100", "--position", "80,100"], 1, b"twice"),
        (["-p", "missing"], 1, b"no such profile"),
    ],
)
def test_mistakes_are_errors_and_nothing_is_written(
    short: Path, tmp_path: Path, arguments: list[str], status: int, message: bytes
) -> None:
    done = run("sweep", "-p", short, "-o", tmp_path / "out.gcode", *arguments)
    assert done.returncode == status
    assert message in done.stderr
    assert b"Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["short.toml"]


def test_no_output_and_no_folder_are_errors(short: Path, tmp_path: Path) -> None:
    assert run("sweep", "-p", short).returncode == 2
    done = run("sweep", "-p", short, "-o", tmp_path / "no" / "out.gcode")
    assert done.returncode == 1
    assert b"does not exist" in done.stderr


def test_a_sweep_is_not_compensated(short: Path, tmp_path: Path) -> None:
    """A compensated sweep would measure the printer without its resonances."""
    out = tmp_path / "out.gcode"
    assert run("sweep", "-p", short, "-q", "-o", out).returncode == 0
    done = run(out)
    assert done.returncode == 1
    assert b"converted already" in done.stderr
