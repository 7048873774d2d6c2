"""Bands of motor speed, from simulated printers whose motors ripple."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import signal

from hframe_post.arrays import Array
from hframe_post.cli.main import main
from hframe_post.errors import IdentificationError
from hframe_post.identification.bands import Band, bands, shaking, to_avoid
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.profile import load

RATE = 3200.0
NOISE = 160.0  # mm/s² RMS at 3200 Hz: 4 mm/s²/√Hz, an ADXL345
COREXY = Kinematics("corexy")


@dataclass(frozen=True)
class Printer:
    """A CoreXY. modes: Hz and damping of x and y; ripple: (mm of belt, mm) of motors A and B."""

    modes: tuple[tuple[float, float], tuple[float, float]]
    ripple: tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]

    def recorded(self, rng: np.random.Generator, motor: int, speed: float) -> Array:
        """Return what an accelerometer records of strokes at a path speed, (n, 4)."""
        path = strokes(speed)
        belt = np.sqrt(2.0) * path
        ripple = sum(
            (a * np.sin(2.0 * np.pi * belt / l) for l, a in self.ripple[motor]), 0.0 * belt
        )
        a = NOISE * rng.standard_normal((len(path), 3)) + [0.0, 0.0, 9806.0]
        for axis, (hz, damping) in enumerate(self.modes):
            w = 2.0 * np.pi * hz
            (b,), c, _ = signal.cont2discrete(
                ([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / RATE
            )
            command = path / np.sqrt(2.0) + ripple / 2.0
            moved = signal.lfilter(b, c, command if axis == 0 or motor == 0 else -command)
            a[:, axis] += RATE**2 * np.gradient(np.gradient(moved))
        steps = 38.2  # mm/s²: 4 mg
        return np.column_stack([np.arange(len(path)) / RATE, steps * np.round(a / steps)])


def strokes(speed: float) -> Array:
    """Return the way (n,) of strokes to and fro, mm."""
    length, acceleration = max(0.6 * speed, 20.0), 3000.0
    ramp = np.linspace(0.0, speed, round(RATE * speed / acceleration))
    still = np.zeros(160)
    there = np.concatenate([ramp, np.full(round(RATE * length / speed), speed), ramp[::-1]])
    return np.cumsum(np.concatenate([still, there, -there, there, -there, still])) / RATE


PRINTER = Printer(
    ((44.0, 0.04), (61.0, 0.06)), (((0.8, 0.003), (2.0, 0.003)), ((0.8, 0.003), (2.0, 0.003)))
)
SMOOTH = Printer(PRINTER.modes, ((), ()))


def measurements(printer: Printer, speeds: Array) -> Iterator[tuple[str, Array]]:
    rng = np.random.default_rng(7)
    for motor, angle in enumerate((45, 135)):
        for speed in speeds.tolist():
            name = f"vib_an{angle}.00sp{speed:.2f}".replace(".", "_")
            yield name, printer.recorded(rng, motor, speed)


def written(folder: Path, printer: Printer, speeds: Array) -> Path:
    """Write recordings as Klipper does."""
    for name, table in measurements(printer, speeds):
        np.savetxt(
            folder / f"adxl345-{name}.csv", table, "%.6f", ",", comments="",
            header="#time,accel_x,accel_y,accel_z",
        )  # fmt: skip
    return folder


@pytest.mark.slow
def test_bands_are_where_a_ripple_meets_a_resonance(tmp_path: Path) -> None:
    motors, aside = shaking([written(tmp_path, PRINTER, np.arange(14.0, 110.0, 2.0))], COREXY)
    assert not aside
    found = bands(motors)
    for motor in (0, 1):
        worst = [band.worst for band in found if band.motor == motor]
        # once per 0.8 and per 2 mm of belt, at 44 and 61 Hz
        assert worst == pytest.approx([35.0, 49.0, 88.0, 122.0], abs=3.0)
    for band in found:
        assert band.least <= band.worst <= band.greatest <= 1.45 * band.least
        assert band.rms > 1.5 * band.usual
    avoid = to_avoid(found)
    assert len(avoid) == 4
    assert all(low < high for low, high in avoid)


@pytest.mark.slow
def test_a_smooth_motor_has_no_bands(tmp_path: Path) -> None:
    motors, _ = shaking([written(tmp_path, SMOOTH, np.arange(14.0, 110.0, 4.0))], COREXY)
    assert [len(motor.speed) for motor in motors] == [24, 24]
    assert bands(motors) == []


@pytest.mark.slow
def test_the_command_takes_shaketune_and_writes_the_profile(tmp_path: Path) -> None:
    profile = tmp_path / "my.toml"
    profile.write_text('extends = "example-corexy"\n[speed]\nspeed_up = 2.0  # mine\n')
    lines = [
        json.dumps({"name": f"{name}_20251101_101500", "samples": table.tolist()})
        for name, table in measurements(PRINTER, np.arange(20.0, 70.0, 2.0))
    ]
    (tmp_path / "vibrationsprofile_20251101.stdata").write_text("\n".join(lines))
    call = ["identify", "-p", str(profile), str(tmp_path), "-o", str(profile), "--json", "-"]
    result = CliRunner().invoke(main, call)
    assert result.exit_code == 0, result.stderr
    avoid = json.loads(result.stdout)["avoid"]
    assert any(low <= 35 <= high for low, high in avoid)
    assert f"avoid     {avoid}" in result.stderr
    assert [list(band) for band in load(str(profile)).speed.avoid] == avoid
    assert "speed_up = 2.0  # mine" in profile.read_text()


def test_what_shows_no_motor_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    table = SMOOTH.recorded(rng, 0, 100.0)
    head = "#time,accel_x,accel_y,accel_z"
    for name in ("vib_an0_00sp50_00", "raw_data_x_1"):
        np.savetxt(tmp_path / f"{name}.csv", table, "%.6f", ",", comments="", header=head)
    few = r"0 speeds of a motor, and 10 are needed\. .*Not used: raw_data_x_1"
    with pytest.raises(IdentificationError, match=few):
        shaking([tmp_path], COREXY)
    for speed in range(52, 72, 2):
        (tmp_path / f"vib_an0_00sp{speed}_00.csv").write_bytes(
            (tmp_path / "vib_an0_00sp50_00.csv").read_bytes()
        )
    _, aside = shaking([tmp_path], Kinematics("cartesian"))
    assert [one.reason for one in aside] == [
        "its name does not say angle and speed, as an45_00sp120_00"
    ]


def test_bands_that_meet_are_joined_unless_that_is_too_wide() -> None:
    def band(least: float, greatest: float, motor: int = 0) -> Band:
        return Band(motor, least, greatest, least, 2e-3, 1e-3)

    assert to_avoid([band(30.2, 33.0), band(32.5, 36.7, 1)]) == ((30, 37),)
    assert to_avoid([band(30.0, 40.0), band(39.0, 55.0, 1)]) == ((30, 40), (41, 55))
    assert to_avoid([]) == ()


def test_what_does_not_follow_the_motor_is_no_band(tmp_path: Path) -> None:
    """Something that shakes by 6 µm at 60 Hz in some recordings."""
    rng = np.random.default_rng(2)
    for speed in np.arange(20.0, 100.0, 4.0).tolist():
        table = SMOOTH.recorded(rng, 0, speed)
        on = 40.0 < speed < 60.0
        table[:, 1] += on * 0.006 * (120.0 * np.pi) ** 2 * np.sin(120.0 * np.pi * table[:, 0])
        name = f"vib_an45.00sp{speed:.2f}".replace(".", "_")
        np.savetxt(tmp_path / f"adxl345-{name}.csv", table, "%.6f", ",", comments="",
                   header="#time,accel_x,accel_y,accel_z")  # fmt: skip
    motors, _ = shaking([tmp_path], COREXY)
    assert bands(motors) == []
