"""Models from recordings that tell neither start, clock, axes nor gain: TEST_RESONANCES."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.errors import IdentificationError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.estimation.directions import Direction, direction
from hframe_post.identification.estimation.frequency_response import Spectra
from hframe_post.identification.estimation.measured import axis_responses
from hframe_post.identification.gather import gather
from hframe_post.identification.identify import Identified, MeasurementSettings, Run, identify
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording
from hframe_post.identification.recordings.clock import Clock, acceleration
from hframe_post.identification.recordings.resonance_test import ResonanceTest
from hframe_post.printer.settings import Travel
from tests.conftest import few
from tests.recordings import write_klipper
from tests.resonance_recordings import (
    BELTS,
    SENSORS,
    START,
    Recorded,
    X,
    Y,
    drawn_sensor,
    klipper,
    recorded,
)
from tests.simulator import Axis, Machine, Mode

Directions = Sequence[tuple[float, ...]]
HEAD = Axis((Mode(47.0, 0.06, 0.85), Mode(78.0, 0.05, 0.15)), 4e-4)
BED = Axis((Mode(33.0, 0.08),), 4e-4)
MACHINE = Machine(HEAD, BED, kinematics="corexy")
SETTINGS = MeasurementSettings((3.0, 100.0), racks=False)
LOW = np.linspace(3.0, 11.0, 30)  # Hz, below a third of the resonances


def short(direction: tuple[float, ...], **changes: float) -> ResonanceTest:
    """Return a test of a minute instead of two."""
    return klipper(direction, min_freq=8.0, max_freq=105.0, hz_per_sec=2.0, **changes)


def run(taken: Recorded, seed: int) -> Run:
    """Return the run as found to 3 ms, and to 0.02 % of its clock."""
    sensor = drawn_sensor(seed, "adxl345")
    clock = Clock(START + 3e-3, sensor.drift + 2e-4)
    return Run("test", taken.test.command(), taken.recording, clock)


def taken(test: ResonanceTest, seed: int, mounting: int, machine: Machine = MACHINE) -> Recorded:
    return recorded(machine, test, drawn_sensor(seed, "adxl345"), mounting, seed)


def found(*tests: ResonanceTest, mounting: int = 3) -> Identified:
    runs = [run(taken(test, k, mounting), k) for k, test in enumerate(tests, 1)]
    return identify(runs, SETTINGS)


def check_modes(result: Identified, name: str, axis: Axis) -> None:
    modes = result.fits[name].modes
    assert len(modes) == len(axis.modes)
    for (hz, damping), true in zip(modes, axis.modes, strict=True):
        assert hz == pytest.approx(true.hz, rel=0.01)
        assert damping == pytest.approx(true.damping, rel=0.1)


def seen(made: Recorded, seed: int) -> Direction:
    given = run(made, seed)
    found = given.aligned()
    assert found.clock.drift == pytest.approx(drawn_sensor(seed, "adxl345").drift, abs=1e-5)
    band = (3.0, 100.0)
    (responses,) = Spectra.of(found.command, found.acceleration).responses(band)
    return direction(found, responses)


@pytest.mark.parametrize("seed", few([1, 4], 1))
def test_clock_and_axis_are_found_from_the_motion(seed: int) -> None:
    """Clocks are up to 2 % off; a mirrored sensor sees the axis mirrored."""
    made = taken(short(Y), seed, 0)
    one = seen(made, seed)
    assert np.abs(one.axis).max() > np.cos(np.radians(5.0))
    assert one.resonance_hz == pytest.approx(33.0, abs=2.0)
    mirror = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]]) * [1.0, 1.0, -1.0]
    other = seen(
        replace(made, recording=replace(made.recording, a=made.recording.a @ mirror.T)), seed
    )
    np.testing.assert_allclose(other.axis, mirror @ one.axis, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("ways", [(X, Y), BELTS], ids=["axes", "belts"])
def test_modes_are_the_printers_and_below_them_it_follows_its_command(ways: Directions) -> None:
    """Neither test of belts moves one axis alone."""
    result = found(*map(short, ways))
    check_modes(result, "Gxx", HEAD)
    check_modes(result, "Gyy", BED)
    assert result.refusal is None
    plant, exact = result.plant(0.0), MACHINE.exact()
    for name in ("Gxx", "Gyy"):
        model, true = (getattr(one, name).response(2.0 * np.pi * TS * LOW)
                       for one in (plant, exact))  # fmt: skip
        late = np.exp(-2j * np.pi * LOW * 4e-4)  # which the recordings cannot tell
        assert np.abs(model * late - true).max() < 0.02
        # 0.2 ms between x and y
        delay = -np.angle(model * late / true) / (2.0 * np.pi * LOW)
        assert np.abs(delay).max() < 2e-4


def written_config(folder: Path) -> Path:
    """Write the printer.cfg of a short test."""
    config = folder / "printer.cfg"
    config.write_text(
        "[printer]\nkinematics: corexy\n[resonance_tester]\nprobe_points: 140, 147.5, 20\n"
        "min_freq: 8\nmax_freq: 105\nhz_per_sec: 2\n"
    )
    return config


@pytest.mark.slow
def test_sessions_of_three_sensors_with_gaps_show_one_printer(tmp_path: Path) -> None:
    """At 394, 1600 and 3200 Hz, of one mounting; each lost 35 ms at four times."""
    config = written_config(tmp_path)
    for k, kind in enumerate(SENSORS, 1):
        made = recorded(MACHINE, short(X), drawn_sensor(k, kind), 3, k).recording
        since = made.t - made.t[0]
        kept = np.ones(len(since), dtype=bool)
        for lost in (3.0, 14.1, 25.2, 36.3):
            kept &= (since < lost) | (since > lost + 0.035)
        path = tmp_path / f"raw_data_x_2026010{k}_120000.csv"
        write_klipper(path, replace(made, t=made.t[kept], a=made.a[kept]))
    travel = Travel((0.0, 300.0), (0.0, 300.0), (0.0, 200.0))
    gathered = gather([tmp_path], KlipperConfig(config), travel)
    assert [one.source.session for one in gathered.used] == [1, 2, 3]
    assert all("are missing; the longest gap is 3" in one.as_text() for one in gathered.used)
    group = axis_responses(gathered.runs, SETTINGS)["Gxx"]
    hz = group.runs[0].response.hz
    true = np.abs(MACHINE.exact().Gxx.response(2.0 * np.pi * TS * hz))
    band = (hz > 15.0) & (hz < 75.0)
    for run in group.runs:
        size = np.abs(run.response.H)
        size *= true[hz < 25.0].mean() / size[hz < 25.0].mean()
        assert np.abs(size - true)[band].mean() < 0.03 * true[band].mean()


@pytest.mark.slow
def test_a_mode_that_x_and_y_share_is_found_where_it_is_no_clear_peak() -> None:
    """At 42 Hz y answers with an eighth of its motion only; the rest is at 58 Hz."""
    result = identify([shared_run(direction) for direction in (X, Y)], SETTINGS)
    for name in ("Gxx", "Gyy"):
        modes = result.fits[name].modes
        for hz in SHARED_HZ:
            assert min(abs(one / hz - 1.0) for one, _ in modes) < 0.01


SHARED_HZ = 42.0, 58.0  # of two modes at right angles, 20° from x and y


def shared_run(direction: tuple[float, float]) -> Run:
    test = short(direction)
    command = np.pad(acceleration(test.command() @ direction), 1000)
    s = 2j * np.pi * np.fft.rfftfreq(len(command), TS)
    w = 2.0 * np.pi * np.array(SHARED_HZ)[:, None]
    modes = np.exp(-1.5e-3 * s) * w**2 / (s * s + 0.1 * w * s + w**2)
    c, d = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    shapes = np.array([[c, d], [-d, c]])
    moved = (shapes @ direction)[:, None] * modes
    answer = shapes.T @ moved * np.fft.rfft(command)
    a = np.column_stack([*np.fft.irfft(answer, len(command)), np.full(len(command), GRAVITY)])
    a += 10.0 * np.random.default_rng(1).standard_normal(a.shape)
    t = np.asarray(np.arange(len(a)) * TS, dtype=np.float64)
    recording = Recording(t, np.asarray(a, dtype=np.float64), False)
    return Run("test", test.command(), recording, Clock(1.0))


@pytest.mark.slow
def test_recordings_of_another_day_tell_how_far_the_printer_repeats_itself() -> None:
    other = replace(MACHINE, x=replace(HEAD, modes=(Mode(45.0, 0.06, 0.85), HEAD.modes[1])))
    runs = [run(taken(short(X), 1, 3), 1), run(taken(short(X), 2, 3, other), 2)]
    result = identify(runs, SETTINGS)
    assert 0.1 < result.repetitions["Gxx"] < 0.4
    assert result.model_error == pytest.approx(2.0 / 46.0, rel=0.5)
    same = [run(taken(short(X), seed, 3), seed) for seed in (1, 2)]
    result = identify(same, SETTINGS)
    assert result.repetitions["Gxx"] < 0.05
    assert result.model_error == pytest.approx(0.02)


@pytest.mark.slow
def test_a_printer_too_stiff_to_ring_is_taken_as_such() -> None:
    """Its resonance lies above what the test excites."""
    stiff = Machine(Axis((Mode(240.0, 0.1),)), BED, kinematics="corexy")
    result = identify([run(taken(short(X), 1, 3, stiff), 1)], SETTINGS)
    hz = np.linspace(3.0, 60.0, 30)
    model = result.plant(0.0).Gxx.response(2.0 * np.pi * TS * hz)
    true = stiff.exact().Gxx.response(2.0 * np.pi * TS * hz)
    assert np.abs(np.abs(model / true) - 1.0).max() < 0.05
    assert result.fits["Gxx"].modes == []
    assert not result.plant(0.0).Gyy.deviation.any(), "of an axis that was not recorded"


def test_a_recording_of_something_else_is_refused() -> None:
    made = taken(short(X), 1, 3)
    noise = np.random.default_rng(0).normal(0.0, 2000.0, made.recording.a.shape)
    given = run(replace(made, recording=replace(made.recording, a=noise)), 1)
    with pytest.raises(IdentificationError, match=r"^test: the recording does not follow"):
        identify([given], SETTINGS)


@pytest.mark.slow
def test_what_rings_above_the_test_is_neither_listed_nor_hidden() -> None:
    """A head of 47 and 78 Hz, tested up to 55 Hz."""
    test = klipper(X, min_freq=8.0, max_freq=55.0, hz_per_sec=1.0)
    taken = recorded(MACHINE, test, drawn_sensor(3, "adxl345"), 3, 3)
    found = identify([run(taken, 3)], MeasurementSettings((3.0, 100.0)))
    assert found.measured["Gxx"].excited_hz == pytest.approx((8.0, 55.0), abs=1.5)
    assert all(hz < 60.0 for hz, _ in found.fits["Gxx"].modes)
