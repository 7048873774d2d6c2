"""The result of a check, as text and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from hframe_post.identification.identified import AXIS, LEAST_CHANGE
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.printer.settings import Printer

NOTICED = 2.0  # standard deviations


@dataclass(frozen=True, slots=True)
class Peak:
    """The main resonance before and now: Hz, and |G| there. sd: of both now."""

    hz: tuple[float, float]
    height: tuple[float, float]
    sd: tuple[float, float]

    @property
    def certain(self) -> bool:
        """Return whether the resonance moved by more than its uncertainty."""
        return abs(self.hz[1] - self.hz[0]) > NOTICED * self.sd[0]

    def as_text(self) -> str:
        (f0, f1), (h0, h1) = self.hz, self.height
        hz, height = (NOTICED * sd for sd in self.sd)
        how = f"moved from {f0:.1f} to {f1:.1f} Hz" if self.certain else f"stays at {f0:.1f} Hz"
        peak = f"its peak {h0:.1f} → {h1:.1f} (±{height:.1f})"
        return f"the main resonance {how} (±{max(hz, 0.1):.1f}), {peak}"

    def as_json(self) -> dict[str, Any]:
        return {
            name: [round(one, 4) for one in getattr(self, name)] for name in ("hz", "height", "sd")
        }


@dataclass(frozen=True, slots=True)
class Drift:
    """A response as it is now.

    seen: whether the fitted motion shows a change. left: share of the unseen response that the old
    and the new model leave. peak: the main resonance. modes: Hz of each before and now.
    """

    G: ImpulseResponse
    seen: bool
    left: tuple[float, float]
    peak: Peak
    modes: tuple[tuple[float, float], ...]

    @property
    def uncertainty(self) -> float:
        """Return that of the new model, as ``plant.uncertainty``."""
        return NOTICED * self.peak.sd[0] / self.peak.hz[1]

    @property
    def certain(self) -> bool:
        """Return whether the new model is also better where it was not fitted."""
        return self.seen and self.left[1] < self.left[0]


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
    def moved(self) -> dict[str, ImpulseResponse]:
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
            rows.append((AXIS[name], one.peak.as_text()))
            if one.certain and len(one.modes) > 1:
                each = ", ".join(f"{before:.1f} → {now:.1f} Hz" for before, now in one.modes)
                rows.append((AXIS[name], f"modes {each}"))
            old, new = (f"{100 * left:.0f} %" for left in one.left)
            kept = ""
            if not one.certain:
                cause = "no better where it was not fitted" if one.seen else "nothing drifted"
                kept = f": {cause}, so the model stays"
            rows.append((AXIS[name], f"unexplained {old} → {new}{kept}"))
        missing = [axis for name, axis in AXIS.items() if name not in self.found]
        rows += [
            ("note", f"{one} was not recorded: its model and the date stay") for one in missing
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
                    "resonance": one.peak.as_json(),
                    "modes_hz": [[round(hz, 3) for hz in mode] for mode in one.modes],
                }
                for name, one in self.found.items()
            },
        }
