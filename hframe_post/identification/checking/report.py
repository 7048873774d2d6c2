"""The result of a check, as text and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from hframe_post.identification.checking.evidence import Drift
from hframe_post.identification.identified import AXIS, LEAST_CHANGE
from hframe_post.model.impulse_response import Linear
from hframe_post.printer.settings import Printer


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What drifted on the printer of a profile. found: by Gxx and Gyy. day: of the recordings."""

    profile: Printer
    found: Mapping[str, Drift]
    day: date

    @property
    def complete(self) -> bool:
        """Return whether both axes were recorded."""
        return self.found.keys() >= AXIS.keys()

    @property
    def moved(self) -> dict[str, Linear]:
        """Return the new response of each axis that drifted beyond its uncertainty."""
        return {name: one.G for name, one in self.found.items() if one.certain}

    @property
    def uncertainty(self) -> float:
        """Return that of the model today: that of its age, unless both axes are known by now."""
        aged = round(self.profile.uncertainty_on(self.day), 4)
        found = self.found.values()
        if not self.complete or any(one.seen and not one.certain for one in found):
            return aged
        now = max(LEAST_CHANGE, *(one.uncertainty for one in found))
        return round(min(now, aged or now), 4)

    def as_text(self) -> str:
        rows = []
        for name, one in self.found.items():
            rows += [(AXIS[name], change.as_text()) for change in one.changes]
            old, new = (f"{100 * left:.0f} %" for left in one.left)
            kept = ""
            if not one.certain:
                cause = "no better where it was not fitted" if one.seen else "nothing drifted"
                kept = f": {cause}, so the model stays"
            rows.append((AXIS[name], f"unexplained {old} → {new}{kept}"))
        missing = [axis for name, axis in AXIS.items() if name not in self.found]
        rows += [
            ("note", f"{axis} was not recorded: its model and the date stay") for axis in missing
        ]
        before = 100 * (self.profile.uncertainty or 0.0)
        rows.append(("uncertainty", f"±{100 * self.uncertainty:.1f} % ({before:.1f} % before)"))
        return "\n".join(f"{label:13s}{text}" for label, text in rows)

    def as_json(self) -> dict[str, Any]:
        return {
            "measured": self.day.isoformat(),
            "uncertainty": self.uncertainty,
            "functions": {
                name: {
                    "drifted": one.certain,
                    "unexplained": [round(left, 4) for left in one.left],
                    "modes": [mode.as_json() for mode in one.modes],
                    **({"resonance": one.peak.as_json()} if one.peak else {}),
                }
                for name, one in self.found.items()
            },
        }
