"""What both recordings of a verification tell, and whether the profile stands."""

from __future__ import annotations

from dataclasses import dataclass

from hframe_post.arrays import Array

HELPS = 0.2  # reduction below which a profile is not worth its risk
AS_PREDICTED = 0.6  # of the predicted reduction, at least
UNEXPLAINED = 0.34  # of what the nozzle does beside its path, that the model may miss
RACKS_ALIKE = 0.4  # relative, by which racking may differ from the model's,
SURE = 3.0  # and standard deviations of it besides


@dataclass(frozen=True, slots=True)
class Verdict:
    """What both recordings tell, µm RMS of contour error and mm/s² RMS of ringing after corners.

    Each pair: plain, compensated. unexplained: of what the nozzle does beside its path, the share
    that the model did not predict. racking: what the gantry racks, of what the model says, and
    its standard deviation; None where the model's racking is none. at (n,): s, of the errors (n,)
    in µm along the motion.
    """

    measured: tuple[float, float]
    predicted: tuple[float, float]
    ringing: tuple[float, float]
    unexplained: float
    racking: tuple[float, float] | None
    at: Array
    errors_measured: tuple[Array, Array]
    errors_predicted: tuple[Array, Array]

    @property
    def reduction(self) -> float:
        """Of the measured contour error, by compensation; negative where it is worse."""
        plain, compensated = self.measured
        return 1.0 - compensated / plain

    @property
    def expected(self) -> float:
        """The same as the model predicts it."""
        plain, compensated = self.predicted
        return 1.0 - compensated / plain

    @property
    def fault(self) -> str | None:
        """Why the profile does not stand; None if it does."""
        if self.reduction <= 0.0:
            return (
                "compensation makes this printer WORSE: the profile is not that of this printer, "
                "or the printer has changed. Do not print with it; sweep and identify again"
            )
        if self.unexplained > UNEXPLAINED:
            return (
                f"the model misses {100 * self.unexplained:.0f} % of what the nozzle does: the "
                "profile is not that of this printer as it is now. Sweep and identify again"
            )
        if self.racking is not None:
            times, unsure = self.racking
            if abs(times - 1.0) > RACKS_ALIKE + SURE * unsure:
                how = "the other way, " if times < 0.0 else ""
                return (
                    f"the gantry racks {how}{abs(times):.1f} times as far as the model says: "
                    "exchanged files, another x_c, or another printer. Sweep and identify again"
                )
        if self.reduction < max(HELPS, AS_PREDICTED * self.expected):
            return (
                f"compensation takes {100 * self.reduction:.0f} % off the error, not the "
                f"{100 * self.expected:.0f} % that the model promises: sweep and identify again"
            )
        return None

    def as_text(self) -> str:
        """For a person."""
        rows = [
            ("contour error measured", self.measured, "µm"),
            ("contour error predicted", self.predicted, "µm"),
            ("ringing after corners", self.ringing, "mm/s²"),
        ]
        lines = [f"{'RMS':26s}{'plain':>10s}{'compensated':>14s}"]
        lines += [f"{name:26s}{a:10.1f}{b:14.1f}  {unit}" for name, (a, b), unit in rows]
        lines.append(f"{'the model misses':26s}{100 * self.unexplained:10.0f} %")
        if self.racking is not None:
            times, unsure = self.racking
            lines.append(f"{'racking, of the model’s':26s}{times:10.2f} ± {unsure:.2f}")
        word = self.fault or f"compensation takes {100 * self.reduction:.0f} % off the error"
        return "\n".join([*lines, f"VERDICT     {'FAILED: ' if self.fault else 'good: '}{word}"])

    def as_json(self) -> dict[str, object]:
        """Ready for ``json.dumps``."""
        pairs = {"measured_um": self.measured, "predicted_um": self.predicted,
                 "ringing": self.ringing}  # fmt: skip
        told = {
            name: {"plain": round(a, 3), "compensated": round(b, 3)}
            for name, (a, b) in pairs.items()
        }
        return {
            **told, "reduction": round(self.reduction, 4), "expected": round(self.expected, 4),
            "unexplained": round(self.unexplained, 4),
            "racking": None if self.racking is None else [round(one, 4) for one in self.racking],
            "fault": self.fault,
        }  # fmt: skip
