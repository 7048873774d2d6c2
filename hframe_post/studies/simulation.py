"""What would it do for this part? Every strategy through the plant, and how far to trust it.

lines → … → guard → (whole steps) → simulate, on the plant and on printers that are not
quite the plant → figures by layer and feature
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.conversion.pipeline import (
    JUDGED_EVERY,
    Options,
    commanded,
    counted,
    extruded,
    prepared,
    timed,
)
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Plant
from hframe_post.prediction.labels import Labels
from hframe_post.prediction.predict import Judgement, judge
from hframe_post.prediction.quantise import quantise
from hframe_post.prediction.statistics import ErrorStatistics, Figures, belt_rates
from hframe_post.printer.settings import Printer, Steps
from hframe_post.stream.chunks import branches
from hframe_post.stream.prefetch import prefetch
from hframe_post.stream.types import Samples
from hframe_post.studies.simulation_report import Group, SimulationReport, Uncertainty

DRAWS_JUDGED_EVERY = 4  # samples: many printers, and their spread is wide


@dataclass(frozen=True, slots=True)
class Study:
    """What stands in for the printer.

    plant: what is simulated, whatever the compensator believes. drawn: share of model error
    → printers that are off by up to that. steps: None for motors without steps.
    """

    plant: Plant
    drawn: dict[float, list[Plant]] = field(default_factory=dict)
    steps: Steps | None = None


def simulate(
    lines: Iterable[bytes],
    printer: Printer,
    options: Options,
    study: Study,
    report: SimulationReport,
) -> None:
    """Fills the report; memory does not grow with the print. Raises HframeError."""
    compensator = prepared(printer)
    commands = prefetch(commanded(counted(lines, report), printer, compensator, options, report))
    commands = _rated(extruded(timed(commands, report), report), printer.kinematics, report)
    if study.steps is not None:
        commands = quantise(commands, printer.kinematics, study.steps)
    count = 1 + sum(map(len, study.drawn.values()))
    streams = iter(branches(commands, count))
    judged = judge(next(streams), study.plant, JUDGED_EVERY)
    drawn: list[Iterator[None]] = []
    for share, plants in study.drawn.items():
        uncertainty = Uncertainty(share)
        report.model_error.append(uncertainty)
        for plant in plants:
            contour: dict[str, ErrorStatistics] = {}
            uncertainty.printers.append(contour)
            drawn.append(_drawn(judge(next(streams), plant, DRAWS_JUDGED_EVERY), contour))
    labels = Labels()
    for judgement, *_ in zip(judged, *drawn, strict=True):  # block by block, to hold but one
        _add_errors(judgement, labels, report)


def _drawn(judged: Iterable[Judgement], contour: dict[str, ErrorStatistics]) -> Iterator[None]:
    """Takes the contour errors of one printer, a block at a time."""
    for judgement in judged:
        for name, errors in judgement.contour.items():
            contour.setdefault(name, ErrorStatistics()).add(errors)
        yield


def _add_errors(judgement: Judgement, labels: Labels, report: SimulationReport) -> None:
    layer, feature = labels.of(judgement.block)
    for group, which in _groups(layer[judgement.at], feature[judgement.at], labels, report):
        for name, contour in judgement.contour.items():
            figures = group.setdefault(name, Figures())
            figures.add_errors(contour[which], judgement.tracking[name][which])
    report.add_errors(judgement.contour)


def _rated(
    blocks: Iterable[Samples], kinematics: Kinematics, report: SimulationReport
) -> Iterator[Samples]:
    """The blocks as they are; how fast the belts go is reported."""
    labels, before = Labels(), dict[str, Array]()
    for block in blocks:
        layer, feature = labels.of(block)
        for name, command in block.commands.items():
            known = before.get(name, command[:1].repeat(2, axis=0))
            if len(command):
                velocity, acceleration = belt_rates(np.concatenate([known, command]), kinematics)
                for group, which in _groups(layer, feature, labels, report):
                    figures = group.setdefault(name, Figures())
                    figures.add_rates(velocity[which], acceleration[which])
                before[name] = np.concatenate([known, command])[-2:]
        if block.yields:
            before = {}
        yield block


def _groups(
    layer: Integers, feature: Integers, labels: Labels, report: SimulationReport
) -> Iterator[tuple[Group, Integers]]:
    """The parts of the print that occur among the samples, each with the indices of its own."""
    yield report.whole, np.arange(len(layer))
    for numbers, names, groups in (
        (layer, labels.layers, report.layers),
        (feature, labels.features, report.features),
    ):
        for number in np.unique(numbers).tolist():
            group = groups.setdefault(names[number], {})
            yield group, np.flatnonzero(numbers == number)
