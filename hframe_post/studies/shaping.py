"""Input shapers for a printer: the best settings of each.

Each shaper gets the frequencies and damping with which it is most accurate on this plant and path,
so a comparison with it is fair. Its section for printer.cfg is an alternative to compensation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain
from typing import Any

from hframe_post.arrays import TS
from hframe_post.compensation.shape import LIVE, Shapes, shape
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import HframeError
from hframe_post.firmware.base import Firmware
from hframe_post.firmware.klipper.live import by_itself
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import (
    WITH_PARAMETERS,
    Shaping,
    compared,
)
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.linear import one_blas_thread
from hframe_post.planner.sliced import AsSliced
from hframe_post.prediction.best_shaper import Paths, ranked
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.predict import quantise
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.printer.settings import Printer
from hframe_post.writers.gcode import as_written
from hframe_post.writers.print_time import duration


def search(plant: Plant, paths: Paths) -> list[Shaping]:
    """Return all shapers with good settings for these paths, the most accurate first.

    A search by the true contour error takes 60 times as long for settings with 1 to 5 % less of it
    (``zvdd`` and ``zvddd``: 8 and 10 %). Raises HframeError if there are no paths.
    """
    if not paths:
        raise HframeError(
            "there is no path to shape: nothing is extruded at a known place after the label of a "
            "layer, such as ;LAYER:0"
        )
    return ranked(plant, paths, compared())


# ----------------------------------------------------------------------
# Comparison of a print with input shapers to one without compensation and to this tool's.
#
#     firmware's own motion ──► with those of shapers ────────┐
#     our plan ──► commands of the strategies ──► their lines ┴─► nozzle ──► contour error of each
#


@dataclass(frozen=True, slots=True)
class ShaperComparison:
    """Predicted print with a strategy or a shaper. shaping: None for a strategy.

    width: shares by which the line's width is off. seconds: duration; for a shaper, including the
    time by which it delays the last motion.
    """

    name: str
    shaping: Shaping | None
    contour: ContourErrors
    width: ErrorStatistics
    seconds: float


@one_blas_thread()
def compare_shapers(
    lines: Callable[[], Iterable[bytes]], printer: Printer, options: Options, plant: Plant
) -> list[ShaperComparison]:
    """Return the predicted print with each strategy and shaper, the most accurate first.

    lines: opens the file and yields its lines, at each call again. plant: on which all are judged;
    they are made for the printer's. Raises HframeError.
    """
    stages = Chain(printer, options)
    pieces = SlicedFile.from_items(stages.read(lines()), printer).paths
    shapings = {found.x.name: found for found in search(printer.plant, pieces)}
    firmware, meter = stages.firmware, ErrorMeter(plant)
    sliced, rules = AsSliced(firmware.limits()), firmware.motion(options.tolerance)
    by_firmware: dict[str, Shapes] = {**shapings, **by_itself(printer, LIVE)}
    today = shape(sliced.samples(stages.read(lines())), by_firmware)
    if firmware.steps is not None:
        today = quantise(today, printer.kinematics, firmware.steps)
    ours = WholeFile(lines(), printer, options)
    strategies = tuple(STRATEGIES)[1:]
    written = as_written(ours.samples(strategies), strategies, rules, firmware.code())
    for _ in chain(meter.samples(today), meter.samples(written)):
        pass
    durations = dict.fromkeys(STRATEGIES, ours.report.time.after) | {"none": sliced.seconds}
    durations |= {name: sliced.seconds + TS * one.reach for name, one in by_firmware.items()}
    compared = (
        ShaperComparison(name, shapings.get(name), contour, meter.width[name], durations[name])
        for name, contour in meter.contour.items()
    )
    return sorted(compared, key=lambda one: one.contour.rms)


def comparison_as_json(found: list[ShaperComparison]) -> list[dict[str, Any]]:
    """Return the compared prints, the most accurate first; µm and s."""
    return [
        {
            "name": compared.name,
            "contour_error_um": compared.contour.micrometres(),
            "line_width_error_percent": compared.width.percents(),
            "print_time_s": round(compared.seconds, 3),
            **({} if compared.shaping is None else compared.shaping.as_json()),
        }
        for compared in found
    ]


def comparison_as_text(found: list[ShaperComparison], firmware: Firmware | type[Firmware]) -> str:
    """Return a table, and the settings of the best shaper that the firmware has."""
    lines = [
        "",
        f"{'comparison':22s}{'x, Hz (damping)':>17s}{'y, Hz (damping)':>17s}"
        f"{'µm RMS':>9s}{'95 %':>8s}{'peak':>7s}{'line, %':>9s}{'time':>13s}",
    ]
    for each in found:
        um = each.contour.micrometres()
        axes = ("", "") if each.shaping is None else each.shaping.as_text()
        lines.append(
            f"{each.name:22s}{axes[0]:>17s}{axes[1]:>17s}{um['rms']:9.1f}{um['p95']:8.1f}"
            f"{um['peak']:7.0f}{100.0 * each.width.rms:9.1f}{duration(each.seconds):>13s}"
        )
    shapers = [(one.contour.rms, one.shaping) for one in found if one.shaping is not None]
    rms, best = next(each for each in shapers if each[1].x.name in firmware.shapers)
    lines += ["", firmware.shaper_settings(best)]
    least, newer = next(
        (each for each in shapers if each[1].x.name in WITH_PARAMETERS), (rms, best)
    )
    if firmware.newer_versions and least < 0.95 * rms:  # so much is worth an update
        lines += ["", f"# {1e3 * least:.1f} µm, on {firmware.newer_versions} only:"]
        lines += [f"# {line}" for line in firmware.shaper_settings(newer).splitlines()]
    return "\n".join(lines)
