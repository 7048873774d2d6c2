"""Outer walls on the Klipper host: its motors leave the bands that the profile avoids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.conversion.options import Options
from hframe_post.planner.bands import MotorBands
from tests.gcode_tools import converted
from tests.planner.test_bands import PRINTER, circle, gcode

from .host import play


def motor_speeds(file: Path, folder: Path) -> Array:
    """Return the speeds of A and B (2, n) on the host, every 2 ms while the circle is printed."""
    playback = play(file, workdir=folder)
    assert playback.warnings == ()
    time = np.arange(playback.start, playback.end, 2e-3)
    extrudes = np.diff(playback.extruded(time)) > 0.0
    return PRINTER.kinematics.belts(*np.diff(playback.position(time)[:, :2].T) / 2e-3)[:, extrudes]


@pytest.mark.slow
@pytest.mark.klipper
def test_motors_leave_the_bands_in_as_much_time(tmp_path: Path) -> None:
    lines = gcode(circle(20.0))
    text, report = converted(lines, PRINTER, Options("racking"))
    (sliced := tmp_path / "sliced.gcode").write_bytes(b"".join(lines))
    (changed := tmp_path / "changed.gcode").write_bytes(text)
    before, after = motor_speeds(sliced, tmp_path / "a"), motor_speeds(changed, tmp_path / "b")
    bands = MotorBands.from_profile(PRINTER.speed.avoid, PRINTER.kinematics)
    assert bands is not None
    assert report.bands is not None
    assert bands.contains(before).mean() == pytest.approx(report.bands.before.share, abs=0.03)
    assert bands.contains(before).mean() > 0.4
    assert bands.contains(after).mean() == pytest.approx(report.bands.after.share, abs=0.03)
    assert bands.contains(after).mean() < 0.1
    assert after.shape[1] < 1.04 * before.shape[1]
