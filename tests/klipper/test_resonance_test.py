"""The motion of TEST_RESONANCES, compared with what the real Klipper host plays."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.recordings.resonance_test import ResonanceTest
from tests.klipper.host import TEMPLATE, Playback, play
from tests.quantities import below

pytestmark = pytest.mark.klipper
SECTION = """
[resonance_tester]
accel_chip: none
probe_points: 140, 147, 10
"""
SLIP = 1e-6  # s a reversal: the host does not stop entirely where the speed changes its sign


def expected(folder: Path, direction: tuple[float, float], options: str) -> ResonanceTest:
    """Return the test of the host's printer.cfg with options of its section."""
    path = folder / "expected.cfg"
    path.write_text(TEMPLATE.read_text() + SECTION + options)
    test = ResonanceTest.from_config(KlipperConfig(path), direction)
    kalico: dict[str, Any] = {"accel_per_hz": 75.0, "sweeping_period": 0.0}
    return replace(test, **{key: usual for key, usual in kalico.items() if key not in options})


def played(folder: Path, lines: str, options: str = "") -> Playback:
    path = folder / "test.gcode"
    path.write_text(f"G28\nG1 Z10 F600\nG1 X140 Y147 F3000\n{lines}\n")
    return play(path, workdir=folder, sections=SECTION + options)


def largest_difference(playback: Playback, test: ResonanceTest, seconds: float) -> float:
    """Return the greatest distance, mm, from the host's motion in the first seconds of the test."""
    moves = playback.moves
    at_point = np.abs(moves["start"] - (140.0, 147.0, 10.0)).max(axis=1) < 1e-6
    lasts = moves["accel_t"] + moves["cruise_t"] + moves["decel_t"] > 0.0
    command = test.command()[: round(seconds / TS)]
    t = moves["print_time"][at_point & lasts][0] + np.arange(len(command)) * TS
    return float(np.abs(playback.position(t)[:, :2] - command).max())


@pytest.mark.parametrize(
    ("axis", "direction", "options"),
    [
        ("1,-0.5", (1.0, -0.5), "max_freq: 20\nhz_per_sec: 2\nsweeping_period: 1.2\n"),
        pytest.param("x", (1.0, 0.0), "max_freq: 140\nmin_freq: 10\n", marks=pytest.mark.slow),
        pytest.param(
            "y", (0.0, 1.0), "sweeping_accel: 200\nsweeping_period: 1.2\naccel_per_hz: 90\n",
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_each_step(tmp_path: Path, axis: str, direction: tuple[float, float], options: str) -> None:
    test = expected(tmp_path, direction, options)
    host = played(tmp_path, f"TEST_RESONANCES AXIS={axis} OUTPUT=raw_data", options)
    # Kalico brakes from the wrong speed at the end, as Klipper did until July 2026
    found = largest_difference(host, test, test.seconds - 0.1)
    reversals = 2.0 * test.seconds / test.sweeping_period if test.sweeping_period else 0.0
    speed = 0.3 * test.sweeping_accel * test.sweeping_period + 0.25 * test.accel_per_hz
    below(found, 1e-8 + SLIP * reversals * speed, "greatest difference of the motion, mm")


def test_motion_before_december_2024(tmp_path: Path) -> None:
    """Earlier versions moved out and back, now on one side of the point, then on the other."""
    test = ResonanceTest((1.0, 0.0), (140.0, 147.0), 5.0, 20.0, 2.0, 75.0, 400.0, 0.0,
                         around_point=True)  # fmt: skip
    lines = ["G4 P500", "SET_VELOCITY_LIMIT ACCEL=10000 MINIMUM_CRUISE_RATIO=0"]
    for k, hz in enumerate(test.half_cycles()):
        quarter, accel = 0.25 / hz, 75.0 * hz
        out = 140.0 + (-1.0) ** k * 0.5 * accel * quarter**2
        feed = 60.0 * accel * quarter
        lines += [f"M204 S{accel:.9f}", *(f"G1 X{x:.12f} F{feed:.9f}" for x in (out, 140.0))]
    host = played(tmp_path, "\n".join(lines))
    found = largest_difference(host, test, test.seconds)
    below(found, 1e-3, "greatest difference of a motion of 0.5 mm, mm")
