"""The paper's figures, computed again.

Each function answers one figure of arXiv 2105.09878; ``figures.py`` draws it, ``tables.py`` prints
it. What the library offers is taken from it; what it hides, from its rooms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

import hframe_post as hp
from examples.paper.commands import WholeTrajectory, windowed
from hframe_post.arrays import TS, Array, Complex, E, X, Y, Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import GcodeError
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.prediction.predict import Judgement, judge
from hframe_post.prediction.statistics import Labels
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Moves
from hframe_post.studies.tuning import rectangle

N_FIG_9 = 125  # control points, counted as the paper's n
SHARES = (0.01, 0.05, 0.10, 0.15, 0.20, 0.25)  # n/E of Fig. 8
CORNER_REST = 3  # samples at each corner: with them the path has the paper's 1944 samples
TIMED = 3  # runs of which the fastest counts
PRINTED_WINDOW = (Window(20, 22, 11, 0.0), Window(20, 22, 11, 0.0))  # Sec. IV.B; see docs
JAW = 5.0  # mm of wall that a calliper touches at once
FROM_END = 10.0  # mm from the part's ends to the middle of the jaws, left and right
OUTER_WALLS = ("WALL-OUTER", "EXTERNAL PERIMETER", "OUTER WALL")  # Cura, PrusaSlicer, OrcaSlicer


@dataclass(frozen=True)
class FrequencyResponses:
    """Fig. 4 and 5: responses (k,) at frequencies hz (k,); Gxtheta in rad/m."""

    hz: Array
    Gxx: Complex
    Gyy: Complex
    Gxtheta: Complex


@dataclass(frozen=True)
class Approximation:
    """Fig. 8, one n: RMS contour error (mm) and time (s), decoupled and coupled."""

    share: float
    n: int
    rms: tuple[float, float]
    seconds: tuple[float, float]


@dataclass(frozen=True)
class TimeResponse:
    """Fig. 9, one control: path, nozzle (k, 2), way along the path, contour error (k,), mm."""

    name: str
    path: Array
    along: Array
    nozzle: Array
    error: Array

    @property
    def rms(self) -> float:
        return _rms(self.error)


@dataclass(frozen=True)
class Preview:
    """Limited preview, one way to solve it: RMS contour error (mm) and time (s)."""

    name: str
    rms: float
    seconds: float


# ---------------------------------------------------------------------- Fig. 4, 5


def frequency_responses(plant: Plant, hz: Array) -> FrequencyResponses:
    """Compute Fig. 4 and 5. Raises ValueError for a plant that does not rack."""
    if plant.Gxtheta is None:
        raise ValueError("the printer does not rack: it has no Gxtheta")
    omega = 2.0 * np.pi * hz * TS
    theta = 1e3 * plant.Gxtheta.response(omega)
    return FrequencyResponses(hz, plant.Gxx.response(omega), plant.Gyy.response(omega), theta)


# ---------------------------------------------------------------------- Fig. 7, 8, 9


def path(printer: Printer) -> Array:
    """Return the planned rectangle of Fig. 7, (E + 1, 2); it begins and ends at rest."""
    options = Options("none", tolerance=None)  # the path alone, without rests for a command
    chain = Chain(printer, options)
    chunks = chain.sampled(chain.planned(rectangle(printer)))
    xy = np.concatenate([chunk.xyze[:, :Z] for chunk in chunks])
    corners = xy[0] + np.array([[120, 0], [120, 20], [0, 20], [0, 0]])
    repeats = np.ones(len(xy), dtype=np.int64)
    repeats[0] = 2
    for corner in corners:
        off = np.abs(xy - corner).max(axis=1)
        repeats[len(xy) - 1 - np.argmin(off[::-1])] += CORNER_REST
    return np.repeat(xy, repeats, axis=0)


def contour(printer: Printer, xy: Array, command: Array) -> tuple[Array, Array]:
    """Return the nozzle (k, 2) under a command (k, 2), and its contour error (k,), mm."""
    places = hp.predict(np.vstack([xy[:1], command]), printer)[1:]  # at rest before the command
    return places, hp.contour_error(places, xy)


def approximations(printer: Printer, xy: Array) -> list[Approximation]:
    """Compute Fig. 8: coupled (eq. 18) against decoupled (eq. 12 and 19)."""
    rows = []
    for share in SHARES:
        n = round(share * (len(xy) - 1))
        whole = WholeTrajectory(printer.plant, xy, n)
        timed = [_timed(solve) for solve in (whole.decoupled, whole.coupled)]
        rms = [_rms(contour(printer, xy, command)[1]) for command, _ in timed]
        rows.append(Approximation(share, n, (rms[0], rms[1]), (timed[0][1], timed[1][1])))
    return rows


def time_responses(printer: Printer, xy: Array) -> list[TimeResponse]:
    """Compute Fig. 9: no control, and n = 125 without and with racking compensation."""
    whole = WholeTrajectory(printer.plant, xy, N_FIG_9)
    commands = {"none": xy, "fbs": whole.decoupled(racking=False), "racking": whole.decoupled()}
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    responses = []
    for name, command in commands.items():
        nozzle, error = contour(printer, xy, command)
        responses.append(TimeResponse(name, xy, along, nozzle, error))
    return responses


def previews(printer: Printer, xy: Array) -> list[Preview]:
    """Compute Appendix B and C on the rectangle: coupled, decoupled, and as the tool streams it.

    The path gets a rest before and after it, in which a preview can lead and settle.
    """
    windows = printer.compensation.windows
    rest = windows[X].L_C
    padded = np.pad(xy, ((rest, rest), (0, 0)), mode="edge")
    ways = list[Preview]()
    for name, solve in (
        ("coupled, eq. 42", lambda: windowed(printer.plant, windows, padded, coupled=True)),
        ("decoupled, eq. 43", lambda: windowed(printer.plant, windows, padded, coupled=False)),
        ("streamed", lambda: hp.compensate(xy, printer)),
    ):
        command, seconds = _timed(solve)
        error = hp.contour_error(hp.predict(command, printer), xy)
        ways.append(Preview(name, _rms(error), seconds))
    return ways


def _timed(solve: Callable[[], Array]) -> tuple[Array, float]:
    """Return the result of a function and the duration of the fastest of TIMED runs (s)."""
    fastest = np.inf
    for _ in range(TIMED):
        start = perf_counter()
        answer = solve()
        fastest = min(fastest, perf_counter() - start)
    return answer, float(fastest)


def _rms(error: Array) -> float:
    return float(np.sqrt(np.square(error).mean()))


# ---------------------------------------------------------------------- Fig. 11


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
    if printed_window:
        window, printer = "printed", printer.with_windows(PRINTED_WINDOW)
    strategies = "none", "fbs", "racking"
    options = Options("racking", strategies, limits="printer")
    commands = (
        replace(chunk, commands={"none": chunk.xyze[:, :Z], **chunk.commands})
        for chunk in WholeFile(lines, printer, options).samples()
    )
    error: dict[str, list[Array]] = {name: [] for name in strategies}
    for walls in _outer_walls(judge(commands, printer.plant)).values():
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


def _outer_walls(judgements: Iterable[Judgement]) -> dict[str, dict[str, Array]]:
    """Return layer → strategy (and ``path``) → x, y of the outer wall's samples, (k, 2)."""
    labels = Labels()
    pieces: dict[str, dict[str, list[Array]]] = {}
    for judgement in judgements:
        block, places = judgement.chunk, judgement.motion
        layer, feature = labels.number(block)
        outer = [k for k, name in enumerate(labels.features) if name.upper() in OUTER_WALLS]
        wall = np.isin(feature, outer)
        for number in np.unique(layer[wall]).tolist():
            here = wall & (layer == number)
            walls = pieces.setdefault(labels.layers[number], {})
            for name, xy in {**places, "path": block.xyze[:, :Z]}.items():
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
