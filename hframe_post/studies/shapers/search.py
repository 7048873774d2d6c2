"""Input shapers for a printer: the best settings of each, and those that Klipper would choose.

Each shaper gets the frequencies and damping with which it is most accurate on this plant and path,
so a comparison with it is fair. Its section for printer.cfg is an alternative to compensation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, X, Y, Z
from hframe_post.conversion.pipeline import Options, parsed, sampled
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant, Response
from hframe_post.model.shapers import SHAPERS, AxisShaping, Shaper, Shaping, shaper
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.planner.lookahead import plan
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from hframe_post.stream.types import Samples
from hframe_post.studies.inputs import excerpt
from hframe_post.studies.shapers.guess import HZ, MOST_DAMPING, Paths, guess, quadratic_form

PIECES = 5  # of a print, of some seconds each, on which settings are compared
BY_ERROR = attrgetter("rms")

# Klipper's calibration (klippy/extras/shaper_calibrate.py)
KLIPPER = ("zv", "mzv", "ei", "2hump_ei", "3hump_ei")
FIRMWARE = {"klipper": KLIPPER, "marlin": ("zv",)}  # shapers by dialect
KLIPPER_HZ = np.arange(5.0, 200.0, 0.2)
KLIPPER_DAMPING = 0.1
KLIPPER_ACCELERATION, KLIPPER_CORNER = 5000.0, 5.0  # mm/s², mm/s, of the smoothing
KLIPPER_LEAST = {"zv": 21.0, "mzv": 23.0, "ei": 29.0, "2hump_ei": 39.0, "3hump_ei": 48.0}  # Hz


def paths(lines: Iterable[bytes], printer: Printer, options: Options) -> Paths:
    """Return pieces of motion from all over a print; none if nothing is extruded.

    The first layer is left out where there are more: it is so slow that all shapers are alike.
    """
    pieces = excerpt(parsed(lines, printer, options), first_layers=0)
    pieces = [piece for piece in pieces if piece.start.place.layer > 1] or pieces
    chosen = np.linspace(0, len(pieces) - 1, min(PIECES, len(pieces))).astype(int).tolist()
    options = Options("none", tolerance=None)  # the path without standstills
    plans = (plan(pieces[k].items, printer.limits) for k in chosen)
    return [_path(sampled(items, printer, options)) for items in plans]


def _path(chunks: Iterable[Samples]) -> tuple[Array, Flags]:
    xyze = np.concatenate([chunk.xyze for chunk in chunks])
    return xyze[:, :Z], np.diff(xyze[:, E], prepend=xyze[0, E]) > 0.0


def error(plant: Plant, shaping: Shaping, paths: Paths) -> Shaping:
    """Return the shaping with its RMS contour error (mm) on the extruding samples of paths."""
    off, x, y = list[Array](), shaping.x.shaper, shaping.y.shaper
    for path, counted in paths:
        command = np.column_stack([x.run(path[:, X]), y.run(path[:, Y])])
        at = np.flatnonzero(counted)
        off.append(contour_error(path, Response(plant, path[0]).run(command), at))
    return replace(shaping, rms=float(np.sqrt(np.square(np.concatenate(off)).mean())))


def best(plant: Plant, paths: Paths, name: str, Q: Array) -> Shaping:
    """Return the frequencies and damping with which that shaper is most accurate on paths.

    Q: their ``quadratic_form``. Its best settings are refined for the true contour error.
    """
    from scipy.optimize import minimize

    def tried_at(v: Array) -> Shaping:
        hz = np.exp(np.clip(v[:2], np.log(HZ[0] / 2.0), np.log(2.0 * HZ[-1]))).tolist()
        damping = np.clip(v[2:], 0.0, MOST_DAMPING).tolist()
        x, y = (AxisShaping(name, hz[axis], damping[axis]) for axis in (X, Y))
        return error(plant, Shaping(x, y), paths)

    begin = guess(Q, name)
    x, y = begin.x, begin.y
    refined = minimize(
        lambda v: tried_at(v).rms, [np.log(x.hz), np.log(y.hz), x.damping, y.damping],
        method="Nelder-Mead", options={"maxfev": 120},
    )  # fmt: skip
    return tried_at(refined.x)


@one_blas_thread()
def good(plant: Plant, paths: Paths, dialect: str) -> Shaping | None:
    """Return about the most accurate of the firmware's shapers, in a tenth of a second.

    None if there are no paths. It is within some percent of what ``search`` finds.
    """
    if not paths:
        return None
    Q = quadratic_form(plant, paths)
    return min((error(plant, guess(Q, name), paths) for name in FIRMWARE[dialect]), key=BY_ERROR)


def search(plant: Plant, paths: Paths) -> list[Shaping]:
    """Return every shaper with its best settings for these paths, the most accurate first.

    Raises HframeError if there are no paths.
    """
    if not paths:
        raise HframeError(
            "there is no path to shape: nothing is extruded at a known place after the label of a "
            "layer, such as ;LAYER:0"
        )
    Q = quadratic_form(plant, paths)
    return sorted((best(plant, paths, name, Q) for name in SHAPERS), key=BY_ERROR)


def calibrated(plant: Plant) -> Shaping:
    """Return the shaping that Klipper's calibration would choose for this plant.

    It excites each axis with an acceleration proportional to the frequency, scores each shaper by
    residual vibration and smoothing, and takes the lowest score.
    """
    return Shaping(_calibrated(plant.Gxx), _calibrated(plant.Gyy))


def calibrated_with(plant: Plant, name: str) -> Shaping:
    """Return the frequencies that Klipper's calibration would choose for a given shaper."""
    x, y = (_best_frequency(G, name)[1] for G in (plant.Gxx, plant.Gyy))
    return Shaping(AxisShaping(name, x, KLIPPER_DAMPING), AxisShaping(name, y, KLIPPER_DAMPING))


def _calibrated(G: TransferFunction) -> AxisShaping:
    best_score, best_axis = np.inf, AxisShaping("mzv", 40.0, KLIPPER_DAMPING)
    for name in KLIPPER:
        score, hz = _best_frequency(G, name)
        if score < best_score / 1.2:  # a longer shaper must be clearly better
            best_score, best_axis = score, AxisShaping(name, hz, KLIPPER_DAMPING)
    return best_axis


def _best_frequency(G: TransferFunction, name: str) -> tuple[float, float]:
    """Return the lowest score of a shaper on an axis, and its frequency (Hz)."""
    hz = KLIPPER_HZ[KLIPPER_HZ < 200.0]
    measured = np.square(np.abs(G.response(2.0 * np.pi * hz * TS))) * hz
    floor = measured.max() / 20.0  # noise of the accelerometer
    loud = np.maximum(measured - floor, 0.0).sum()
    scored = []
    for f in np.arange(150.0, KLIPPER_LEAST[name], -0.5).tolist():
        tried = shaper(name, f, KLIPPER_DAMPING)
        left = tried.residual(hz, KLIPPER_DAMPING)
        vibration = float(np.maximum(left * measured - floor, 0.0).sum() / loud)
        score = _smoothing(tried) * (vibration**1.5 + 0.2 * vibration + 0.01)
        scored.append((score, vibration, f))
    quietest = min(vibration for _, vibration, _ in scored)
    score, _, f = min(row for row in scored if row[1] <= 1.1 * quietest)
    return score, f


def _smoothing(tried: Shaper) -> float:
    """Return by how many mm a shaper rounds a corner of 90° or a reversal, as Klipper computes."""
    T, half = tried.T, KLIPPER_ACCELERATION / 2.0
    late = T >= 0.0
    by_corner = float((tried.A * (KLIPPER_CORNER + half * T) * T)[late].sum())
    back = float((tried.A * half * T * T).sum())
    return max(by_corner * float(np.sqrt(2.0)), back)


# ---------------------------------------------------------------------- reports


def shapings_as_json(found: list[Shaping], usual: Shaping) -> dict[str, Any]:
    """Return the shapers, the best first, and the choice of Klipper's calibration; µm."""
    *shapers, calibration = (
        s.as_json() | {"contour_error_rms_um": round(s.rms * 1e3, 4)} for s in (*found, usual)
    )
    return {"shapers": shapers, "klipper_calibration": calibration}


def shapings_as_text(found: list[Shaping], usual: Shaping, dialect: str) -> str:
    """Return a table, and the settings of the best shaper that the firmware has."""
    lines = [f"{'shaper':12s}{'x, Hz (damping)':>18s}{'y, Hz (damping)':>18s}{'µm RMS':>10s}"]
    lines += [_row(s.x.name, s) for s in found]
    names = "/".join(dict.fromkeys((usual.x.name, usual.y.name)))
    lines += [_row(f"Klipper's calibration: {names}", usual)]
    best = next(s for s in found if s.x.name in FIRMWARE[dialect])
    return "\n".join([*lines, "", best.config(dialect)])


def _row(name: str, s: Shaping) -> str:
    (x, y), wrapped = s.as_text(), f"{name}\n{'':12s}" if len(name) > 12 else f"{name:12s}"
    return f"{wrapped}{x:>18s}{y:>18s}{s.rms * 1e3:10.1f}"
