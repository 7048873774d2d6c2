"""The report of a conversion: rows, each with a line for people and keys for programs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, NamedTuple, Self

from hframe_post.compensation.shape import SHAPER
from hframe_post.conversion.ledger import SLIGHT, Ledger, percent, warnings
from hframe_post.conversion.options import Options
from hframe_post.firmware.base import Firmware
from hframe_post.model.shapers import Shaping
from hframe_post.model.strategies import STRATEGIES
from hframe_post.prediction.error_meter import PIECE_MM
from hframe_post.printer.settings import Printer
from hframe_post.writers.print_time import duration

VISIBLE = 0.012  # mm RMS; ringing below it shows on no wall, whatever the light
NO_GAIN = 0.9  # share of the best shaper's error from which on compensation is not worth its stream


@dataclass(frozen=True, slots=True)
class Row:
    """A figure of the report. label, text: its line, if any; keys: of the JSON, None for none."""

    label: str
    text: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.label:17s}{self.text}"


class PrintTime(NamedTuple):
    """Duration of the print, s: as the firmware plays the sliced file, and as converted."""

    before: float
    after: float

    @property
    def change(self) -> float:
        """Return by which share the print takes longer."""
        return self.after / self.before - 1.0 if self.before else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Report(Ledger):
    """What one conversion did: its ledger, and what it was made for.

    player: the firmware that plays the output; None if none does. speed: rows on how accuracy was
    traded for speed. notices: warnings that no figure tells. capped: whether limits of the profile
    bind what the file asks. shaping: the best input shaper, whose errors stand among the others.
    predicted_sliced: share of the print whose errors as sliced are predicted.
    """

    printer: Printer = field(repr=False)
    options: Options
    player: Firmware | None = field(default=None, compare=False, repr=False)
    speed: tuple[Row, ...] = ()
    notices: tuple[str, ...] = ()
    capped: bool = True
    shaping: Shaping | None = None
    predicted_sliced: float = 1.0

    @classmethod
    def from_ledger(cls, ledger: Ledger, **more: Any) -> Self:
        """Return a report with all fields of a ledger, or of a report, and more."""
        return cls(**{each.name: getattr(ledger, each.name) for each in fields(ledger)}, **more)

    @property
    def strategy(self) -> str:
        """Return whose commands were written."""
        return self.options.strategy

    @property
    def time(self) -> PrintTime:
        """Return the duration of the print."""
        return PrintTime(self.sliced_s + self.elsewhere, self.duration + self.elsewhere)

    @property
    def predicted(self) -> float:
        """Return the share of the print whose errors are predicted; they stand for all."""
        return (self.judged or self.samples) / max(self.samples, 1)

    @property
    def filament_after(self) -> float | None:
        """Return the filament (mm) of the output; None if nothing is written."""
        return self.written.filament if self.written.lines else None

    @property
    def strategies(self) -> list[str]:
        """Return the strategies whose errors are predicted."""
        return [name for name in STRATEGIES if name in self.contour]

    def label(self, name: str) -> str:
        """Return what a strategy compensates on this printer, or a shaper's name."""
        if name == SHAPER:
            return "best input shaper"
        couples = self.printer.kinematics.racks and self.printer.plant.Gxtheta is not None
        return STRATEGIES[name].label if couples or name == "none" else "ringing"

    # ------------------------------------------------------------------ as text and as JSON

    def as_json(self) -> dict[str, Any]:
        """Return all figures, ready for ``json.dumps``."""
        found: dict[str, Any] = {"warnings": self.warnings(), "compensation": self.strategy}
        for row in (*self._first(), *self._advice(), *self._figures()):
            found |= {key: value for key, value in row.keys.items() if value is not None}
        return found

    def as_text(self) -> str:
        """Return a few lines for a person."""
        return self.summary(())

    def summary(self, head: Iterable[str]) -> str:
        """Return notices and what an owner asks first, then the head, then all figures."""
        found = [Row("WARNING", text) for text in self.warnings()]
        notices, others = found[: len(self.notices)], found[len(self.notices) :]
        first = [*notices, *self._first(), *others, *self._advice()]
        rows = [*first, *head, *self._figures()]
        return "\n".join(str(row) for row in rows if not isinstance(row, Row) or row.text)

    def _first(self) -> list[Row]:
        """Return what an owner asks first: what the print gains, its time, and what is left out."""
        result, found = "", self.contour
        if self.strategy == "none":
            result = "nothing is compensated (-c none)"
        elif {"none", self.strategy} <= found.keys():
            result = f"{self.label(self.strategy)} {1e3 * found['none'].expected:.1f} → "
            result += found[self.strategy].as_text()
            if SHAPER in found:
                result += f"; the best input shaper would leave {1e3 * found[SHAPER].expected:.1f}"
        return [Row("result", result), self._print_time(), self._uncompensated()]

    def _print_time(self) -> Row:
        """Return both times, and which limits cost the difference if it is worth a word."""
        before, after = self.time
        text = f"{duration(before)} → {duration(after)} ({100.0 * self.time.change:+.1f} %)"
        if self.time.change >= SLIGHT and self.slowed:
            text += f": the limits in [motors] slow down {percent(self.slowed)} of the path"
        elif self.time.change >= SLIGHT and self.capped:
            text += ": the limits in the profile are lower than the file's"
        return Row("print time", text, {
            "print_time_s": {"before": round(before, 3), "after": round(after, 3)},
            "slowed_for_motors_percent": round(100.0 * self.slowed, 2),
        })  # fmt: skip

    def _uncompensated(self) -> Row:
        """Return how much is not compensated, and after which commands."""
        read, text = self.read, "nothing: the whole path is"
        parts = sorted(read.uncompensated.items(), key=lambda item: -item[1].path)
        if parts:
            more = f" and {len(parts) - 4} more" if len(parts) > 4 else ""
            text = (
                f"{percent(read.path_share)} of the path, {percent(read.extrusion_share)} of the "
                f"extrusion (after {', '.join(cause for cause, _ in parts[:4])}{more})"
            )
        by_cause = {
            cause: {
                "moves": part.moves, "path_mm": round(part.path, 3),
                "filament_mm": round(part.filament, 5),
            }
            for cause, part in parts
        }  # fmt: skip
        return Row("not compensated", text, {"uncompensated": {
            "path_percent": round(100.0 * read.path_share, 3),
            "extrusion_percent": round(100.0 * read.extrusion_share, 3),
            "by_cause": by_cause,
        }})  # fmt: skip

    def _advice(self) -> list[Row]:
        """Return what else to do where compensation is not worth it."""
        if self.strategy == "none":
            text = "to see what compensation brings, compare with the file as sliced instead"
            return [Row("advice", text)]
        if not {"none", self.strategy} <= self.contour.keys() or self.time.change < -0.02:
            return []  # by a speed that was asked for: a shaper could not print as fast
        before, ours = (self.contour[name].expected for name in ("none", self.strategy))
        shaper = self.contour[SHAPER].expected if SHAPER in self.contour else math.inf
        if ours >= before:
            return [Row("advice", "this print is better as sliced")]
        texts = list[str]()
        if before < VISIBLE:
            texts.append("hardly worth it: errors as small as these are not seen on a print")
        if ours > NO_GAIN * shaper:
            texts.append(
                f"the best input shaper does {'better' if ours > shaper else 'as well'}: use it "
                "instead ('hframe-post simulate --shapers' prints its settings)"
            )
        return [Row("advice", "; ".join(texts))]

    def _figures(self) -> list[Row]:
        read, peaks, written, steps = self.read, self.peaks, self.written, self.steps
        lines, after = written.lines or None, self.filament_after
        filament = {"before": read.filament, "after": after}
        x, y = peaks.axis_acceleration
        motors = ", ".join(f"{motor} {n}" for motor, n in steps.motors.items()) if steps else ""
        stopped = self.player.code().when_stopped if self.player else ""
        return [
            Row("moves", f"{read.moves} in {read.lines} lines; {lines} lines written", {
                "moves": read.moves, "lines_read": read.lines, "lines_written": lines,
                "busiest_second_lines": written.busiest_second or None,
                "firmware_retractions": read.firmware_retractions,
            }),
            Row("filament", f"{after or 0.0:.2f} mm, unchanged", {
                "filament_mm": {k: round(mm, 5) for k, mm in filament.items() if mm is not None},
            }),
            self._predicted(), self._width(),
            *self._advance(),
            Row("belts", f"at most {peaks.belt_velocity:.0f} mm/s, "
                f"{peaks.belt_acceleration:.0f} mm/s²", {
                "peak_belt_speed": round(peaks.belt_velocity, 3),
                "peak_belt_acceleration": round(peaks.belt_acceleration, 1),
                "peak_axis_acceleration": {"x": round(x, 1), "y": round(y, 1)},
                "clamped_samples": self.clamped.samples,
                "clamped_mm": round(self.clamped.most, 6),
            }),
            *((Row("steps", f"{steps.rows} rows, {steps.ticks} ticks of {steps.clock_hz:g} Hz; "
                f"{motors}", {"steps": asdict(steps)}),) if steps else ()),
            *self.speed,
            Row("if you stop it", f"send {stopped} before you print again" if stopped else ""),
        ]  # fmt: skip

    def _predicted(self) -> Row:
        """Return the errors by strategy, and on how much of the print, if not on all."""
        ours, sliced, text = self.predicted, self.predicted_sliced, ""
        if min(ours, sliced) <= 0.995 and self.contour:
            text = (
                f"on {percent(ours)} of the print as converted, {percent(sliced)} as sliced, from "
                "all over it; 'hframe-post simulate' takes all"
            )
        against = None
        if self.shaping is not None and SHAPER in self.contour:
            against = [{
                "name": self.shaping.x.name, **self.shaping.as_json(),
                "contour_error_um": self.contour[SHAPER].micrometres(),
                "line_width_error_percent": self.width[SHAPER].percents(),
            }]  # fmt: skip
        errors = {name: self.contour[name].micrometres() for name in sorted(self.strategies)}
        return Row("predicted", text, {
            "contour_error_um": errors,
            "predicted_percent": round(100.0 * ours, 1),
            "predicted_as_sliced_percent": round(100.0 * sliced, 1),
            "against": against,
        })  # fmt: skip

    def _advance(self) -> list[Row]:
        """Return a row on pressure advance, and one on what the extruder cannot follow."""
        found, limit = self.advancing, self.printer.limits.extruder_acceleration
        if self.player is None or not found.most:
            return []
        slowed, to = self.following or (0.0, math.inf)
        values = f"{found.least:.3g}" + f" to {found.most:.3g}" * (found.most != found.least)
        computed, extruder = self.following is not None, ""
        how = "the firmware's own"
        if computed:
            how = "computed into E; the firmware's own is off while the file moves"
        if slowed:
            extruder = (
                f"{percent(slowed)} of the lines accelerate by less, from {to:.0f} mm/s² on, so "
                "that it can follow its advance"
            )
        elif found.hardest > 1.05 * limit:  # less is not worth a line
            extruder = (
                f"its advance asks for up to {found.hardest:.0f} mm/s², more than "
                f"limits.extruder_acceleration ({limit:g}): if it skips, raise "
                "extruder.stream_smooth_time or lower limits.acceleration"
            )
        known = {
            "least": found.least, "most": found.most, "computed": computed,
            "extruder_mm_s2": round(found.hardest, 1) or None,
            "slowed_path_percent": round(100.0 * slowed, 3),
        }  # fmt: skip
        advance = Row("advance", f"{values} s, {how}", {"pressure_advance_s": known})
        return [advance, Row("extruder", extruder)]

    def _width(self) -> Row:
        """Return how far the printed line's width is off, if anything is extruded."""
        said = {self.strategy: "as converted", "none": "as sliced"}
        shares = ", ".join(
            f"{100.0 * self.width[name].rms:.1f} % {said.get(name) or self.label(name)}"
            for name in STRATEGIES
            if name in self.width and self.width[name].count
        )
        known = {
            name: self.width[name].percents() for name in self.strategies if name in self.width
        }
        text = f"off by {shares} (RMS, on {PIECE_MM:g} mm of line)" if shares else ""
        return Row("line width", text, {"line_width_error_percent": known})

    def warnings(self) -> list[str]:
        """Return a sentence for everything that a person must not overlook."""
        motion = self.player.motion(self.options.tolerance) if self.player else None
        most = motion.lines_per_second if motion else math.inf
        return [*self.notices, *warnings(self, self.printer.firmware.other_tools, most)]
