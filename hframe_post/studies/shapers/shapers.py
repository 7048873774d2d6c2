"""What an input shaper would do for this printer: the best there is, and what Klipper would take.

An honest yardstick: each shaper gets the frequencies and damping with which it serves this
plant and path best, found by trial, not those of a rule of thumb. And a fallback: who does not
want a dense stream finds the lines for printer.cfg here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, X, Y, Z
from hframe_post.conversion.pipeline import Options, parsed, sampled
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant, Response
from hframe_post.model.shapers import SHAPERS, Shaper, shaper
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.planner.lookahead import plan
from hframe_post.prediction.contour import contour_error
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen
from hframe_post.studies.speed.excerpt import excerpt

PIECES = 5  # of a print, of some seconds, for which shapers are chosen
HZ = np.geomspace(12.0, 120.0, 14)  # tried first on each axis
DAMPING = (0.05, 0.15, 0.3)
ROUNDS = 2  # of the axes in turn, before both are refined together
REFINED = 120  # trials of that

# Klipper's calibration: what it measures, and how it weighs smoothing against ringing
KLIPPER = ("zv", "mzv", "ei", "2hump_ei", "3hump_ei")
KLIPPER_HZ = np.arange(5.0, 200.0, 0.2)
KLIPPER_DAMPING = 0.1
KLIPPER_ACCELERATION, KLIPPER_CORNER = 5000.0, 5.0  # mm/s², mm/s, at which smoothing is judged
KLIPPER_LEAST = {"zv": 21.0, "mzv": 23.0, "ei": 29.0, "2hump_ei": 39.0, "3hump_ei": 48.0}  # Hz
UNFELT = 1.0 / 20.0  # of the greatest vibration; less is noise
MUCH_AS_QUIET = 1.1  # times the least vibration that a shaper can leave
CLEARLY_BETTER = 1.0 / 1.2  # of the score of a shorter shaper

Paths = list[tuple[Array, Flags]]  # each (n, 2), mm, and which of its samples count, (n,)


@dataclass(frozen=True, slots=True)
class AxisShaping:
    """The shaper of one axis."""

    name: str
    hz: float
    damping: float

    @property
    def shaper(self) -> Shaper:
        """Its impulses."""
        return shaper(self.name, self.hz, self.damping)


@dataclass(frozen=True, slots=True)
class Shaping:
    """Shapers of x and y, and the RMS contour error (mm) on the path they were chosen for."""

    x: AxisShaping
    y: AxisShaping
    rms: float = np.inf

    def config(self) -> str:
        """The section of Klipper's printer.cfg."""
        lines = ["[input_shaper]"]
        for axis, chosen in (("x", self.x), ("y", self.y)):
            lines += [
                f"shaper_type_{axis}: {chosen.name}",
                f"shaper_freq_{axis}: {chosen.hz:.1f}",
                f"damping_ratio_{axis}: {chosen.damping:.3f}",
            ]
        return "\n".join(lines)


def shape(chunks: Iterable[Samples], shapings: dict[str, Shaping]) -> Iterator[Samples]:
    """The samples with the commands, beside theirs, that each shaper makes of the path."""
    pairs = {name: (s.x.shaper, s.y.shaper) for name, s in shapings.items()}
    reach = max((s.reach for pair in pairs.values() for s in pair), default=0)
    for stretch in stretches(chunks):
        for chunk, wide, where in with_neighbours(stretch, reach, reach):
            path = wide.xyze
            commands = {
                name: frozen(np.column_stack([x.run(path[:, X]), y.run(path[:, Y])])[where])
                if len(path)
                else path[where, :Z]
                for name, (x, y) in pairs.items()
            }
            yield replace(chunk, commands={**chunk.commands, **commands})


def paths(lines: Iterable[bytes], printer: Printer, options: Options) -> Paths:
    """Motion from all over a print, above its first layer where there is more. Raises HframeError.

    What is laid slowly, as first layers are, tells shapers little apart.
    """
    pieces = excerpt(parsed(lines, printer, options), first_layers=0)
    pieces = [piece for piece in pieces if piece.start.place.layer > 1] or pieces
    if not pieces:
        raise HframeError("nothing is extruded at a known place: there is no path to shape")
    chosen = np.linspace(0, len(pieces) - 1, min(PIECES, len(pieces))).astype(int).tolist()
    options = Options("none", tolerance=None)  # the path alone, without rests for a command
    plans = (plan(pieces[k].items, printer.limits) for k in chosen)
    return [_path(sampled(items, printer, options)) for items in plans]


def _path(chunks: Iterable[Samples]) -> tuple[Array, Flags]:
    xyze = np.concatenate([chunk.xyze for chunk in chunks])
    return xyze[:, :Z], np.diff(xyze[:, E], prepend=xyze[0, E]) > 0.0


def error(plant: Plant, shaping: Shaping, paths: Paths) -> Shaping:
    """The shaping with its RMS contour error on paths, over the samples that count."""
    off = [
        contour_error(path, _nozzle(plant, shaping, path)[at], at)
        for path, counted in paths
        for at in [np.flatnonzero(counted)]
    ]
    return replace(shaping, rms=float(np.sqrt(np.square(np.concatenate(off)).mean())))


def _nozzle(plant: Plant, shaping: Shaping, path: Array) -> Array:
    command = np.column_stack([shaping.x.shaper.run(path[:, X]), shaping.y.shaper.run(path[:, Y])])
    return Response(plant, path[0]).run(command)


def best(plant: Plant, paths: Paths, name: str) -> Shaping:
    """The frequencies and damping with which that shaper follows paths best.

    Both axes are searched in turn on a grid, then refined together, because y also feels what x
    leaves of racking.
    """
    from scipy.optimize import minimize

    def rms(x: AxisShaping, y: AxisShaping) -> float:
        return error(plant, Shaping(x, y), paths).rms

    grid = [AxisShaping(name, float(hz), damping) for hz in HZ for damping in DAMPING]
    x = y = AxisShaping(name, 40.0, DAMPING[1])
    for _ in range(ROUNDS):
        held = y
        x = min(grid, key=lambda tried: rms(tried, held))
        other = x
        y = min(grid, key=lambda tried: rms(other, tried))

    def chosen(v: Array) -> tuple[AxisShaping, AxisShaping]:
        hz = np.exp(np.clip(v[:2], np.log(HZ[0] / 2.0), np.log(2.0 * HZ[-1])))
        damping = np.clip(v[2:], 0.0, 0.6)
        return (
            AxisShaping(name, float(hz[X]), float(damping[X])),
            AxisShaping(name, float(hz[Y]), float(damping[Y])),
        )

    start = np.array([np.log(x.hz), np.log(y.hz), x.damping, y.damping])
    found = minimize(
        lambda v: rms(*chosen(v)), start, method="Nelder-Mead", options={"maxfev": REFINED}
    )
    refined = chosen(found.x)
    return min(
        (error(plant, Shaping(*pair), paths) for pair in ((x, y), refined)),
        key=lambda tried: tried.rms,
    )


def search(plant: Plant, paths: Paths) -> list[Shaping]:
    """Every shaper at its best on these paths, the best first; see ``best``."""
    found = [best(plant, paths, name) for name in SHAPERS]
    return sorted(found, key=lambda tried: tried.rms)


def calibrated(plant: Plant) -> Shaping:
    """What Klipper's own calibration would set up, from the accelerations that it would measure.

    Each axis is shaken with an acceleration that grows with the frequency; a shaper is scored by
    the vibration that it leaves and the smoothing that it costs, and the least of it is taken.
    """
    return Shaping(_calibrated(plant.Gxx), _calibrated(plant.Gyy))


def calibrated_as(plant: Plant, name: str) -> Shaping:
    """The same where the shaper is given: its frequencies."""
    x, y = (_placed(G, name)[1] for G in (plant.Gxx, plant.Gyy))
    return Shaping(AxisShaping(name, x, KLIPPER_DAMPING), AxisShaping(name, y, KLIPPER_DAMPING))


def _calibrated(G: TransferFunction) -> AxisShaping:
    best_score, best_axis = np.inf, AxisShaping("mzv", 40.0, KLIPPER_DAMPING)
    for name in KLIPPER:
        score, hz = _placed(G, name)
        if score < CLEARLY_BETTER * best_score:
            best_score, best_axis = score, AxisShaping(name, hz, KLIPPER_DAMPING)
    return best_axis


def _placed(G: TransferFunction, name: str) -> tuple[float, float]:
    """Score and frequency (Hz) of a shaper where it is best for an axis."""
    hz = KLIPPER_HZ[KLIPPER_HZ < 200.0]
    felt = np.square(np.abs(G.response(2.0 * np.pi * hz * TS))) * hz
    floor = UNFELT * felt.max()
    loud = np.maximum(felt - floor, 0.0).sum()
    scored = []
    for f in np.arange(150.0, KLIPPER_LEAST[name], -0.5).tolist():
        tried = shaper(name, f, KLIPPER_DAMPING)
        left = tried.residual(hz, KLIPPER_DAMPING)
        vibration = float(np.maximum(left * felt - floor, 0.0).sum() / loud)
        score = _smoothing(tried) * (vibration**1.5 + 0.2 * vibration + 0.01)
        scored.append((score, vibration, f))
    quietest = min(vibration for _, vibration, _ in scored)
    score, _, f = min(row for row in scored if row[1] <= MUCH_AS_QUIET * quietest)
    return score, f


def _smoothing(tried: Shaper) -> float:
    """How far a shaper rounds a corner of 90° or a way there and back, mm, as Klipper sees it."""
    T, half = tried.T, KLIPPER_ACCELERATION / 2.0
    late = T >= 0.0
    by_corner = float((tried.A * (KLIPPER_CORNER + half * T) * T)[late].sum())
    back = float((tried.A * half * T * T).sum())
    return max(by_corner * float(np.sqrt(2.0)), back)
