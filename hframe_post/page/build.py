"""The page of a print: its layers by predicted error, the worst places, what is in words."""

from __future__ import annotations

import base64
import math
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.compensation.shape import SHAPER
from hframe_post.conversion.print_report import Report
from hframe_post.model.shapers import Shaping
from hframe_post.model.strategies import STRATEGIES
from hframe_post.page import filled
from hframe_post.prediction.picture import Picture, Pieces
from hframe_post.prediction.statistics import TRAVEL, ContourErrors
from hframe_post.version import __version__

TEXT_LEVEL = 4  # of compression of text: a third of the time of 6, for 3 to 20 % more bytes
PACKED_LEVEL = 2  # of pieces: two thirds of the time of 4, for 5 % more bytes
MAX_TEXT_BYTES = 1_650_000  # bytes of compressed G-code that a page carries
TRIED_LINES = 10_000  # after which a text that will take a tenth more than that is given up
WORST_PLACES = 10  # places
APART_MM = 2.0  # mm between two of them, seen from above
PER_MM = 100.0  # places are written in 10 µm
PER_MM_OF_ERROR = 1e4  # errors in 0.1 µm
PER_MM_OFF = 1e3  # the way from the path to the nozzle in 1 µm
SHOWN = ("none", SHAPER, *list(STRATEGIES)[1:])


def page(report: Report, lines: Iterable[bytes], name: str, notes: list[str]) -> bytes:
    """Return the HTML page for a print.

    report: with a picture. lines: of the file, shown where the reader points. name: the title;
    notes: the lines of the summary.
    """
    picture, printer = report.picture, report.printer
    assert picture is not None
    strategies = [each for each in SHOWN if each in picture.strategies]
    columns = {picture.strategies.index(each): _median(report.contour[each]) for each in strategies}
    pieces = picture.pieces()
    belts, stated = report.peaks, printer.motors.stated
    data = {
        "name": name,
        "version": __version__,
        "warnings": report.warnings(),
        "notes": [each for each in notes if not each.startswith("WARNING")],
        "facts": _facts(report),
        "chosen": report.strategy,
        "strategies": [_strategy(each, report) for each in strategies],
        "figures": [_strategy(each, report) for each in SHOWN if each in report.contour],
        "seconds": [report.time.before, report.time.after],
        "belts": {
            "speed": _of(belts.belt_velocity, stated.belt_velocity),
            "acceleration": _of(belts.belt_acceleration, stated.belt_acceleration),
        },
        "matrix": printer.kinematics.matrix.tolist(),
        "features": picture.labels.features,
        "layers": _layers(picture, pieces, columns),
        "byFeature": _by_feature(picture, columns),
        "worst": _worst(pieces, picture.strategies.index(report.strategy)) if strategies else [],
        "coarse": picture.finest if picture.coarser else None,
    }
    packed = _packed(pieces, list(columns))
    text = _compressed(lines, report.read.lines)
    return filled("page", data, SEGMENTS=_coded(packed), TEXT=_coded(text))


def _coded(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _compressed(lines: Iterable[bytes], count: int) -> bytes:
    """Return the text compressed, or nothing if it is too long. count: of its lines."""
    squeeze, parts = zlib.compressobj(TEXT_LEVEL), list[bytes]()
    read = size = 0
    for text in lines:  # of one line, or of many
        some = [line.rstrip(b"\r") for line in text.removesuffix(b"\n").split(b"\n")]
        parts.append(squeeze.compress(b"\n".join([*some, b""])))
        read, size = read + len(some), size + len(parts[-1])
        hopeless = read >= TRIED_LINES and size * count > 1.1 * MAX_TEXT_BYTES * read
        if hopeless or size > MAX_TEXT_BYTES:
            return b""
    return b"".join([*parts, squeeze.flush()])


# ---------------------------------------------------------------------- figures


def _strategy(name: str, report: Report) -> dict[str, Any]:
    um = report.contour[name].micrometres()
    shown: dict[str, Any] = {"name": name, "label": report.label(name), "p95": um["p95"]}
    shown["rms"] = um.get("median", um["rms"])
    if "from" in um:
        shown["range"] = [um["from"], um["to"]]
    return shown


def _layers(picture: Picture, pieces: Pieces, columns: Mapping[int, float]) -> list[dict[str, Any]]:
    """Return name, number of pieces and errors of each layer with pieces, in order."""
    printed, moved = defaultdict[int, Any](float), defaultdict[int, Any](float)
    travel = picture.labels.features.index(TRAVEL)
    for (layer, feature), sums in _sums(picture):
        (moved if feature == travel else printed)[layer] += sums
    numbers, counts = np.unique(pieces.layer, return_counts=True)
    return [
        {
            "name": picture.labels.layers[number],
            "count": count,
            "rms": _rms(printed[number] if number in printed else moved[number], columns),
        }
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True)
    ]


def _by_feature(picture: Picture, columns: Mapping[int, float]) -> list[dict[str, Any]]:
    """Return for each feature its share of the time and the errors of each strategy."""
    groups = defaultdict[int, Any](float)
    for (_, feature), sums in _sums(picture):
        groups[feature] += sums
    whole = sum(sums[0, 0] for sums in groups.values())
    return [
        {
            "name": picture.labels.features[feature],
            "share": sums[0, 0] / whole,
            "rms": _rms(sums, columns),
        }
        for feature, sums in sorted(groups.items(), key=lambda each: -each[1][0, 0])
    ]


def _sums(picture: Picture) -> Iterator[tuple[tuple[int, int], Array]]:
    """Yield layer and feature, with number and squares of each strategy in a row."""
    for key, (count, *squares) in picture.sums.items():
        yield key, np.column_stack([np.full(len(squares), count), squares])


def _median(contour: ContourErrors) -> float:
    """Return by which factor the median error is greater as the printer changes.

    What is not known of a printer grows with its motion as the error does, so that the factor of
    a print is that of its layers and features.
    """
    return contour.expected / contour.rms if contour.rms else 1.0


def _rms(sums: Array, columns: Mapping[int, float]) -> list[float]:
    """Return the RMS errors in µm, medians if anything is not known; sums: as of ``_sums``."""
    mean = np.sqrt(sums[:, 1] / sums[:, 0]).tolist()
    return [round(1e3 * factor * mean[k], 3) for k, factor in columns.items()]


def _worst(pieces: Pieces, column: int) -> list[int]:
    """Return the pieces with the largest errors while printing, none near another."""
    errors = np.where(pieces.feature > 0, pieces.error[:, column], 0.0)
    x, y = pieces.xy.T
    found = list[int]()
    while len(found) < WORST_PLACES and errors.max(initial=0.0) > 0.0:
        k = int(errors.argmax())
        found.append(k)
        errors[np.square(x - x[k]) + np.square(y - y[k]) < APART_MM * APART_MM] = 0.0
    return found


def _of(peak: float, limit: float) -> list[float]:
    """Return a peak and, if the owner has stated it, its limit."""
    return [round(peak), *([limit] if limit < math.inf else [])]


def _facts(report: Report) -> list[list[str]]:
    printer, options = report.printer, report.options
    shaping = report.shaping or options.shaping
    limits, window = printer.limits, printer.compensation
    return [
        ["profile", f"{printer.name}: {printer.description}"],
        ["kinematics", printer.kinematics.type],
        ["firmware", printer.firmware.dialect],
        ["highest speed", f"{limits.velocity:g} mm/s"],
        ["highest acceleration", f"{limits.acceleration:g} mm/s²"],
        ["square corner", f"{limits.square_corner_velocity:g} mm/s"],
        ["knots", f"{window.L} ms apart, effort {window.effort[0]:g} and {window.effort[1]:g}"],
        ["limits of the file", str(options.limits)],
        *([["best input shaper", _shaper(shaping)]] if shaping else []),
        ["beyond a limit", "clamped" if options.clamp else "an error"],
        ["settings", printer.digest],
    ]


def _shaper(shaping: Shaping) -> str:
    axes = (("x", shaping.x), ("y", shaping.y))
    settings = ", ".join(f"{one.hz:.1f} Hz, damping {one.damping:.2f} ({a})" for a, one in axes)
    return f"{shaping.x.name}: {settings}; the firmware's best for this print"


def _packed(pieces: Pieces, columns: list[int]) -> bytes:
    """Return all pieces compressed, column by column, positions as differences; little-endian.

    int32 x, y, line; uint16 speed and each strategy's error; int16 x, y of each strategy's nozzle
    and then of each one's way to it from the path; uint8 feature, 128 more where the path begins.
    """
    places = (*(np.rint(row * PER_MM) for row in pieces.xy.T), pieces.line)
    ways = (
        np.clip(np.rint(way[:, column, axis] * scale), -32767, 32767)
        for way, scale in ((pieces.nozzle, PER_MM), (pieces.off, PER_MM_OFF))
        for column in columns
        for axis in (X, Y)
    )
    squeeze = zlib.compressobj(PACKED_LEVEL)
    parts = (
        *(np.diff(row.astype("<i4"), prepend=np.int32(0)) for row in places),
        np.minimum(pieces.speed, 65535.0).astype("<u2"),
        *(
            np.minimum(np.rint(pieces.error[:, k] * PER_MM_OF_ERROR), 65535.0).astype("<u2")
            for k in columns
        ),
        *(way.astype("<i2") for way in ways),
        (np.minimum(pieces.feature, 127) + 128 * pieces.begins).astype("u1"),
    )
    return b"".join([*(squeeze.compress(part.tobytes()) for part in parts), squeeze.flush()])
