"""The page of a verification: the verdict, and the contour error as it was measured."""

from __future__ import annotations

from hframe_post.identification.verification.verdict import Verdict
from hframe_post.model.strategies import STRATEGIES
from hframe_post.page.measured import Card, Chart, Line, Section, page

TIME, UNIT = "time, s", "µm"


def verification_page(verdict: Verdict, name: str, setup: list[tuple[str, str]]) -> bytes:
    """name: of the printer; setup: the data."""
    measured, predicted = verdict.measured, verdict.predicted
    kind = "bad" if verdict.fault else "best"
    less = f"{100 * verdict.reduction:.0f}"
    cards = [
        Card("Less contour error", less, "%", f"{100 * verdict.expected:.0f} % predicted", kind),
        Card("Measured", f"{measured[1]:.1f}", "µm RMS", f"{measured[0]:.1f} µm plain"),
        Card("Predicted", f"{predicted[1]:.1f}", "µm RMS", f"{predicted[0]:.1f} µm plain"),
        Card("Ringing after corners", f"{verdict.ringing[1]:.0f}", "mm/s²",
             f"{verdict.ringing[0]:.0f} mm/s² plain"),
        Card("The model misses", f"{100 * verdict.unexplained:.0f}", "%",
             "of what the nozzle does beside its path"),
    ]  # fmt: skip
    lead = verdict.fault or f"The profile helps: {less} % less contour error on the machine."
    charts = [
        Chart(title, TIME, UNIT, [
            Line("plain", verdict.at, errors[0], STRATEGIES["none"].colour),
            Line("compensated", verdict.at, errors[1], STRATEGIES["racking"].colour),
        ])
        for title, errors in (
            ("Contour error, measured", verdict.errors_measured),
            ("Contour error, predicted", verdict.errors_predicted),
        )
    ]  # fmt: skip
    notes = verdict.as_text().splitlines()[-1:]  # the verdict; the cards have the rest
    return page(name, lead[:1].upper() + lead[1:], cards, [Section("Along the motion", charts)],
                notes, setup)  # fmt: skip
