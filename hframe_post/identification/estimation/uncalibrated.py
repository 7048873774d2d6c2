"""The axis along which a recorded printer moved, as its sensor sees it.

Below its resonances the printer follows its command, so the response there points along the swept
axis, whatever way the sensor is mounted.

Frequency responses from recordings that tell neither start, nor axes, nor gain.

    runs → own clock and direction → responses along and across → one delay and gain for each axis

The response points along the motion at low frequencies. Runs in two directions with the sensor
mounted alike show where x and y point; of one direction the other lies at right angles, by gravity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from hframe_post.arrays import Array, Complex, Flags, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    Spectra,
)
from hframe_post.identification.estimation.measured import (
    AXIS,
    Measured,
    MeasurementSettings,
    Run,
    RunResponse,
)
from hframe_post.identification.recordings.clock import (
    acceleration,
    axes_in_sensor,
    not_found,
    self_aligned,
)

EXCITED = 0.1  # of a test's usual power, from which a frequency counts as excited
LATEST_GAP_HZ = 30.0  # at which a test begins at the latest
LEAST_HZ = 8.0  # to which a test lasts at least; slow sweeping lies below
LATEST = 0.08  # s by which the rough start may be off
SLOW_HZ = 25.0  # below it a printer moves more than it racks


@dataclass(frozen=True, slots=True)
class Direction:
    """Where the swept axis points, as the sensor sees it.

    axis (3,): unit vector. delay: s by which the response is late, ±2 ms. resonance_hz: of the
    lowest strong resonance. excited_hz: lowest and highest frequency at which the command explains
    the response.
    """

    axis: Array
    delay: float
    resonance_hz: float
    excited_hz: tuple[float, float]


def direction(responses: list[FrequencyResponse]) -> Direction:
    """Return the axis that three responses (one for each of the sensor's axes) show.

    Raises IdentificationError if the printer does not follow the command at low frequencies.
    """
    hz = responses[0].hz
    H = np.array([one.H for one in responses])
    size = np.sqrt((np.abs(H) ** 2).sum(axis=0))
    slow = hz <= SLOW_HZ  # in the fast part the nozzle may rack more than it moves
    strongest = int(np.argmax((np.abs(H) ** 2 * responses[0].power)[:, slow].sum(axis=1)))
    excited = _excited(responses[strongest])
    resonance = _first_resonance(hz, size, excited)
    low, high = hz[excited][[0, -1]].tolist()
    low_end = max(0.7 * resonance, 2.5 * low)
    used = excited & (hz <= low_end)
    unit = H[:, used] / np.abs(H[strongest, used])
    weight = np.clip(responses[strongest].coherence, 0.0, 1.0)[used]
    delays = np.arange(-LATEST, LATEST, 2e-4)
    turned = np.exp(2j * np.pi * np.outer(hz[used], delays)) * weight[:, None]
    delay = float(delays[np.argmax((np.abs(unit @ turned) ** 2).sum(axis=0))])
    lowest = hz[used] <= 0.6 * low_end
    along = (unit * np.exp(2j * np.pi * hz[used] * delay))[:, lowest]
    axis = _at_rest(along, hz[used][lowest], weight[lowest])
    mean = along @ weight[lowest]
    if np.linalg.norm(mean.imag) > verdict.OUT_OF_PHASE * np.linalg.norm(mean.real):
        raise not_found()
    return Direction(axis / np.linalg.norm(axis), delay, resonance, (low, high))


def _excited(response: FrequencyResponse) -> Flags:
    """Flag the frequencies (k,) from the last gap at the low end to where the test ended.

    A test's pulses grow with the frequency. The slow sweeping under them has lines below, too, and
    the pulses have harmonics of a ninth of their power.
    """
    coherence = _smoothed(response.coherence, response.hz, 1.0)
    middle = response.hz <= LATEST_GAP_HZ
    step = float(response.hz[1] - response.hz[0])
    level = response.power / np.square(response.hz)
    steady = median_filter(level, max(round(2.0 / step), 1), mode="nearest")
    usual = float(
        np.median(level[steady > EXCITED * steady[response.hz > LEAST_HZ].max(initial=0.0)])
    )
    inside = ~middle & (steady > EXCITED * usual)
    if not inside.any() or np.median(coherence[inside]) < verdict.COHERENCE:
        raise not_found()
    gaps = np.flatnonzero(middle & (steady < EXCITED * usual))
    flags = np.zeros(len(response.hz), dtype=bool)
    ends = slice(int(gaps[-1]) + 1 if gaps.size else 0, int(np.flatnonzero(inside)[-1]) + 1)
    flags[ends] = True
    return flags


def _first_resonance(hz: Array, size: Array, excited: Flags) -> float:
    """Return the lowest frequency at which the response has a clear peak.

    A peak far below the strongest one counts if it is half as high: a frame that rocks is not.
    """
    smooth = _smoothed(size, hz, 2.0)[excited]
    octave = hz[excited] < 2.0 * hz[excited][0]
    clear = max(0.1 * float(smooth.max()), 0.3 * float(np.median(smooth[octave])))
    peaks, _ = find_peaks(np.append(smooth, 0.0), prominence=clear)
    if not peaks.size:  # a stiff printer: what rings lies far above what was excited
        return 3.0 * float(hz[-1])
    high = smooth[peaks]
    at = hz[excited][peaks]
    return float(at[(at > at[np.argmax(high)] / 3.0) | (high > 0.5 * high.max())][0])


def _smoothed(values: Array, hz: Array, width_hz: float) -> Array:
    n = max(int(width_hz / (hz[1] - hz[0])) | 1, 1)
    padded = np.pad(values, n // 2, mode="edge")
    return np.convolve(padded, np.ones(n) / n, "valid")


def _at_rest(response: Complex, hz: Array, weight: Array) -> Array:
    """Return the response (3,) at rest by a line through (3, k): racking grows with j·f."""
    columns = np.column_stack([weight, 1j * weight * hz / hz[-1]])
    stacked = np.concatenate([columns.real, columns.imag])
    response = response * weight
    wanted = np.concatenate([response.T.real, response.T.imag])
    return np.asarray(np.linalg.lstsq(stacked, wanted, rcond=None)[0][0])


ALIKE = np.cos(np.radians(8.0))  # of gravity in two recordings of one mounting
SQUARE = np.sin(np.radians(25.0))  # by which directions in the sensor may differ from the command's


@dataclass(frozen=True, slots=True)
class _Located:
    """A run and its direction: in x and y as commanded (2,), and as the sensor sees it.

    spectra: of its command and of the sensor's axes.
    """

    run: Run
    spectra: Spectra
    commanded: Array
    seen: Direction

    @property
    def up(self) -> Array:
        return self.run.nozzle.up


def uncalibrated_responses(
    runs: Sequence[Run], settings: MeasurementSettings
) -> dict[str, Measured]:
    """Return the responses of the runs of each axis, by name.

    A run along a diagonal counts for both axes if no run moves one of them alone. Raises
    IdentificationError, which names the run.
    """
    located = [_located(run, settings) for run in runs]
    groups = {}
    for axis in (X, Y):
        alone = [one for one in located if abs(one.commanded[axis]) > 1.0 - 1e-6]
        chosen = alone or [one for one in located if one.commanded[axis]]
        if chosen:
            groups[tuple(AXIS)[axis]] = _group(axis, chosen, located, settings)
    return groups


def _located(run: Run, settings: MeasurementSettings) -> _Located:
    try:
        found = self_aligned(acceleration(run.displacement), run.nozzle, run.clock)
        spectra = Spectra.of(found.command[:, None], found.acceleration)
        (responses,) = spectra.responses(settings.band_hz)
        return _Located(run, spectra, run.direction, direction(responses))
    except IdentificationError as error:
        raise IdentificationError(f"{run.name}: {error}") from None


def _group(
    axis: int,
    chosen: Sequence[_Located],
    located: Sequence[_Located],
    settings: MeasurementSettings,
) -> Measured:
    responses = [_run_response(axis, one, located, settings) for one in chosen]
    low = max(one.seen.excited_hz[0] for one in chosen)
    high = min(one.seen.excited_hz[1] for one in chosen)
    resonance = float(np.median([one.seen.resonance_hz for one in chosen]))
    runs = _with_common_gain(responses, low, resonance)
    return Measured.of(runs, (low, high), resonance)


def _run_response(
    axis: int, one: _Located, located: Sequence[_Located], settings: MeasurementSettings
) -> RunResponse:
    ((x, y),) = one.spectra.along(_axes(one, located)).responses(settings.band_hz)
    share = float(one.commanded[axis])
    alone = share > 1.0 - 1e-6  # a diagonal does not show racking alone
    along = x if axis == X else y
    direction = float(one.commanded[X]), float(one.commanded[Y])
    place = one.run.place + settings.offset[X]
    found = RunResponse(place, along, y if alone else along, direction)
    return found.scaled(1.0 / share).advanced(one.seen.delay)


def _axes(one: _Located, located: Sequence[_Located]) -> Array:
    """Return what shows the printer's x and y, (2, 3), in the recording of a run.

    From all runs with the sensor mounted alike; of a single direction, from gravity.
    """
    mates = [other for other in located if _mounted_alike(one, other)]
    commanded = np.array([mate.commanded for mate in mates])
    seen = np.array([mate.seen.axis for mate in mates])
    try:
        axes = axes_in_sensor(commanded, seen, one.up)
    except IdentificationError as error:
        raise IdentificationError(f"{one.run.name}: {error}") from None
    return np.asarray(np.linalg.inv(axes).T[:2])


def _mounted_alike(one: _Located, other: _Located) -> bool:
    known = one.up.any() and other.up.any()
    if known and float(one.up @ other.up) < ALIKE:
        return False
    angle = float(one.seen.axis @ other.seen.axis - one.commanded @ other.commanded)
    return bool(abs(angle) < SQUARE)


def _with_common_gain(
    responses: Sequence[RunResponse], low: float, resonance_hz: float
) -> list[RunResponse]:
    """Return the responses with the gain of the first, as the responses below resonance show it.

    Sensors, and the strength of the excitation, may differ from session to session.
    """
    hz = responses[0].response.hz
    below = (hz >= low) & (hz <= max(0.6 * resonance_hz, 1.5 * low))
    sizes = [float(np.abs(one.response.H[below]).mean()) for one in responses]
    return [one.scaled(sizes[0] / size) for one, size in zip(responses, sizes, strict=True)]
