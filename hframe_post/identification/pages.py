"""Pages for a browser: what `identify` measured and fitted, and the verdict of `verify`."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.identify import Measured
from hframe_post.identification.report import IdentificationReport
from hframe_post.identification.verification.verdict import Verdict
from hframe_post.model.strategies import STRATEGIES
from hframe_post.page.measured import Card, Chart, Line, Section, page
from hframe_post.plotting import decibel, degrees


def identification_page(report: IdentificationReport, name: str) -> bytes:
    """Return the page of an identification of the printer ``name``."""
    fits, measured = report.identified.fits, report.identified.measured
    cards = [
        Card(f"{name}: fit error", f"{100 * found.residual:.2f}", "%",
             f"order {found.order}; modes: "
             + (", ".join(f"{hz:.1f} Hz" for hz, _ in found.modes) or "none"))
        for name, found in fits.items()
    ]  # fmt: skip
    lead = "No profile can be made from these recordings."
    if report.compensation is not None:
        none, racking = (report.compensation.rms(strategy) for strategy in ("none", "racking"))
        cards.append(Card("Predicted, rectangle", f"{racking:.1f}", "µm RMS",
                          f"{none:.0f} µm without compensation", "best"))  # fmt: skip
        lead = (
            f"With this model the nozzle would stay within {racking:.1f} µm (RMS) of a 120 × 20 mm "
            f"rectangle, instead of {none:.0f} µm. Run 'hframe-post verify' to check it on the "
            "printer."
        )
    sections = [Section(name, _charts(name, measured[name], found)) for name, found in fits.items()]
    notes = report.as_text().partition("\n\n")[2].splitlines()  # without the table
    facts = [(name, _fact(measured[name], found)) for name, found in fits.items()]
    facts += [("data", line.strip()) for line in report.setup]
    return page(name, lead, cards, sections, notes, facts)


def _fact(measured: Measured, found: Fit) -> str:
    modes = ", ".join(f"{hz:.1f} Hz (damping {damping:.2f})" for hz, damping in found.modes)
    several = len(measured.places) > 1
    variation = f"; variation between positions {100 * measured.spread:.1f} %" if several else ""
    return f"modes: {modes or 'none'}; delay {found.printer_delay * 1e3:.2f} ms{variation}"


def _charts(name: str, measured: Measured, found: Fit) -> list[Chart]:
    """Return magnitude, phase, coherence and residual of a transfer function (Fig. 4 and 5)."""
    mean, hz = measured.mean, measured.mean.hz
    delay = np.exp(-2j * np.pi * hz * found.recording_delay)
    model = found.G.response(2.0 * np.pi * TS * hz) * delay
    racking, fbs = STRATEGIES["racking"].colour, STRATEGIES["fbs"].colour
    several = len(measured.places) > 1
    magnitude, phase = (
        [
            *(Line(f"x = {at:.0f} mm", run.hz, of(run.H)) for at, run in measured.places),
            *([Line("mean", hz, of(mean.H), "var(--ink)")] if several else []),
            Line("model", hz, of(model), racking, strong=True, dashed=True),
        ]
        for of in (decibel, degrees)
    )
    coherence = Line("coherence", hz, mean.coherence, "var(--ink)")
    residual = Line("residual", hz, np.abs(mean.H / model - 1.0), fbs)
    unit = "dB (rad/mm)" if name == "Gxtheta" else "dB (mm/mm)"
    frequency = "frequency, Hz"
    return [
        Chart("Magnitude", frequency, unit, magnitude, (True, False)),
        Chart("Phase", frequency, "°", phase, (True, False)),
        Chart("Coherence", frequency, "", [coherence], (True, False)),
        Chart("Residual of the model", frequency, "relative", [residual], (True, True)),
    ]


def verification_page(verdict: Verdict, name: str, setup: list[tuple[str, str]]) -> bytes:
    """Return the page of a verification of the printer ``name``; setup: labelled data."""
    measured, predicted, ringing = verdict.measured, verdict.predicted, verdict.ringing
    kind = "bad" if verdict.fault else "best"
    reduction = f"{100 * verdict.reduction:.0f}"
    cards = [
        Card("Reduction of contour error", reduction, "%",
             f"{100 * verdict.expected:.0f} % predicted", kind),
        Card("Measured", f"{measured[1]:.1f}", "µm RMS", f"{measured[0]:.1f} µm plain"),
        Card("Predicted", f"{predicted[1]:.1f}", "µm RMS", f"{predicted[0]:.1f} µm plain"),
        Card("Ringing after corners", f"{ringing[1]:.0f}", "mm/s²", f"{ringing[0]:.0f} plain"),
        Card("Model misses", f"{100 * verdict.unexplained:.0f}", "%",
             "of the nozzle's motion off its path"),
    ]  # fmt: skip
    lead = verdict.fault or (
        f"The profile helps: it reduces the contour error on the machine by {reduction} %."
    )
    charts = [
        Chart(title, "time, s", "µm", [
            Line("plain", verdict.at, errors[0], STRATEGIES["none"].colour),
            Line("compensated", verdict.at, errors[1], STRATEGIES["racking"].colour),
        ])
        for title, errors in (
            ("Contour error, measured", verdict.errors_measured),
            ("Contour error, predicted", verdict.errors_predicted),
        )
    ]  # fmt: skip
    notes = verdict.as_text().splitlines()[-1:]  # the verdict; the cards show the rest
    lead = lead[:1].upper() + lead[1:]
    return page(name, lead, cards, [Section("Along the motion", charts)], notes, setup)
