"""Simulation of every strategy on a print, and on printers that differ from the model.

commands → (whole steps) → judged on the plant, and on printers that are not quite the plant
→ figures by layer and feature
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any

import numpy as np

from hframe_post.arrays import Integers
from hframe_post.compensation.guard import check_prediction
from hframe_post.compensation.shape import SHAPER, shape
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.model.kinematics import Differences
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.planner.sliced import AsSliced
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.error_meter import JUDGED_EVERY, ErrorMeter, Lines
from hframe_post.prediction.picture import Picture
from hframe_post.prediction.predict import Judge, Judgement, quantise
from hframe_post.prediction.statistics import ContourErrors, Figures, Labels
from hframe_post.prediction.windows import Windows
from hframe_post.printer.settings import Printer, Steps
from hframe_post.stream.types import Samples
from hframe_post.writers.gcode import as_written
from hframe_post.writers.print_time import duration

# ---------------------------------------------------------------------- the report

Group = dict[str, Figures]  # strategy → figures of one part of the print


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Printers whose parameters are off by up to ``share``: contour errors by strategy."""

    share: float
    printers: list[dict[str, ContourErrors]]

    def rms(self, strategy: str) -> list[float]:
        """Return the RMS contour error (mm) of each printer."""
        return [contour[strategy].rms for contour in self.printers if strategy in contour]

    def better(self, strategy: str, than: str) -> int:
        """Return the number of printers on which one strategy's RMS is below another's."""
        pairs = zip(self.rms(strategy), self.rms(than), strict=True)
        return sum(a < b for a, b in pairs)

    def as_json(self, strategies: list[str]) -> dict[str, Any]:
        """Return median and worst RMS in µm, and how often each strategy beats no compensation."""
        values: dict[str, Any] = {"share": self.share, "printers": len(self.printers)}
        for name in strategies:
            rms = self.rms(name) or [0.0]
            values[name] = {
                "median_um": round(median(rms) * 1e3, 4),
                "worst_um": round(max(rms) * 1e3, 4),
                "better_than_none": self.better(name, "none"),
            }
        return values


@dataclass(frozen=True, slots=True)
class Parts:
    """Figures by strategy, of the whole print, and by layer and feature."""

    whole: Group = field(default_factory=dict)
    layers: dict[str, Group] = field(default_factory=dict)
    features: dict[str, Group] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SimulationReport(Report):
    """What each strategy would do. plant: the name of the simulated printer."""

    plant: str = ""
    quantised: bool = False
    parts: Parts = field(default_factory=Parts)
    model_error: tuple[Uncertainty, ...] = ()

    def print_time(self, strategy: str) -> float:
        """Return the print time (s); without compensation no stop needs any rest."""
        return self.time.before if strategy == "none" else self.time.after

    def as_json(self) -> dict[str, Any]:
        """Return the keys of a conversion and those of a simulation."""
        return Report.as_json(self) | {
            "simulated_plant": self.plant,
            "quantised": self.quantised,
            "strategies": {
                name: {"print_time_s": round(self.print_time(name), 3), **figures}
                for name, figures in _figures(self.parts.whole).items()
            },
            "features": {
                name: _figures(group) for name, group in self._judged(self.parts.features)
            },
            "layers": {name: _figures(group) for name, group in self._judged(self.parts.layers)},
            "model_error": [error.as_json(self.strategies) for error in self.model_error],
        }

    def as_text(self) -> str:
        stepped = ", in whole steps" if self.quantised else ""
        ranges = self._ranges()
        title = "exact model, error in µm" if ranges else "contour error, µm"
        lines = [
            f"{self.read.moves} moves, {duration(self.time.after)}, "
            f"simulated on {self.plant}{stepped}",
            "",
            f"{'':21s}{title:>24s}{'all':>8s}{'line':>8s}{'tracking RMS, µm':>19s}"
            f"{'belts, at most':>19s}{'time':>13s}",
            f"{'':21s}{'RMS':>8s}{'95 %':>8s}{'peak':>8s}{'RMS':>8s}{'%':>8s}{'x':>10s}{'y':>9s}"
            f"{'mm/s':>9s}{'mm/s²':>10s}",
            *(
                _row(STRATEGIES[name].label, self.parts.whole[name])
                + f"{duration(self.print_time(name)):>13s}"
                for name in self.strategies
            ),
        ]
        lines += ranges
        lines += self._table("feature", list(self._judged(self.parts.features)))
        layers = list(self._judged(self.parts.layers))
        title = "layer"
        if len(layers) > 5:
            title = f"worst of {len(layers)} layers"
            best = self.strategies[-1]
            layers.sort(key=lambda item: -item[1][best].contour.expected)
            del layers[5:]
        lines += self._table(title, layers)
        lines += self._trust()
        warnings = [f"WARNING          {text}" for text in self.warnings()]
        return "\n".join([*warnings, *lines])

    def _ranges(self) -> list[str]:
        """Return the ranges of the errors of the whole print, which the table does not hold."""
        return [
            f"{'expected':17s}{STRATEGIES[name].label}: contour error {contour.as_text()}"
            for name in self.strategies
            if (contour := self.parts.whole[name].contour).range is not None
        ]

    def _median(self) -> str:
        return ", median as the printer changes" if self._ranges() else ""

    def _judged(self, groups: dict[str, Group]) -> list[tuple[str, Group]]:
        """Return the parts in which anything moves."""
        return [
            (name, group)
            for name, group in groups.items()
            if any(figures.contour.all.count for figures in group.values())
        ]

    def _table(self, title: str, groups: list[tuple[str, Group]]) -> list[str]:
        if not groups:
            return []
        width = max(19, len(title), *(len(name) for name, _ in groups)) + 2
        head = "".join(f"{'-c ' + name:>12s}" for name in self.strategies)
        lines = ["", f"{title:{width}s}{head}   RMS contour error, µm{self._median()}"]
        for name, group in groups:
            cells = "".join(f"{group[s].contour.expected * 1e3:12.1f}" for s in self.strategies)
            lines.append(f"{name:{width}s}{cells}")
        return lines

    def _trust(self) -> list[str]:
        """Return lines on model errors and on parts where compensation does not help."""
        if "none" not in self.parts.whole or len(self.strategies) < 2:
            return []
        best, lines = self.strategies[-1], [""]
        for error in self.model_error:
            values, count = error.as_json(self.strategies), len(error.printers)
            medians = ", ".join(
                f"{STRATEGIES[s].label} {values[s]['median_um']:.1f}" for s in self.strategies
            )
            lines.append(
                f"model off by up to {100 * error.share:g} %: median of {count} printers, µm: "
                f"{medians}, at worst {values[best]['worst_um']:.1f}; better than without "
                f"compensation on {error.better(best, 'none')} of {count}"
            )
        harmed = [
            f"{kind} {name}"
            for kind, groups in (("feature", self.parts.features), ("layer", self.parts.layers))
            for name, group in self._judged(groups)
            if group[best].contour.expected >= group["none"].contour.rms
        ]
        whole = self.parts.whole
        gain = whole["none"].contour.rms > whole[best].contour.expected
        if not gain:
            lines.append("NO HELP          compensation does not improve this print as a whole")
        elif harmed:
            more = f" and {len(harmed) - 5} more" if len(harmed) > 5 else ""
            lines.append(
                f"NO HELP          in {', '.join(harmed[:5])}{more}: no better than without"
            )
        return lines if len(lines) > 1 else []


def _figures(group: Group) -> dict[str, Any]:
    return {name: group[name].as_json() for name in STRATEGIES if name in group}


def _row(name: str, figures: Figures) -> str:
    um, (x, y) = figures.contour.micrometres(), figures.tracking_rms() * 1e3
    return (
        f"{name:21s}{um['rms']:8.1f}{um['p95']:8.1f}{um['peak']:8.0f}{um['all']['rms']:8.1f}"
        f"{100.0 * figures.width.rms:8.1f}{x:10.1f}{y:9.1f}"
        f"{figures.velocity:9.0f}{figures.acceleration:10.0f}"
    )


# ---------------------------------------------------------------------- the simulation


@dataclass(frozen=True, slots=True)
class Study:
    """The printer that is simulated.

    plant, name: of the simulated printer, which may differ from the one compensated for. drawn:
    share of model error → random printers that differ by up to that. steps: round commands to
    whole motor steps; None for none. exact: judge the commands as computed, since what lines and
    the firmware's steps leave is the same with every window.
    """

    plant: Plant
    drawn: dict[float, list[Plant]] = field(default_factory=dict)
    steps: Steps | None = None
    name: str = ""
    doubts: Doubts | None = None
    exact: bool = False


def simulate(
    lines: Callable[[], Iterable[bytes]], printer: Printer, options: Options, study: Study
) -> SimulationReport:
    """Simulate the options' strategies; memory does not grow with the print.

    lines: opens the file and yields its lines, at each call again. Without compensation the
    firmware moves as the file asks; with it, as this tool plans. Raises HframeError, also if the
    model predicts an error that no working printer has.
    """
    shapings = {} if options.shaping is None else {SHAPER: options.shaping}
    chain = Chain(printer, options)
    sliced = AsSliced(chain.firmware.limits())
    motion = sliced.samples(chain.read(lines()))
    steps = study.steps or (None if study.exact else chain.firmware.steps)
    today = _Judged(shape(motion, shapings), printer, study, steps)
    strategies = tuple(name for name in options.strategies if name != "none")
    ours = WholeFile(lines(), printer, replace(options, predict=()))
    parts, picture = Parts(), Picture(Labels()) if options.picture else None
    if "none" in (options.predict or ()):
        today.run(parts)
    commands = ours.samples(strategies)
    if not study.exact:
        own = chain.firmware
        commands = as_written(commands, strategies, own.motion(options.tolerance), own.code())
    judged = _Judged(commands, printer, study, study.steps)
    judged.run(parts, picture)
    off = {
        share: [{**own, **before} for own, before in zip(judged.off[share], found, strict=True)]
        for share, found in today.off.items()
    }
    contour = {name: figures.contour for name, figures in parts.whole.items()}
    if "none" in contour:
        check_prediction(contour["none"].rms)
    width = {name: figures.width for name, figures in parts.whole.items()}
    report = replace(ours.report, contour=contour, width=width, picture=picture)
    return SimulationReport.from_ledger(
        report, plant=study.name, quantised=study.steps is not None, parts=parts,
        model_error=tuple(Uncertainty(*each) for each in off.items()),
    )  # fmt: skip


class _Judged:
    """A motion of the print, judged on the simulated printer and on those that differ from it.

    steps: of the motors; None: the motion is exact. off: by share
    of model error, the contour errors of each of these.
    """

    def __init__(
        self, source: Iterable[Samples], printer: Printer, study: Study, steps: Steps | None
    ) -> None:  # fmt: skip
        self._source, self._kinematics, self._study = source, printer.kinematics, study
        self._steps = steps
        self._names = set[str]()  # strategies of its own
        self._meters = {  # every fourth sample: there are many printers, and their spread is wide
            share: [ErrorMeter(plant, every=4) for plant in plants]
            for share, plants in study.drawn.items()
        }
        self.off = {
            share: [meter.contour for meter in meters] for share, meters in self._meters.items()
        }

    def run(self, parts: Parts, picture: Picture | None = None) -> None:
        """Add the errors to parts, and those of this path without compensation to the picture."""
        study, commands = self._study, self._rated(parts)
        if self._steps is not None:
            commands = quantise(commands, self._kinematics, self._steps)
        drawn = [meter for each in self._meters.values() for meter in each]
        own, labels, drawing = Judge(study.plant, JUDGED_EVERY, study.doubts), Labels(), Lines()
        judges = [own, *(meter.judge for meter in drawn)]
        before, after = (max(k) for k in zip(*((j.before, j.after) for j in judges), strict=True))
        for window in Windows(before, after).of(commands):
            judgement = own.judged(window, sliced=picture is not None)
            for meter in drawn:
                meter.add(window)
            if picture is not None:
                picture.add(judgement)
            layer, feature = labels.number(judgement.chunk)
            groups = _groups(layer[judgement.at], feature[judgement.at], labels, parts)
            _add_errors(judgement, groups, self._names)
            for name, (at, shares) in drawing.pieces(judgement).items():
                if name in self._names:
                    for group, which in _groups(layer[at], feature[at], labels, parts):
                        group.setdefault(name, Figures()).width.add(shares[which])

    def _rated(self, parts: Parts) -> Iterator[Samples]:
        """Note how fast the belts move; yield the chunks unchanged."""
        labels, differences = Labels(), dict[str, Differences]()
        for chunk in self._source:
            layer, feature = labels.number(chunk)
            for name, command in chunk.commands.items():
                self._names.add(name)
                if len(command):
                    rates = differences.setdefault(name, Differences(self._kinematics))
                    found = rates.rates(command)
                    rates.pass_by(command)
                    velocity = np.abs(found.belt_velocity).max(axis=0)
                    acceleration = np.abs(found.belt_acceleration).max(axis=0)
                    for group, which in _groups(layer, feature, labels, parts):
                        figures = group.setdefault(name, Figures())
                        figures.add_rates(velocity[which], acceleration[which])
            if chunk.ends_stretch:
                differences = {}
            yield chunk


def _add_errors(
    judgement: Judgement, groups: Iterable[tuple[Group, Integers]], names: set[str]
) -> None:
    """Add a chunk's contour errors to the parts of the print that it belongs to."""
    for group, which in groups:
        for name, errors in judgement.contour.items():
            if name not in names:  # drawn in the picture only
                continue
            off = judgement.tracking(name)[which]
            figures = group.setdefault(name, Figures())
            figures.add_errors(errors[which], off, judgement.extruding[which])
            if name in judgement.products:
                inside = np.zeros(len(errors), bool)
                inside[which] = True
                some = inside[judgement.doubtful]
                extruding = judgement.extruding[judgement.doubtful[some]]
                figures.contour.doubt(judgement.products[name][some], extruding)


def _groups(
    layer: Integers, feature: Integers, labels: Labels, parts: Parts
) -> Iterator[tuple[Group, Integers]]:
    """Yield the parts of the print that occur in the samples, each with its samples' indices."""
    yield parts.whole, np.arange(len(layer))
    for numbers, names, groups in (
        (layer, labels.layers, parts.layers),
        (feature, labels.features, parts.features),
    ):
        for number in np.unique(numbers).tolist():
            group = groups.setdefault(names[number], {})
            yield group, np.flatnonzero(numbers == number)
