"""What is told of an identification: warnings in words, a text, JSON, notes for the profile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hframe_post.identification.fitting.recommend import Recommendation
from hframe_post.identification.identify import Identified
from hframe_post.model.plant import Plant

SPREAD = 0.2  # of a transfer function over places, that deserves a word
OFF = 0.005  # of a sensor's gain, that deserves a word
ONE_MODEL = "The profile's one model is that of the middle"


def functions_table(identified: Identified) -> list[str]:
    """A row for each transfer function: order, residual, spread over places, delay, modes."""
    lines = [f"{'':10s}{'order':>6s}{'off by':>9s}{'places differ':>15s}{'delay':>10s}   modes"]
    for name, found in identified.fits.items():
        measured = identified.measured[name]
        ringing = [f"{hz:.1f} Hz ({damping:.2f})" for hz, damping in found.modes]
        several = len(measured.places) > 1
        differ = f"{100 * measured.spread:.1f} %" if several else "one place"
        lines.append(
            f"{name:10s}{found.order:6d}{100 * found.residual:7.2f} %{differ:>15s}"
            f"{found.printer_delay * 1e3:7.2f} ms   {', '.join(ringing) or 'none rings'}"
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
        """In words, what the user should not rely on, and what it costs."""
        identified = self.identified
        told = [*self.findings, *identified.warnings]
        if identified.nonlinearity is not None:
            told.append(
                identified.nonlinearity.message + self._stays(identified.nonlinearity.share)
            )
        if identified.mode_shift is not None:
            told.append(f"{identified.mode_shift.message}. {ONE_MODEL}{self._elsewhere()}")
        elif identified.measured["Gxx"].spread > SPREAD:
            told.append(
                f"Gxx differs by {100 * identified.measured['Gxx'].spread:.0f} % over the gantry's "
                "positions; one model cannot hold for all of them"
                + self._stays(identified.measured["Gxx"].spread)
            )
        for name, found in identified.fits.items():
            if identified.nonlinearity is None and identified.mode_shift is None:
                told += [f"{name}: {text}" + self._stays(found.residual) for text in found.warnings]
        racking = "Gxtheta" in identified.fits
        if not racking and identified.racks and not identified.racking_below_noise:
            told.append(
                "racking was not measured: the profile cancels ringing only. Sweep x at several "
                "places, or put sensors on both ends of the bridge"
            )
        elif racking and identified.x_c is None:
            told.append(f"x_c was not measured: {self.plant.x_c:g} mm is taken")
        return told

    def _stays(self, share: float) -> str:
        """What a share of the motion that no model explains may cost."""
        if self.compensation is None:
            return ""
        none = self.compensation.rms("none")
        return f". Of {none:.0f} µm without compensation up to {share * none:.0f} µm may stay"

    def _elsewhere(self) -> str:
        if self.compensation is None or not self.compensation.rms_at_ends:
            return ""
        worst = max(self.compensation.rms_at_ends)
        return f". At the ends the rectangle would be {worst:.0f} µm off"

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for ``json.dumps``."""
        gains = self.identified.gains.items()
        return {
            "functions": {name: self._function(name) for name in self.identified.fits},
            "x_c": {"mm": round(self.plant.x_c, 3), "measured": self.identified.x_c is not None},
            "uncertainty": {
                "share": round(self.identified.model_error, 5),
                **{
                    name: {"hz": one.hz, "damping": one.damping, "gain": one.gain}
                    for name, one in self.identified.uncertainties.items()
                },
                **self._of_centre(),
            },
            "sensor_gain": {axis: round(gain, 5) for axis, gain in gains},
            **(self.compensation.as_json() if self.compensation else {}),
            "setup": self.setup,
            "warnings": self.warnings(),
            "notes": self.notes(),
        }

    def _of_centre(self) -> dict[str, float]:
        if self.identified.lever_arm_sd is None:
            return {}
        x_c, size = self.identified.lever_arm_sd
        return {"x_c_mm": round(x_c, 4), "racking": round(size, 5)}

    def _function(self, name: str) -> dict[str, Any]:
        found, measured = self.identified.fits[name], self.identified.measured[name]
        return {
            "order": found.order,
            "residual": round(found.residual, 6),
            "delay_ms": round(found.printer_delay * 1e3, 4),
            "recording_late_ms": round(found.recording_delay * 1e3, 4),
            "spread": round(measured.spread, 6),
            "runs": len(measured.places),
            "modes": [
                {"hz": round(hz, 3), "damping": round(damping, 4)} for hz, damping in found.modes
            ],
        }

    def as_text(self) -> str:
        """A table for a person."""
        lines = [*functions_table(self.identified), ""]
        if "Gxtheta" in self.identified.fits:
            measured = "" if self.identified.x_c is not None else " (not measured)"
            lines.append(f"x_c         {self.plant.x_c:.2f} mm{measured}")
        lines += [
            f"sensor      {self._sensor()}",
            *(f"known to    {text}" for text in self._known()),
            *(self.compensation.as_text() if self.compensation else []),
            *(f"note        {text}" for text in self.notes()),
            *(f"WARNING     {text}" for text in self.warnings()),
        ]
        return "\n".join(lines)

    def _known(self) -> list[str]:
        """Twice the standard deviations, a line for each function, and what `tune` makes of it."""
        found = self.identified
        lines = []
        for name, one in found.uncertainties.items():
            hz = ", ".join(f"±{200.0 * sd:.2f} %" for sd in one.hz)
            lines.append(f"{name}: modes {hz}; gain ±{200.0 * one.gain:.2f} %")
        if found.lever_arm_sd is not None:
            x_c, size = found.lever_arm_sd
            lines.append(f"x_c ±{2.0 * x_c:.2f} mm, racking ±{200.0 * size:.2f} %")
        return [*lines, f"the printer, from day to day: {100.0 * found.model_error:.1f} %"]

    def _sensor(self) -> str:
        reads = []
        for axis, gain in self.identified.gains.items():
            off = gain - 1.0
            how = f"{100 * abs(off):.1f} % {'high' if off > 0.0 else 'low'}"
            reads.append(f"{how if abs(off) > OFF else 'right'} in {axis}")
        return f"reads {', '.join(reads)}; taken out of the model"

    def notes(self) -> list[str]:
        """In words, what is as usual but good to know."""
        told = []
        if self.identified.racking_below_noise:
            told.append("racking is less than its own uncertainty: the profile has none")
        fits = self.identified.fits.items()
        return told + [f"{name}: {text}" for name, found in fits for text in found.notes]

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
