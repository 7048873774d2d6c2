"""What is told of an identification: warnings in words, a text, JSON, notes for the profile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hframe_post.identification.diagnostics import natural
from hframe_post.identification.fit import Fit
from hframe_post.identification.identify import Identified
from hframe_post.identification.recommend import Recommendation
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction

POOR_FIT = 0.05  # weighted relative residual that deserves a word
SPREAD = 0.2  # of a transfer function over places, that deserves a word
LIGHTLY_DAMPED = 0.3  # damping ratio below which a pole rings


def modes(G: TransferFunction) -> list[tuple[float, float]]:
    """(Hz, damping ratio) of the poles that ring, lowest first."""
    upper = G.poles[G.poles.imag > 0.0]
    return sorted(natural(pole) for pole in upper)


def functions_table(identified: Identified) -> list[str]:
    """A row for each transfer function: order, residual, spread over places, delay, modes."""
    lines = [f"{'':10s}{'order':>6s}{'off by':>9s}{'places differ':>15s}{'delay':>10s}   modes"]
    for name, found in identified.fits.items():
        measured = identified.measured[name]
        ringing = [f"{hz:.1f} Hz ({damping:.2f})" for hz, damping in modes(found.G)]
        several = len(measured.places) > 1
        differ = f"{100 * measured.spread:.1f} %" if several else "one place"
        lines.append(
            f"{name:10s}{found.order:6d}{100 * found.residual:7.2f} %{differ:>15s}"
            f"{found.delay * 1e3:7.2f} ms   {', '.join(ringing) or 'none rings'}"
        )
    return lines


@dataclass(frozen=True, slots=True)
class IdentificationReport:
    """All that is told to the user.

    compensation: None where no window works. setup: the data, a line each. findings: warnings
    about the recordings.
    """

    identified: Identified
    plant: Plant
    compensation: Recommendation | None
    setup: list[str]
    findings: list[str]

    def warnings(self) -> list[str]:
        """In words, what the user should not rely on."""
        told = [*self.findings, *self.identified.warnings]
        for name, measured in self.identified.measured.items():
            if measured.spread > SPREAD:
                told.append(
                    f"{name}: differs by {100 * measured.spread:.0f} % over the gantry's "
                    "positions; one model cannot hold for all of them"
                )
        for name, found in self.identified.fits.items():
            told += [f"{name}: {text}" for text in found.warnings]
            if found.residual > POOR_FIT:
                told.append(
                    f"{name}: the model is off by {100 * found.residual:.0f} % of what was measured"
                )
            told += [f"{name}: {text}" for text in self._beyond_knots(found)]
        if "Gxtheta" not in self.identified.fits:
            told.append(
                "racking was not measured: the profile cancels ringing only. Sweep x at several "
                "places, or put sensors on both ends of the bridge"
            )
        elif self.identified.x_c is None:
            told.append(f"x_c was not measured: {self.plant.x_c:g} mm is taken")
        return told

    def _beyond_knots(self, found: Fit) -> list[str]:
        if self.compensation is None:
            return []
        L = self.compensation.windows[0].L
        nyquist = 500.0 / L
        return [
            f"rings at {hz:.1f} Hz, above the {nyquist:g} Hz that knots every {L} ms can follow"
            for hz, damping in modes(found.G)
            if hz > nyquist and damping < LIGHTLY_DAMPED
        ]

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for ``json.dumps``."""
        return {
            "functions": {name: self._function(name) for name in self.identified.fits},
            "x_c": {"mm": round(self.plant.x_c, 3), "measured": self.identified.x_c is not None},
            **(self.compensation.as_json() if self.compensation else {}),
            "setup": self.setup,
            "warnings": self.warnings(),
            "notes": self.notes(),
        }

    def _function(self, name: str) -> dict[str, Any]:
        found, measured = self.identified.fits[name], self.identified.measured[name]
        return {
            "order": found.order,
            "residual": round(found.residual, 6),
            "delay_ms": round(found.delay * 1e3, 4),
            "spread": round(measured.spread, 6),
            "runs": len(measured.places),
            "modes": [
                {"hz": round(hz, 3), "damping": round(damping, 4)} for hz, damping in modes(found.G)
            ],
        }

    def as_text(self) -> str:
        """A table for a person."""
        lines = functions_table(self.identified)
        measured = "" if self.identified.x_c is not None else " (not measured)"
        lines += [
            "",
            f"x_c         {self.plant.x_c:.2f} mm{measured}",
            *(self.compensation.as_text() if self.compensation else []),
            *(f"note        {text}" for text in self.notes()),
            *(f"WARNING     {text}" for text in self.warnings()),
        ]
        return "\n".join(lines)

    def notes(self) -> list[str]:
        """In words, what is as usual but good to know."""
        fits = self.identified.fits.items()
        return [f"{name}: {text}" for name, found in fits for text in found.notes]

    def origin(self) -> list[str]:
        """What stands in the profile, above the plant."""
        rows = []
        for name in self.identified.fits:
            told = self._function(name)
            rows.append(
                f"{name}: order {told['order']}, off the measurement by "
                f"{100 * told['residual']:.2f} %, {told['runs']} runs"
            )
        gain = [self.compensation.gain()] if self.compensation else []
        return ["Identified by hframe-post from:", *self.setup, *rows, *gain]
