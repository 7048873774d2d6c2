"""Identification from end to end: played sweeps, sensors with faults, and the profiles found."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from hframe_post.arrays import TS, Array
from hframe_post.cli.main import main
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.printer import profile as profiles
from tests.command_line import run
from tests.klipper.host import play
from tests.profiles import with_plant
from tests.recordings import Sensor, moved, write_klipper

QUICK = """
extends = "paper"
[sweep]
rate_hz_per_s = 4.0
"""
SENSOR = Sensor(turned=(93.0, -4.0, 2.0), drift=0.005)  # rotated by a quarter turn, and tilted
AXES = "x=-y,y=x,z=z"
SHIPPED = Path("paper")  # the profile of that name
BAND = (5.0, 80.0)


@dataclass(frozen=True)
class Played:
    """A run: its command file, and the motors' motion (m, 2) in mm, every 1 ms."""

    command: Path
    motors: Array


def swept(folder: Path, profile: Path, axis: str, place: float, klipper: bool) -> Played:
    """Write a sweep of that axis and return it, as played by the Klipper host or as commanded."""
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
        lines[k] = "G4 P0"  # which reads the time as the call does
    dwell = float(lines[calls[0] + 1].removeprefix("G4 P")) * 1e-3
    stepped = folder / f"{axis}-{place:g}.gcode"
    stepped.write_text("\n".join(lines) + "\n")
    playback = play(stepped, workdir=folder / f"klipper-{axis}-{place:g}")
    begin = float(playback.moves["print_time"][2]) - dwell
    t = begin + np.arange(len(intended)) * TS
    steps = playback.steps()
    A, B = (steps[motor].position(t) for motor in "AB")
    return Played(command, np.column_stack([(A + B) / 2.0, (A - B) / 2.0]))


def recorded(played: Played, plant: Plant, sensor: Sensor, folder: Path, seed: int) -> Path:
    """Write Klipper's file of the sensor's recording on a printer of that plant."""
    path = folder / f"{played.command.stem}.nozzle.{seed}.csv"
    seconds = (len(played.motors) - 1) * TS
    return write_klipper(path, sensor.record(moved(plant, played.motors), seconds, seed))


def off(found: ImpulseResponse | None, true: ImpulseResponse | None, motors: Array) -> float:
    """Return the relative RMS error of a response, 5 to 80 Hz, weighted by input power."""
    assert found is not None
    assert true is not None
    omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(len(motors), TS), dtype=np.float64)
    inside = (omega >= 2.0 * np.pi * BAND[0]) & (omega <= 2.0 * np.pi * BAND[1])
    swept = motors[:, int(np.argmax(np.ptp(motors, axis=0)))]
    power = np.abs(np.fft.rfft(swept - swept[0]) * omega**2)[inside] ** 2
    H, true_H = (G.response(omega[inside] * TS) for G in (found, true))
    return math.sqrt((power * np.abs(H - true_H) ** 2).sum() / (power * np.abs(true_H) ** 2).sum())


def compensated(profile: Path, plant: Path, folder: Path) -> float:
    """Return the RMS contour error (µm) of the rectangle with that profile, on that plant."""
    summary = folder / "summary.json"
    done = run("simulate", "-p", profile, "--plant", plant,
               "--on-limit", "clamp", "-q", "--json", summary)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return float(
        json.loads(summary.read_text())["strategies"]["racking"]["contour_error_um"]["rms"]
    )


@dataclass(frozen=True)
class Bench:
    """A printer on which sweeps are played: its plant, and whether Klipper drives its motors."""

    folder: Path
    plant: Plant
    profile: Path
    klipper: bool

    def runs(self, axis: str, places: Sequence[float], sensor: Sensor) -> list[tuple[Played, Path]]:
        """Return sweeps at these places, each with its recording."""
        played = [swept(self.folder, self.profile, axis, p, self.klipper) for p in places]
        return [
            (one, recorded(one, self.plant, sensor, self.folder, seed))
            for seed, one in enumerate(played)
        ]


def nozzle(*runs: tuple[Played, Path]) -> list[str | Path]:
    return [part for one, path in runs for part in ("--nozzle", one.command, path)]


def check_recovered(
    bench: Bench, places: Sequence[float], *more: str | Path, times: float = 1.5
) -> None:
    """Check that the transfer functions are found and the profile compensates the true plant.

    times: contour error of the rectangle relative to that of the exact model, at most.
    """
    mine, true = bench.folder / "mine.toml", bench.folder / "true.toml"
    x_runs, y_runs = bench.runs("x", places, SENSOR), bench.runs("y", places[:2], SENSOR)
    arguments = [*nozzle(*x_runs, *y_runs), "--axes", AXES]
    done = run("identify", "-p", bench.profile, *arguments, "-o", mine, *more)
    assert done.returncode == 0, done.stderr
    found = profiles.load(str(mine))
    x, y = x_runs[0][0].motors, y_runs[0][0].motors
    assert off(found.plant.Gxx, bench.plant.Gxx, x) <= 0.03
    assert off(found.plant.Gyy, bench.plant.Gyy, y) <= 0.03
    assert off(found.plant.Gxtheta, bench.plant.Gxtheta, x) <= 0.04
    assert found.plant.x_c == pytest.approx(bench.plant.x_c, abs=1.0)
    windows = found.compensation.windows
    true.write_text(with_plant(str(bench.profile), bench.plant, windows, []))
    exact = compensated(true, true, bench.folder)
    assert compensated(mine, true, bench.folder) <= times * exact


FAST = """
extends = "paper"
[sweep]
rate_hz_per_s = 8.0
start_hz = 3.0
end_hz = 110.0
"""
MAP = ("--axes", AXES)


@dataclass(frozen=True)
class Recorded:
    """Sweeps of the paper's printer: x at three places, y at one."""

    folder: Path
    x: list[tuple[Played, Path]]
    y: tuple[Played, Path]

    @property
    def all(self) -> list[str | Path]:
        return nozzle(*self.x, self.y)


def invoked(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["identify", *map(str, arguments)])


def check_refused(folder: Path, message: str, *arguments: str | Path, status: int = 1) -> None:
    mine = folder / "refused.toml"
    done = invoked(*arguments, "-o", mine)
    assert done.exit_code == status, done.output
    assert re.search(message, done.output), done.output
    assert not mine.exists()
