"""The page of an identification: what was measured, what the model makes of it, what to doubt."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.identify import Measured
from hframe_post.identification.report import IdentificationReport
from hframe_post.model.strategies import STRATEGIES
from hframe_post.page.measured import Card, Chart, Line, Section, page
from hframe_post.plotting import decibel, degrees

FREQUENCY = "frequency, Hz"


def identification_page(report: IdentificationReport, name: str) -> bytes:
    """name: of the printer."""
    identified = report.identified
    cards = [_card(name, found) for name, found in identified.fits.items()]
    rectangle = report.compensation
    if rectangle is not None:
        none, racking = rectangle.rms("none"), rectangle.rms("racking")
        told = f"{none:.0f} µm without compensation"
        cards.append(Card("Predicted, rectangle", f"{racking:.1f}", "µm RMS", told, "best"))
        lead = (
            f"With this model the nozzle would stay within {racking:.1f} µm (RMS) of a 120 × 20 mm "
            f"rectangle, instead of {none:.0f} µm. 'hframe-post verify' shows whether it does."
        )
    else:
        lead = "No profile came of these recordings."
    sections = [
        Section(name, _charts(name, measured, identified.fits[name]))
        for name, measured in identified.measured.items()
        if name in identified.fits
    ]
    notes = report.as_text().partition("\n\n")[2].splitlines()  # what follows the table
    facts = [
        (name, _told(identified.measured[name], found)) for name, found in identified.fits.items()
    ]
    facts += [("data", line.strip()) for line in report.setup]
    return page(name, lead, cards, sections, notes, facts)


def _card(name: str, found: Fit) -> Card:
    modes = ", ".join(f"{hz:.1f} Hz" for hz, _ in found.modes) or "none rings"
    return Card(f"{name} is off by", f"{100 * found.residual:.2f}", "%",
                f"order {found.order}; {modes}")  # fmt: skip


def _told(measured: Measured, found: Fit) -> str:
    """What the cards leave out."""
    modes = ", ".join(f"{hz:.1f} Hz (damping {damping:.2f})" for hz, damping in found.modes)
    several = len(measured.places) > 1
    places = f", places differ by {100 * measured.spread:.1f} %" if several else ""
    return f"{modes or 'none rings'}; delay {found.printer_delay * 1e3:.2f} ms{places}"


def _charts(name: str, measured: Measured, found: Fit) -> list[Chart]:
    """Magnitude and phase as measured by place, together and fitted; coherence; what it is off."""
    mean, hz = measured.mean, measured.mean.hz
    model = found.G.response(2.0 * np.pi * TS * hz) * np.exp(
        -2j * np.pi * hz * found.recording_delay
    )
    racking, fbs = STRATEGIES["racking"].colour, STRATEGIES["fbs"].colour
    places = [(f"x = {place:.0f} mm", heard) for place, heard in measured.places]
    lines = {
        title: [
            *(Line(label, heard.hz, of(heard.H)) for label, heard in places),
            *([Line("together", hz, of(mean.H), "var(--ink)")] if len(places) > 1 else []),
            Line("model", hz, of(model), racking, strong=True, dashed=True),
        ]
        for title, of in (("Magnitude", decibel), ("Phase", degrees))
    }
    unit = "dB (rad/mm)" if name == "Gxtheta" else "dB (mm/mm)"
    off = np.abs(mean.H / model - 1.0)
    along = (True, False)
    return [
        Chart("Magnitude", FREQUENCY, unit, lines["Magnitude"], along),
        Chart("Phase", FREQUENCY, "°", lines["Phase"], along),
        Chart("Coherence", FREQUENCY, "", [Line("coherence", hz, mean.coherence, "var(--ink)")],
              along),
        Chart("What the model is off", FREQUENCY, "relative", [Line("off", hz, off, fbs)],
              (True, True)),
    ]  # fmt: skip
