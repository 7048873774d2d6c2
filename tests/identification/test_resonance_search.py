"""The parameters, start and clock of a resonance test, found in its recording."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from hframe_post.errors import IdentificationError
from hframe_post.identification.gather import gather
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.resonance_search import find
from hframe_post.printer.settings import Travel
from tests.recordings import write_klipper
from tests.resonance_recordings import (
    BELTS,
    START,
    Recorded,
    X,
    Y,
    drawn_sensor,
    klipper,
    linear_printer,
    recorded,
)

QUICK = {"hz_per_sec": 2.0, "max_freq": 100.0}


def made(seed: int, kind: str, direction: tuple[float, ...], **changes: Any) -> Recorded:
    test = klipper(direction, **QUICK, **changes)
    return recorded(linear_printer(seed), test, drawn_sensor(seed, kind), seed, seed)


def checked(seed: int, kind: str, it: Recorded, **expected: Any) -> None:
    """Find the test where printer.cfg says something else; compare all with the truth."""
    found = find(it.recording, replace(it.test, **expected))
    assert found.test == it.test
    assert abs(found.clock.start - START) < 6e-3  # the printer's own delay of up to 3 ms included
    assert abs(found.clock.drift - drawn_sensor(seed, kind).drift) < 5e-4


def test_lis2dw_at_its_slowest_with_a_wrong_printer_cfg() -> None:
    seed, kind = 2, "lis2dw-394"
    it = made(seed, kind, BELTS[1])
    wrong = {"min_freq": 10.0, "max_freq": 135.0, "hz_per_sec": 1.0, "sweeping_period": 0.0}
    checked(seed, kind, it, **wrong)


def test_noise_of_fans_and_another_level() -> None:
    seed, kind = 4, "lis2dw"
    it = made(seed, kind, Y, accel_per_hz=90.0)
    r = it.recording
    noisy = r.a + np.random.default_rng(1).normal(0.0, 1300.0, r.a.shape)
    found = find(replace(r, a=noisy), replace(it.test, accel_per_hz=60.0))
    assert found.test.accel_per_hz == pytest.approx(90.0, rel=0.15)
    assert replace(found.test, accel_per_hz=90.0) == it.test


def test_without_sweeping() -> None:
    seed, kind = 8, "lis2dw-394"
    it = made(seed, kind, X, sweeping_period=0.0, around_point=True)
    found = find(it.recording, replace(it.test, sweeping_period=1.2, around_point=False))
    assert found.test == it.test
    assert abs(found.clock.drift - drawn_sensor(seed, kind).drift) < 5e-4


def test_another_period_of_sweeping_is_found() -> None:
    it = made(4, "lis2dw-394", X, sweeping_period=0.8)
    checked(4, "lis2dw-394", it, sweeping_period=1.2)


def test_a_recording_that_begins_with_the_motion_needs_its_first_frequency() -> None:
    """As those of Klipper of 2023; printer.cfg has another first frequency by now."""
    it = made(8, "lis2dw-394", X, sweeping_period=0.0, around_point=True, min_freq=10.0)
    kept = it.recording.t > START + 0.01
    recording = Recording(it.recording.t[kept], it.recording.a[kept], False)
    with pytest.raises(IdentificationError, match=r"or min_freq was not 5 as in .resonance_tester"):
        find(recording, replace(it.test, min_freq=5.0))
    found = find(recording, it.test)
    assert found.test == it.test
    assert abs(found.clock.start - START) < 6e-3


@pytest.fixture(scope="module")
def whole() -> Recorded:
    return made(11, "lis2dw-394", X)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (
            slice(0, 10000),
            "ends in the middle of the resonance test, at 5[56] Hz of 100 Hz: it was cut",
        ),
        (slice(6000, None), "begins in the middle of the resonance test, at 3[56] Hz: it was cut"),
        (slice(0, 800), "ends in the middle of the resonance test, at 9 Hz of 100 Hz: it was cut"),
    ],
)
def test_a_cut_recording_is_refused(whole: Recorded, part: slice, message: str) -> None:
    r = whole.recording
    with pytest.raises(IdentificationError, match=message):
        find(Recording(r.t[part], r.a[part], False), whole.test)


def test_other_recordings_are_refused(whole: Recorded) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(20000) / 400.0
    still = rng.normal(0.0, 50.0, (len(t), 3))
    moves = still + 2000.0 * np.sign(np.sin(2.0 * np.pi * 25.0 * t))[:, None]
    for a, words in (
        (still, r"shows \d % of the acceleration that the test makes, not 20 % or more"),
        (20.0 * still, r"no resonance test: \d+ % of what it shows .* not 40 % or more"),
        (moves, r"shows \d % of the acceleration that the test makes, not 20 % or more"),
    ):
        with pytest.raises(IdentificationError, match=words):
            find(Recording(t, a, False), whole.test)
    moving = np.maximum(t - 2.0, 0.0)
    sine = 4000.0 * np.sin(2.0 * np.pi * (4.0 + 0.5 * 2.0 * moving) * moving)
    with pytest.raises(IdentificationError, match="acceleration does not grow with it"):
        find(Recording(t, still + sine[:, None] * [1.0, 0.0, 0.0], False), whole.test)


def test_a_rate_that_printer_cfg_does_not_say_is_refused() -> None:
    """Else the sensor's clock would be 10 % off, and so would all frequencies."""
    test = klipper(X, hz_per_sec=1.25, max_freq=60.0)
    chip = replace(drawn_sensor(8, "lis2dw-394"), drift=0.0, lead=0.4)
    made = replace(chip.record(linear_printer(8), test.command(), 8), started=False)
    words = r"grows by 1.25 Hz/s, not by hz_per_sec 1, and no sensor's clock is 11 % wrong .* 3 %"
    with pytest.raises(IdentificationError, match=words):
        find(made, replace(test, hz_per_sec=1.0))


def test_input_shaping_is_noticed() -> None:
    """An MZV shaper at the printer's mode leaves no resonance."""
    seed, machine = 8, linear_printer(8)
    test = klipper(X, **QUICK)
    hz, damping = machine.x.modes[0].hz, 0.1
    step = np.exp(-0.75 * np.pi * damping)
    sizes = np.array([1.0 - 0.5**0.5, (2.0**0.5 - 1.0) * step, (1.0 - 0.5**0.5) * step**2])
    command = test.command()
    at = np.arange(len(command) + 100)
    shaped = sum(
        size * np.stack([np.interp(at - 375.0 / hz * k, at[:-100], c) for c in command.T], axis=1)
        for k, size in enumerate(sizes / sizes.sum())
    )
    chip = replace(drawn_sensor(seed, "lis2dw-394"), lead=0.4)
    with pytest.raises(
        IdentificationError, match=r"no resonance .* Either input shaping was on .*, or"
    ):
        find(chip.record(machine, shaped, seed), test)


def test_a_sensor_that_does_not_move_with_the_axis_is_not_taken_for_shaping() -> None:
    """It sits on the head while the bed moves, and feels what the frame passes on."""
    chip = replace(drawn_sensor(8, "adxl345"), lead=0.4)
    test = klipper(X, **QUICK)
    made = chip.record(linear_printer(8), test.command(), 8)
    rest = made.a.mean(axis=0)
    passed_on = replace(made, a=rest + 0.1 * (made.a - rest), started=False)
    with pytest.raises(IdentificationError, match="the sensor did not move with this axis") as one:
        find(passed_on, test)
    assert "input shaping" not in str(one.value)


def on_the_frame(made: Recording, hz: float) -> Recording:
    """Return what a frame on a table makes of the forces: it rocks at ``hz``, and z too."""
    sos = butter(2, hz, "high", fs=1.0 / made.period, output="sos")
    passed = 0.2 * sosfiltfilt(sos, made.a - made.a.mean(axis=0), axis=0)
    return replace(made, a=made.a.mean(axis=0) + passed, started=False)


def test_a_sensor_on_a_frame_is_neither_shaped_nor_cut() -> None:
    """Slow motion does not reach it, so the recording seems to begin late."""
    chip = replace(drawn_sensor(8, "lis2dw-394"), lead=0.02)
    test = klipper(X, **QUICK)
    made = chip.record(linear_printer(8), test.command(), 8)
    with pytest.raises(IdentificationError, match="the sensor did not move with this axis"):
        find(on_the_frame(made, 9.0), test)


def test_values_in_another_unit_are_no_weak_motion(whole: Recorded, tmp_path: Path) -> None:
    r = whole.recording
    write_klipper(tmp_path / "raw_data_x_1.csv", replace(r, a=r.a * 0.1))
    with pytest.raises(IdentificationError, match=r"shows 0\.9\d* m/s² instead of gravity, 9\.81"):
        gather([tmp_path], None, Travel((0.0, 300.0), (0.0, 300.0), (0.0, 300.0)))


def test_a_test_of_weak_pulses_is_taken() -> None:
    """Its sweeping shows that the sensor moves with the axis."""
    it = made(8, "lis2dw-394", X, accel_per_hz=10.0)
    found = find(it.recording, replace(it.test, accel_per_hz=60.0))
    assert found.test.accel_per_hz == pytest.approx(10.0, rel=0.15)
