"""The results of an identification as a page for a browser."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.fit import Fit
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.estimation.measured import Measured
from hframe_post.identification.identify import AXIS
from hframe_post.identification.report import COLUMNS, IdentificationReport, functions
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.page.charts import Card, Chart, Curve, Section, page

TITLES = {
    "Gxx": "x: from the motors to the nozzle (Gxx)",
    "Gyy": "y: from the motors to the nozzle (Gyy)",
    "Gxtheta": "Racking: from x to the rotation of the gantry (Gxθ)",
}
LEAST_SHOWN = 1e-3  # of |G|
RELIABLE = 0.5  # coherence below which the phase of a response is noise


def identification_page(report: IdentificationReport, name: str) -> bytes:
    identified = report.identified
    fits, measured = identified.fits, identified.measured
    modes = {axis: _strongest(fits[G]) for G, axis in AXIS.items() if G in fits}
    cards = [_ringing_card(axis, mode) for axis, mode in modes.items()]
    lead = ", ".join(_ringing(axis, mode) for axis, mode in modes.items()) + ". "
    if report.compensation is None:
        lead += "No profile can be made from these recordings."
    else:
        none, racking = (report.compensation.rms(strategy) for strategy in ("none", "racking"))
        most = report.compensation.most
        cards.append(Card("Predicted, rectangle", f"{racking:.1f}", "µm RMS",
                          f"up to {most:.1f} as the printer changes, {none:.0f} µm without "
                          "compensation", "best"))  # fmt: skip
        lead += (
            f"With compensation the nozzle would be {racking:.1f} µm (RMS) off a 120 × 20 mm "
            f"rectangle, up to {most:.1f} as the printer changes, instead of {none:.0f} µm."
        )
    plant = report.plant
    profiles = {"Gxx": plant.Gxx, "Gyy": plant.Gyy, "Gxtheta": plant.Gxtheta}
    sections = [
        Section(TITLES[G], _charts(G, measured[G], found, profiles[G])) for G, found in fits.items()
    ]
    facts = [
        (G, "; ".join(f"{column}: {text}" for column, text in zip(COLUMNS, row, strict=True)))
        for G, row in functions(identified).items()
    ]
    facts += report.gathered.rows()
    return page(name, lead, cards, sections, report.remarks(), facts)


def _strongest(found: Fit) -> tuple[float, float] | None:
    """Return Hz and damping ratio of the mode that rings most, None if none rings."""
    hz = np.array([hz for hz, _ in found.modes])
    strength = np.abs(_at(found.G, hz))
    return found.modes[int(strength.argmax())] if len(hz) else None


def _ringing(axis: str, mode: tuple[float, float] | None) -> str:
    if mode is None:
        return f"{axis} does not ring"
    return f"{axis} rings at {mode[0]:.0f} Hz, damping {mode[1]:.2f}"


def _ringing_card(axis: str, mode: tuple[float, float] | None) -> Card:
    if mode is None:
        return Card(f"{axis} rings at", "–", "", "no mode rings")
    return Card(f"{axis} rings at", f"{mode[0]:.1f}", "Hz", f"damping {mode[1]:.2f}")


def _charts(name: str, measured: Measured, found: Fit, held: ImpulseResponse | None) -> list[Chart]:
    """Return charts of the responses without the sensor's gain and the recording's delay.

    held: the response in the profile, which may say how well it is known.
    """
    mean, hz = measured.mean, measured.mean.hz
    runs = [(f"x = {at:.0f} mm", run, "") for at, run in measured.places]
    runs += [("mean", mean, "var(--ink)")] if len(runs) > 1 else []
    magnitudes, phases = list[Curve](), list[Curve]()
    for label, run, ink in runs:
        clean, model = _clean(run, found), _at(found.G, run.hz)
        near = degrees(model) + np.degrees(np.angle(clean / model))
        phase = np.where(run.coherence >= RELIABLE, near, np.nan)
        magnitudes.append(Curve(label, run.hz, decibel(clean), ink or None))
        phases.append(Curve(label, run.hz, phase, ink or None))
    model = _at(found.G, hz)
    for curves, shown in ((magnitudes, decibel(model)), (phases, degrees(model))):
        curves.append(Curve("model", hz, shown, "var(--racking)", strong=True, dashed=True))
    if held is not None and held.doubts:
        for label, size in (("model + 2 σ", 2.0), ("model − 2 σ", -2.0)):
            edge = np.maximum(np.abs(model) + size * uncertain(held, hz), LEAST_SHOWN)
            magnitudes.append(Curve(label, hz, decibel(edge.astype(complex)), "var(--soft)"))
    coherence = Curve("coherence", hz, mean.coherence, "var(--ink)")
    residual = Curve("residual", hz, np.abs(_clean(mean, found) / model - 1.0), "var(--fbs)")
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


def _clean(run: FrequencyResponse, found: Fit) -> Complex:
    """Return what was measured, without the sensor's gain and the recording's delay."""
    late = np.exp(2j * np.pi * run.hz * found.delay)
    return np.asarray(run.H * late / found.gain)


def uncertain(G: ImpulseResponse, hz: Array) -> Array:
    """Return the standard deviation of |G| at ``hz`` (k,), by drift and by what is not known."""
    doubts = [np.abs(_at(one, hz)) ** 2 for one in G.doubts]
    return np.asarray(np.sqrt(np.sum(doubts, axis=0)))


def decibel(H: Complex) -> Array:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(H), 1e-12)))


def degrees(H: Complex) -> Array:
    """Return the unwrapped phase of ``H`` in degrees."""
    return np.degrees(np.unwrap(np.angle(H)))
