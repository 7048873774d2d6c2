"""Simulation of every strategy on a print, and on printers that differ from the model.

commands → (whole steps) → judged on the plant, and on printers that are not quite the plant
→ figures by layer and feature
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hframe_post.arrays import Integers
from hframe_post.compensation.guard import check_prediction
from hframe_post.conversion.meters import JUDGED_EVERY
from hframe_post.conversion.pipeline import Commands, Options
from hframe_post.model.kinematics import Differences, Kinematics
from hframe_post.model.plant import Plant
from hframe_post.prediction.predict import Judgement, judge, quantise
from hframe_post.prediction.statistics import ContourErrors, Figures, Labels
from hframe_post.printer.settings import Printer, Steps
from hframe_post.stream.chunks import branches
from hframe_post.stream.types import Samples
from hframe_post.studies.simulation.layer_view import LayerView
from hframe_post.studies.simulation.report import (
    Group,
    Parts,
    SimulationReport,
    Uncertainty,
    report_fields,
)

DRAWS_JUDGED_EVERY = 4  # samples: many printers, and their spread is wide


@dataclass(frozen=True, slots=True)
class Study:
    """The printer that is simulated.

    plant, name: of the simulated printer, which may differ from the one compensated for. drawn:
    share of model error → random printers that differ by up to that. steps: round commands to
    whole motor steps; None for none.
    """

    plant: Plant
    drawn: dict[float, list[Plant]] = field(default_factory=dict)
    steps: Steps | None = None
    name: str = ""


def simulate(
    lines: Iterable[bytes],
    printer: Printer,
    options: Options,
    study: Study,
    view: LayerView | None = None,
) -> SimulationReport:
    """Simulate the options' strategies; memory does not grow with the print.

    view: collects a picture of the layers. Raises HframeError, also if the model predicts an
    error that no working printer has.
    """
    source = Commands(lines, printer, replace(options, predict=()), options.strategies)
    parts, uncertainties = Parts(), list[Uncertainty]()
    commands = _rated(source, printer.kinematics, parts)
    if study.steps is not None:
        commands = quantise(commands, printer.kinematics, study.steps)
    count = 1 + sum(map(len, study.drawn.values()))
    streams = iter(branches(commands, count))
    judged = judge(next(streams), study.plant, JUDGED_EVERY)
    drawn: list[Iterator[None]] = []
    for share, plants in study.drawn.items():
        uncertainty = Uncertainty(share)
        uncertainties.append(uncertainty)
        for plant in plants:
            contour: dict[str, ContourErrors] = {}
            uncertainty.printers.append(contour)
            drawn.append(_drawn(judge(next(streams), plant, DRAWS_JUDGED_EVERY), contour))
    labels = Labels()
    for judgement, *_ in zip(judged, *drawn, strict=True):  # chunk by chunk, to hold but one
        layer, feature = labels.number(judgement.chunk)
        _add_errors(judgement, layer, feature, labels, parts)
        if view is not None:
            view.add(judgement, layer, feature, labels)
    contour = {name: figures.contour for name, figures in parts.whole.items()}
    if "none" in contour:
        check_prediction(contour["none"].rms)
    return SimulationReport(
        **report_fields(replace(source.report(), contour=contour)), plant=study.name,
        quantised=study.steps is not None, parts=parts, model_error=tuple(uncertainties),
    )  # fmt: skip


def _drawn(judged: Iterable[Judgement], contour: dict[str, ContourErrors]) -> Iterator[None]:
    """Add the contour errors of one random printer, a chunk at a time."""
    for judgement in judged:
        for name, errors in judgement.contour.items():
            contour.setdefault(name, ContourErrors()).add(errors, judgement.extruding)
        yield


def _add_errors(
    judgement: Judgement, layer: Integers, feature: Integers, labels: Labels, parts: Parts
) -> None:
    for group, which in _groups(layer[judgement.at], feature[judgement.at], labels, parts):
        for name, contour in judgement.contour.items():
            figures = group.setdefault(name, Figures())
            figures.add_errors(
                contour[which], judgement.tracking(name)[which], judgement.extruding[which]
            )


def _rated(chunks: Iterable[Samples], kinematics: Kinematics, parts: Parts) -> Iterator[Samples]:
    """Note how fast the belts move; yield the chunks unchanged."""
    labels, differences = Labels(), dict[str, Differences]()
    for chunk in chunks:
        layer, feature = labels.number(chunk)
        for name, command in chunk.commands.items():
            if len(command):
                rates = differences.setdefault(name, Differences(kinematics)).rates(command)
                velocity = np.abs(rates.belt_velocity).max(axis=0)
                acceleration = np.abs(rates.belt_acceleration).max(axis=0)
                for group, which in _groups(layer, feature, labels, parts):
                    figures = group.setdefault(name, Figures())
                    figures.add_rates(velocity[which], acceleration[which])
        if chunk.ends_stretch:
            differences = {}
        yield chunk


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
