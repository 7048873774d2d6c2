"""The report of a conversion, as text and as JSON."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from hframe_post.compensation.clamp import Clamped
from hframe_post.compensation.guard import Peaks
from hframe_post.compensation.shape import SHAPER
from hframe_post.conversion.meters import InputSummary, PrintTime
from hframe_post.conversion.path_meter import PathSummary, percent
from hframe_post.gcode.reader import CHANGE_OF_OBJECT, START_OF_FILE
from hframe_post.model.shapers import Shaping
from hframe_post.model.strategies import STRATEGIES
from hframe_post.planner.bands import TimeInBands
from hframe_post.prediction.line_width import PIECE
from hframe_post.prediction.statistics import DECIMALS, ContourErrors, ErrorStatistics

TOOL = re.compile(r"T[1-9]\d*")
# Share of the lines' distance from the command by which the nozzle is off its path: only what is
# across the path counts. Simulated Marlin leaves 0.62 to 0.63
ACROSS = math.sqrt(0.5)
VISIBLE = 0.012  # mm RMS; ringing below it shows on no wall, whatever the light
NO_GAIN = 0.9  # share of the best shaper's error from which on compensation is not worth its stream
OUTRUN = 1.05  # times its limit, the acceleration of an extruder is worth a line

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

REMEDIES = {  # of extrusion that is not compensated, by causes that are no commands
    START_OF_FILE: "because its place is not known: begin with a move to X, Y and Z",
    CHANGE_OF_OBJECT: "because an object begins without a travel to it",
}


@dataclass(frozen=True, slots=True)
class StepReport:
    """What a step file holds: rows, ticks of its clock, steps by motor."""

    rows: int
    ticks: int
    clock_hz: float
    motors: dict[str, int]


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


@dataclass(frozen=True, slots=True)
class Report:
    """What one conversion did: the summaries of its stages. Lengths in mm.

    lines_written, filament_after: None if nothing is written. busiest_second: the most lines of
    motion in a second, compared with the firmware's lines_per_second; approximation: what the lines
    are off the command (RMS) where that bounds them. seconds: processor time by stage, not
    compared. speed, speed_text: how accuracy was traded for speed. picture: the path with its
    errors, if one was asked for. metered: sums of the options' meters. notices: warnings of the
    printer's profile. plastic: of a bed that moves. other_tools: commands after which the plant is
    not that of the tool that prints; None if the profile does not say. advance: pressure advance,
    if there is any. bands: of motor speed, if the profile avoids any. couples: whether a coupling,
    such as racking, is compensated. shaping: the best input shaper, whose errors stand among
    the others. when_stopped: what to send after the print was stopped midway.
    """

    strategy: str
    read: InputSummary
    path: PathSummary
    time: PrintTime
    peaks: Peaks
    clamped: Clamped
    contour: dict[str, ContourErrors]
    width: dict[str, ErrorStatistics]
    lines_written: int | None = None
    filament_after: float | None = None
    busiest_second: int = 0
    lines_per_second: float = math.inf
    approximation: float = 0.0
    steps: StepReport | None = None
    seconds: dict[str, float] = field(default_factory=dict, compare=False)
    speed: dict[str, Any] | None = None
    speed_text: str = ""
    picture: Picture | None = field(default=None, compare=False, repr=False)
    metered: Any = field(default=None, compare=False, repr=False)
    notices: tuple[str, ...] = ()
    plastic: Plastic | None = None
    other_tools: tuple[str, ...] | None = None
    shaping: Shaping | None = None
    couples: bool = True
    when_stopped: str = ""
    advance: AdvanceReport | None = None
    bands: BandReport | None = None
    predicted: float = 1.0  # share of the print whose errors are predicted; they stand for all
    predicted_sliced: float = 1.0  # the same of the errors as sliced, and with a shaper
    sliced_off: float = 0.0  # mm RMS across the path by which whole steps put the sliced file off

    def lines_error(self, name: str) -> float:
        """Return by how much (mm RMS) whole steps of the lines add to a strategy's error.

        The error and this one are independent, so that their squares add up.
        """
        if name == self.strategy:
            return ACROSS * self.approximation
        return self.sliced_off if name in ("none", SHAPER) else 0.0

    def printed(self, name: str) -> float:
        """Return the RMS error (mm) that a strategy or the shaper leaves, whole steps included."""
        return math.hypot(self.contour[name].expected, self.lines_error(name))

    def as_json(self) -> dict[str, Any]:
        """Return all figures, ready for ``json.dumps``."""
        x, y = self.peaks.axis_acceleration
        filament = {"before": self.read.filament, "after": self.filament_after}
        written: dict[str, Any] = {
            "lines_written": self.lines_written,
            "busiest_second_lines": self.busiest_second or None,
            "approximation_um": round(1e3 * self.approximation, 2) or None,
            "steps": asdict(self.steps) if self.steps else None,
            "speed": self.speed,
            "plastic_on_bed": asdict(self.plastic) if self.plastic else None,
            "pressure_advance_s": self.advance.as_json() if self.advance else None,
            "motor_bands": self.bands.as_json() if self.bands else None,
            "against": self._against() or None,
        }
        return {
            "warnings": self.warnings(),
            "compensation": self.strategy,
            "moves": self.read.moves,
            "lines_read": self.read.lines,
            "print_time_s": {
                "before": round(self.time.before, 3),
                "after": round(self.time.after, 3),
            },
            "slowed_for_motors_percent": round(100.0 * self.time.slowed, 2),
            "time_costs_s": {cause: round(s, 3) for cause, s in self.time.costs.items()},
            "filament_mm": {k: round(mm, 5) for k, mm in filament.items() if mm is not None},
            "contour_error_um": {n: self._errors_as_json(n) for n in sorted(self.strategies)},
            "predicted_percent": round(100.0 * self.predicted, 1),
            "predicted_as_sliced_percent": round(100.0 * self.predicted_sliced, 1),
            "line_width_error_percent": {
                n: self.width[n].percents() for n in sorted(self.strategies) if n in self.width
            },
            "peak_belt_speed": round(self.peaks.belt_velocity, 3),
            "peak_belt_acceleration": round(self.peaks.belt_acceleration, 1),
            "peak_axis_acceleration": {"x": round(x, 1), "y": round(y, 1)},
            "firmware_retractions": self.read.firmware_retractions,
            "uncompensated": self.path.uncompensated_as_json(),
            "limited_by": self.path.limits_as_json(),
            "clamped_samples": self.clamped.samples,
            "clamped_mm": round(self.clamped.most, 6),
            **{name: value for name, value in written.items() if value is not None},
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
            "contour_error_um": self._errors_as_json(SHAPER),
            "line_width_error_percent": self.width[SHAPER].percents(),
        }]  # fmt: skip

    def _errors_as_json(self, name: str) -> dict[str, Any]:
        found, lines = self.contour[name].micrometres(), self.lines_error(name)
        if lines:
            found["with_steps"] = round(1e3 * self.printed(name), DECIMALS)
        return found

    def as_text(self) -> str:
        """Return a few lines for a person."""
        return self.summary(())

    def summary(self, head: Iterable[str]) -> str:
        """Return notices and what an owner asks first, then the head, then all figures."""
        lines = [
            *(f"WARNING          {text}" for text in self.notices),
            *self._result(),
            f"print time       {self.time.as_text()}",
            f"not compensated  {self.path.uncompensated_as_text()}",
            *(f"WARNING          {text}" for text in self.warnings()[len(self.notices) :]),
            *self._advice(),
            *head,
            f"moves            {self.read.moves} in {self.read.lines} lines; "
            f"{self.lines_written} lines written",
            f"filament         {self.filament_after:.2f} mm, unchanged",
            *self._predicted(),
            *self._width_as_text(),
            *(self.advance.as_text() if self.advance else []),
            f"belts            at most {self.peaks.belt_velocity:.0f} mm/s, "
            f"{self.peaks.belt_acceleration:.0f} mm/s²",
        ]
        if self.approximation:
            lines.append(
                f"lines            at most {self.busiest_second} in a second, "
                f"{1e3 * self.approximation:.1f} µm RMS off the exact command"
            )
        if (on := self.plastic) is not None:
            lines.append(
                f"bed              y's model followed {1e3 * on.printed:.0f} g of plastic on "
                f"{on.bed:g} kg, in steps of at most {1e3 * on.step:.2g} g (filament of "
                f"{on.diameter:g} mm, {on.density:g} g/cm³)"
            )
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
        return "\n".join(lines)

    def _result(self) -> list[str]:
        """Return what the print gains: its error as sliced, compensated, and with a shaper."""
        if self.strategy == "none":
            return ["result           nothing is compensated (-c none)"]
        if not {"none", self.strategy} <= self.contour.keys():
            return []
        lines = self.lines_error(self.strategy)
        steps = f", of which whole steps leave {1e3 * lines:.1f}" if lines else ""
        shaper = ""
        if SHAPER in self.contour:
            shaper = f"; the best input shaper would leave {1e3 * self.printed(SHAPER):.1f}"
        before = f"{self.label(self.strategy)} {1e3 * self.printed('none'):.1f}"
        ours = range_as_text(self.contour[self.strategy], lines)
        return [f"result           {before} → {ours}{steps}{shaper}"]

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
        before, ours = self.printed("none"), self.printed(self.strategy)
        shaper = self.printed(SHAPER) if SHAPER in self.contour else math.inf
        if ours >= before:
            text = "this print is better as sliced"
        elif before < VISIBLE:
            text = "hardly worth it: errors as small as these are not seen on a print"
        elif ours > NO_GAIN * shaper:
            text = (
                "the best input shaper does as well: use it instead "
                "('hframe-post simulate --shapers' prints its settings)"
            )
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
        if self.busiest_second > self.lines_per_second:
            found.append(
                f"up to {self.busiest_second} lines in a second; the printer takes "
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


def range_as_text(contour: ContourErrors, lines: float = 0.0) -> str:
    """Return the RMS error in µm, with its range if it has one. lines: see ``_predicted``."""
    text = f"{1e3 * math.hypot(contour.expected, lines):.1f} µm RMS"
    if (known := contour.range) is None:
        return text
    low, high = (1e3 * math.hypot(end, lines) for end in (known.low, known.high))
    return f"{text} ({low:.1f} to {high:.1f} as the printer changes)"
