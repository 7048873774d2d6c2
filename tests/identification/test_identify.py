"""Identification from end to end: sweeps that Klipper plays, sensors with faults, profiles."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from hframe_post.arrays import TS, Array
from hframe_post.cli.main import main
from hframe_post.identification.accelerometer import Recording
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer import profile as profiles
from hframe_post.printer.edit import with_plant
from hframe_post.printer.settings import Printer
from tests.cli.test_main import run
from tests.klipper.host import play
from tests.recordings import Sensor, moved, write_klipper

QUICK = """
extends = "paper"
[sweep]
rate_hz_per_s = 4.0
"""
SENSOR = Sensor(turned=(93.0, -4.0, 2.0), drift=0.005)  # a quarter turn round, not quite level
AXES = "x=-y,y=x,z=z"
SHIPPED = Path("paper")  # the profile of that name
BAND = (5.0, 80.0)


@dataclass(frozen=True)
class Played:
    """A run: its command file and what the motors did, (m, 2) mm, every 1 ms."""

    command: Path
    motors: Array


def swept(folder: Path, profile: Path, axis: str, place: float, klipper: bool) -> Played:
    """A sweep of that axis, written by the tool and stepped as Klipper would, or just taken."""
    out = folder / f"{axis}.gcode"
    done = run(
        "sweep", "-p", profile, "-q", "--axis", axis, "--position", f"{place},150", "-o", out
    )
    assert done.returncode == 0, done.stderr
    (command,) = folder.glob(f"{axis}.{axis}-at-{place:g}*.csv")
    intended = np.loadtxt(command, delimiter=",", skiprows=1)[:, 1:]
    if not klipper:
        return Played(command, intended)
    lines = ["G28", *out.read_text().splitlines()]
    calls = [k for k, line in enumerate(lines) if line.startswith("ACCELEROMETER_MEASURE")]
    for k in calls:
        lines[k] = "G4 P0"  # which asks for the time as the call does
    dwell = float(lines[calls[0] + 1].removeprefix("G4 P")) * 1e-3
    stepped = folder / f"{axis}-{place:g}.gcode"
    stepped.write_text("\n".join(lines) + "\n")
    playback = play(stepped, workdir=folder / f"klipper-{axis}-{place:g}")
    begin = float(playback.moves["print_time"][2]) - dwell
    t = begin + np.arange(len(intended)) * TS
    steps = playback.steps()
    A, B = (steps[motor].position(t) for motor in "AB")
    return Played(command, np.column_stack([(A + B) / 2.0, (A - B) / 2.0]))


def heard(
    played: Played, plant: Plant, sensor: Sensor, folder: Path, seed: int, at: float | None = None
) -> Path:
    """Klipper's file of what the sensor felt on a printer of that plant."""
    place = "nozzle" if at is None else f"at-{at:g}"
    path = folder / f"{played.command.stem}.{place}.{seed}.csv"
    seconds = (len(played.motors) - 1) * TS
    return write_klipper(path, sensor.felt(moved(plant, played.motors, at), seconds, seed))


def off(found: TransferFunction | None, true: TransferFunction | None, motors: Array) -> float:
    """RMS error of a frequency response from 5 to 80 Hz, weighted by input power, relative."""
    assert found is not None
    assert true is not None
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(len(motors), TS), dtype=np.float64)
    inside = (omega >= 2.0 * np.pi * BAND[0]) & (omega <= 2.0 * np.pi * BAND[1])
    swept = motors[:, int(np.argmax(np.ptp(motors, axis=0)))]
    power = np.abs(np.fft.rfft(swept - swept[0]) * omega**2)[inside] ** 2
    is_, should = (G.response(omega[inside] * TS) for G in (found, true))
    return math.sqrt(
        (power * np.abs(is_ - should) ** 2).sum() / (power * np.abs(should) ** 2).sum()
    )


def compensated(profile: Path, plant: Path, folder: Path) -> float:
    """RMS contour error (µm) of the rectangle under that profile, on that plant."""
    told = folder / "told.json"
    done = run("simulate", "--path", "rectangle", "-p", profile, "--plant", plant,
               "--on-limit", "clamp", "-q", "--json", told)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return float(json.loads(told.read_text())["strategies"]["racking"]["contour_error_um"]["rms"])


@dataclass(frozen=True)
class Bench:
    """A printer on which sweeps are played: its plant, and how its motors are told to move."""

    folder: Path
    plant: Plant
    profile: Path
    klipper: bool

    def runs(self, axis: str, places: Sequence[float], sensor: Sensor) -> list[tuple[Played, Path]]:
        """Sweeps at these places, and what the sensor recorded of each."""
        played = [swept(self.folder, self.profile, axis, p, self.klipper) for p in places]
        return [
            (one, heard(one, self.plant, sensor, self.folder, seed))
            for seed, one in enumerate(played)
        ]


def nozzle(*runs: tuple[Played, Path]) -> list[str | Path]:
    return [part for one, path in runs for part in ("--nozzle", one.command, path)]


def check_recovered(bench: Bench, places: Sequence[float], *more: str | Path) -> None:
    """The three transfer functions are found, and the profile compensates the true plant."""
    mine, true = bench.folder / "mine.toml", bench.folder / "true.toml"
    x_runs, y_runs = bench.runs("x", places, SENSOR), bench.runs("y", places[:2], SENSOR)
    arguments = [*nozzle(*x_runs, *y_runs), "--axes", AXES]
    done = run("identify", "-p", bench.profile, *arguments, "-o", mine, *more)
    assert done.returncode == 0, done.stderr
    found = profiles.load(str(mine))
    x, y = x_runs[0][0].motors, y_runs[0][0].motors
    assert off(found.plant.Gxx, bench.plant.Gxx, x) <= 0.03
    assert off(found.plant.Gyy, bench.plant.Gyy, y) <= 0.03
    assert off(found.plant.Gxtheta, bench.plant.Gxtheta, x) <= 0.03
    assert found.plant.x_c == pytest.approx(bench.plant.x_c, abs=1.0)
    windows = found.compensation.windows
    true.write_text(with_plant(str(bench.profile), bench.plant, windows, []))
    assert compensated(mine, true, bench.folder) <= 1.5 * compensated(true, true, bench.folder)


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK)
    return path


@pytest.mark.klipper
def test_the_papers_printer_is_recovered(tmp_path: Path, quick: Path, paper: Printer) -> None:
    check_recovered(Bench(tmp_path, paper.plant, quick, klipper=True), (80.0, 140.0, 200.0))


@pytest.mark.klipper
@pytest.mark.slow
def test_the_papers_printer_is_recovered_by_the_default_sweep(
    tmp_path: Path, paper: Printer
) -> None:
    places = (80.0, 110.0, 140.0, 170.0, 200.0)
    check_recovered(Bench(tmp_path, paper.plant, SHIPPED, klipper=True), places)


# ---------------------------------------------------------------------- other printers


def resonance(hz: float, damping: float) -> tuple[complex, complex]:
    s = 2.0 * np.pi * hz * complex(-damping, math.sqrt(1.0 - damping**2))
    pole = complex(np.exp(s * TS))
    return pole, pole.conjugate()


def drawn(seed: int) -> Plant:
    """Resonances of 20 to 90 Hz, damped by 0.03 to 0.3, behind a motor's lag."""
    rng = np.random.default_rng(seed)

    def mode() -> tuple[complex, complex]:
        return resonance(rng.uniform(20.0, 90.0), rng.uniform(0.03, 0.3))

    def at_rest(zeros: Sequence[complex], poles: Sequence[complex]) -> TransferFunction:
        G = TransferFunction(np.array(zeros), np.array(poles), 1.0)
        return replace(G, gain=1.0 / G.dc_gain)

    lag = math.exp(-2.0 * np.pi * rng.uniform(40.0, 120.0) * TS)
    Gxx, Gyy = (at_rest([lag * 0.5], [*mode(), lag]) for _ in "xy")
    poles = np.array([*mode(), lag])
    Gxtheta = TransferFunction(np.array([1.0, 0.3]), poles, 1.0)
    slope = float(np.prod(1.0 - poles).real) / 0.7
    Gxtheta = replace(Gxtheta, gain=slope * rng.uniform(1e-3, 3e-3))
    return Plant(Gxx, Gyy, Gxtheta, float(rng.uniform(120.0, 160.0)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_printers_are_recovered(tmp_path: Path, quick: Path, seed: int) -> None:
    check_recovered(Bench(tmp_path, drawn(seed), quick, klipper=False), (90.0, 140.0, 190.0))


# ---------------------------------------------------------------------- faults

FAST = """
extends = "paper"
[sweep]
rate_hz_per_s = 8.0
start_hz = 3.0
end_hz = 110.0
"""
LEFT, RIGHT = 10.0, 270.0  # mm, where the bridge has its sensors
ON_BRIDGE = Sensor(drift=0.005, clock=99.0)
MAP = ("--axes", AXES)


@dataclass(frozen=True)
class Recorded:
    """Sweeps of the paper's printer: x at three places, y at one, and the bridge at one."""

    folder: Path
    x: list[tuple[Played, Path]]
    y: tuple[Played, Path]
    ends: tuple[Path, Path]  # P1 at the greater x, P2

    @property
    def all(self) -> list[str | Path]:
        return nozzle(*self.x, self.y)

    @property
    def bridge(self) -> list[str | Path]:
        return ["--bridge", self.x[1][0].command, *self.ends, "--bridge-length", "260"]


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory, paper: Printer) -> Recorded:
    folder = tmp_path_factory.mktemp("sweeps")
    profile = folder / "fast.toml"
    profile.write_text(FAST)
    bench = Bench(folder, paper.plant, profile, klipper=False)
    x = bench.runs("x", (80.0, 140.0, 200.0), SENSOR)
    (y,) = bench.runs("y", (140.0,), SENSOR)
    P1, P2 = (heard(x[1][0], paper.plant, ON_BRIDGE, folder, 7, at) for at in (RIGHT, LEFT))
    return Recorded(folder, x, y, (P1, P2))


def invoked(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["identify", *map(str, arguments)])


def check_refused(folder: Path, told: str, *arguments: str | Path, status: int = 1) -> None:
    mine = folder / "refused.toml"
    done = invoked(*arguments, "-o", mine)
    assert done.exit_code == status, done.output
    assert re.search(told, done.output), done.output
    assert not mine.exists()


def changed(source: Path, folder: Path, change: Callable[[Array], Array]) -> Path:
    """The recording after ``change`` of its rows (n, 4)."""
    rows = change(np.loadtxt(source, delimiter=","))
    return write_klipper(folder / "changed.csv", Recording(rows[:, 0], rows[:, 1:], False))


def test_exchanged_files_are_told(taken: Recorded, tmp_path: Path) -> None:
    (x0, heard0), (_, heard1), (x2, heard2) = taken.x
    y, heard_y = taken.y
    check_refused(tmp_path, "not in", *MAP, *nozzle((x0, heard_y), (y, heard0)))
    places = nozzle((x0, heard1), (taken.x[1][0], heard0), (x2, heard2), taken.y)
    check_refused(tmp_path, "files of two places\\s+exchanged", *MAP, *places)
    P1, P2 = taken.ends
    ends: list[str | Path] = ["--bridge", x0.command, P2, P1, "--bridge-length", "260"]
    check_refused(tmp_path, "P1\\s+must be the one", *MAP, *taken.all, *ends)


def test_racking_that_two_ways_tell_differently_is_doubted(taken: Recorded) -> None:
    done = invoked(*MAP, *taken.all, *taken.bridge[:-1], "180")
    assert done.exit_code == 0, done.output
    assert "check --bridge-length" in done.output


def test_wrong_axes_are_told(taken: Recorded, tmp_path: Path) -> None:
    check_refused(tmp_path, "not in", "--axes", "x=x,y=y,z=z", *taken.all)
    check_refused(tmp_path, "left-handed", "--axes", "x=y,y=x,z=z", *taken.all)
    check_refused(tmp_path, "tilted", "--axes", "x=x,y=z,z=-y", *taken.all)
    check_refused(tmp_path, "no axis map", "--axes", "up", *taken.all)


def test_what_was_not_played_or_is_cut_or_clipped_is_told(taken: Recorded, tmp_path: Path) -> None:
    x, path = taken.x[0]
    rng = np.random.default_rng(5)

    def silent(rows: Array) -> Array:
        still = np.array([0.0, 0.0, 9806.65])
        return np.column_stack([rows[:, 0], still + rng.normal(0.0, 100.0, (len(rows), 3))])

    for told, change in (
        ("does not follow", silent),
        ("shorter|ends .* before", lambda rows: rows[: len(rows) // 2]),
        ("clipped", lambda rows: np.clip(rows, [-np.inf, -3000, -3000, -np.inf], np.inf)),
        ("missing", lambda rows: np.delete(rows, slice(9000, 9100), axis=0)),
    ):
        bad = changed(path, tmp_path, change)
        axes = "x=x,y=y,z=z" if change is silent else AXES
        check_refused(tmp_path, told, "--axes", axes, *nozzle((x, bad), taken.y))


def test_another_sweeps_recording_is_told(taken: Recorded, tmp_path: Path, paper: Printer) -> None:
    """The same frequencies, but falling."""
    x, _ = taken.x[0]
    backwards = heard(Played(x.command, x.motors[::-1]), paper.plant, SENSOR, tmp_path, 3)
    check_refused(tmp_path, "does not follow", *MAP, *nozzle((x, backwards), taken.y))


def test_noise_is_doubted(taken: Recorded, tmp_path: Path, paper: Printer) -> None:
    noisy = replace(SENSOR, noise=12.0)
    runs = [
        (played, heard(played, paper.plant, noisy, tmp_path, 20 + k))
        for k, (played, _) in enumerate((taken.x[1], taken.y))
    ]
    done = invoked(*MAP, *nozzle(*runs))
    assert done.exit_code == 0, done.output
    assert re.search(r"WARNING .*coherence is below 0\.8", done.output)


def test_orders_that_do_not_fit_are_told(taken: Recorded, tmp_path: Path) -> None:
    """What is measured is shown all the same, to be looked at."""
    told, drawn = tmp_path / "told.json", tmp_path / "f"
    one_place = nozzle(taken.x[1], taken.y)
    low = (*MAP, *one_place, "--order", "Gxx=1", "--json", told, "--figures", drawn)
    check_refused(tmp_path, "order 1 .*too low", *low)
    assert json.loads(told.read_text())["functions"]["Gxx"]["residual"] > 0.2
    assert (drawn / "Gxx.png").exists()
    done = invoked(*MAP, *one_place, "--order", "Gxx=10", "--json", "-")
    assert done.exit_code == 0, done.output
    assert re.search("order 10 is too high|outside the measured", done.output)


def test_a_plant_that_no_window_compensates_is_told(taken: Recorded, tmp_path: Path) -> None:
    weak = tmp_path / "weak.toml"
    weak.write_text('extends = "paper"\n[motors]\nbelt_acceleration = 600.0\n')
    told = tmp_path / "told.json"
    one_place = nozzle(taken.x[1], taken.y)
    check_refused(tmp_path, "no window", "-p", weak, *MAP, *one_place, "--json", told)
    assert "windows" not in json.loads(told.read_text())


def test_usage_and_files_are_told(taken: Recorded, tmp_path: Path) -> None:
    (x0, heard0), *_ = taken.x
    check_refused(tmp_path, "no run .* sweeps y", *MAP, *nozzle(*taken.x))
    check_refused(tmp_path, "not the command of a sweep", *MAP, "--nozzle", heard0, heard0)
    check_refused(tmp_path, "no accelerometer file", *MAP, "--nozzle", x0.command, x0.command)
    check_refused(tmp_path, "--bridge-length", *MAP, *taken.all, *taken.bridge[:4], status=2)
    check_refused(tmp_path, "does not exist", *MAP, "--nozzle", "no.csv", heard0, status=2)
    check_refused(tmp_path, "--nozzle", *MAP, status=2)
    check_refused(tmp_path, "Gxx=4", *taken.all, "--order", "Gxx", status=2)
    check_refused(tmp_path, "four names", *taken.all, "--columns", "t,x", status=2)
    check_refused(tmp_path, "--band", *taken.all, "--band", "50", "5", status=2)


# ---------------------------------------------------------------------- other set-ups


def check_racking(done: Result, mine: Path, taken: Recorded, paper: Printer, within: float) -> None:
    assert done.exit_code == 0, done.output
    found = profiles.load(str(mine)).plant
    assert off(found.Gxtheta, paper.plant.Gxtheta, taken.x[0][0].motors) <= within


def test_two_sensors_on_the_bridge_tell_racking(
    taken: Recorded, tmp_path: Path, paper: Printer
) -> None:
    mine = tmp_path / "mine.toml"
    one_place = nozzle(taken.x[1], taken.y)
    done = invoked(*MAP, *one_place, *taken.bridge, "--x-c", "140", "-o", mine)
    check_racking(done, mine, taken, paper, 0.05)
    assert profiles.load(str(mine)).plant.x_c == 140.0
    assert "x_c was not measured" in done.output


def test_one_sensor_moved_along_the_bridge_tells_racking(
    taken: Recorded, tmp_path: Path, paper: Printer
) -> None:
    played = taken.x[1][0]
    earlier, later = (
        replace(ON_BRIDGE, clock=clock, drift=drift)
        for clock, drift in ((7.0, -0.003), (500.0, 0.005))
    )
    P1 = heard(played, paper.plant, earlier, tmp_path, 8, RIGHT)
    P2 = heard(played, paper.plant, later, tmp_path, 9, LEFT)
    ends: list[str | Path] = ["--bridge", played.command, P1, P2, "--bridge-length", "260"]
    mine = tmp_path / "mine.toml"
    check_racking(invoked(*MAP, *taken.all, *ends, "-o", mine), mine, taken, paper, 0.05)


def test_without_places_or_bridge_the_profile_cancels_ringing_only(
    taken: Recorded, tmp_path: Path
) -> None:
    mine = tmp_path / "mine.toml"
    done = invoked(*MAP, *nozzle(taken.x[1], taken.y), "-o", mine, "--figures", tmp_path / "f")
    assert done.exit_code == 0, done.output
    assert "racking was not measured" in done.output
    assert profiles.load(str(mine)).plant.Gxtheta is None
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == [
        "Gxx.png", "Gxx.svg", "Gyy.png", "Gyy.svg",
    ]  # fmt: skip


def test_other_files_in_other_units_are_read(taken: Recorded, tmp_path: Path) -> None:
    """Recordings whose start is not known: the answer is usable, and the doubt is told."""
    arguments: list[str | Path] = []
    for k, (played, path) in enumerate((*taken.x, taken.y)):
        rows = np.loadtxt(path, delimiter=",")
        late = np.concatenate([np.repeat(rows[:1], 800, axis=0), rows])
        late[:800, 0] = rows[0, 0] - np.arange(800, 0, -1) * 3.125e-4
        columns = (late / [1.0, 9806.65, 9806.65, 9806.65]).T
        names = dict(zip(("time", "ax", "ay", "az"), columns, strict=True))
        np.savez(tmp_path / f"{k}.npz", **names)
        arguments += ["--nozzle", played.command, tmp_path / f"{k}.npz"]
    mine = tmp_path / "mine.toml"
    more = ("--columns", "time,ax,ay,az", "--unit", "g", "-o", mine)
    done = invoked(*MAP, *arguments, *more)
    assert done.exit_code == 0, done.output
    assert profiles.load(str(mine)).plant.Gxtheta is not None
    assert "start" in done.output
