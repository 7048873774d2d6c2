"""The page of a print: its layers by predicted error, the worst places, what is in words."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.conversion.pipeline import Options
from hframe_post.model.strategies import STRATEGIES
from hframe_post.page import filled
from hframe_post.printer.settings import Printer
from hframe_post.studies.simulation.layer_view import LayerView, Segments
from hframe_post.studies.simulation.simulate import Group, SimulationReport, Study, simulate
from hframe_post.version import __version__

LARGEST_TEXT = 1_500_000  # bytes of compressed G-code that a page carries
WORST = 10  # places
APART = 2.0  # mm between two of them, seen from above
PER_MM = 100.0  # places are written in 10 µm
PER_MM_OF_ERROR = 1e4  # errors in 0.1 µm


def page(
    lines: Iterable[bytes], printer: Printer, options: Options, name: str, notes: list[str],
    simulated: Printer | None = None,
) -> bytes:  # fmt: skip
    """Return the HTML page for a file, simulated with all strategies. Raises HframeError.

    name: the title; notes: the lines of the summary. simulated: the printer whose plant is
    simulated, if not the one compensated for.
    """
    source = _Kept(lines)
    view = LayerView(tuple(STRATEGIES))
    answers = simulated or printer
    study = Study(answers.plant, name=answers.name)
    report = simulate(source, printer, replace(options, predict=tuple(STRATEGIES)), study, view)
    names = view.labels
    layers = view.layers()
    data = {
        "name": name,
        "version": __version__,
        "notes": notes,
        "chosen": options.strategy,
        "strategies": [
            {"name": each.name, "label": each.label, "colour": each.colour}
            for each in STRATEGIES.values()
        ],
        "report": report.as_json(),
        "features": names.features,
        "layers": [
            {
                "name": names.layers[number],
                "count": len(each.line),
                "rms": _rms_of(report.parts.layers.get(names.layers[number], {})),
            }
            for number, each in layers.items()
        ],
        "byFeature": _by_feature(report),
        "worst": _worst(layers, options.strategy),
        "coarse": view.finest if view.coarser else None,
        "belts": {
            "speed": printer.motors.belt_velocity,
            "acceleration": printer.motors.belt_acceleration,
        },
        "printer": _printer(printer, options),
    }
    return filled("page", data, SEGMENTS=_coded(_packed(layers)), TEXT=_coded(source.packed))


def _coded(content: bytes) -> str:
    return base64.b64encode(content).decode()


class _Kept:
    """The lines of a file, compressed while they pass, unless that gets too long."""

    def __init__(self, lines: Iterable[bytes]) -> None:
        self._lines, self._size = lines, 0
        self._parts: list[bytes] | None = []

    def __iter__(self) -> Iterator[bytes]:
        squeeze = zlib.compressobj(9)
        for line in self._lines:
            if self._parts is not None:
                part = squeeze.compress(line.rstrip(b"\r\n") + b"\n")
                self._parts.append(part)
                self._size += len(part)
                if self._size > LARGEST_TEXT:
                    self._parts = None
            yield line
        if self._parts is not None:
            self._parts.append(squeeze.flush())

    @property
    def packed(self) -> bytes:
        """Return the compressed text; nothing if it is too long."""
        return b"".join(self._parts or ())


def _rms_of(group: Group) -> list[float]:
    return [
        round(group[name].contour.rms * 1e3, 3) if name in group else 0.0 for name in STRATEGIES
    ]


def _by_feature(report: SimulationReport) -> list[dict[str, Any]]:
    """Return for each feature its share of the time and the errors of each strategy."""
    groups = report.parts.features
    counts = {
        name: max(each.contour.all.count for each in group.values())
        for name, group in groups.items()
        if group
    }
    whole = sum(counts.values()) or 1
    return [
        {
            "name": name,
            "share": count / whole,
            "rms": _rms_of(groups[name]),
            "peak": [
                round(groups[name][each].contour.shown.peak * 1e3, 1)
                if each in groups[name]
                else 0.0
                for each in STRATEGIES
            ],
        }
        for name, count in sorted(counts.items(), key=lambda each: -each[1])
        if count
    ]


def _worst(layers: dict[int, Segments], strategy: str) -> list[dict[str, Any]]:
    """Return layer and segment of the places where the chosen strategy has the largest errors."""
    column = list(STRATEGIES).index(strategy)
    order, found = list(layers.values()), list[dict[str, Any]]()
    candidates = []
    for index, each in enumerate(order):
        errors = np.where(each.feature > 0, each.error[:, column], 0.0)  # what prints
        candidates += [(float(errors[k]), index, int(k)) for k in np.argsort(errors)[-5 * WORST :]]
    taken: list[Array] = []
    for error, index, k in sorted(candidates, reverse=True):
        place = order[index].xy[k]
        if error > 0.0 and not any(np.hypot(*(place - other)) < APART for other in taken):
            taken.append(place)
            found.append({"layer": index, "segment": k})
        if len(found) == WORST:
            break
    return found


def _printer(printer: Printer, options: Options) -> list[list[str]]:
    limits, window, motors = printer.limits, printer.compensation, printer.motors
    return [
        ["profile", f"{printer.name}: {printer.description}"],
        ["kinematics", printer.kinematics.type],
        ["firmware", printer.firmware.dialect],
        ["highest speed", f"{limits.velocity:g} mm/s"],
        ["highest acceleration", f"{limits.acceleration:g} mm/s²"],
        ["square corner", f"{limits.square_corner_velocity:g} mm/s"],
        ["belts", f"{motors.belt_velocity:g} mm/s, {motors.belt_acceleration:g} mm/s²"],
        ["knots", f"{window.L} ms apart, effort {window.effort[0]:g} and {window.effort[1]:g}"],
        ["limits of the file", str(options.limits)],
        ["beyond a limit", "clamped" if options.clamp else "an error"],
        ["settings", printer.digest],
    ]


def _packed(layers: dict[int, Segments]) -> bytes:
    """Return all segments compressed, column by column, positions as differences; little-endian.

    int32 x, y, line; uint16 speed and each strategy's error; uint8 feature, 128 more where the
    path begins.
    """
    parts = list(layers.values())
    if not parts:
        return zlib.compress(b"")
    xy, speed, error = (
        np.concatenate([getattr(each, name) for each in parts]) for name in ("xy", "speed", "error")
    )
    feature = np.concatenate([np.minimum(each.feature, 127) + 128 * each.begins for each in parts])
    line = np.concatenate([each.line for each in parts])
    places = np.column_stack([np.rint(xy * PER_MM).astype(np.int64), line])
    errors = np.minimum(np.rint(error * PER_MM_OF_ERROR), 65535.0)
    columns = (
        np.diff(places, axis=0, prepend=np.zeros((1, 3), np.int64)).T.astype("<i4"),
        np.minimum(speed, 65535.0).astype("<u2"),
        errors.T.astype("<u2"),
        feature.astype("u1"),
    )
    return zlib.compress(b"".join(column.tobytes() for column in columns), 9)
