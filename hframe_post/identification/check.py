"""What has drifted since a profile was identified, by 20 s of strokes.

The first half of a run is regressed as `identify` does it. The rest is not fitted, but judges: the
profile changes only if the new response foresees it better. It changes to the response of the whole
run, which halves the error of the lag. Both axes change together, since their recordings tell a
delay of motors and drivers that the old ones may not.

The new responses also judge the profile: its commands for a rectangle, played on the printer as it
is now.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Complex
from hframe_post.conversion.options import Options
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.estimation import response as estimation
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    Spectra,
    share_left,
)
from hframe_post.identification.estimation.measured import Run
from hframe_post.identification.identify import AXIS, DRIFT
from hframe_post.identification.recordings import strokes
from hframe_post.identification.recordings.folder import CHECK
from hframe_post.identification.recordings.runs import PlannedRun
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.native.linear import one_blas_thread
from hframe_post.printer.settings import Printer
from hframe_post.studies.simulation import Study, simulate
from hframe_post.studies.tuning import rectangle

SECONDS = 20.0
BAND_HZ = (3.0, 100.0)
PEAK_HZ = np.arange(15.0, 120.0, 0.05)  # in which the main resonance is
SAME_DELAY = 0.3  # samples: damping of a mode that drifts makes up to 0.2
CHANGED = 0.02  # share of the response, from which it has changed: motor steps make up to 0.01


def runs(printer: Printer) -> list[PlannedRun]:
    """Return the run, in the middle of the travel; one for each axis where the bed moves.

    Raises HframeError.
    """
    x, y = (round(sum(ends) / 2.0, 3) for ends in (printer.travel.x, printer.travel.y))
    return strokes.runs(printer, [(x, y)], SECONDS, CHECK)


@dataclass(frozen=True, slots=True)
class Drift:
    """An axis as it is now.

    left: share of the unseen part that the old and the new response leave. apart: share of the new
    one's motion there that the old one leaves. later: samples by which it is later. hz, height: of
    the main resonance, before and now.
    """

    G: ImpulseResponse
    left: tuple[float, float]
    apart: float
    later: float
    hz: tuple[float, float]
    height: tuple[float, float]

    @property
    def certain(self) -> bool:
        """Return whether the new response differs, and is better where it was not fitted."""
        return self.apart > CHANGED and self.left[1] < self.left[0]

    def as_text(self) -> str:
        (f0, f1), (h0, h1), (old, new) = self.hz, self.height, self.left
        how = f"moved from {f0:.1f} to {f1:.1f} Hz" if self.certain else f"stays at {f0:.1f} Hz"
        text = f"the main resonance {how}, its peak {h0:.1f} → {h1:.1f}; unexplained "
        return f"{text}{100 * old:.0f} → {100 * new:.0f} %"

    def as_json(self) -> dict[str, Any]:
        return {
            "drifted": self.certain,
            "unexplained": [round(left, 4) for left in self.left],
            "resonance": {
                "hz": [round(hz, 4) for hz in self.hz],
                "height": [round(size, 4) for size in self.height],
            },
        }


@one_blas_thread()
def drifts(plant: Plant, runs: Sequence[Run]) -> dict[str, Drift]:
    """Return what drifted, by Gxx and Gyy, from the last run of each axis.

    Raises IdentificationError.
    """
    found = {}
    for run in runs:
        try:
            for axis, parts in _split(run).items():
                name, G = tuple(AXIS)[axis], (plant.Gxx, plant.Gyy)[axis]
                found[name] = drift(G, *parts)
        except IdentificationError as error:
            raise IdentificationError(f"{run.name}: {error}") from None
    return found


def drift(
    old: ImpulseResponse, whole: FrequencyResponse, part: FrequencyResponse,
    unseen: tuple[Array, Array],
) -> Drift:  # fmt: skip
    """Return how an axis' response changed.

    whole: of the run; part: of what is fitted before the rest judges. unseen: that rest, commanded
    and measured acceleration (n,), mm/s². Raises IdentificationError if the recording is not of its
    printer.
    """
    found = estimation.estimated(part)
    before, now = _main(old), _main(found.G)
    judged = [_foreseen(G, unseen) for G in (old, found.G)]
    measured = _whole_record(*unseen)
    left = [share_left(one.H, measured, measured.power) for one in judged]
    apart = share_left(judged[0].H, judged[1], measured.power)
    if abs(now[0] / before[0] - 1.0) > verdict.FREQUENCY_CHANGE or left[1] > verdict.UNEXPLAINED:
        raise IdentificationError(
            "the recording is of another printer, or a belt, the head or the bed was changed: the "
            f"main resonance is at {now[0]:.1f} Hz instead of {before[0]:.1f}, and a new model "
            f"leaves {100 * left[1]:.0f} % of the motion unexplained. Identify again"
        )
    G = replace(estimation.estimated(whole, start=found.prior).G, drift=DRIFT)
    hz, height = zip(before, now, strict=True)
    return Drift(G, (left[0], left[1]), apart, G.lag - old.lag, hz, height)


def _split(
    run: Run,
) -> dict[int, tuple[FrequencyResponse, FrequencyResponse, tuple[Array, Array]]]:
    """Return all, what is fitted first, up to a rest between figures, and what judges, by axis."""
    found = run.aligned()
    u, a = found.command, found.acceleration @ run.own_axes()
    moving = np.flatnonzero((np.diff(run.command, axis=0) != 0.0).any(axis=1))
    again = moving[1:][np.diff(moving) >= strokes.RESTS[0]]
    if not len(again):
        raise IdentificationError("not a run of 'hframe-post measure --for check'")
    end = int(again[np.argmin(np.abs(again - len(u) // 2))])
    whole, part = (Spectra.of(u[:n], a[:n]).responses(BAND_HZ) for n in (len(u), end))
    return {
        axis: (whole[k][axis], part[k][axis], (u[end:, k], a[end:, axis]))
        for k, axis in enumerate(run.axes)
    }


def _at_hz(G: ImpulseResponse, hz: Array) -> Complex:
    return np.asarray(G.response(2.0 * np.pi * TS * hz))


def _main(G: ImpulseResponse) -> tuple[float, float]:
    """Return Hz and |G| of the resonance that moves a print most: of G − 1 over f²."""
    H = _at_hz(G, PEAK_HZ)
    moving = PEAK_HZ[np.argmax(np.abs(H - 1.0) / PEAK_HZ**2)]
    near = np.abs(PEAK_HZ / moving - 1.0) < verdict.FREQUENCY_CHANGE
    k = int(np.argmax(np.abs(H) * near))
    return float(PEAK_HZ[k]), float(np.abs(H[k]))


def _foreseen(G: ImpulseResponse, unseen: tuple[Array, Array]) -> FrequencyResponse:
    """Return what a response makes of the unseen motion, cut off where the recording ends."""
    u, _ = unseen
    n = 4 * len(u)
    a = irfft(_at_hz(G, rfftfreq(n, TS)) * rfft(u, n), n)[: len(u)]
    return _whole_record(u, a)


def _whole_record(u: Array, y: Array) -> FrequencyResponse:
    """Return the response of y (n,) to u (n,) at 1 kHz, from the spectra of the whole record."""
    hz = rfftfreq(len(u), TS)
    judged = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1])
    U, Y = (rfft(values)[judged] for values in (u, y))
    return FrequencyResponse(hz[judged], Y / U, np.ones(len(U)), np.abs(U) ** 2)


@dataclass(frozen=True, slots=True)
class Effect:
    """RMS contour errors of a rectangle, µm, on the printer as it is now: without compensation,
    and with the profile's."""

    none: float
    compensated: float

    @property
    def reduction(self) -> float:
        return 1.0 - self.compensated / self.none

    def as_text(self) -> str:
        return (
            f"on a 120 × 20 mm rectangle the profile leaves {self.compensated:.1f} of the "
            f"{self.none:.0f} µm without compensation"
        )


def effect(profile: Printer, found: Mapping[str, Drift]) -> Effect:
    """Return what the profile's commands do on the printer that was found. Raises HframeError."""
    Gxx, Gyy = (found[name].G for name in AXIS)
    now = replace(profile.plant, Gxx=Gxx, Gyy=Gyy)
    options = Options("racking", ("none", "racking"), clamp=True)
    study = Study(now, name=profile.name, exact=True)
    whole = simulate(lambda: rectangle(profile), profile, options, study).parts.whole
    none, compensated = (1e3 * whole[name].contour.rms for name in ("none", "racking"))
    return Effect(none, compensated)


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What drifted on the printer of a profile.

    found: by Gxx and Gyy. day: of the recordings. effect: None unless both axes were recorded.
    """

    profile: Printer
    found: Mapping[str, Drift]
    day: date
    effect: Effect | None = None

    @property
    def complete(self) -> bool:
        """Return whether both axes were recorded."""
        return self.found.keys() >= AXIS.keys()

    @property
    def moved(self) -> dict[str, ImpulseResponse]:
        """Return the new response of each axis if one drifted.

        One alone changes only if the profile's delay is that of a recording with a known start.
        """
        alike = self.complete or all(abs(one.later) < SAME_DELAY for one in self.found.values())
        if not alike or not any(one.certain for one in self.found.values()):
            return {}
        return {name: one.G for name, one in self.found.items()}

    @property
    def uncertainty(self) -> float:
        """Return that of the model today: that of its age, unless both axes are known by now."""
        aged = round(self.profile.uncertainty_on(self.day), 4)
        return min(DRIFT, aged or DRIFT) if self.complete else aged

    def as_text(self) -> str:
        rows = [(AXIS[name], one.as_text()) for name, one in self.found.items()]
        if not self.moved:
            drifted = any(one.certain for one in self.found.values())
            rows.append(("note", "its delay is not the profile's, so one axis alone cannot change"
                         if drifted else "nothing drifted: the model stays"))  # fmt: skip
        if self.effect is not None:
            rows.append(("effect", self.effect.as_text()))
        if not self.complete:
            rows.append(("note", "the other axis was not recorded: the date stays"))
        before = 100 * (self.profile.uncertainty or 0.0)
        rows.append(("uncertainty", f"±{100 * self.uncertainty:.1f} % ({before:.1f} % before)"))
        return "\n".join(f"{label:13s}{text}" for label, text in rows)

    def as_json(self) -> dict[str, Any]:
        return {
            "measured": self.day.isoformat(),
            "uncertainty": self.uncertainty,
            "functions": {name: one.as_json() for name, one in self.found.items()},
            "contour_error_um": self.effect and {
                "none": round(self.effect.none, 3), "racking": round(self.effect.compensated, 3),
            },
        }  # fmt: skip


def judged(profile: Printer, runs: Sequence[Run], day: date) -> CheckReport:
    """Return what drifted on a printer, and what its profile brings. Raises HframeError."""
    found = drifts(profile.plant, runs)
    complete = found.keys() >= AXIS.keys()
    return CheckReport(profile, found, day, effect(profile, found) if complete else None)
