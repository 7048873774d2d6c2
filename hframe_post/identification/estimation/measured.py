"""Frequency responses of single runs.

    runs → accelerations on the command's clock → frequency responses

A run moves one axis. A sensor on the nozzle gives Gxx from runs in x and Gyy from runs in y, and
racking by the lever arm of eq. 2: a run in x with the gantry at x = p moves the nozzle in y by the
lever arm times θ, and a sensor rotated by a small ψ about the vertical adds its share of x. Per x
commanded,

    H_y(p) = (p − x_c)·Gxθ + ψ·Gxx

is a straight line over p: its slope is Gxθ, whatever ψ; its offset gives x_c and ψ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.frequency_response import (
    SEGMENT,
    FrequencyResponse,
    advanced,
    by_command,
)
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.clock import Clock, acceleration, on_command_clock


@dataclass(frozen=True, slots=True)
class Run:
    """A recording. command (m, 2): x and y in mm, every 1 ms; nozzle: in the sensor's axes.

    clock: if it is known to 20 ms, or better for motions of `measure`, whose recordings tell it.
    in_time (m, 3): what ``on_command_clock`` returns, if it was computed already.
    """

    name: str
    command: Array
    nozzle: Recording
    clock: Clock | None = None
    in_time: Array | None = None

    @property
    def known_start(self) -> bool:
        """Return whether the printer's own clock tells when the motion began."""
        return self.clock is not None and self.clock.sd is not None

    @property
    def axes(self) -> tuple[int, ...]:
        """Return the axes that move, of X and Y."""
        return tuple(np.flatnonzero(np.ptp(self.command, axis=0) > 0.0).tolist())

    def on_command_clock(self) -> Array:
        """Return what the nozzle's sensor shows of a motion whose start is known, (m, 3) in mm/s².

        It is along the printer's axes at each row of the command. Raises IdentificationError.
        """
        if self.in_time is not None:
            return self.in_time
        if self.clock is None or self.clock.sd is None:
            raise IdentificationError(f"{self.name}: the start of this recording is not known")
        try:
            return on_command_clock(self.command, self.nozzle, self.clock)
        except IdentificationError as error:
            raise IdentificationError(f"{self.name}: {error}") from None

    @property
    def direction(self) -> Array:
        """Return the unit vector (2,) of the motion; raise IdentificationError if that bends."""
        moved = self.command - self.command[0]
        _, sizes, axes = np.linalg.svd(moved - moved.mean(axis=0), full_matrices=False)
        if not sizes[0] > 0.0 or sizes[1] > 1e-3 * sizes[0]:
            raise IdentificationError(f"{self.name}: a test must move along one line")
        along = np.where(np.abs(axes[0]) < 1e-3, 0.0, axes[0])
        along = along / np.linalg.norm(along)
        return np.asarray(along * np.sign(along[np.argmax(np.abs(along) > 0.1)]))

    @property
    def displacement(self) -> Array:
        """Return the motion (m,) in mm along its direction."""
        return np.asarray((self.command - self.command[0]) @ self.direction)

    @property
    def place(self) -> float:
        """Return the mean x, mm."""
        return float(self.command[:, X].mean())


@dataclass(frozen=True, slots=True)
class MeasurementSettings:
    """What `identify` needs to know about the measurement.

    racks: whether the kinematics can rack. offset: from the nozzle to its sensor in x and y, mm.
    """

    band_hz: tuple[float, float]
    racks: bool = True
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class RunResponse:
    """Frequency responses of one run.

    response: along the swept axis. y: along y, which shows racking. place: x of the sensor, mm.
    direction: unit vector of the motion; both responses are per motion along the axis.
    """

    place: float
    response: FrequencyResponse
    y: FrequencyResponse
    direction: tuple[float, float] | None = None

    def advanced(self, seconds: float) -> RunResponse:
        """Return the responses as if the recording had begun ``seconds`` later."""
        response, y = advanced(self.response, seconds), advanced(self.y, seconds)
        return replace(self, response=response, y=y)

    def scaled(self, gain: float) -> RunResponse:
        response, y = (replace(one, H=one.H * gain) for one in (self.response, self.y))
        return replace(self, response=response, y=y)


@dataclass(frozen=True, slots=True)
class RunGroup:
    """Runs of one axis on one delay.

    known_start: whether they are of strokes. Of uncalibrated runs also between which frequencies
    they are excited, and the lowest strong resonance.
    """

    runs: list[RunResponse]
    excited_hz: tuple[float, float] = (0.0, np.inf)
    resonance_hz: float | None = None
    known_start: bool = False


# ---------------------------------------------------------------------- lever arm


@dataclass(frozen=True, slots=True)
class LineOverPlaces:
    """The straight line over places, (k,) frequencies each.

    slope: Gxθ (rad/mm). middle: the mean place, mm. at_middle (k,): H_y there.
    off: RMS deviation of the places from the line, relative to the part that varies with the
    place; beyond_noise: the same without the part that noise explains. over_noise: power of the
    slope over that of its noise. by_place: each place (mm), and the slope from it alone.
    """

    slope: FrequencyResponse
    middle: float
    at_middle: Complex
    off: float
    beyond_noise: float
    over_noise: float
    by_place: list[tuple[float, FrequencyResponse]]


def line(places: Sequence[float], responses: Sequence[FrequencyResponse]) -> LineOverPlaces:
    """Fit the line by least squares to H_y (k,) at two places (mm) or more."""
    first = responses[0]
    p = np.asarray(places)
    middle = float(p.mean())
    arm = p - middle
    H = np.array([r.H for r in responses])
    weights = arm / (arm @ arm)
    averages = min(r.averages for r in responses)
    slope, at_middle = weights @ H, H.mean(axis=0)
    noise = np.array([_noise(r) / r.averages for r in responses])
    power = np.mean([r.power for r in responses], axis=0)
    by_arm = np.outer(arm, slope)
    off = H - at_middle - by_arm
    size = (power * np.abs(by_arm) ** 2).sum()
    off_line = (power * np.abs(off) ** 2).sum() / size
    by_noise = (power * noise).sum() * (1.0 - 2.0 / len(p)) / size
    slope_noise = (power * (weights**2 @ noise)).sum()

    def response(value: Complex, noise: Array) -> FrequencyResponse:
        signal = np.abs(value) ** 2
        power_of_all = signal + averages * noise
        coherence = np.divide(signal, power_of_all, out=np.zeros_like(signal), where=signal > 0.0)
        return FrequencyResponse(first.hz, value, coherence, power, averages)

    return LineOverPlaces(
        response(slope, weights**2 @ noise),
        middle,
        at_middle,
        float(np.sqrt(off_line)),
        float(np.sqrt(max(off_line - by_noise, 0.0))),
        float((power * np.abs(slope) ** 2).sum() / max(slope_noise, np.finfo(float).tiny)),
        [
            (place, response((h - at_middle) / a, n / a**2))
            for place, a, h, n in zip(p.tolist(), arm.tolist(), H, noise, strict=True)
            if abs(a) >= 10.0  # mm; a place nearer the middle shows nothing of the slope
        ],
    )


def centre(line: LineOverPlaces, Gxx: Complex) -> tuple[float, float]:
    """Return x_c (mm) and ψ (rad) from the line's offset. Gxx (k,): as measured."""
    weight = np.sqrt(line.slope.power)
    columns = np.column_stack([line.slope.H, Gxx]) * weight[:, None]
    target = line.at_middle * weight
    stacked = np.concatenate([columns.real, columns.imag])
    (arm, psi), *_ = np.linalg.lstsq(
        stacked, np.concatenate([target.real, target.imag]), rcond=None
    )
    return line.middle - float(arm), float(psi)


def _noise(response: FrequencyResponse) -> Array:
    """Return the power that the command does not explain, per power of the command, (k,).

    Of one estimate: that of the mean of several is as many times smaller.
    """
    coherence = np.clip(response.coherence, 1e-12, 1.0)
    noise: Array = (1.0 / coherence - 1.0) * np.abs(response.H) ** 2
    return noise


def stroke_responses(runs: Sequence[Run], settings: MeasurementSettings) -> dict[int, RunGroup]:
    """Return the responses of the runs of each axis, X or Y. Raises IdentificationError."""
    found: dict[int, list[RunResponse]] = {X: [], Y: []}
    # of the shortest run, so that all have the same frequencies
    segment = min([SEGMENT, *(len(run.command) // 2 for run in runs)])
    for run in runs:
        responses = _responses(run, settings, segment)
        for axis in run.axes:
            along, y = responses[axis][axis], responses[axis][Y]
            x = run.place + settings.offset[X]
            found[axis].append(RunResponse(x, along, y, (1.0 - axis, float(axis))))
    return {axis: RunGroup(made, known_start=True) for axis, made in found.items() if made}


def _responses(
    run: Run, settings: MeasurementSettings, segment: int
) -> dict[int, list[FrequencyResponse]]:
    """Return what a command in each axis that moves does to x and y."""
    u = np.column_stack([acceleration(run.command[:, axis]) for axis in run.axes])
    found = by_command(u, run.on_command_clock()[:, :2], segment)
    return {
        axis: [one.within(settings.band_hz) for one in each]
        for axis, each in zip(run.axes, found, strict=True)
    }
