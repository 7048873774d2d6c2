"""The report of a conversion, as text and as JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any

from hframe_post.arrays import TS
from hframe_post.compensation.shape import SHAPER
from hframe_post.conversion.ledger import Ledger, PathTally, Uncompensated
from hframe_post.gcode.reader import CHANGE_OF_OBJECT, START_OF_FILE
from hframe_post.model.shapers import Shaping
from hframe_post.model.strategies import STRATEGIES
from hframe_post.planner.bands import TimeInBands
from hframe_post.prediction.error_meter import PIECE
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.writers.print_time import duration

TOOL = re.compile(r"T[1-9]\d*")
VISIBLE = 0.012  # mm RMS; ringing below it shows on no wall, whatever the light
NO_GAIN = 0.9  # share of the best shaper's error from which on compensation is not worth its stream
OUTRUN = 1.05  # times its limit, the acceleration of an extruder is worth a line

COSTS = {  # causes of a longer print, for people
    "limits": "lower limits in the profile",
    "jerk": "smoother acceleration",
    "stops": "rests at stops",
}
WORTH_SAYING = 5e-3  # of the print's time, which no owner notices
FASTER = 0.02  # of the print's time: won by a speed that was asked for, and so is worth a stream
REMEDIES = {  # of extrusion that is not compensated, by causes that are no commands
    START_OF_FILE: "because its place is not known: begin with a move to X, Y and Z",
    CHANGE_OF_OBJECT: "because an object begins without a travel to it",
}


@dataclass(frozen=True, slots=True)
class PrintTime:
    """Duration of the print, s: as the firmware plays the sliced file, and as converted.

    ramps: of the converted path if nothing limited its jerk; resting: added at stops. slowed: share
    of the path that is slower so that the motors can follow. capped: whether limits of the
    profile bind what the file asks.
    """

    before: float = 0.0
    after: float = 0.0
    ramps: float = 0.0
    resting: float = 0.0
    slowed: float = 0.0
    capped: bool = True

    @property
    def costs(self) -> dict[str, float]:
        """Return the seconds that the print takes longer than as sliced, by cause."""
        return {
            "limits": self.ramps - self.before,
            "jerk": self.after - self.resting - self.ramps,
            "stops": self.resting,
        }

    def as_json(self) -> dict[str, Any]:
        return {
            "print_time_s": {"before": round(self.before, 3), "after": round(self.after, 3)},
            "slowed_for_motors_percent": round(100.0 * self.slowed, 2),
            "time_costs_s": {cause: round(s, 3) for cause, s in self.costs.items()},
        }

    @property
    def change(self) -> float:
        """Return by which share the print takes longer."""
        return self.after / self.before - 1.0 if self.before else 0.0

    def as_text(self) -> str:
        """Return both times, and what costs the difference if it is worth a word."""
        text = f"{duration(self.before)} → {duration(self.after)} ({100.0 * self.change:+.1f} %)"
        if self.change < WORTH_SAYING:
            return text
        motors = f"the limits in [motors], on {percent(self.slowed)} of the path"
        names = dict(COSTS)
        if self.slowed or not self.capped:
            names["limits"] = motors if self.slowed else "slower corners and stops"
        causes = [
            f"{s:.0f} s for {names[cause]}"
            for cause, s in sorted(self.costs.items(), key=lambda each: -each[1])
            if s >= max(0.5, WORTH_SAYING * self.before)
        ]
        return f"{text}: {', '.join(causes)}" if causes else text


@dataclass(frozen=True, slots=True)
class Plastic:
    """What y's model followed on a moving bed, kg: mass of bed, print, and the largest step.

    diameter (mm), density (g/cm³): those of the filament that were assumed.
    """

    bed: float
    printed: float
    step: float
    diameter: float
    density: float

    def as_text(self) -> str:
        """Return a line for the summary."""
        return (
            f"bed              y's model followed {1e3 * self.printed:.0f} g of plastic on "
            f"{self.bed:g} kg, in steps of at most {1e3 * self.step:.2g} g (filament of "
            f"{self.diameter:g} mm, {self.density:g} g/cm³)"
        )


@dataclass(frozen=True, slots=True)
class AdvanceReport:
    """Pressure advance in the file, s: least and most. computed: E contains it.

    hardest: acceleration, mm/s², that the firmware asks of the extruder; limit: that of the
    profile. slowed: share of lines that accelerate less, for the extruder to follow; to: mm/s², the
    least of them.
    """

    least: float
    most: float
    computed: bool
    hardest: float = 0.0
    limit: float = math.inf
    slowed: float = 0.0
    to: float = math.inf

    def as_json(self) -> dict[str, Any]:
        return {
            "least": self.least, "most": self.most, "computed": self.computed,
            "extruder_mm_s2": round(self.hardest, 1) or None,
            "slowed_path_percent": round(100.0 * self.slowed, 3),
        }  # fmt: skip

    def as_text(self) -> list[str]:
        """Return lines for a person."""
        return [self._kind(), *self._extruder()]

    def _extruder(self) -> list[str]:
        """Return what the extruder cannot follow."""
        if self.slowed:
            return [
                f"extruder         {percent(self.slowed)} of the lines accelerate by less, from "
                f"{self.to:.0f} mm/s² on, so that it can follow its advance"
            ]
        if self.hardest > OUTRUN * self.limit:
            return [
                f"extruder         its advance asks for up to {self.hardest:.0f} mm/s², more than "
                f"limits.extruder_acceleration ({self.limit:g}): if it skips, raise "
                "extruder.stream_smooth_time or lower limits.acceleration"
            ]
        return []

    def _kind(self) -> str:
        """Return a line on the advance itself."""
        values = f"{self.least:.3g}"
        if self.most != self.least:
            values += f" to {self.most:.3g}"
        how = "the firmware's own"
        if self.computed:
            how = "computed into E; the firmware's own is off while the file moves"
        return f"advance          {values} s, {how}"


@dataclass(frozen=True, slots=True)
class BandReport:
    """Time of outer walls in bands of motor speed (mm/s): as sliced, and as converted."""

    bands: tuple[tuple[float, float], ...]
    before: TimeInBands
    after: TimeInBands

    def as_text(self) -> str:
        """Return a line for the summary."""
        if not self.after.total:
            return (
                "motor bands      no outer walls are named in the file, so no speed was changed "
                "for speed.avoid of the profile"
            )
        bands = ", ".join(f"{low:g} to {high:g}" for low, high in self.bands)
        return (
            f"motor bands      outer walls: {percent(self.before.share)} of their time with a "
            f"motor at {bands} mm/s as sliced, {percent(self.after.share)} now"
        )

    def as_json(self) -> dict[str, Any]:
        return {
            "bands": self.bands,
            "outer_wall_s": {
                "before": round(self.before.total, 3),
                "after": round(self.after.total, 3),
            },
            "in_bands_s": {
                "before": round(self.before.inside, 3),
                "after": round(self.after.inside, 3),
            },
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Report(Ledger):
    """What one conversion did: its ledger, and what must be known of the printer to read it.

    speed, speed_text: how accuracy was traded for speed. notices: warnings of the printer's
    profile. capped: see ``PrintTime``. plastic: of a bed that moves. other_tools: commands after
    which the plant is not that of the tool that prints; None if the profile does not say. advance:
    pressure advance, if there is any. bands: of motor speed, if the profile avoids any. couples:
    whether a coupling, such as racking, is compensated. shaping: the best input shaper, whose
    errors stand among the others. predicted_sliced: share of the print whose errors as sliced are
    predicted.
    lines_per_second: that the firmware takes. with_summary: the output ends with this report.
    when_stopped: what to send after the print was stopped midway.
    """

    strategy: str
    speed: dict[str, Any] | None = None
    speed_text: str = ""
    notices: tuple[str, ...] = ()
    capped: bool = True
    plastic: Plastic | None = None
    other_tools: tuple[str, ...] | None = None
    shaping: Shaping | None = None
    couples: bool = True
    advance: AdvanceReport | None = None
    bands: BandReport | None = None
    predicted_sliced: float = 1.0
    lines_per_second: float = math.inf
    with_summary: bool = False
    when_stopped: str = ""

    @property
    def time(self) -> PrintTime:
        """Return the duration of the print."""
        before, after = self.sliced_s + self.elsewhere, self.duration + self.elsewhere
        ramps = self.ramps + self.elsewhere
        resting = TS * self.resting
        return PrintTime(before, after, ramps, resting, self.slowed, self.capped)

    @property
    def predicted(self) -> float:
        """Return the share of the print whose errors are predicted; they stand for all."""
        return (self.judged or self.samples) / max(self.samples, 1)

    @property
    def lines_written(self) -> int | None:
        """Return the number of lines of the output; None if nothing is written."""
        return self._count(self._lines()) if self.written.lines else None

    def _count(self, summary: list[str]) -> int:
        return self.written.lines + (1 + len(summary) if self.with_summary else 0)  # 1: the stamp

    @property
    def filament_after(self) -> float | None:
        """Return the filament (mm) of the output; None if nothing is written."""
        return self.written.filament if self.written.lines else None

    def as_json(self) -> dict[str, Any]:
        """Return all figures, ready for ``json.dumps``."""
        filament = {"before": self.read.filament, "after": self.filament_after}
        return {
            "warnings": self.warnings(),
            "compensation": self.strategy,
            "moves": self.read.moves,
            "lines_read": self.read.lines,
            **self.time.as_json(),
            "filament_mm": {k: round(mm, 5) for k, mm in filament.items() if mm is not None},
            **self._errors_by_strategy(),
            **self._belts_as_json(),
            "firmware_retractions": self.read.firmware_retractions,
            "uncompensated": _uncompensated_as_json(self.path),
            "limited_by": _limits_as_json(self.path),
            "clamped_samples": self.clamped.samples,
            "clamped_mm": round(self.clamped.most, 6),
            **{k: value for k, value in self._optional_as_json().items() if value is not None},
        }

    def _errors_by_strategy(self) -> dict[str, Any]:
        names = sorted(self.strategies)
        return {
            "contour_error_um": {name: self.contour[name].micrometres() for name in names},
            "predicted_percent": round(100.0 * self.predicted, 1),
            "predicted_as_sliced_percent": round(100.0 * self.predicted_sliced, 1),
            "line_width_error_percent": {
                name: self.width[name].percents() for name in names if name in self.width
            },
        }

    def _belts_as_json(self) -> dict[str, Any]:
        x, y = self.peaks.axis_acceleration
        return {
            "peak_belt_speed": round(self.peaks.belt_velocity, 3),
            "peak_belt_acceleration": round(self.peaks.belt_acceleration, 1),
            "peak_axis_acceleration": {"x": round(x, 1), "y": round(y, 1)},
        }

    def _optional_as_json(self) -> dict[str, Any]:
        """Return what not every conversion has; None stands for nothing."""
        return {
            "lines_written": self.lines_written,
            "busiest_second_lines": self.written.busiest_second or None,
            "steps": asdict(self.steps) if self.steps else None,
            "speed": self.speed,
            "plastic_on_bed": asdict(self.plastic) if self.plastic else None,
            "pressure_advance_s": self.advance.as_json() if self.advance else None,
            "motor_bands": self.bands.as_json() if self.bands else None,
            "against": self._against() or None,
        }

    @property
    def strategies(self) -> list[str]:
        """Return the strategies whose errors are predicted."""
        return [name for name in STRATEGIES if name in self.contour]

    def label(self, name: str) -> str:
        """Return what a strategy compensates on this printer, or a shaper's name."""
        if name == SHAPER:
            return "best input shaper"
        compensated = name != "none" and not self.couples
        return "ringing" if compensated else STRATEGIES[name].label

    def _against(self) -> list[dict[str, Any]]:
        """Return the best input shaper, if its error is predicted."""
        if self.shaping is None or SHAPER not in self.contour:
            return []
        return [{
            "name": self.shaping.x.name, **self.shaping.as_json(),
            "contour_error_um": self.contour[SHAPER].micrometres(),
            "line_width_error_percent": self.width[SHAPER].percents(),
        }]  # fmt: skip

    def as_text(self) -> str:
        """Return a few lines for a person."""
        return self.summary(())

    def summary(self, head: Iterable[str]) -> str:
        """Return notices and what an owner asks first, then the head, then all figures."""
        return "\n".join(self._lines(head))

    def _lines(self, head: Iterable[str] = ()) -> list[str]:
        own, first = self._figures(), self._first()
        head, written = [*head], self._count([*first, "", *own]) if self.written.lines else None
        moves = f"{self.read.moves} in {self.read.lines} lines; {written} lines written"
        return [*first, *head, f"moves            {moves}", *own]

    def _first(self) -> list[str]:
        return [
            *(f"WARNING          {text}" for text in self.notices),
            *self._result(),
            f"print time       {self.time.as_text()}",
            f"not compensated  {_uncompensated_as_text(self.path)}",
            *(f"WARNING          {text}" for text in self.warnings()[len(self.notices) :]),
            *self._advice(),
        ]

    def _figures(self) -> list[str]:
        lines = [
            f"filament         {self.filament_after:.2f} mm, unchanged",
            *self._predicted(),
            *self._width_as_text(),
            *(self.advance.as_text() if self.advance else []),
            f"belts            at most {self.peaks.belt_velocity:.0f} mm/s, "
            f"{self.peaks.belt_acceleration:.0f} mm/s²",
        ]
        lines += [self.plastic.as_text()] if self.plastic else []
        lines += [self.bands.as_text()] if self.bands else []
        if self.steps:
            motors = ", ".join(f"{motor} {n}" for motor, n in self.steps.motors.items())
            lines.append(
                f"steps            {self.steps.rows} rows, {self.steps.ticks} ticks of "
                f"{self.steps.clock_hz:g} Hz; {motors}"
            )
        lines += self.speed_text.splitlines()
        if self.when_stopped:
            lines.append(f"if you stop it   send {self.when_stopped} before you print again")
        return lines

    def _result(self) -> list[str]:
        """Return what the print gains: its error as sliced, compensated, and with a shaper."""
        if self.strategy == "none":
            return ["result           nothing is compensated (-c none)"]
        if not {"none", self.strategy} <= self.contour.keys():
            return []
        shaper = ""
        if SHAPER in self.contour:
            shaper = (
                f"; the best input shaper would leave {1e3 * self.contour[SHAPER].expected:.1f}"
            )
        before = f"{self.label(self.strategy)} {1e3 * self.contour['none'].expected:.1f}"
        ours = range_as_text(self.contour[self.strategy])
        return [f"result           {before} → {ours}{shaper}"]

    def _predicted(self) -> list[str]:
        """Return on how much of the print the errors are predicted, if not on all."""
        ours, sliced = self.predicted, self.predicted_sliced
        if min(ours, sliced) > 0.995 or not self.contour:
            return []
        return [
            f"predicted        on {percent(ours)} of the print as converted, {percent(sliced)} as "
            "sliced, from all over it; 'hframe-post simulate' takes all"
        ]

    def _advice(self) -> list[str]:
        """Return what else to do where compensation is not worth it."""
        if self.strategy == "none":
            text = "to see what compensation brings, compare with the file as sliced instead"
            return [f"advice           {text}"]
        if not {"none", self.strategy} <= self.contour.keys():
            return []
        before, ours = (self.contour[name].expected for name in ("none", self.strategy))
        shaper = self.contour[SHAPER].expected if SHAPER in self.contour else math.inf
        use_it = "use it instead ('hframe-post simulate --shapers' prints its settings)"
        if self.time.change < -FASTER:
            return []  # a shaper could not print as fast as this
        if ours >= before:
            text = "this print is better as sliced"
        elif ours > NO_GAIN * shaper:
            text = f"the best input shaper does as well: {use_it}"
        elif before < VISIBLE:
            text = "hardly worth it: errors as small as these are not seen on a print"
        else:
            return []
        return [f"advice           {text}"]

    def _width_as_text(self) -> list[str]:
        """Return how far the printed line's width is off, if anything is extruded."""
        found = [name for name in STRATEGIES if name in self.width and self.width[name].count]
        shares = ", ".join(
            f"{self.label(name)} {100.0 * self.width[name].rms:.1f} %" for name in found
        )
        return [f"line width       off by {shares} RMS, on {PIECE:g} mm of line"] if found else []

    def warnings(self) -> list[str]:
        """Return a sentence for everything that a person must not overlook."""
        found = list(self.notices)
        if not self.read.moves:
            found.append(
                "nothing was compensated, because no move starts at a known position: move to an "
                "absolute X, Y and Z before printing"
            )
        found += self.read.oddities.values()
        found += self._tools()
        uncompensated = self.path.uncompensated
        cause = max(uncompensated, key=lambda name: uncompensated[name].filament, default="")
        if self.path.extrusion_share > 0.005 and not self._is_other_tool(cause):
            found.append(
                f"{100.0 * self.path.extrusion_share:.1f} % of the extrusion is not compensated, "
                + REMEDIES.get(
                    cause,
                    f"mostly after {cause}. If {cause} does not move the head, add it to harmless "
                    "in [firmware] of the profile; if the head comes back, add it to returns",
                )
            )
        if self.written.busiest_second > self.lines_per_second:
            found.append(
                f"up to {self.written.busiest_second} lines in a second; the printer takes "
                f"{self.lines_per_second:.0f} (lines_per_second in the profile), so it may stutter"
            )
        if (count := self.read.firmware_retractions) > 9:  # more than a few in macros
            found.append(
                f"estimated duration of {count} G10/G11: less is compensated next to them. Say in "
                "[retraction] of the profile what they do"
            )
        if self.clamped.samples:
            found.append(
                f"less is compensated on {percent(1e-3 * self.clamped.samples / self.time.after)} "
                f"of the print, first at line {self.clamped.line}, by up to "
                f"{self.clamped.most:.3f} mm: the bed's edge ([travel] of the profile) or the "
                "motors ([motors]) allow no more. If the motors can do more, raise "
                "motors.belt_acceleration"
            )
        return found

    def _tools(self) -> list[str]:
        """Return a warning if the file uses tools that the profile may have no model of."""
        if self.other_tools is None:
            tools = filter(TOOL.fullmatch, self.path.uncompensated)
            if not (named := ", ".join(tools)):
                return []
            return [
                f"the file changes tools ({named}), and all are compensated with the model of one. "
                "If they are separate heads, list those that were not measured below [firmware] of "
                'the profile, such as other_tools = ["T1"]; otherwise write other_tools = []'
            ]
        parts = self.path.uncompensated.items()
        others = {name: part.filament for name, part in parts if self._is_other_tool(name)}
        if not (filament := sum(others.values())):
            return []
        return [
            f"{percent(filament / self.path.filament)} of the extrusion is not compensated: the "
            f"profile has no model of {', '.join(others)} (other_tools in the profile)"
        ]

    def _is_other_tool(self, cause: str) -> bool:
        names = (name.upper() for name in self.other_tools or ())
        return any(fnmatchcase(cause, name) for name in names)


def range_as_text(contour: ContourErrors) -> str:
    """Return the RMS error in µm, with its range if it has one."""
    text = f"{1e3 * contour.expected:.1f} µm RMS"
    if (known := contour.range) is None:
        return text
    return f"{text} ({1e3 * known.low:.1f} to {1e3 * known.high:.1f} as the printer changes)"


def _uncompensated_as_text(path: PathTally) -> str:
    """Return how much is not compensated, and after which commands."""
    if not path.uncompensated:
        return "nothing: the whole path is"
    causes = [cause for cause, _ in _largest(path)]
    more = f" and {len(causes) - 4} more" if len(causes) > 4 else ""
    return (
        f"{percent(path.path_share)} of the path, {percent(path.extrusion_share)} of the "
        f"extrusion (after {', '.join(causes[:4])}{more})"
    )


def _limits_as_json(path: PathTally) -> dict[str, Any]:
    """Return where limits apply, and their ranges."""
    limits = {"acceleration": path.acceleration, "corner": path.corner, "speed": path.speed}
    return {
        name: {
            "path_percent": round(100.0 * limit.path / path.path, 2),
            "least": round(limit.least, 3),
            "greatest": round(limit.greatest, 3),
        }
        for name, limit in limits.items()
        if limit.path
    }


def _uncompensated_as_json(path: PathTally) -> dict[str, Any]:
    """Return what is not compensated, by cause, the longest path first."""
    return {
        "path_percent": round(100.0 * path.path_share, 3),
        "extrusion_percent": round(100.0 * path.extrusion_share, 3),
        "by_cause": {
            cause: {
                "moves": part.moves,
                "path_mm": round(part.path, 3),
                "filament_mm": round(part.filament, 5),
            }
            for cause, part in _largest(path)
        },
    }


def _largest(path: PathTally) -> list[tuple[str, Uncompensated]]:
    """Return causes of uncompensated motion, the longest path first."""
    return sorted(path.uncompensated.items(), key=lambda item: -item[1].path)


def percent(share: float) -> str:
    """Return a share as text: whole from 10 % on, below with two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"
