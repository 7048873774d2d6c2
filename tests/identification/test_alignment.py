"""Recordings on the command's clock: drift, start, axes; and recordings that are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import Recording, oriented
from hframe_post.identification.recordings.alignment import acceleration, aligned, heading, turned
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.settings import Printer
from tests.recordings import THIRTEEN_BITS, Sensor, in_y_alone, nozzle, spline, sweep
from tests.resonance_recordings import MOTIONS, klipper

X, Y, Z = 0, 1, 2
PPM = 1e-6


@pytest.fixture(scope="module")
def swept() -> Array:
    return sweep()


@pytest.fixture(scope="module")
def command(swept: Array) -> Array:
    return acceleration(swept)


def seconds(swept: Array) -> float:
    return (len(swept) - 1) * TS


def tone(values: Array, hz: float, t: Array) -> complex:
    """Complex amplitude of a sine in values (n,)."""
    columns = np.column_stack([np.sin(2.0 * np.pi * hz * t), np.cos(2.0 * np.pi * hz * t)])
    (sine, cosine), *_ = np.linalg.lstsq(columns, values, rcond=None)
    return complex(sine, cosine)


# ---------------------------------------------------------------- interpolation


@pytest.mark.parametrize("hz", [1.0, 20.0, 80.0, 100.0, 120.0])
def test_command_is_the_true_acceleration_of_a_sine(hz: float) -> None:
    t = np.arange(4000) * TS
    omega = 2.0 * np.pi * hz
    a = acceleration(110.0 + np.sin(omega * t) / omega**2)
    np.testing.assert_allclose(a[50:-50], -np.sin(omega * t)[50:-50], atol=2e-5)


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_motion_that_stops_between_samples_has_no_jump(kind: str) -> None:
    """A jump, which no printer plays, hides what the answers to the slow part are."""
    test = klipper(**MOTIONS[kind])
    a = np.abs(acceleration(test.command()[:, X]))
    sweeping = test.sweeping_accel if test.sweeping_period else 0.0
    most = test.accel_per_hz * test.max_freq + sweeping
    ends = max(float(a[:10].max()), float(a[-10:].max()))
    assert ends < 1.3 * most, f"{ends:.0f} mm/s² at the ends of a motion of {most:.0f} mm/s²"
    first = test.accel_per_hz * test.min_freq + sweeping
    assert a[:10].max() < 1.3 * first, f"{a[:10].max():.0f} mm/s² at the start, not {first:.0f}"


@pytest.mark.parametrize("rate", [1000.0, 1344.0, 3200.0, 26667.0])
@pytest.mark.parametrize("hz", [5.0, 40.0, 100.0])
def test_resampling_keeps_gain_and_phase(rate: float, hz: float) -> None:
    """The sine is added to the sweep, in z, and recorded at uneven times on a fast clock."""
    whole = sweep(rate=30.0)
    sensor = Sensor(noise=0.0, rate=rate, drift=0.005, step=1e-6)
    recording = sensor.record(spline(whole, 0.0 * whole), seconds(whole))
    true = (recording.t - sensor.clock) / (1.0 + sensor.drift)
    a = recording.a.copy()
    a[:, Z] = np.sin(2.0 * np.pi * hz * true)
    found = aligned(acceleration(whole), oriented(replace(recording, a=a)), X)
    t = np.arange(200, len(whole) - 200) * TS
    late = (found.start - sensor.clock) / (1.0 + sensor.drift)  # the only unknown
    measured = tone(found.acceleration[200:-200, Z], hz, np.asarray(t + late))
    assert abs(abs(measured) - 1.0) <= 2e-4
    assert abs(np.degrees(np.angle(measured))) <= 0.02 + 360.0 * hz * PPM * seconds(whole)


def test_resampling_does_not_alias(swept: Array) -> None:
    """A squeal at 990 Hz would alias to 10 Hz."""
    recording = Sensor(noise=0.0).record(spline(swept, 0.0 * swept), seconds(swept))
    a = recording.a.copy()
    a[:, Y] += 1000.0 * np.sin(2.0 * np.pi * 990.0 * (recording.t - recording.t[0]))
    found = aligned(acceleration(swept), oriented(replace(recording, a=a)), X)
    assert np.abs(found.acceleration[100:-100, Y]).max() < 1.0


# -------------------------------------------------------------- drift and start


@pytest.mark.parametrize(
    ("axis", "sensor"),
    [
        (X, Sensor(drift=0.005, turned=(3.0, -4.0, 2.0))),
        (X, Sensor(drift=-0.005, turned=(-2.0, 11.0, 10.0), step=THIRTEEN_BITS)),
        (X, Sensor(drift=0.01, rate=1600.0, jitter=2e-5)),
        (Y, Sensor(drift=0.005, step=THIRTEEN_BITS)),
        (Y, Sensor(drift=-0.01, turned=(0.0, 15.0, 0.0))),
        (Y, Sensor()),
    ],
)
def test_clock_is_found_from_the_marks(
    paper: Printer, swept: Array, command: Array, axis: int, sensor: Sensor
) -> None:
    recording = sensor.record(nozzle(paper.plant, swept, axis), seconds(swept))
    found = aligned(command, oriented(recording), axis)
    assert abs(found.drift - sensor.drift) <= 2 * PPM
    assert abs(found.start - sensor.clock) <= 0.6 / sensor.rate
    assert abs(found.start - sensor.clock) <= 1.05 * found.uncertainty
    assert found.uncertainty <= 0.0002 * 3200.0 / sensor.rate
    assert found.correlation > 0.95


def test_motion_comes_back(paper: Printer, swept: Array, command: Array) -> None:
    """Without noise the only error is the part of a sample by which the start is unknown."""
    motion = nozzle(paper.plant, swept, X)
    sensor = Sensor(drift=0.005, noise=0.0, step=1e-6, offset=(0.0, 0.0, 0.0))
    found = aligned(command, oriented(sensor.record(motion, seconds(swept))), X)
    t = np.clip(np.arange(len(swept)) * TS + found.start - sensor.clock, 0.0, seconds(swept))
    error = found.acceleration - motion.derivative(2)(t)
    assert np.sqrt((error**2).mean()) < 2e-3 * np.sqrt((found.acceleration**2).mean())


@pytest.mark.parametrize("axis", [X, Y])
def test_motor_steps_do_not_disturb_the_clock(
    paper: Printer, swept: Array, command: Array, axis: int
) -> None:
    """Steps of 0.02 mm shake the nozzle above the sweep's band."""
    steps = np.round(swept / 0.02) * 0.02
    sensor = Sensor(drift=0.005)
    recording = sensor.record(nozzle(paper.plant, steps, axis), seconds(swept))
    found = aligned(command, oriented(recording), axis)
    assert abs(found.drift - sensor.drift) <= 2 * PPM
    assert found.correlation > 0.95


@pytest.mark.parametrize("lead", [0.0, 1.5])
@pytest.mark.parametrize("axis", [X, Y])
def test_short_rests_are_enough(paper: Printer, axis: int, lead: float) -> None:
    """Rests of 0.1 s, into which the responses to the marks ring on."""
    swept = sweep()
    swept = swept[900 : len(swept) - 900]
    sensor = Sensor(drift=0.005, lead=lead)
    recording = sensor.record(nozzle(paper.plant, swept, axis), seconds(swept))
    found = aligned(acceleration(swept), oriented(recording, quiet=0.09), axis)
    assert abs(found.drift - sensor.drift) <= 2 * PPM


def random_plants() -> list[TransferFunction]:
    """Resonances of 20 to 90 Hz, alone or two in a row, and some that vanish at rest."""
    rng = np.random.default_rng(5)
    plants = []
    for kind in range(6):
        poles = []
        for _ in range(1 + kind % 2):
            omega, damping = 2.0 * np.pi * rng.uniform(20.0, 90.0), rng.uniform(0.03, 0.3)
            pole = np.exp(omega * TS * complex(-damping, np.sqrt(1.0 - damping**2)))
            poles += [pole, pole.conjugate()]
        zeros = np.ones(kind // 4, dtype=complex)
        gain = np.prod(1.0 - np.array(poles)).real
        plants.append(TransferFunction(zeros, np.array(poles), float(gain)))
    return plants


@pytest.mark.parametrize("lead", [0.0, 2.3])
@pytest.mark.parametrize("kind", range(6))
def test_clock_is_found_on_any_plant(swept: Array, command: Array, kind: int, lead: float) -> None:
    G = random_plants()[kind]
    sensor = Sensor(drift=-0.004, lead=lead, step=THIRTEEN_BITS)
    recording = sensor.record(in_y_alone(G, swept, 1.0 if kind < 4 else 5.0), seconds(swept), kind)
    found = aligned(command, oriented(recording), Y)
    assert abs(found.drift - sensor.drift) <= 2 * PPM
    assert abs(found.start - sensor.clock) <= 1.05 * found.uncertainty


@pytest.mark.parametrize("arm", [-140.0, 140.0])
def test_clock_is_found_from_racking_alone(
    paper: Printer, swept: Array, command: Array, arm: float
) -> None:
    assert paper.plant.Gxtheta is not None
    sensor = Sensor(drift=0.005, turned=(1.0, 2.0, -3.0))
    recording = sensor.record(in_y_alone(paper.plant.Gxtheta, swept, arm), seconds(swept))
    found = aligned(command, oriented(recording), Y)
    assert abs(found.drift - sensor.drift) <= 2 * PPM
    assert found.correlation > 0.9


@pytest.mark.parametrize("axis", [X, Y])
def test_start_is_found_where_it_is_not_known(
    paper: Printer, swept: Array, command: Array, axis: int
) -> None:
    sensor = Sensor(drift=0.005, lead=5.1)
    recording = sensor.record(nozzle(paper.plant, swept, axis), seconds(swept))
    found = aligned(command, oriented(recording), axis)
    assert abs(found.drift - sensor.drift) <= 2 * PPM
    assert found.uncertainty == pytest.approx(0.01)
    assert abs(found.start - sensor.clock) <= found.uncertainty


# --------------------------------------------------------------------- refusals


def refused(command: Array, recording: Recording, channel: int, words: str) -> None:
    with pytest.raises(IdentificationError, match=words):
        aligned(command, recording, channel)


@pytest.mark.parametrize("lead", [0.0, 2.0])
def test_sweep_that_was_never_played(swept: Array, command: Array, lead: float) -> None:
    silent = Sensor(lead=lead).record(spline(0.0 * swept, 0.0 * swept), seconds(swept))
    refused(command, oriented(silent), X, "that it is of this motion")


def test_recording_of_the_other_axis(paper: Printer, swept: Array, command: Array) -> None:
    for axis, name in ((X, "x"), (Y, "y")):
        recording = oriented(Sensor().record(nozzle(paper.plant, swept, axis), seconds(swept)))
        refused(command, recording, 1 - axis, f"follows the command in {name}")


def test_wrong_axis_map(paper: Printer, swept: Array, command: Array) -> None:
    recording = Sensor().record(nozzle(paper.plant, swept, X), seconds(swept))
    refused(command, oriented(recording, "x=-y,y=x,z=z"), X, "--axes is wrong")


@pytest.mark.parametrize("axis", [X, Y])
def test_wrong_sign(paper: Printer, swept: Array, command: Array, axis: int) -> None:
    recording = Sensor().record(nozzle(paper.plant, swept, axis), seconds(swept))
    found = aligned(command, oriented(recording, "x=-x,y=-y,z=z"), axis)
    with pytest.raises(IdentificationError, match="rotated by 180°"):
        heading(command, found.acceleration, axis)


@pytest.mark.parametrize("other", [sweep(5.0), sweep(low=5.0, high=123.0), sweep(rate=3.0)])
def test_recording_of_another_sweep(paper: Printer, command: Array, other: Array) -> None:
    recording = Sensor().record(nozzle(paper.plant, other, Y), seconds(other))
    refused(command, oriented(recording), Y, "does not follow|shorter|after the recording")


def test_recording_that_lacks_its_end_or_beginning(
    paper: Printer, swept: Array, command: Array
) -> None:
    whole = oriented(Sensor().record(nozzle(paper.plant, swept, Y), seconds(swept)))
    n = len(whole.t)
    for part, cause in (
        (slice(0, n // 2), "shorter than"),
        (slice(0, n - 12_000), "shorter than"),
        (
            slice(0, n - 5000),
            "of a sensor that moves with this axis",
        ),  # as short as a clock 2 % slow makes it
        (slice(5000, n), "motion begins -"),
    ):
        refused(command, replace(whole, t=whole.t[part], a=whole.a[part]), Y, cause)
    late = replace(whole, t=whole.t[6400:], a=whole.a[6400:], started=False)
    refused(command, late, Y, "complete|begins")


def test_recording_that_was_started_by_hand(paper: Printer, swept: Array, command: Array) -> None:
    recording = Sensor(lead=1.0).record(nozzle(paper.plant, swept, Y), seconds(swept))
    refused(command, replace(oriented(recording), started=True), Y, "ACCELEROMETER_MEASURE")


def test_command_without_motion_is_refused(swept: Array) -> None:
    recording = Sensor().record(spline(0.0 * swept, 0.0 * swept), seconds(swept))
    refused(np.zeros(5000), recording, X, "does not move")
    short = np.where(np.arange(5000) % 4000 == 3000, 1000.0, 0.0)
    refused(short, recording, X, "has no marks")
    with pytest.raises(IdentificationError, match="too short to be a motion"):
        acceleration(np.zeros(3))


# ---------------------------------------------------------------------- heading


@pytest.mark.parametrize("yaw", [-8.0, 0.0, 3.0, 20.0])
@pytest.mark.parametrize("axis", [X, Y])
def test_heading(paper: Printer, swept: Array, command: Array, axis: int, yaw: float) -> None:
    sensor = Sensor(turned=(yaw, 0.0, 0.0), drift=0.003)
    motion = nozzle(paper.plant, swept, axis)
    found = aligned(command, oriented(sensor.record(motion, seconds(swept))), axis)
    angle = heading(command, found.acceleration, axis)
    assert abs(np.degrees(angle) - yaw) <= (0.4 if axis == X else 0.2)
    straight = turned(found.acceleration, np.radians(yaw))
    t = np.clip(np.arange(len(swept)) * TS + found.start - sensor.clock, 0.0, seconds(swept))
    true = motion.derivative(2)(t)
    error = np.sqrt(((straight - true)[:, :2] ** 2).mean()) / np.sqrt((true**2).mean())
    assert error < 0.1  # the sensor's noise up to 500 Hz


def test_heading_needs_slow_motion(paper: Printer) -> None:
    swept = sweep(low=30.0)
    command = acceleration(swept)
    recording = oriented(Sensor().record(nozzle(paper.plant, swept, Y), seconds(swept)))
    found = aligned(command, recording, Y)
    with pytest.raises(IdentificationError, match="lower frequency"):
        heading(command, found.acceleration, Y)
