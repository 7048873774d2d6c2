"""Printers identified from TEST_RESONANCES: as good as from an exact model.

Sensors of three kinds, clocks 2 % and gains 10 % off, left-handed mountings, unknown starts.
"""

from dataclasses import replace

import pytest

from hframe_post.identification.identify import MeasurementSettings, identify
from tests.random_printers import judged, printer
from tests.resonance_recordings import MOTIONS, SENSORS, drawn_sensor, linear_printer, runs_of_tests

PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)  # mm of x, of an H-bot that racks


# each sensor and each motion, and an H-bot
@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 8, 18])
def test_modes_and_rectangle(seed: int) -> None:
    machine = linear_printer(seed)
    chip = drawn_sensor(seed, tuple(SENSORS)[seed % 3])
    racks = machine.kinematics == "hbot"
    motion = tuple(MOTIONS)[seed // 3 % 3]
    runs = runs_of_tests(machine, chip, motion, seed, PLACES if racks else (140.0,), (140.0,))
    found = identify(runs, MeasurementSettings((3.0, 100.0), racks=racks))
    assert found.refusal is None
    for name, axis in (("Gxx", machine.x), ("Gyy", machine.y)):
        modes = [hz for hz, _ in found.fits[name].modes]
        for mode in axis.modes:
            assert min(abs(hz / mode.hz - 1.0) for hz in modes) < 0.01, (name, mode, modes)
    profile = printer(machine)
    own = judged(machine, replace(profile, plant=found.plant(machine.x_c))).compensated
    best = judged(machine, replace(profile, plant=machine.exact())).compensated
    assert own <= max(1.3 * best, 1.0)
