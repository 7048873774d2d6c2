"""What several places along x show: modes that move, and racking.

Modes may change with the gantry's position, since a belt's free length, and with it its stiffness,
changes along x. The response of all places together is stretched to what each shows; where that
moves, an axis has the response of each place. Racking is what the nozzle does in y while x moves,
which grows with the distance from x_c. It is seen at several places at once, so what was measured
there is first moved to common frequencies, by the factors of x.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.axes import (
    Fit,
    Measured,
    fit_known_start,
    fit_racking,
)
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    advanced,
    average,
    lowest,
    share_left,
)
from hframe_post.identification.estimation.measured import (
    LineOverPlaces,
    MeasurementSettings,
    RunGroup,
    RunResponse,
    centre,
    line,
)
from hframe_post.model.impulse_response import (
    MOST_PLACES,
    Elsewhere,
    ImpulseResponse,
)

DAY_TO_DAY = 0.05  # relative change of a printer as belts, bearings and temperature change
MOST = 0.2  # a model that scatters by more is wrong in another way
SCATTER = 0.002  # of the frequencies from run to run, relative
COUNTED_AS = 4  # positions that this usual scatter is worth
LEAST_SHIFT = 0.01  # over all positions
CHANCE = 1e-3  # that a shift is only noise
SHIFTS = np.exp(np.arange(-0.3, 0.3001, 0.004))  # of frequencies, that are tried


@dataclass(frozen=True, slots=True)
class ModeShift:
    """How the frequencies change along x.

    hz: the main resonance at the least and the greatest x (mm) that was measured.
    """

    hz: tuple[float, float]
    x: tuple[float, float]

    @property
    def message(self) -> str:
        return (
            f"the printer changes along x: a mode at {self.hz[0]:.1f} Hz for x = {self.x[0]:.0f} "
            f"mm lies at {self.hz[1]:.1f} Hz for x = {self.x[1]:.0f} mm"
        )


def find_mode_shift(
    G: ImpulseResponse, resonance_hz: float, places: Sequence[tuple[float, FrequencyResponse]]
) -> ModeShift | None:
    """Return how modes shift along x; None if they do not, or fewer than 3 positions tell.

    G: of all places together. places: (x in mm, response) of each run. A shift counts if it is
    above 1 % over the positions and has a chance of 0.1 % at most to be noise (Student's t). Three
    places lie close to any line by chance, so the scatter that is usual counts, too.
    """
    x = np.array([place for place, _ in places])
    if len(places) < 3 or np.ptp(x) == 0.0:
        return None
    change = np.array([_log_factor(G, response) for _, response in places])
    away, n = x - x.mean(), COUNTED_AS + len(x) - 2
    power = float(away @ away)
    slope = float(away @ change) / power
    off = change - change.mean() - slope * away
    sd = np.sqrt((COUNTED_AS * SCATTER**2 + float(off @ off)) / n / power)
    if abs(slope) * np.ptp(x) < LEAST_SHIFT or abs(slope) < stats.t.isf(CHANCE, n) * sd:
        return None
    ends = float(x.min()), float(x.max())
    first, last = (float(np.exp(change.mean() + slope * (end - x.mean()))) for end in ends)
    return ModeShift((first * resonance_hz, last * resonance_hz), ends)


def _log_factor(G: ImpulseResponse, measured: FrequencyResponse) -> float:
    """Return the logarithm of the factor of all frequencies with which G is most like a place."""
    hz = measured.hz
    fine = np.linspace(hz[0] / SHIFTS[-1], hz[-1] / SHIFTS[0], 4 * len(hz))
    H = G.response(2.0 * np.pi * TS * fine)

    def left(factor: float) -> float:
        at = hz / factor
        there = np.interp(at, fine, H.real) + 1j * np.interp(at, fine, H.imag)
        return share_left(there, measured, measured.power)

    return lowest(np.log(SHIFTS), [left(factor) for factor in SHIFTS.tolist()])


SAME_PLACE = 5.0  # mm
DIGITS = 4  # of factors
LEAST_ARM = 20.0  # mm; nearer to x_c, racking does not tell its size

Places = Sequence[tuple[float, FrequencyResponse]]


def fit_places(found: Fit, places: Places) -> Fit:
    """Return the fit of the middle place, whose response knows those of the others.

    found: the fit of all of them together. places: x (mm) and what was measured there, its start
    known up to the recording's delay in ``found``. Raises IdentificationError.
    """
    at = _together(places)
    middle = min(at, key=lambda x: (abs(x - (min(at) + max(at)) / 2.0), x))
    fits = {
        x: fit_known_start(advanced(response, found.recording_delay)) for x, response in at.items()
    }
    own = fits[middle].G
    elsewhere = [
        Elsewhere(x, round(float(np.exp(_log_factor(own, at[x]))), DIGITS), one.G)
        for x, one in fits.items()
        if x != middle
    ]
    G = replace(own, x=middle, elsewhere=tuple(elsewhere))
    return replace(fits[middle], G=G).begun(found.recording_delay)


def factor(G: ImpulseResponse, place: float) -> float:
    """Return the frequencies at a place (mm), relative to those at the response's own."""
    if not G.elsewhere:
        return 1.0
    known = sorted([(G.x, 1.0), *((one.x, one.frequency) for one in G.elsewhere)])
    x, frequency = zip(*known, strict=True)
    return float(np.interp(place, x, frequency))


def at_common_frequencies(
    response: FrequencyResponse, G: ImpulseResponse, place: float
) -> FrequencyResponse:
    """Return the response at a place (mm) as it would be where G itself holds.

    The frequencies are those that are known of all places.
    """
    by, every = factor(G, place), [1.0, *(one.frequency for one in G.elsewhere)]
    hz = response.hz
    hz = hz[(hz * min(every) >= hz[0]) & (hz * max(every) <= hz[-1])]

    def there(values: Array) -> Array:
        return np.asarray(np.interp(hz * by, response.hz, values))

    H = there(response.H.real) + 1j * there(response.H.imag)
    coherence, power = there(response.coherence), there(response.power)
    return replace(response, hz=hz, H=H, coherence=coherence, power=power)


def racking_along_x(
    racking: ImpulseResponse,
    along: ImpulseResponse,
    slope: FrequencyResponse,
    measured: Sequence[tuple[float, float, FrequencyResponse]],
) -> ImpulseResponse:
    """Return racking that changes along x as the response along it does, ``along``.

    Its frequencies have the same factors, and its size is that which was measured. slope: what
    ``racking`` is the model of. measured: place and lever arm (mm), and what the nozzle did in y,
    at common frequencies.
    """
    own = replace(racking, x=along.x)
    power = float((slope.power * np.abs(slope.H) ** 2).sum())
    elsewhere: list[Elsewhere] = []
    for place, arm, response in measured:
        taken = [own.x, *(one.x for one in elsewhere)]
        if abs(arm) < LEAST_ARM or min(abs(place - x) for x in taken) < SAME_PLACE:
            continue
        size = float((slope.power * slope.H.conj() * response.H).sum().real) / (power * arm)
        frequency = factor(along, place)
        there = own.stretched(1.0 / frequency)
        there = replace(there, deviation=size * there.deviation, lag=size * own.lag)
        elsewhere.append(Elsewhere(round(place, 2), round(frequency, DIGITS), there))
    return replace(own, elsewhere=tuple(elsewhere))


def _together(places: Places) -> dict[float, FrequencyResponse]:
    """Return the mean response at each place (mm), of as many as a profile holds."""
    groups: dict[float, list[FrequencyResponse]] = {}
    for place, response in sorted(places, key=lambda one: one[0]):
        near = [x for x in groups if abs(x - place) < SAME_PLACE]
        groups.setdefault(near[0] if near else round(float(place), 2), []).append(response)
    every = -(-len(groups) // MOST_PLACES)
    return {x: average(each) for x, each in list(groups.items())[::every]}


OFF_LINE = 0.3  # of the lever arms' effect, that may deviate from the line through the positions
NOISE = 2.5  # least power of racking per that of its noise; without racking 0.9 to 2.0 are seen
APART = 20.0  # mm, at least, of the outer positions


@dataclass(frozen=True, slots=True)
class Racking:
    """Gxtheta as measured and as fitted, and x_c in mm."""

    measured: Measured
    fit: Fit
    x_c: float


def find_racking(
    group: RunGroup, fits: Mapping[str, Fit], settings: MeasurementSettings, shifts: bool
) -> tuple[Racking | None, bool]:
    """Return what runs along x show of racking, and whether they could show any.

    fits: of the axes. shifts: whether modes shift along x. Raises IdentificationError if what the
    runs show is not racking.
    """
    G, runs = fits["Gxx"].G, group.runs
    moves = G if G.elsewhere else None
    if moves is not None:
        runs = [_unmoved(run, moves) for run in runs]
    arm = _lever_arm(runs, settings, shifts)
    if arm is None:
        return None, False
    if moves is not None:
        arm = _by_the_middle(arm, runs)
    if arm.over_noise <= NOISE:
        return None, True
    measured = Measured(arm.by_place, arm.slope, arm.off, arm.off)
    along = average([run.response for run in runs])
    x_c, _ = centre(arm, along.H)
    fit = _fitted(measured, group, fits, settings)
    if moves is not None:
        turned = [(run.place, run.place - x_c, run.y) for run in runs]
        fit = replace(fit, G=racking_along_x(fit.G, moves, measured.mean, turned))
    return Racking(measured, fit, x_c), True


def _fitted(
    measured: Measured, group: RunGroup, fits: Mapping[str, Fit], settings: MeasurementSettings
) -> Fit:
    low, high = settings.band_hz
    seen = measured.mean.within((max(low, group.excited_hz[0]), min(high, group.excited_hz[1])))
    # an unknown excitation is wrong in x alone, an unknown sensor where it measures
    calibrated = group.resonance_hz is None
    gain = fits["Gyy" if calibrated and "Gyy" in fits else "Gxx"].gain
    return fit_racking(seen, fits["Gxx"], gain, calibrated)


def _unmoved(run: RunResponse, moves: ImpulseResponse) -> RunResponse:
    """Return the run as if its frequencies were those where the response itself holds."""
    response, y = (at_common_frequencies(one, moves, run.place) for one in (run.response, run.y))
    return replace(run, response=response, y=y)


def _by_the_middle(arm: LineOverPlaces, runs: Sequence[RunResponse]) -> LineOverPlaces:
    """Return the line with what was measured nearest the middle instead of the mean.

    Where modes move, the outer places may rack differently, and would pull x_c to one side.
    """
    run = min(runs, key=lambda run: abs(run.place - arm.middle))
    return replace(arm, middle=run.place, at_middle=run.y.H)


def _lever_arm(
    runs: Sequence[RunResponse], settings: MeasurementSettings, changes: bool
) -> LineOverPlaces | None:
    """Return the line over positions whose slope is racking.

    None if the kinematics cannot rack or the positions are too close. changes: whether the printer
    changes along x, so that no straight line can be expected.
    """
    places, across = [run.place for run in runs], [run.y for run in runs]
    if not settings.racks or np.ptp(places) < APART:
        return None
    found = line(places, across)
    if found.over_noise <= NOISE or changes or found.beyond_noise <= OFF_LINE:
        return found
    raise IdentificationError(
        "what the nozzle does in y while x sweeps does not grow with the position: "
        f"{100 * found.beyond_noise:.0f} % of it deviate from a straight line. "
        "Are files of two places exchanged, or was the sensor moved between runs?"
    )
