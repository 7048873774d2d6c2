"""Figures of a simulation, and what is told of them: text and JSON."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from statistics import median
from typing import Any

from hframe_post.conversion.report import Report
from hframe_post.model.strategies import STRATEGIES
from hframe_post.prediction.statistics import ContourErrors, Figures
from hframe_post.writers.stream.print_time import duration

Group = dict[str, Figures]  # strategy → figures of one part of the print
LAYERS_SHOWN = 5  # the worst ones, unless all are asked for


@dataclass
class Uncertainty:
    """Printers whose parameters are off by up to ``share``: contour errors by strategy."""

    share: float
    printers: list[dict[str, ContourErrors]] = field(default_factory=list)

    def rms(self, strategy: str) -> list[float]:
        """RMS contour error (mm) of each printer."""
        return [contour[strategy].rms for contour in self.printers if strategy in contour]

    def better(self, strategy: str, than: str) -> int:
        """Printers on which one strategy's RMS is below another's."""
        pairs = zip(self.rms(strategy), self.rms(than), strict=True)
        return sum(a < b for a, b in pairs)

    def as_json(self, strategies: list[str]) -> dict[str, Any]:
        """Median and worst RMS in µm, and on how many printers each beats no compensation."""
        told: dict[str, Any] = {"share": self.share, "printers": len(self.printers)}
        for name in strategies:
            rms = self.rms(name) or [0.0]
            told[name] = {
                "median_um": round(median(rms) * 1e3, 4),
                "worst_um": round(max(rms) * 1e3, 4),
                "better_than_none": self.better(name, "none"),
            }
        return told


@dataclass(frozen=True, slots=True)
class Parts:
    """Figures by strategy, of the whole print, and by layer and feature."""

    whole: Group = field(default_factory=dict)
    layers: dict[str, Group] = field(default_factory=dict)
    features: dict[str, Group] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SimulationReport(Report):
    """What each strategy would do. plant: name of what was simulated."""

    plant: str = ""
    quantised: bool = False
    parts: Parts = field(default_factory=Parts)
    model_error: tuple[Uncertainty, ...] = ()

    @property
    def strategies(self) -> list[str]:
        """Those simulated, from doing nothing to doing all."""
        return [name for name in STRATEGIES if name in self.parts.whole]

    def print_time(self, strategy: str) -> float:
        """How long the print takes (s); without compensation no stop needs any standstill."""
        return self.time.before if strategy == "none" else self.time.after

    def as_json(self) -> dict[str, Any]:
        """The keys of a conversion, and those of a simulation."""
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

    def as_text(self, all_layers: bool = False) -> str:
        """Tables for a person."""
        stepped = ", in whole steps" if self.quantised else ""
        lines = [
            f"{self.read.moves} moves, {duration(self.time.after)}, "
            f"simulated on {self.plant}{stepped}",
            "",
            f"{'':21s}{'contour error, µm':>24s}{'all':>8s}{'tracking RMS, µm':>19s}"
            f"{'belts, at most':>19s}{'time':>13s}",
            f"{'':21s}{'RMS':>8s}{'95 %':>8s}{'peak':>8s}{'RMS':>8s}{'x':>10s}{'y':>9s}"
            f"{'mm/s':>9s}{'mm/s²':>10s}",
            *(
                _row(STRATEGIES[name].label, self.parts.whole[name])
                + f"{duration(self.print_time(name)):>13s}"
                for name in self.strategies
            ),
        ]
        lines += self._table("feature", list(self._judged(self.parts.features)))
        layers = list(self._judged(self.parts.layers))
        title = "layer"
        if not all_layers and len(layers) > LAYERS_SHOWN:
            title = f"worst of {len(layers)} layers"
            best = self.strategies[-1]
            layers.sort(key=lambda item: -item[1][best].contour.rms)
            layers = layers[:LAYERS_SHOWN]
        lines += self._table(title, layers)
        lines += self._trust()
        return "\n".join(lines + self.warnings())

    def _judged(self, groups: dict[str, Group]) -> list[tuple[str, Group]]:
        """Those parts in which anything moves."""
        return [
            (name, group)
            for name, group in groups.items()
            if any(figures.contour.all.count for figures in group.values())
        ]

    def _table(self, title: str, groups: list[tuple[str, Group]]) -> list[str]:
        """RMS contour error by part of the print."""
        if not groups:
            return []
        width = max(19, len(title), *(len(name) for name, _ in groups)) + 2
        head = "".join(f"{name:>10s}" for name in self.strategies)
        lines = ["", f"{title:{width}s}{head}   RMS contour error, µm"]
        for name, group in groups:
            cells = "".join(f"{group[s].contour.rms * 1e3:10.1f}" for s in self.strategies)
            lines.append(f"{name:{width}s}{cells}")
        return lines

    def _trust(self) -> list[str]:
        """Where compensation helps and where it stops to."""
        if "none" not in self.parts.whole or len(self.strategies) < 2:
            return []
        best, lines = self.strategies[-1], [""]
        for error in self.model_error:
            told, count = error.as_json(self.strategies), len(error.printers)
            medians = ", ".join(f"{s} {told[s]['median_um']:.1f}" for s in self.strategies)
            lines.append(
                f"model off by up to {100 * error.share:g} %: "
                f"median of {count} printers {medians} µm; "
                f"worst {best} {told[best]['worst_um']:.1f} µm; "
                f"better than none on {error.better(best, 'none')}"
            )
        harmed = [
            f"{kind} {name}"
            for kind, groups in (("feature", self.parts.features), ("layer", self.parts.layers))
            for name, group in self._judged(groups)
            if group[best].contour.rms >= group["none"].contour.rms
        ]
        gain = self.parts.whole["none"].contour.rms > self.parts.whole[best].contour.rms
        if not gain:
            lines.append("NO HELP     compensation makes the whole of this print no better")
        elif harmed:
            more = f" and {len(harmed) - 5} more" if len(harmed) > 5 else ""
            lines.append(f"NO HELP     in {', '.join(harmed[:5])}{more}: no better than without")
        return lines if len(lines) > 1 else []


def known(report: Report) -> dict[str, Any]:
    """The fields of a conversion's report, to start a simulation's from."""
    return {field.name: getattr(report, field.name) for field in fields(Report)}


def _figures(group: Group) -> dict[str, Any]:
    return {name: group[name].as_json() for name in STRATEGIES if name in group}


def _row(name: str, figures: Figures) -> str:
    um, (x, y) = figures.contour.micrometres(), figures.tracking_rms() * 1e3
    return (
        f"{name:21s}{um['rms']:8.1f}{um['p95']:8.1f}{um['peak']:8.0f}{um['all']['rms']:8.1f}"
        f"{x:10.1f}{y:9.1f}{figures.velocity:9.0f}{figures.acceleration:10.0f}"
    )
