"""How far the modes of a profile have moved, from one short run of each axis.

recording → response of the whole record → the known modes, moved → the profile's plant

The fit begins at the profile's modes and expects them to have changed as printers do (`Known`). No
profile describes a real printer wholly: some of its modes lie above what was measured, or account
for what is not linear. A mode that would move farther than printers drift therefore stays where it
is, unless it is the main one and the old model does not explain the recording: then this is another
printer, or one that was rebuilt, and refused. So is a recording of which the moved model explains
little of what a linear model can explain at all.

The second mark is not part of the fit: an axis moves only if its new model explains the answer to
that better than the old one. A mark is fast, like a corner, so belts that stiffen on the long sine
of a resonance do not pass as belts that drifted.

Delays and racking stay: a short run at one place does not show them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, Complex, X
from hframe_post.errors import IdentificationError
from hframe_post.identification.checking import response
from hframe_post.identification.checking.evidence import (
    EXCITED,
    LEAST_EXPLAINED,
    LEAST_FREQUENCIES,
    STEPS_DAMPING,
    STEPS_HZ,
    UNMOVED,
    Drift,
    Moved,
    Recorded,
    explained,
    left_unseen,
)
from hframe_post.identification.checking.known import BAND_HZ, Known, as_modes, known_modes
from hframe_post.identification.diagnosis.scatter import Uncertainty, with_noise
from hframe_post.identification.fitting.dominant import INDEPENDENT_HZ
from hframe_post.identification.fitting.fit import RINGS
from hframe_post.identification.fitting.modal import Data, Modal, columns, refine
from hframe_post.identification.recordings.alignment import acceleration, aligned, heading, turned
from hframe_post.identification.recordings.clock_sync import find_marks, moving_samples
from hframe_post.identification.responses.frequency_response import (
    NOISE_FLOOR,
    FrequencyResponse,
    delays,
    weights,
    whole_record,
)
from hframe_post.identification.responses.measured import Run
from hframe_post.model.impulse_response import ImpulseResponse, Linear
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.stream.running import one_blas_thread

SAMPLES = 8  # of the response with noise added, from which uncertainties follow
LATE = 3e-3  # s by which the delay may differ from that of the phase
MEASURED_HZ = 100.0  # above it `identify` measures no modes, but may need some
LEAST_DAMPING = 0.0105  # that `identify` finds; with less a mode is at its bound, and none
OFF_PEAK = 0.4  # of the median answer, that an error is measured by where the answer is smaller
LOWEST = 0.5  # times the lowest mode: below, the whole printer may rock on its table
HIGHEST = 1.25  # times the highest mode


@one_blas_thread()
def drifts(plant: Plant, runs: Sequence[Run]) -> dict[str, Drift]:
    """Return what drifted, by Gxx and Gyy, from at most one run of each axis.

    runs: with recordings along the printer's axes. Raises IdentificationError.
    """
    found = {}
    for run in runs:
        name, G = ("Gxx", plant.Gxx) if run.axis == X else ("Gyy", plant.Gyy)
        try:
            found[name] = drift(G, _recorded(run))
        except IdentificationError as error:
            raise IdentificationError(f"{run.name}: {error}") from None
    return found


def _recorded(run: Run) -> Recorded:
    """Return what is before the second mark, when the sine's answer has died away, and the mark."""
    u = acceleration(run.command[:, run.axis])
    marks = find_marks(u, moving_samples(u))
    if marks is None or run.nozzle is None:
        raise IdentificationError("not a run of 'hframe-post check --gcode'")
    one = aligned(u, run.nozzle, run.axis)
    a = turned(one.acceleration, heading(u, one.acceleration, run.axis))[:, run.axis]
    noise = float(a[: marks.first].std())
    end = marks.second
    return Recorded(whole_record(u[:end], a[:end], noise), (u[end:], a[end:]))


def drift(G: Linear, recorded: Recorded) -> Drift:
    """Return how an axis' response changed.

    Raises IdentificationError if the recording is not of its printer.
    """
    return response.drift(G, recorded) if isinstance(G, ImpulseResponse) else _modes(G, recorded)


def _modes(G: TransferFunction, recorded: Recorded) -> Drift:
    old = as_modes(G)
    rings = known_modes(G)
    if not rings:
        raise IdentificationError("the profile's model does not ring, so there is nothing to check")
    part = recorded.response.within((LOWEST * rings[0], min(HIGHEST * rings[-1], BAND_HZ[1])))
    part = part.where(part.power > EXCITED * np.median(part.power))
    if len(part.hz) < LEAST_FREQUENCIES:
        raise IdentificationError("the motion is too short to show the modes")
    new, sd, known = _plausible(old, part)
    omega, zeta = _uncertainty(new, part, sd, known)
    size = np.abs(new.c) + np.abs(new.d)
    importance = size * (new.parameters.zeta < RINGS) / size.max()
    share = Uncertainty(tuple(omega), tuple(zeta), tuple(importance), 0.0).share
    modes = [
        replace(mode, sd=(float(omega[k]), float(zeta[k])))
        for k, mode in _changes(old, new).items()
    ]
    band = float(part.hz[0]), float(part.hz[-1])
    left = [left_unseen(model.response, recorded.unseen, band) for model in (old, new)]
    seen = any(mode.certain for mode in modes)
    return Drift(new.discrete(old.delay, new.gain), seen, (left[0], left[1]), share, modes)


def _pair(old: Array, new: Array, k: int, unit: float = 1.0) -> tuple[float, float]:
    return float(old[k]) / unit, float(new[k]) / unit


def _changes(old: Modal, new: Modal) -> dict[int, Moved]:
    """Return the modes that ring, by their number, lowest frequency first."""
    return {
        k: Moved(
            _pair(old.parameters.omega, new.parameters.omega, k, 2.0 * np.pi),
            _pair(old.parameters.zeta, new.parameters.zeta, k),
            (float(old.c[k] / old.gain), float(new.c[k] / new.gain)),
            (0.0, 0.0),
        )
        for k in np.argsort(old.parameters.omega).tolist()
        if old.parameters.zeta[k] < RINGS
    }


def _plausible(old: Modal, part: FrequencyResponse) -> tuple[Modal, Array, Known]:
    """Return the model moved as far as printers drift, as ``_moved``.

    Raises IdentificationError if the recording is of another printer.
    """
    share = explained(part)
    same = share(old.response(part.hz)) > UNMOVED
    hz = old.parameters.omega / (2.0 * np.pi)
    held = (hz > MEASURED_HZ) | (old.parameters.zeta < LEAST_DAMPING)
    ways = (part.power[:, None] * np.abs(_contributions(old, part.hz)) ** 2).sum(axis=0)
    main = int(np.argmax(np.where(held, -1.0, ways)))
    while True:
        known = Known(old, held)
        new, sd = _moved(known, part)
        far = {k: mode for k, mode in _changes(old, new).items() if mode.too_far and not held[k]}
        if main in far and not same:
            raise IdentificationError(
                f"a mode would move farther than printers drift: {far[main].as_text()}. Is it "
                "another printer, or was a belt, the head or the bed changed? Identify again"
            )
        if not far:
            break
        held = held.copy()
        held[list(far)] = True
    shown = share(new.response(part.hz))
    if not same and shown < LEAST_EXPLAINED:
        raise IdentificationError(
            f"the profile's modes explain {100 * max(shown, 0.0):.0f} % of what they "
            "could of this recording: it is of another printer, or of one that was rebuilt. "
            "Identify again"
        )
    return new, sd, known


def _contributions(model: Modal, hz: Array) -> Complex:
    """Return what each mode contributes to the response at ``hz`` (k,), (k, modes)."""
    n = model.structure.modes
    each = columns(np.asarray(2j * np.pi * hz), model.structure, model.parameters)
    by_speed = each[:, n : 2 * n] * model.d if model.structure.speed else 0.0
    return np.asarray(each[:, :n] * model.c + by_speed)


def _moved(known: Known, part: FrequencyResponse) -> tuple[Modal, Array]:
    """Return the model moved to a response, and that one's standard deviation (k,), relative."""
    new = _in_time(known.model, part)
    sd = np.hypot(part.noise, NOISE_FLOOR)
    for _ in range(2):
        new = _refined(part, sd, new, known)
        sd = _scatter(part, new)
    return new, sd


def _scatter(part: FrequencyResponse, model: Modal) -> Array:
    """Return the standard deviation (k,) of a response about its model, relative.

    Noise and motor steps differ from one frequency to the next. What no mode explains, since a
    printer is not quite linear, is wrong alike at neighbouring frequencies, and counts as often.
    """
    size = np.abs(part.H)
    usual = np.hypot(size, OFF_PEAK * np.median(size))
    off = (part.H - model.response(part.hz)) / usual
    alike = max(int(INDEPENDENT_HZ * len(part.hz) / np.ptp(part.hz)), 2)
    blocks = off[: len(off) // alike * alike].reshape(-1, alike)
    means = blocks.mean(axis=1)
    white = float((np.abs(blocks - means[:, None]) ** 2).mean()) * alike / (alike - 1.0)
    common = max(float((np.abs(means) ** 2).mean()) - white / alike, 0.0)
    noise = part.noise * size / usual
    more = max(white - float((noise**2).mean()), 0.0) + alike * common
    return np.asarray(np.sqrt(noise**2 + max(more, NOISE_FLOOR**2)) * usual / size)


def _in_time(model: Modal, part: FrequencyResponse) -> Modal:
    """Return the model with the delay of a response."""
    early, late = delays([replace(part, H=model.response(part.hz)), part])
    delay = model.delay + float(late - early)
    return replace(model, parameters=replace(model.parameters, delay=delay))


def _refined(part: FrequencyResponse, sd: Array, start: Modal, known: Known) -> Modal:
    old = known.model.parameters
    hz = np.concatenate([old.omega, old.corner]) / (2.0 * np.pi)
    reach = 0.5 * float(hz.min()), 2.0 * float(hz.max())
    delay = start.delay - LATE, start.delay + LATE
    exact = replace(part, coherence=np.ones(len(part.hz)))  # sd holds the noise
    data = Data(part.hz, part.H, weights(exact, sd), reach, delay, prior=known)
    return refine(data, start.structure, start.parameters)


def _uncertainty(
    new: Modal, part: FrequencyResponse, sd: Array, known: Known
) -> tuple[Array, Array]:
    """Return standard deviations of frequencies and damping ratios (modes,), relative."""
    doubtful = replace(part, coherence=1.0 / (1.0 + sd**2), averages=1.0)
    rng = np.random.default_rng(0)
    drawn = [_refined(with_noise(doubtful, rng), sd, new, known).parameters for _ in range(SAMPLES)]
    omega = np.std([one.omega for one in drawn], axis=0) / new.parameters.omega
    zeta = np.std([one.zeta for one in drawn], axis=0) / new.parameters.zeta
    return np.hypot(omega, STEPS_HZ), np.hypot(zeta, STEPS_DAMPING)
