"""A recording on the clock of its command, rotated into line with the swept axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import fft, fftfreq, ifft, next_fast_len, rfft, rfftfreq
from scipy.interpolate import make_interp_spline
from scipy.signal import csd, welch

from hframe_post.arrays import TS, Array, Complex, Integers
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import AXES, Recording
from hframe_post.identification.recordings.clock_sync import (
    AT_REST,
    LEAST_CORRELATION,
    MOST_DRIFT,
    RATE,
    UNKNOWN_START,
    Resampler,
    clock_from_marks,
    energy_band,
    find_marks,
    moving_samples,
    not_found,
)

ONSET = 0.01  # s, uncertainty of the onset: −8 to 9 ms for the paper's plants and 40 others
RESTING = 16  # samples before and after a motion; a spline feels none farther away
SEGMENT = 1024  # samples over which a response's spectrum is computed
HEADING_HZ = (2.0, 8.0)
LEAST_LOW = 1e-4  # share of the command's energy that must be slow to show an axis


@dataclass(frozen=True, slots=True)
class Aligned:
    """A recording on the command's clock.

    acceleration (m, 3): mm/s² every 1 ms; start: s on the sensor's clock when the command
    began; drift: by how much that clock runs fast; uncertainty: half-width of the delay's
    uncertainty, s; correlation: share of the channel's amplitude that the command explains.
    """

    acceleration: Array
    start: float
    drift: float
    uncertainty: float
    correlation: float


def acceleration(position: Array) -> Array:
    """Return the second derivative (m,), mm/s², of positions (m,) in mm every 1 ms.

    It is that of a spline, with a gain within 1e-5 up to 100 Hz; the second difference would be
    2 % low at 80 Hz. Before and after, the position rests where it begins and ends: at the ends of
    its samples alone a spline is free to turn as steeply as it likes. Raises IdentificationError
    for fewer samples than a spline needs.
    """
    degree = 7
    if len(position) <= degree:
        raise IdentificationError(f"a command of {len(position)} ms is too short to be a motion")
    resting = np.pad(position - position[0], RESTING, mode="edge")
    k = np.arange(len(resting), dtype=np.float64)
    spline = make_interp_spline(k, resting, degree)
    return np.asarray(spline.derivative(2)(k[RESTING:-RESTING]) / TS**2)


def aligned(command: Array, recording: Recording, channel: int) -> Aligned:
    """Return the recording on the command's clock, by its response in ``channel`` (0 to 2).

    command (m,): mm/s² every 1 ms. Drift comes from the command's two marks. The start is that of
    the recording if it is ``started``; otherwise it is where the response sets in, within 10 ms.

    Raises IdentificationError if the command has no marks, or if the recording does not cover it,
    does not follow it, or follows it in another channel.
    """
    moving = moving_samples(command)
    if not moving.size:
        raise IdentificationError("the command does not move")
    sensor = Resampler(recording.t, recording.a)
    _check_length(sensor, moving, recording.started)
    marks = find_marks(command, moving)
    if marks is None:
        raise IdentificationError(
            "the command has no marks before and after its motion, as those of 'sweep', 'check' "
            "and 'verify' have"
        )
    track = sensor.resampled(0.0, 0.0, int(sensor.seconds * RATE) + 1)
    start, drift = clock_from_marks(command, marks, track)
    if recording.started:
        if abs(start) > UNKNOWN_START:
            raise IdentificationError(
                f"the command's motion begins {start:.3g} s after the recording: the recording was "
                "not started by the sweep's own ACCELEROMETER_MEASURE, or is of another sweep"
            )
        start, unknown = -recording.period / 2.0, recording.period / 2.0
    else:
        a = sensor.resampled(start, drift, len(command))[:, channel]
        start, unknown = start + _onset(command, a), ONSET
    first, last = start + (1.0 + drift) * TS * moving[[0, -1]]
    sensor.check_covers(first, last)
    a = sensor.resampled(start, drift, len(command))
    correlation = _followed(command, a, channel)
    return Aligned(a, float(recording.t[0] + start), drift, unknown, correlation)


def heading(command: Array, acceleration: Array, axis: int) -> float:
    """Return the angle by which the nozzle's sensor is rotated about the vertical, rad.

    command (m,), acceleration (m, 3): mm/s², of a run of ``axis`` (0: x, 1: y). The slower the
    nozzle moves, the closer it follows that axis alone: in a run of x the motion across it, due
    to racking, grows with j·f, which is fitted together with the angle from 2 to 8 Hz. At a
    lever arm of 50 mm the paper's printer leaves 0.1°. Raises IdentificationError beyond 45°,
    and if the command has no energy at these frequencies.
    """
    hz = rfftfreq(len(command), TS)
    sent = rfft(command)
    low = (hz >= HEADING_HZ[0]) & (hz <= HEADING_HZ[1])
    if (np.abs(sent[low]) ** 2).sum() < LEAST_LOW * (np.abs(sent) ** 2).sum():
        raise IdentificationError(
            f"the sensor's rotation about the vertical shows only below {HEADING_HZ[1]:g} Hz. "
            "Sweep from a lower frequency (sweep.start_hz in the profile)"
        )
    edges = np.searchsorted(hz, np.arange(HEADING_HZ[0], HEADING_HZ[1], 0.5))
    last = int(np.flatnonzero(low)[-1]) + 1

    def banded(values: Complex) -> Complex:
        return np.asarray(np.add.reduceat((sent.conj() * values)[:last], edges))

    along, across = (
        banded(rfft(acceleration[:, k])) / np.sqrt(banded(sent).real) for k in (axis, 1 - axis)
    )
    f = hz[edges] / HEADING_HZ[1]
    columns = np.column_stack([along, 1j * f * along] if axis == 0 else [along])
    stacked = np.concatenate([columns.real, columns.imag])
    tangent = np.linalg.lstsq(stacked, np.concatenate([across.real, across.imag]), rcond=None)[0][0]
    forwards = np.sign(along.sum().real)
    angle = float(np.arctan2((-1.0 if axis == 0 else 1.0) * tangent * forwards, forwards))
    if abs(angle) > np.radians(45.0):
        raise IdentificationError(
            f"in a run of {AXES[axis]} the sensor seems rotated by {np.degrees(abs(angle)):.0f}° "
            "about the vertical: an axis or a sign of its axis map is wrong"
        )
    return angle


def turned(acceleration: Array, angle: float) -> Array:
    """Return accelerations (m, 3) in axes rotated by −``angle`` (rad) about z, same shape."""
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(acceleration @ rotation.T)


def _check_length(sensor: Resampler, moving: Integers, started: bool) -> None:
    needed = float(moving[-1] - (0 if started else moving[0])) * TS
    if sensor.seconds < needed * (1.0 - MOST_DRIFT):
        raise IdentificationError(
            f"the recording lasts {sensor.seconds:.4g} s, shorter than the command, whose "
            f"motion takes {needed:.4g} s"
        )


def _onset(command: Array, a: Array) -> float:
    """Return when the response a (m,) sets in, s: where its impulse response first rises."""
    low, high = energy_band(command, (0.01, 0.99))
    n = next_fast_len(len(command) + int(2.0 * UNKNOWN_START * RATE))
    hz = fftfreq(n, TS)
    sent = fft(command, n)
    power = np.abs(sent) ** 2
    inside = (hz >= low) & (hz <= high)
    window = np.sqrt(np.sin(np.pi * np.clip((hz - low) / (high - low), 0.0, 1.0)))
    response = window * sent.conj() * fft(a, n) / (power + power[inside].mean() * AT_REST)
    envelope = np.abs(ifft(response))
    reach = int(UNKNOWN_START * RATE)
    near = np.concatenate([envelope[-reach:], envelope[: reach + 1]])
    return float(np.argmax(near >= 0.3 * near.max()) - reach) * TS


def _followed(command: Array, a: Array, channel: int) -> float:
    """Return the correlation in ``channel``, √(Σ|S_ua|²/S_uu / ΣS_aa) over the command's band.

    The axis shows in the slow part of the motion; in the fast part the nozzle may rack more than
    it moves. Raises IdentificationError if another channel follows the command, or none.
    """
    low, high = energy_band(command, (0.005, 0.995))
    options = {"fs": RATE, "nperseg": min(SEGMENT, len(command)), "detrend": False}
    hz, sent = welch(command, **options)
    received = welch(a, axis=0, **options)[1]
    cross = np.abs(csd(command[:, None], a, axis=0, **options)[1]) ** 2
    slow = hz <= 12.0
    if sent[slow].sum() > LEAST_LOW * sent.sum():
        shares = cross[slow].sum(axis=0)
        other = int(np.argmax(shares))
        if shares[other] > 4.0 * shares[channel]:
            raise IdentificationError(
                f"the recording follows the command in {AXES[other]}, not in {AXES[channel]}: "
                "--axes is wrong, or the recording is of another sweep or sensor"
            )
    band = (hz >= low - RATE / SEGMENT) & (hz <= high + RATE / SEGMENT)
    explained = (cross[band, channel] / np.maximum(sent[band], 1e-300)).sum()
    correlation = float(np.sqrt(explained / max(received[band, channel].sum(), 1e-300)))
    if correlation < LEAST_CORRELATION:
        raise not_found()
    return correlation
