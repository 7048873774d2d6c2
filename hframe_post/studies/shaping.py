"""Input shapers for a printer: the best settings of each, and those that Klipper would choose.

Each shaper gets the frequencies and damping with which it is most accurate on this plant and path,
so a comparison with it is fair. Its section for printer.cfg is an alternative to compensation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from hframe_post.arrays import TS
from hframe_post.compensation.shape import LIVE, Shapes, shape
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, SampleStream
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.errors import HframeError
from hframe_post.firmware.base import Firmware
from hframe_post.firmware.klipper.firmware import SHAPERS as KLIPPER
from hframe_post.firmware.klipper.live import by_itself
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import (
    WITH_PARAMETERS,
    AxisShaping,
    Shaper,
    Shaping,
    compared,
    shaper,
)
from hframe_post.model.strategies import STRATEGIES
from hframe_post.planner.sliced import AsSliced
from hframe_post.prediction.best_shaper import Paths, ranked
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from hframe_post.writers.print_time import duration

# Klipper's calibration, as of November 2025 (klippy/extras/shaper_calibrate.py)
KLIPPER_HZ = np.arange(5.0, 135.0, 0.5)  # that its test shakes with
KLIPPER_LOW = 10.0  # Hz, below which its data count less
KLIPPER_DAMPING = 0.1  # that a shaper is made for
KLIPPER_DAMPINGS = (0.075, 0.1, 0.15)  # that the printer may have
KLIPPER_ACCELERATION, KLIPPER_CORNER = 5000.0, 5.0  # mm/s², mm/s, of the smoothing
KLIPPER_LEAST = {"zv": 21.0, "mzv": 23.0, "ei": 29.0, "2hump_ei": 39.0, "3hump_ei": 48.0}  # Hz
KLIPPER_MOST, KLIPPER_STEP = 150.0, 0.2  # Hz


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


def calibrated(plant: Plant) -> Shaping:
    """Return the shaping that Klipper's calibration would choose for this plant.

    It excites each axis with an acceleration proportional to the frequency, and judges each shaper
    by the vibration that it leaves at the worst of three damping ratios, and by its smoothing.
    """
    return calibrated_with(plant, *KLIPPER)


def calibrated_with(plant: Plant, *names: str) -> Shaping:
    """Return the shaping that Klipper's calibration would choose among these shapers."""
    return Shaping(_calibrated(plant.Gxx, names), _calibrated(plant.Gyy, names))


@dataclass(frozen=True, slots=True)
class _JudgedShaper:
    """A shaper as Klipper judges it. vibration: share that it leaves; smoothing: mm."""

    name: str
    hz: float
    vibration: float
    smoothing: float

    @property
    def score(self) -> float:
        return self.smoothing * float(self.vibration**1.5 + 0.2 * self.vibration + 0.01)


def _calibrated(G: ImpulseResponse, names: Iterable[str]) -> AxisShaping:
    best, chosen = None, list[_JudgedShaper]()
    for name in names:
        fits = _fits(G, name)
        fit = _chosen(fits)
        if best is None or _is_clearly_better(fit, best):
            best = fit
        for other in reversed(fits):  # better in both
            if other.vibration < best.vibration and other.smoothing < best.smoothing:
                best = fit = other
        chosen.append(fit)
    assert best is not None
    if best.name == "zv":  # unless another leaves clearly less
        least = best.vibration / 1.1
        best = next((fit for fit in chosen if fit.name != "zv" and fit.vibration < least), best)
    return AxisShaping(best.name, best.hz, KLIPPER_DAMPING)


def _is_clearly_better(fit: _JudgedShaper, best: _JudgedShaper) -> bool:
    """Return whether the score is better by 20 %, or by 5 % with a tenth less smoothing."""
    return 1.2 * fit.score < best.score or (
        1.05 * fit.score < best.score and 1.1 * fit.smoothing < best.smoothing
    )


def _chosen(fits: list[_JudgedShaper]) -> _JudgedShaper:
    """Return the fit with the best score of those that leave about the least vibration."""
    quietest = min(fits, key=lambda fit: fit.vibration)
    near = [fit for fit in fits if fit.vibration < 1.1 * quietest.vibration + 0.0005]
    return min((quietest, *reversed(near)), key=lambda fit: fit.score)


def _fits(G: ImpulseResponse, name: str) -> list[_JudgedShaper]:
    """Return a shaper at each frequency that Klipper tries, the highest first."""
    hz = KLIPPER_HZ
    measured = np.square(np.abs(G.response(2.0 * np.pi * hz * TS)) * hz) / (hz + 0.1)
    low = hz < KLIPPER_LOW
    measured[low] *= np.exp(1.0 - np.square(KLIPPER_LOW / (hz[low] + 0.1)))
    floor = measured.max() / 20.0  # noise of the accelerometer
    loud = np.maximum(measured - floor, 0.0).sum()
    fits = []
    for f in np.arange(KLIPPER_LEAST[name], KLIPPER_MOST, KLIPPER_STEP)[::-1].tolist():
        tried = shaper(name, f, KLIPPER_DAMPING)
        left = (tried.residual(hz, damping) * measured for damping in KLIPPER_DAMPINGS)
        vibration = max(float(np.maximum(each - floor, 0.0).sum() / loud) for each in left)
        fits.append(_JudgedShaper(name, f, vibration, _smoothing(tried)))
    return fits


def _smoothing(tried: Shaper) -> float:
    """Return by how many mm a shaper rounds a corner of 90° or a reversal, as Klipper computes."""
    T, half = tried.T, KLIPPER_ACCELERATION / 2.0
    late = T >= 0.0
    by_corner = float((tried.A * (KLIPPER_CORNER + half * T) * T)[late].sum())
    back = float((tried.A * half * T * T).sum())
    return max(by_corner * float(np.sqrt(2.0)), back)


# ----------------------------------------------------------------------
# Comparison of a print with input shapers to one without compensation and to this tool's.
#
#     firmware's own motion ──► with those of shapers ─┐
#     our plan ──► commands of the strategies ─────────┴─► nozzle ──► contour error of each
#
# Each shaper appears twice: with the frequencies and damping that are most accurate on pieces of
# the
# print, and with the frequencies that Klipper's calibration would choose.

WORTH = 0.95  # of a shaper's error, below which one that needs a newer Klipper is shown
CALIBRATED = " as calibrated"  # appended to the name of a shaper with Klipper's frequencies


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
    pieces = SlicedFile.from_items(stages.parsed(lines()), printer).paths
    shapings = {found.x.name: found for found in search(printer.plant, pieces)}
    shapings |= {name + CALIBRATED: calibrated_with(printer.plant, name) for name in KLIPPER}
    sliced, meter = AsSliced(stages.firmware.limits()), ErrorMeter(plant)
    by_firmware: dict[str, Shapes] = {**shapings, **by_itself(printer, LIVE)}
    today = shape(sliced.samples(stages.parsed(lines())), by_firmware)
    ours = SampleStream(lines(), printer, options, tuple(STRATEGIES)[1:])
    for _ in chain(meter.samples(today), meter.samples(ours)):
        pass
    durations = dict.fromkeys(STRATEGIES, ours.report().time.after) | {"none": sliced.seconds}
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
    if firmware.newer_versions and least < WORTH * rms:
        lines += ["", f"# {1e3 * least:.1f} µm, on {firmware.newer_versions} only:"]
        lines += [f"# {line}" for line in firmware.shaper_settings(newer).splitlines()]
    return "\n".join(lines)
