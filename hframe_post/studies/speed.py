"""The fastest print within an error: the file's accelerations and corner speeds times one factor.

The whole file is converted at several factors. Each is judged as the summary judges every print: on
the lines that are printed, with the range of the model. Feed rates stay, so a layer takes no less
time than the slicer, which counts with feed rates alone, wants for its cooling.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import Report, Row
from hframe_post.errors import HframeError
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.printer.settings import Speed

SLOWEST, FASTEST = 1.0 / 16.0, 32.0  # factors
AIM, NEAR = 0.975, 0.95  # shares of the bound: to aim at, and from which on it is used up
STEP = 1.2  # least ratio of two factors while all are on one side of the bound
MEASURES = {"rms": "RMS", "p95": "at 95 %", "peak": "at most"}

Convert = Callable[[Options], Report]  # converts the file; what it wrote last counts


@dataclass(frozen=True, slots=True)
class Trial:
    """A conversion at one factor. error: mm, with the range of the model; inf if it was refused."""

    factor: float
    error: float
    report: Report | None


def fastest(options: Options, convert: Convert) -> Report:
    """Return the report of the fastest print within ``options.speed``; convert it last.

    Raises HframeError if no print is within the bound.
    """
    speed, trials, factor = options.speed, list[Trial](), 1.0
    assert speed is not None
    while len(trials) < 8:
        trials.append(_tried(options, convert, factor))
        found = next_factor({each.factor: each.error / speed.max_error for each in trials})
        if found is None or _saturated(trials, speed.max_error):
            break
        factor = found
    best = max((one for one in trials if one.error <= speed.max_error), key=_factor, default=None)
    if best is None:
        least = min(trials, key=_factor)
        raise HframeError(
            f"this print cannot be kept within that error: even with {least.factor:.2g} times its "
            f"accelerations it has {1e3 * least.error:.0f} µm, model uncertainty included; allow "
            "more with --max-error or in max_error below [speed]"
        )
    last = best if best is trials[-1] else _tried(options, convert, best.factor)
    assert last.report is not None
    return replace(last.report, speed=(_row(last, last.report, speed),))


def next_factor(shares: dict[float, float]) -> float | None:
    """Return the factor to try next; None if there is none.

    shares: of the bound that the error was, by factor.
    """
    within = max((factor for factor, share in shares.items() if share <= 1.0), default=0.0)
    beyond = min((f for f, share in shares.items() if share > 1.0 and f > within), default=math.inf)
    if within and shares[within] >= NEAR:
        return None
    if within and beyond < math.inf:  # between both, on the line through their logarithms
        rise = math.log(shares[beyond] / shares[within])
        way = min(max(math.log(AIM / shares[within]) / rise, 0.1), 0.9)
        return within * math.pow(beyond / within, way) if beyond > 1.02 * within else None
    known, *others = sorted(shares, reverse=within > 0.0)  # the nearest to the bound first
    growth = 0.7  # of the error with the factor, on logarithmic scales, until two factors tell
    if others:
        growth = math.log(shares[others[0]] / shares[known]) / math.log(others[0] / known)
    step = math.pow(AIM / shares[known], 1.0 / min(max(growth, 0.2), 1.5))
    step = min(max(step, STEP), 4.0) if within else min(step, 1.0 / STEP)
    factor = min(max(known * step, SLOWEST), FASTEST)
    return factor if factor != known else None


def _saturated(trials: list[Trial], bound: float) -> bool:
    """Return whether the last raise within the bound made nothing faster: something else limits."""
    if len(trials) < 2 or trials[-1].error > bound or trials[-1].factor < trials[-2].factor:
        return False
    before, now = (each.report.time.after for each in trials[-2:] if each.report is not None)
    return now > 0.999 * before


def worst(contour: ContourErrors, measure: str) -> float:
    """Return a statistic of the errors at the upper end of the range of the model, mm."""
    known, rms = contour.range, contour.rms
    return contour.shown.measured(measure) * (known.high / rms if known and rms else 1.0)


def _factor(trial: Trial) -> float:
    return trial.factor


def _tried(options: Options, convert: Convert, factor: float) -> Trial:
    """Convert at a factor. A print that is refused for its accelerations has too great an error."""
    try:
        report = convert(replace(options, pace=factor))
    except HframeError:
        if factor <= 1.0:
            raise
        return Trial(factor, math.inf, None)
    speed = options.speed
    assert speed is not None
    contour = report.contour.get(options.strategy, ContourErrors())  # none if nothing moves
    return Trial(factor, max(worst(contour, speed.error_measure), 1e-6), report)


def _row(trial: Trial, report: Report, speed: Speed) -> Row:
    """Return the line of the summary about the factor and its error."""
    measure, contour = speed.error_measure, report.contour
    um = 1e3 * contour.get(report.strategy, ContourErrors()).shown.measured(measure)
    known = {
        "factor": round(trial.factor, 4), "measure": measure,
        "bound_um": round(1e3 * speed.max_error, 4), "predicted_um": round(um, 4),
        "with_model_uncertainty_um": round(1e3 * trial.error, 4),
    }  # fmt: skip
    text = (
        f"{trial.factor:.2f} times the file's accelerations: {um:.0f} µm {MEASURES[measure]}, "
        f"{1e3 * trial.error:.0f} with model uncertainty; {1e3 * speed.max_error:.0f} permitted"
    )
    if "none" in contour:
        before = 1e3 * contour["none"].shown.measured(measure)
        known["uncompensated_um"] = round(before, 4)
        text += f"; {before:.0f} without hframe-post"
    return Row("speed", text, {"speed": known})
