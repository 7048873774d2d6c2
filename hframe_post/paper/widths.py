"""Fig. 11: what a calliper would feel of the paper's prism, layer by layer."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E, X, Y, Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream, prepared
from hframe_post.errors import GcodeError
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.model.lpfbs import Window
from hframe_post.model.strategies import Compensator
from hframe_post.prediction.predict import predict
from hframe_post.prediction.statistics import Labels
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Moves, Samples

PRINTED_WINDOW = (Window(20, 22, 11, 0.0), Window(20, 22, 11, 0.0))  # Sec. IV.B; see docs
JAW = 5.0  # mm of wall that a calliper touches at once
FROM_END = 10.0  # mm from the part's ends to the middle of the jaws, left and right
OUTER_WALLS = ("WALL-OUTER", "EXTERNAL PERIMETER", "OUTER WALL")  # Cura, PrusaSlicer, OrcaSlicer


@dataclass(frozen=True)
class Widths:
    """Fig. 11: error of the width (mm) by strategy, (layers, 3): left, middle, right."""

    window: str
    error: dict[str, Array]

    def rms(self, strategy: str) -> float:
        return float(np.sqrt(np.square(self.error[strategy]).mean()))

    def median(self, strategy: str) -> float:
        return float(np.median(np.abs(self.error[strategy])))


def widths(printer: Printer, lines: Iterable[bytes], printed_window: bool = False) -> Widths:
    """Compute Fig. 11 of a sliced prism whose long side lies along x, in the middle of the gantry.

    The width is what a calliper feels: from the outermost point of the front wall to that of
    the rear wall within its jaws, nozzle less intended path, on every layer. The planner's
    limits are the profile's. Raises HframeError, also if the part is not a prism with walls.
    """
    lines = list(lines)
    printer = replace(printer, plant=replace(printer.plant, x_c=_middle(lines, printer)))
    window = "shipped"
    compensator = prepared(printer)
    if printed_window:
        window, compensator = "printed", Compensator(printer.plant, PRINTED_WINDOW)
    strategies = "none", "fbs", "racking"
    options = Options("racking", strategies, limits="printer")
    commands = SampleStream(lines, printer, options, compensator=compensator).computed()
    error: dict[str, list[Array]] = {name: [] for name in strategies}
    for walls in _outer_walls(predict(commands, printer.plant)).values():
        wanted = _width(walls["path"], walls["path"])
        for name, rows in error.items():
            rows.append(_width(walls[name], walls["path"]) - wanted)
    if not error["none"]:
        raise GcodeError("no outer wall in this slice (;TYPE:WALL-OUTER or External perimeter)")
    return Widths(window, {name: np.array(rows) for name, rows in error.items()})


def _middle(lines: Iterable[bytes], printer: Printer) -> float:
    low, high = np.inf, -np.inf
    for item in read(lines, ReadOptions.from_printer(printer, "file-all")):
        if isinstance(item, Moves):
            laid = np.flatnonzero(np.diff(item.points[:, E]) > 0.0)
            ends = item.points[np.concatenate([laid, laid + 1]), X]
            low, high = min(low, ends.min(initial=np.inf)), max(high, ends.max(initial=-np.inf))
    return float((low + high) / 2.0) if low < high else printer.plant.x_c


def _outer_walls(
    predicted: Iterable[tuple[Samples, dict[str, Array]]],
) -> dict[str, dict[str, Array]]:
    """Return layer → strategy (and ``path``) → x, y of the outer wall's samples, (k, 2)."""
    labels = Labels()
    pieces: dict[str, dict[str, list[Array]]] = {}
    for block, nozzle in predicted:
        layer, feature = labels.number(block)
        outer = [k for k, name in enumerate(labels.features) if name.upper() in OUTER_WALLS]
        wall = np.isin(feature, outer)
        for number in np.unique(layer[wall]).tolist():
            here = wall & (layer == number)
            walls = pieces.setdefault(labels.layers[number], {})
            for name, xy in {**nozzle, "path": block.xyze[:, :Z]}.items():
                walls.setdefault(name, []).append(xy[here])
    return {
        layer: {name: np.concatenate(parts) for name, parts in walls.items()}
        for layer, walls in pieces.items()
    }


def _width(wall: Array, path: Array) -> Array:
    """Return the width (3,) of a wall (k, 2) between the jaws: left, middle, right of its path."""
    (left, front), (right, rear) = path.min(axis=0), path.max(axis=0)
    in_rear = path[:, Y] > (front + rear) / 2.0
    widths = []
    for place in (left + FROM_END, (left + right) / 2.0, right - FROM_END):
        felt = np.abs(wall[:, X] - place) <= JAW / 2.0
        if not (felt & in_rear).any() or not (felt & ~in_rear).any():
            raise GcodeError(f"no two walls to measure at x = {place:.1f}: not the paper's prism")
        widths.append(wall[felt & in_rear, Y].max() - wall[felt & ~in_rear, Y].min())
    return np.array(widths)
