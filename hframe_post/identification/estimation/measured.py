"""Frequency responses of runs, by axis.

    runs → accelerations on the command's clock → spectra → along the printer's axes → responses

Recordings that do not tell their start have a delay, and a gain, of their own each; strokes have
none.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.estimation.directions import (
    Direction,
    axes_in_sensor,
    direction,
    slow_directions,
)
from hframe_post.identification.estimation.frequency_response import (
    SEGMENT,
    FrequencyResponse,
    Spectra,
    average,
    spread,
)
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.clock import (
    Aligned,
    Clock,
    acceleration,
    aligned,
)

AXIS = {"Gxx": "x", "Gyy": "y"}
ALONE = 1.0 - 1e-6  # share of a motion along an axis, from which no other one moves


@dataclass(frozen=True, slots=True)
class Run:
    """A recording. command (m, 2): x and y in mm, every 1 ms; nozzle: in the sensor's axes.

    clock: what is known of it. found: the recording on it, if it was computed already.
    """

    name: str
    command: Array
    nozzle: Recording
    clock: Clock | None = None
    found: Aligned | None = None

    @property
    def known_start(self) -> bool:
        """Return whether the printer's own clock tells when the motion began."""
        return self.clock is not None and self.clock.is_exact

    @property
    def axes(self) -> tuple[int, ...]:
        """Return the axes that move, of X and Y."""
        return tuple(np.flatnonzero(np.ptp(self.command, axis=0) > 0.0).tolist())

    @property
    def directions(self) -> Array:
        """Return the directions (k, 2) that move on their own: both axes, or one line.

        Raises IdentificationError if the motion of a test bends.
        """
        return np.eye(2)[list(self.axes)] if self.known_start else self.direction[None, :]

    def aligned(self) -> Aligned:
        """Return the recording on the clock of its command. Raises IdentificationError."""
        if self.found is not None:
            return self.found
        moved = (self.command - self.command[0]) @ self.directions.T
        return aligned(acceleration(moved), self.nozzle, self.clock)

    def own_axes(self) -> Array:
        """Return what shows the printer's x and y, (3, 2), in what the sensor shows of strokes.

        Raises IdentificationError if they are not in it.
        """
        seen = slow_directions(self.aligned())
        verdict.check_shown(float(np.linalg.norm(seen, axis=1).min()))
        return axes_in_sensor(self.directions, seen, self.nozzle.up)

    @property
    def direction(self) -> Array:
        """Return the unit vector (2,) of the motion; raise IdentificationError if that bends."""
        moved = self.command - self.command[0]
        _, sizes, axes = np.linalg.svd(moved - moved.mean(axis=0), full_matrices=False)
        if not sizes[0] > 0.0 or sizes[1] > 1e-3 * sizes[0]:
            raise IdentificationError("a test must move along one line")
        along = np.where(np.abs(axes[0]) < 1e-3, 0.0, axes[0])
        along = along / np.linalg.norm(along)
        return np.asarray(along * np.sign(along[np.argmax(np.abs(along) > 0.1)]))

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

    def corrected(self, gain: float, late: float = 0.0) -> RunResponse:
        """Return the responses without a sensor's gain, as if it had begun ``late`` s later."""
        response, y = (one.corrected(gain, late) for one in (self.response, self.y))
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


ALIKE = np.cos(np.radians(8.0))  # of gravity in two recordings of one mounting
SQUARE = np.sin(np.radians(25.0))  # by which directions in the sensor may differ from the command's


@dataclass(frozen=True, slots=True)
class _Seen:
    """A run, and the spectra of its command and of the sensor's axes.

    direction: of a test, as the sensor sees it; strokes have axes (3, 2) of their own.
    """

    run: Run
    spectra: Spectra
    direction: Direction | None
    axes: Array | None = None


def axis_responses(runs: Sequence[Run], settings: MeasurementSettings) -> dict[str, Measured]:
    """Return the responses of the runs of each axis, by name: of strokes, or else of others.

    A run along a diagonal counts for both axes if no run moves one of them alone. Raises
    IdentificationError, which names the run.
    """
    # of the shortest run of strokes, so that all have the same frequencies
    segment = min([SEGMENT, *(len(run.command) // 2 for run in runs if run.known_start)])
    seen = [_seen(run, settings, segment if run.known_start else SEGMENT) for run in runs]
    groups = {}
    for axis, name in enumerate(AXIS):
        struck = [one for one in seen if one.direction is None and axis in one.run.axes]
        others = [one for one in seen if one.direction is not None and one.run.direction[axis]]
        alone = [one for one in others if abs(one.run.direction[axis]) > ALONE]
        if chosen := struck or alone or others:
            responses = [_run_response(axis, one, seen, settings) for one in chosen]
            groups[name] = _measured([one.direction for one in chosen], responses)
    return groups


def _seen(run: Run, settings: MeasurementSettings, segment: int) -> _Seen:
    try:
        found = run.aligned()
        spectra = Spectra.of(found.command, found.acceleration, segment)
        if run.known_start:
            return _Seen(run, spectra, None, run.own_axes())
        return _Seen(run, spectra, direction(found, spectra.responses(settings.band_hz)[0]))
    except IdentificationError as error:
        raise IdentificationError(f"{run.name}: {error}") from None


def _run_response(
    axis: int, one: _Seen, seen: Sequence[_Seen], settings: MeasurementSettings
) -> RunResponse:
    axes = _axes(one, seen) if one.axes is None else one.axes
    late = 0.0 if one.direction is None else one.direction.delay
    responses = one.spectra.along(axes.T).responses(settings.band_hz)
    directions = one.run.directions[:, axis]
    k = int(np.argmax(np.abs(directions)))
    share = float(directions[k])
    # a diagonal does not show racking alone
    y = responses[k][Y if abs(share) > ALONE else axis]
    x_part, y_part = one.run.directions[k].tolist()
    place = one.run.place + settings.offset[X]
    return RunResponse(place, responses[k][axis], y, (x_part, y_part)).corrected(share, late)


def _measured(directions: Sequence[Direction | None], found: list[RunResponse]) -> Measured:
    """Return what runs show together, those of tests with one gain."""
    tests = [one for one in directions if one is not None]
    if not tests:
        return Measured.of(found)
    low, high = max(one.excited_hz[0] for one in tests), min(one.excited_hz[1] for one in tests)
    resonance = float(np.median([one.resonance_hz for one in tests]))
    return Measured.of(_with_common_gain(found, low, resonance), (low, high), resonance)


def _axes(one: _Seen, seen: Sequence[_Seen]) -> Array:
    """Return what shows the printer's x and y, (3, 2), in the recording of a test.

    From all tests with the sensor mounted alike; of a single direction, from gravity.
    """
    mates = [other for other in seen if _mounted_alike(one, other)]
    commanded = np.array([mate.run.direction for mate in mates])
    shown = np.array([mate.direction.axis for mate in mates if mate.direction])
    try:
        return axes_in_sensor(commanded, shown, one.run.nozzle.up)
    except IdentificationError as error:
        raise IdentificationError(f"{one.run.name}: {error}") from None


def _mounted_alike(one: _Seen, other: _Seen) -> bool:
    if one.direction is None or other.direction is None:
        return False
    up, others = one.run.nozzle.up, other.run.nozzle.up
    if up.any() and others.any() and float(up @ others) < ALIKE:
        return False
    angle = float(one.direction.axis @ other.direction.axis)
    return bool(abs(angle - float(one.run.direction @ other.run.direction)) < SQUARE)


def _with_common_gain(
    responses: Sequence[RunResponse], low: float, resonance_hz: float
) -> list[RunResponse]:
    """Return the responses with the gain of the first, as the responses below resonance show it.

    Sensors, and the strength of the excitation, may differ from session to session.
    """
    hz = responses[0].response.hz
    below = (hz >= low) & (hz <= max(0.6 * resonance_hz, 1.5 * low))
    sizes = [float(np.abs(one.response.H[below]).mean()) for one in responses]
    return [one.corrected(size / sizes[0]) for one, size in zip(responses, sizes, strict=True)]
