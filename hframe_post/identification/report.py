"""The results of an identification as text, as JSON and as a page for a browser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification import verdict
from hframe_post.identification.estimation.fit import Fit
from hframe_post.identification.estimation.measured import Measured
from hframe_post.identification.gather import Gathered
from hframe_post.identification.identify import AXIS, Identified, MeasurementSettings, identify
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.page.charts import Card, Chart, Curve, Section, page
from hframe_post.printer.settings import Printer
from hframe_post.studies.tuning import Recommendation, recommend


def conclude(
    gathered: Gathered, profile: Printer, settings: MeasurementSettings
) -> IdentificationReport:
    """Identify the printer of a profile from gathered runs, and report it. Raises HframeError."""
    found = identify(gathered.runs, settings)
    middle = sum(profile.travel.x) / 2.0
    plant, compensation = found.plant(middle), None
    if found.refusal is None:
        compensation = recommend(plant, profile, found.model_error)
    return IdentificationReport(found, plant, compensation, gathered)


CORRECT = 5e-3  # error of a sensor that is not worth a word; of its motion, too
COLUMNS = ("unexplained", "variation", "lag", "modes")


def functions(identified: Identified) -> dict[str, tuple[str, str, str, str]]:
    """Return what is known of each response, by its name, as texts of COLUMNS."""
    rows = {}
    for name, found in identified.fits.items():
        measured = identified.measured[name]
        several = len(measured.places) > 1
        rows[name] = (
            f"{100 * found.residual:.2f} %",
            f"{100 * measured.spread:.1f} %" if several else "–",
            f"{round(found.lag * 1e3, 2) + 0.0:.2f} ms",
            ", ".join(f"{hz:.1f} Hz ({damping:.2f})" for hz, damping in found.modes) or "none",
        )
    return rows


@dataclass(frozen=True, slots=True)
class IdentificationReport:
    """Everything that is reported to the user.

    compensation: None if no window works. gathered: the recordings, used and not.
    """

    identified: Identified
    plant: Plant
    compensation: Recommendation | None
    gathered: Gathered

    def warnings(self) -> list[str]:
        """Return what the user should not rely on, with the contour error that may remain."""
        identified, messages = self.identified, list[str]()
        for name in identified.axes:
            axis, share = AXIS[name], identified.fits[name].residual
            measured = identified.measured[name]
            if measured.excited_hz[1] < verdict.TESTED_BAND * measured.mean.hz[-1]:
                messages.append(
                    f"{axis} was tested up to {measured.excited_hz[1]:.0f} Hz, so what rings above "
                    "is not known. Test up to 135 Hz (max_freq of [resonance_tester])"
                )
            if share > verdict.MISFIT:
                messages.append(
                    f"{100 * share:.0f} % of what {axis} does is not linear in its command: look "
                    "for friction, play and loose parts" + self._uncompensated(share)
                )
        if identified.changes:
            spread = identified.measured["Gxx"].spread
            messages.append(identified.changes + self._uncompensated(spread))
        racks = identified.racks and "Gxx" in identified.fits
        if racks and not (identified.racking_below_noise or "Gxtheta" in identified.fits):
            messages.append(
                "racking was not measured: on an H-bot the profile cancels ringing only. Test x at "
                "several places, 20 mm apart or more, to measure it; a CoreXY does not rack"
            )
        return messages

    def _uncompensated(self, share: float) -> str:
        """Return the contour error that may remain if a share of the motion is not explained."""
        if self.compensation is None:
            return ""
        none = self.compensation.rms("none")
        return f". Up to {share * none:.0f} of the {none:.0f} µm without compensation may remain"

    def notes(self) -> list[str]:
        missing = [axis for axis in "xy" if axis not in self.identified.gains]
        notes = list[str]()
        if missing:
            notes.append(f"{missing[0]} was not recorded, so the profile compensates nothing in it")
        elif self.identified.racking_below_noise:
            notes.append("racking is too small to measure here: the profile cancels ringing only")
        return notes

    def as_text(self) -> str:
        used = [f"{label:13s}{text}" for label, text in self.gathered.rows()]
        rows = {"": COLUMNS, **functions(self.identified)}
        table = [f"{name:10s}{a:>11s}{b:>13s}{c:>10s}   {d}" for name, (a, b, c, d) in rows.items()]
        return "\n".join([*used, "", *table, "", *self.remarks()])

    def remarks(self) -> list[str]:
        """Return what is known in addition to the functions, a line each."""
        rows = []
        if "Gxtheta" in self.identified.fits:
            rows.append(("x_c", f"{self.plant.x_c:.2f} mm"))
        rows.append(("sensor", self._sensor()))
        error = f"whole model, with day-to-day change: ±{100.0 * self.identified.model_error:.1f} %"
        rows.append(("uncertainty", error))
        repeats = [
            f"recordings of {AXIS[name]} differ by {100 * share:.0f} %"
            for name, share in self.identified.repetitions.items()
        ]
        rows += [("repeats", ", ".join(repeats))] if repeats else []
        rows += self.compensation.rows() if self.compensation else []
        rows += [("note", text) for text in self.notes()]
        rows += [("WARNING", text) for text in self.warnings()]
        return [f"{label:13s}{text}" for label, text in rows]

    def _sensor(self) -> str:
        errors, found = [], self.identified
        for name in found.axes:
            off, measured = found.fits[name].gain - 1.0, found.measured[name]
            # recordings of a test in two directions differ by where its axes seem to lie, too
            repeats = 0.0 if measured.known_start else measured.spread
            doubt = max(found.fits[name].gain_sd, repeats, CORRECT)
            how = f"{100 * abs(off):.1f} % too {'high' if off > 0.0 else 'low'}"
            if abs(off) <= doubt:
                how = f"correctly as far as known (±{100 * doubt:.1f} %)"
            errors.append(f"{how} in {AXIS[name]}")
        return f"reads {', '.join(errors)} (allowed for)"

    def as_json(self) -> dict[str, Any]:
        identified = self.identified
        return {
            "functions": {name: self._function(name) for name in identified.fits},
            "x_c": {"mm": round(self.plant.x_c, 3), "measured": identified.x_c is not None},
            "uncertainty": {"share": round(identified.model_error, 5)},
            "repeats": {name: round(share, 4) for name, share in identified.repetitions.items()},
            "sensor_gain": {axis: round(gain, 5) for axis, gain in identified.gains.items()},
            **(self.compensation.as_json() if self.compensation else {}),
            **self.gathered.as_json(),
            "warnings": self.warnings(),
            "notes": self.notes(),
        }

    def _function(self, name: str) -> dict[str, Any]:
        found, measured = self.identified.fits[name], self.identified.measured[name]
        return {
            "residual": round(found.residual, 6),
            "lag_ms": round(found.lag * 1e3, 4),
            "recording_late_ms": round(found.delay * 1e3, 4),
            "spread": round(measured.spread, 6),
            "runs": len(measured.places),
            "modes": [
                {"hz": round(hz, 3), "damping": round(damping, 4)} for hz, damping in found.modes
            ],
        }

    def _facts(self) -> list[tuple[str, str]]:
        """Return what is known of each response, labelled."""
        return [
            (G, "; ".join(f"{column}: {text}" for column, text in zip(COLUMNS, row, strict=True)))
            for G, row in functions(self.identified).items()
        ]

    def origin(self) -> list[str]:
        """Return what the profile's model is from, a line each."""
        used = self.gathered.used
        recordings = [f"  {one.label}, {one.motion}, sha256 {one.source.digest}" for one in used]
        gain = [f"predicted {self.compensation.gain()}"] if self.compensation else []
        known = [f"{G}: {text}" for G, text in self._facts()]
        return ["Identified by hframe-post from:", *recordings, *known, *gain]

    def page(self, name: str) -> bytes:
        """Return the report as a page for a browser, of the printer with this name."""
        fits, cards, lead = self.identified.fits, list[Card](), list[str]()
        for G in self.identified.axes:
            axis, (hz, damping) = AXIS[G], _strongest(fits[G])
            if hz:
                lead.append(f"{axis} rings at {hz:.0f} Hz, damping {damping:.2f}")
                cards.append(Card(f"{axis} rings at", f"{hz:.1f}", "Hz", f"damping {damping:.2f}"))
            else:
                lead.append(f"{axis} does not ring")
                cards.append(Card(f"{axis} rings at", "–", "", "no mode rings"))
        predicted = "No profile can be made from these recordings."
        if self.compensation is not None:
            none, racking = (self.compensation.rms(strategy) for strategy in ("none", "racking"))
            up_to = f"up to {self.compensation.most:.1f} as the printer changes"
            cards.append(Card("Predicted, rectangle", f"{racking:.1f}", "µm RMS",
                              f"{up_to}, {none:.0f} µm without compensation", "best"))  # fmt: skip
            predicted = (
                f"With compensation the nozzle would be {racking:.1f} µm (RMS) off a 120 × 20 mm "
                f"rectangle, {up_to}, instead of {none:.0f} µm."
            )
        measured = self.identified.measured
        sections = [
            Section(TITLES[G], _charts(G, measured[G], found, getattr(self.plant, G)))
            for G, found in fits.items()
        ]
        facts = [*self._facts(), *self.gathered.rows()]
        text = f"{', '.join(lead)}. {predicted}"
        return page(name, text, cards, sections, self.remarks(), facts)


# ---------------------------------------------------------------------- charts

TITLES = {
    "Gxx": "x: from the motors to the nozzle (Gxx)",
    "Gyy": "y: from the motors to the nozzle (Gyy)",
    "Gxtheta": "Racking: from x to the rotation of the gantry (Gxθ)",
}
LEAST_SHOWN = 1e-3  # of |G|
RELIABLE = 0.5  # coherence below which the phase of a response is noise


def _strongest(found: Fit) -> tuple[float, float]:
    """Return Hz and damping ratio of the mode that rings most, zeros if none rings."""
    strength = np.abs(_at(found.G, np.array([hz for hz, _ in found.modes])))
    return found.modes[int(strength.argmax())] if len(strength) else (0.0, 0.0)


def _charts(name: str, measured: Measured, found: Fit, held: ImpulseResponse | None) -> list[Chart]:
    """Return charts of the responses without the sensor's gain and the recording's delay.

    held: the response in the profile, which may say how well it is known.
    """
    mean, hz = measured.mean, measured.mean.hz
    runs = [(f"x = {at:.0f} mm", run, "") for at, run in measured.places]
    runs += [("mean", mean, "var(--ink)")] if len(runs) > 1 else []
    magnitudes, phases = list[Curve](), list[Curve]()
    for label, run, ink in runs:
        clean, model = run.corrected(found.gain, found.delay).H, _at(found.G, run.hz)
        near = degrees(model) + np.degrees(np.angle(clean / model))
        phase = np.where(run.coherence >= RELIABLE, near, np.nan)
        magnitudes.append(Curve(label, run.hz, decibel(clean), ink or None))
        phases.append(Curve(label, run.hz, phase, ink or None))
    model, clean = _at(found.G, hz), mean.corrected(found.gain, found.delay).H
    for curves, shown in ((magnitudes, decibel(model)), (phases, degrees(model))):
        curves.append(Curve("model", hz, shown, "var(--racking)", strong=True, dashed=True))
    if held is not None and held.doubts:
        for label, size in (("model + 2 σ", 2.0), ("model − 2 σ", -2.0)):
            edge = np.maximum(np.abs(model) + size * uncertain(held, hz), LEAST_SHOWN)
            magnitudes.append(Curve(label, hz, decibel(edge.astype(complex)), "var(--soft)"))
    coherence = Curve("coherence", hz, mean.coherence, "var(--ink)")
    residual = Curve("residual", hz, np.abs(clean / model - 1.0), "var(--fbs)")
    unit = "dB (rad/mm)" if name == "Gxtheta" else "dB (mm/mm)"
    peaks, frequency = [(at, f"{at:.1f} Hz") for at, _ in found.modes], "frequency, Hz"
    return [
        Chart("Magnitude", frequency, unit, magnitudes, (True, False), peaks),
        Chart("Phase, where the coherence is above 0.5", frequency, "°", phases, (True, False)),
        Chart("Coherence", frequency, "", [coherence], (True, False)),
        Chart("Residual of the model", frequency, "relative", [residual], (True, True)),
    ]


def _at(G: ImpulseResponse, hz: Array) -> Complex:
    return G.response(2.0 * np.pi * TS * hz)


def uncertain(G: ImpulseResponse, hz: Array) -> Array:
    """Return the standard deviation of |G| at ``hz`` (k,), by drift and by what is not known."""
    doubts = [np.abs(_at(one, hz)) ** 2 for one in G.doubts]
    return np.asarray(np.sqrt(np.sum(doubts, axis=0)))


def decibel(H: Complex) -> Array:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(H), 1e-12)))


def degrees(H: Complex) -> Array:
    """Return the unwrapped phase of ``H`` in degrees."""
    return np.degrees(np.unwrap(np.angle(H)))
