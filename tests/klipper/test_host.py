"""The harness itself: what Klipper is known to do comes out of ``play``, from mainline, too."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.klipper.host import KlippyError, Playback, play

pytestmark = pytest.mark.klipper

LIMITS = {
    "max_velocity": 500.0, "max_accel": 1000.0, "square_corner_velocity": 5.0,
    "minimum_cruise_ratio": 0.0,
}  # fmt: skip


def play_text(folder: Path, text: str, **limits: float) -> Playback:
    gcode = folder / "input.gcode"
    gcode.write_text(text)
    return play(gcode, limits=LIMITS | limits, workdir=folder / "work")


def trapezoid_time(distance: float, speed: float, accel: float) -> float:
    """Return the time in s from rest to rest for a distance long enough to reach the speed."""
    return distance / speed + speed / accel


def test_two_collinear_lines_take_the_time_of_one_trapezoid(tmp_path: Path) -> None:
    text, speed, max_accel = "G28\nG1 X60 Y45 F6000\nG1 X120 Y90\n", 80.0, 2500.0
    playback = play_text(tmp_path, text, max_velocity=speed, max_accel=max_accel)
    assert playback.warnings == ()
    assert len(playback.moves) == 2
    assert playback.duration == pytest.approx(trapezoid_time(150.0, speed, max_accel), abs=1e-9)
    ramp = speed / max_accel
    times = playback.start + np.array([-1.0, ramp, 0.5 * playback.duration, playback.duration, 9.0])
    along = np.array([0.0, 0.5 * speed * ramp, 75.0, 150.0, 150.0])
    expected = along[:, None] * [0.8, 0.6, 0.0]
    np.testing.assert_allclose(playback.position(times), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G28\nG1 X281 F6000\n", "Move out of range"),
        ("G1 X10 F6000\n", "Must home"),
        ("G28\nG1 X10 F0\n", "Invalid speed"),
    ],
)
def test_a_failure_shows_the_log(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(KlippyError, match=message):
        play_text(tmp_path, text)


MAINLINE = os.environ.get("MAINLINE_KLIPPER", "")
SET = ("test_host.py", "test_playback.py")
LIVE = ("../live/test_host.py::test_the_hosts_steps_are_the_kernels[hbot]",)


@pytest.mark.slow
@pytest.mark.skipif(not MAINLINE, reason="no source of mainline Klipper here: make programs")
@pytest.mark.parametrize(("names", "marked"), [(SET, "not slow"), (LIVE, "slow")])
def test_mainline_plays_the_set_as_well(names: tuple[str, ...], marked: str) -> None:
    files = [str(Path(__file__).parent / name) for name in names]
    command = [sys.executable, "-m", "pytest", "-q", "-m", marked, "-p", "no:cacheprovider", *files]
    environment = {name: text for name, text in os.environ.items() if "PYTEST" not in name}
    result = subprocess.run(
        command, cwd=Path(__file__).parents[2], env=environment | {"KLIPPER": MAINLINE},
        capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout[-4000:] + result.stderr[-1000:]
