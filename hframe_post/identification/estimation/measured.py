"""Frequency responses of runs, and of those that tell their start.

runs → accelerations on the command's clock → spectra → responses of each axis
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.frequency_response import (
    SEGMENT,
    FrequencyResponse,
    Spectra,
    advanced,
    average,
    spread,
)
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.clock import Clock, acceleration, on_command_clock

AXIS = {"Gxx": "x", "Gyy": "y"}


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
class Measured:
    """What runs of one axis show, on one delay.

    mean: of their responses. spread: RMS difference from it, relative; repeated: likewise of runs
    in one direction. known_start: whether they are of strokes. Of others also between which
    frequencies they are excited, and the lowest strong resonance.
    """

    runs: list[RunResponse]
    mean: FrequencyResponse
    spread: float
    repeated: float
    excited_hz: tuple[float, float] = (0.0, np.inf)
    resonance_hz: float | None = None

    @classmethod
    def of(
        cls, runs: list[RunResponse], excited_hz: tuple[float, float] = (0.0, np.inf),
        resonance_hz: float | None = None,
    ) -> Measured:  # fmt: skip
        responses, alike = [run.response for run in runs], defaultdict(list)
        for run in runs:
            alike[run.direction].append(run.response)
        mean, repeated = average(responses), max(map(spread, alike.values()))
        return cls(runs, mean, spread(responses), repeated, excited_hz, resonance_hz)

    @property
    def known_start(self) -> bool:
        """Return whether the runs are of strokes."""
        return self.resonance_hz is None

    @property
    def places(self) -> list[tuple[float, FrequencyResponse]]:
        """Return the response at each position, mm of x."""
        return [(run.place, run.response) for run in self.runs]

    def excited(self) -> list[FrequencyResponse]:
        """Return the runs where they were excited."""
        return [run.response.within(self.excited_hz) for run in self.runs]


def stroke_responses(runs: Sequence[Run], settings: MeasurementSettings) -> dict[str, Measured]:
    """Return the responses of the runs of each axis, by name. Raises IdentificationError."""
    found: dict[str, list[RunResponse]] = {name: [] for name in AXIS}
    # of the shortest run, so that all have the same frequencies
    segment = min([SEGMENT, *(len(run.command) // 2 for run in runs)])
    for run in runs:
        u = np.column_stack([acceleration(run.command[:, axis]) for axis in run.axes])
        spectra = Spectra.of(u, run.on_command_clock()[:, :2], segment)
        place = run.place + settings.offset[X]
        for axis, seen in zip(run.axes, spectra.responses(settings.band_hz), strict=True):
            found[tuple(AXIS)[axis]].append(
                RunResponse(place, seen[axis], seen[Y], (1.0 - axis, float(axis)))
            )
    return {name: Measured.of(made) for name, made in found.items() if made}
