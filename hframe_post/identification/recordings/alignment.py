"""A recording on the clock of the command it is the answer to, and in line with its axis."""

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
    MOST_DRIFT,
    POOR,
    QUIETEST,
    band_of,
    by_marks,
    by_windows,
    marks_of,
    unlike,
)
from hframe_post.identification.recordings.resampling import RATE, Resampler

COMMAND_DEGREE = 7  # of the spline: gain of its second derivative within 1e-5 to 100 Hz
RISE = 0.3  # of an impulse response's envelope that counts as its onset,
ONSET = 0.01  # which is so near to 0 s: from −8 to 9 ms, of the paper's plants and 40 others
AWAY = 0.25  # s between start and answer that is no plant's doing
SEGMENT = 1024  # samples over which an answer's spectrum is taken
OTHER_AXIS = 2.0  # times the channel's motion that another may show,
SLOW_HZ = 12.0  # up to this frequency
HEADING_HZ = (2.0, 8.0)
BAND_HZ = 0.5  # in which noise is averaged
LEAST_LOW = 1e-4  # of the command's energy that must be slow to say something
MOST_HEADING = np.radians(45.0)


@dataclass(frozen=True, slots=True)
class Aligned:
    """A recording on the command's clock.

    acceleration (m, 3): mm/s² every 1 ms; start: s on the sensor's clock when the command
    began; drift: by how much that clock runs fast; uncertainty: s, half-width of what is not
    known of the delay; correlation: share of the channel's amplitude that the command explains.
    """

    acceleration: Array
    start: float
    drift: float
    uncertainty: float
    correlation: float


def acceleration(position: Array) -> Array:
    """Second derivative (m,), mm/s², of positions (m,) in mm every 1 ms, as band-limited.

    Not the second difference, whose gain is 2 % low at 80 Hz. Raises IdentificationError for
    fewer samples than a spline needs.
    """
    if len(position) <= COMMAND_DEGREE:
        raise IdentificationError(f"a command of {len(position)} ms is no motion")
    k = np.arange(len(position), dtype=np.float64)
    spline = make_interp_spline(k, position - position[0], COMMAND_DEGREE)
    return np.asarray(spline.derivative(2)(k) / TS**2)


def aligned(command: Array, recording: Recording, channel: int) -> Aligned:
    """The recording on the command's clock, by the answer in ``channel`` (0, 1, 2: x, y, z).

    command (m,): mm/s² every 1 ms. Drift comes from the command's two marks. A command without
    them is correlated in windows, which cannot tell drift from a plant whose lag changes along
    the sweep: clocks are then taken as one unless they differ by more than any plant explains
    (20 ms over the run), and if they do, as much stays unknown. The start is that of the
    recording if it is ``started``, else where the answer sets in, as far as the sweep's band
    shows it: 10 ms to either side stay unknown.

    Raises IdentificationError where the recording does not cover the command or does not
    follow it, or follows it in another channel.
    """
    moving = np.flatnonzero(np.abs(command) > QUIETEST * np.abs(command).max(initial=0.0))
    if not moving.size:
        raise IdentificationError("the command does not move")
    sensor = Resampler(recording.t, recording.a)
    _check_length(sensor, moving, recording.started)
    track = sensor.resampled(0.0, 0.0, int(sensor.seconds * RATE) + 1)
    marks = marks_of(command, moving)
    if marks is None:
        start, drift, unknown = by_windows(command, moving, sensor, recording.started)
    else:
        start, drift, unknown = *by_marks(command, marks, track), 0.0
    if recording.started:
        if abs(start) > AWAY:
            raise IdentificationError(
                f"the command's motion begins {start:.3g} s after the recording: it was not "
                "started by the sweep's own ACCELEROMETER_MEASURE, or belongs to another sweep"
            )
        start, unknown = -recording.period / 2.0, unknown + recording.period / 2.0
    else:
        a = sensor.resampled(start, drift, len(command))[:, channel]
        start, unknown = start + _onset(command, a), unknown + ONSET
    _check_covered(sensor, moving, start, drift)
    a = sensor.resampled(start, drift, len(command))
    correlation = _followed(command, a, channel)
    return Aligned(a, float(recording.t[0] + start), drift, unknown, correlation)


def heading(command: Array, acceleration: Array, axis: int) -> float:
    """By how much to turn (``turned``) the sensor on the nozzle about the vertical, rad.

    command (m,), acceleration (m, 3): mm/s², of a run of ``axis`` (0: x, 1: y). The slower the
    nozzle moves, the more it moves along that axis only: in a run of x racking across grows
    with j·f, which is fitted beside the angle from 2 to 8 Hz. At a lever arm of 50 mm the
    paper's printer leaves 0.1°. Raises IdentificationError beyond 45°, and where the command
    has nothing at these frequencies.
    """
    hz = rfftfreq(len(command), TS)
    sent = rfft(command)
    low = (hz >= HEADING_HZ[0]) & (hz <= HEADING_HZ[1])
    if (np.abs(sent[low]) ** 2).sum() < LEAST_LOW * (np.abs(sent) ** 2).sum():
        raise IdentificationError(
            f"how the sensor is turned about the vertical shows below {HEADING_HZ[1]:g} Hz: "
            "sweep from a lower frequency"
        )
    edges = np.searchsorted(hz, np.arange(HEADING_HZ[0], HEADING_HZ[1], BAND_HZ))
    last = int(np.flatnonzero(low)[-1]) + 1

    def banded(values: Complex) -> Complex:
        return np.asarray(np.add.reduceat((sent.conj() * values)[:last], edges))

    along, across = (
        banded(rfft(acceleration[:, k])) / np.sqrt(banded(sent).real) for k in (axis, 1 - axis)
    )
    f = hz[edges] / HEADING_HZ[1]
    columns = np.column_stack([along, 1j * f * along] if axis == 0 else [along])
    stacked = np.concatenate([columns.real, columns.imag])
    tangent = np.linalg.lstsq(stacked, np.concatenate([across.real, across.imag]))[0][0]
    forwards = np.sign(along.sum().real)
    angle = float(np.arctan2((-1.0 if axis == 0 else 1.0) * tangent * forwards, forwards))
    if abs(angle) > MOST_HEADING:
        raise IdentificationError(
            f"the sensor is turned by {np.degrees(abs(angle)):.0f}° about the vertical, as a run "
            f"of {AXES[axis]} tells: an axis or a sign of its axis map is wrong"
        )
    return angle


def turned(acceleration: Array, angle: float) -> Array:
    """Accelerations (m, 3) in axes turned by −``angle`` (rad) about z, same shape."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(acceleration @ turn.T)


def _check_length(sensor: Resampler, moving: Integers, started: bool) -> None:
    asked = float(moving[-1] - (0 if started else moving[0])) * TS
    if sensor.seconds < asked * (1.0 - MOST_DRIFT):
        raise IdentificationError(
            f"the recording lasts {sensor.seconds:.4g} s, shorter than the command, whose "
            f"motion takes {asked:.4g} s"
        )


def _check_covered(sensor: Resampler, moving: Integers, start: float, drift: float) -> None:
    first, last = start + (1.0 + drift) * TS * moving[[0, -1]]
    if first < 0.0:
        raise IdentificationError(f"the recording begins {-first:.3g} s after the motion")
    if last > sensor.seconds:
        raise IdentificationError(
            f"the recording ends {last - sensor.seconds:.3g} s before the command's motion does"
        )


def _onset(command: Array, a: Array) -> float:
    """Where the answer a (m,) sets in, s: the first rise of its impulse response's envelope."""
    low, high = band_of(command, (0.01, 0.99))
    n = next_fast_len(len(command) + int(2.0 * AWAY * RATE))
    hz = fftfreq(n, TS)
    sent = fft(command, n)
    power = np.abs(sent) ** 2
    inside = (hz >= low) & (hz <= high)
    window = np.sqrt(np.sin(np.pi * np.clip((hz - low) / (high - low), 0.0, 1.0)))
    response = window * sent.conj() * fft(a, n) / (power + power[inside].mean() * QUIETEST)
    envelope = np.abs(ifft(response))
    reach = int(AWAY * RATE)
    near = np.concatenate([envelope[-reach:], envelope[: reach + 1]])
    return float(np.argmax(near >= RISE * near.max()) - reach) * TS


def _followed(command: Array, a: Array, channel: int) -> float:
    """The correlation in ``channel``, √(Σ|S_ua|²/S_uu / ΣS_aa) over the command's band.

    The slow part of a motion tells the axis: faster, a nozzle may rack more than it moves.
    Raises IdentificationError if it is of another channel, or poor.
    """
    low, high = band_of(command, (0.005, 0.995))
    options = {"fs": RATE, "nperseg": min(SEGMENT, len(command)), "detrend": False}
    hz, sent = welch(command, **options)
    heard = welch(a, axis=0, **options)[1]
    cross = np.abs(csd(command[:, None], a, axis=0, **options)[1]) ** 2
    slow = hz <= SLOW_HZ
    if sent[slow].sum() > LEAST_LOW * sent.sum():
        shares = cross[slow].sum(axis=0)
        other = int(np.argmax(shares))
        if shares[other] > OTHER_AXIS**2 * shares[channel]:
            raise IdentificationError(
                f"the recording follows the command in {AXES[other]}, not in {AXES[channel]}: the "
                "axis map is wrong, or the recording is that of another sweep or sensor"
            )
    band = (hz >= low - RATE / SEGMENT) & (hz <= high + RATE / SEGMENT)
    explained = (cross[band, channel] / np.maximum(sent[band], 1e-300)).sum()
    correlation = float(np.sqrt(explained / max(heard[band, channel].sum(), 1e-300)))
    if correlation < POOR:
        raise unlike()
    return correlation
