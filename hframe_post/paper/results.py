"""The paper's tables and figures, computed anew: numbers, and what was calibrated.

Each function answers one figure of arXiv 2105.09878; ``figures`` draws them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from hframe_post.arrays import TS, Array, Complex, E, X, Y, Z
from hframe_post.compensation.compensate import compensate
from hframe_post.conversion.pipeline import Commands, Options, prepared
from hframe_post.errors import GcodeError
from hframe_post.gcode.options import ReadOptions
from hframe_post.gcode.reader import read
from hframe_post.model.course import Compensator
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant, Response
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.paper.appendix_c import windowed
from hframe_post.paper.whole_trajectory import WholeTrajectory
from hframe_post.planner.lookahead import plan
from hframe_post.planner.sampling import sample
from hframe_post.prediction.contour import contour_error
from hframe_post.prediction.labels import Labels
from hframe_post.prediction.predict import predict
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Moves, Rests, Samples
from hframe_post.studies.reference_path import rectangle

N_FIG_9 = 125  # control points, counted as the paper's n
SHARES = (0.01, 0.05, 0.10, 0.15, 0.20, 0.25)  # n/E of Fig. 8
CORNER_REST = 3  # samples at each corner: with them the path has the paper's 1944 samples
TIMED = 3  # runs of which the fastest counts
PRINTED_WINDOW = (Window(20, 22, 11, 0.0), Window(20, 22, 11, 0.0))  # Sec. IV.B; see docs

# Tables I and II, descending powers of z without the cancelled root at the origin, with the
# two signs mended (b_2 of Gxx, a_4 of Gxθ). As text, for the number of their digits.
PRINTED = {
    "Gxx": ("0.07632 -0.231 0.236 -0.0813", "1 -3.577 4.774 -2.815 0.6175"),
    "Gxtheta": (
        "4.246 -29.27 87.51 -147 149.9 -92.76 32.26 -4.865",
        "1 -5.866 14.86 -21 17.83 -9.06 2.535 -0.2987",
    ),
    "Gyy": (
        "0.1646 -0.8951 1.975 -2.199 1.231 -0.2764",
        "1 -4.813 9.386 -9.344 4.845 -1.14 0.06512",
    ),
}
SIGNIFICANT = 4  # printed digits; trailing zeros were not printed


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
        """Root mean square of the contour error, mm."""
        return _rms(self.error)


@dataclass(frozen=True)
class Preview:
    """Limited preview, one way to solve it: RMS contour error (mm) and time (s)."""

    name: str
    rms: float
    seconds: float


@dataclass(frozen=True)
class Widths:
    """Fig. 11: error of the width (mm) by strategy, (layers, 3): left, middle, right."""

    window: str
    error: dict[str, Array]

    def rms(self, strategy: str) -> float:
        """Root mean square over layers and places, mm."""
        return float(np.sqrt(np.square(self.error[strategy]).mean()))

    def median(self, strategy: str) -> float:
        """Median of the absolute error, mm."""
        return float(np.median(np.abs(self.error[strategy])))


# ---------------------------------------------------------------------- Tables I, II, Fig. 4, 5


def coefficients_off(plant: Plant) -> dict[str, float]:
    """Largest distance of a coefficient from the printed one, in half units of its last digit.

    At most 1: the model is among those that the printed tables may mean.
    """
    off = {}
    for name, texts in PRINTED.items():
        G: TransferFunction = getattr(plant, name)
        gain = G.gain * (1e3 if name == "Gxtheta" else 1.0)  # rad/mm to rad/m
        worst = 0.0
        for text, roots, factor in zip(texts, (G.zeros, G.poles), (gain, 1.0), strict=True):
            printed = np.array(text.split(), dtype=float)
            digits = np.floor(np.log10(np.abs(printed))) + 1 - SIGNIFICANT
            ours = factor * np.poly(roots).real
            worst = max(worst, float((np.abs(ours - printed) / (0.5 * 10.0**digits)).max()))
        off[name] = worst
    return off


def frequency_responses(plant: Plant, hz: Array) -> FrequencyResponses:
    """Fig. 4 and 5. Raises ValueError for a plant that does not rack."""
    if plant.Gxtheta is None:
        raise ValueError("the printer does not rack: it has no Gxtheta")
    omega = 2.0 * np.pi * hz * TS
    theta = 1e3 * plant.Gxtheta.response(omega)
    return FrequencyResponses(hz, plant.Gxx.response(omega), plant.Gyy.response(omega), theta)


# ---------------------------------------------------------------------- Fig. 7, 8, 9


def path(printer: Printer) -> Array:
    """The rectangle of Fig. 7, planned, (E + 1, 2); it begins and ends at rest."""
    items = read(rectangle(printer), ReadOptions.of(printer))
    blocks = sample(plan(items, printer.limits), printer.limits, Rests())
    xy = np.concatenate([block.xyze[:, :Z] for block in blocks])
    corners = xy[0] + np.array([[120, 0], [120, 20], [0, 20], [0, 0]])
    repeats = np.ones(len(xy), dtype=np.int64)
    repeats[0] = 2
    for corner in corners:
        off = np.abs(xy - corner).max(axis=1)
        repeats[len(xy) - 1 - np.argmin(off[::-1])] += CORNER_REST
    return np.repeat(xy, repeats, axis=0)


def contour(plant: Plant, xy: Array, command: Array) -> tuple[Array, Array]:
    """Nozzle (k, 2) under a command (k, 2), and its contour error (k,), mm."""
    nozzle = Response(plant, xy[0]).run(command)
    return nozzle, contour_error(xy, nozzle, np.arange(len(xy)))


def approximations(plant: Plant, xy: Array) -> list[Approximation]:
    """Fig. 8: coupled (eq. 18) against decoupled (eq. 12 and 19)."""
    rows = []
    for share in SHARES:
        n = round(share * (len(xy) - 1))
        whole = WholeTrajectory(plant, xy, n)
        timed = [_timed(solve) for solve in (whole.decoupled, whole.coupled)]
        rms = [_rms(contour(plant, xy, command)[1]) for command, _ in timed]
        rows.append(Approximation(share, n, (rms[0], rms[1]), (timed[0][1], timed[1][1])))
    return rows


def time_responses(plant: Plant, xy: Array) -> list[TimeResponse]:
    """Fig. 9: no control, and n = 125 without and with racking compensation."""
    whole = WholeTrajectory(plant, xy, N_FIG_9)
    commands = {"none": xy, "fbs": whole.decoupled(racking=False), "racking": whole.decoupled()}
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    responses = []
    for name, command in commands.items():
        nozzle, error = contour(plant, xy, command)
        responses.append(TimeResponse(name, xy, along, nozzle, error))
    return responses


def previews(printer: Printer, xy: Array) -> list[Preview]:
    """Appendix B and C on the rectangle: coupled, decoupled, and as the tool streams it.

    The path gets a rest before and after it, in which a preview can lead and settle.
    """
    plant, ways = printer.plant, list[Preview]()
    windows = printer.compensation.windows
    rest = windows[X].L_C
    xy = np.pad(xy, ((rest, rest), (0, 0)), mode="edge")
    compensator = Compensator(plant, windows)
    xyze = np.pad(xy, ((0, 0), (0, 2)))
    line = np.zeros(len(xy), dtype=np.int64)

    def streamed() -> Array:
        blocks = compensate([Samples(0, xyze, line)], compensator, ("racking",))
        return np.concatenate([block.commands["racking"] for block in blocks])

    for name, solve in (
        ("coupled, eq. 42", lambda: windowed(plant, windows, xy, coupled=True)),
        ("decoupled, eq. 43", lambda: windowed(plant, windows, xy, coupled=False)),
        ("streamed", streamed),
    ):
        command, seconds = _timed(solve)
        moving = slice(rest, len(xy) - rest)
        ways.append(Preview(name, _rms(contour(plant, xy, command)[1][moving]), seconds))
    return ways


def _timed(solve: Callable[[], Array]) -> tuple[Array, float]:
    """Its answer, and the fastest of TIMED runs (s)."""
    fastest = np.inf
    for _ in range(TIMED):
        start = perf_counter()
        answer = solve()
        fastest = min(fastest, perf_counter() - start)
    return answer, float(fastest)


def _rms(error: Array) -> float:
    return float(np.sqrt(np.square(error).mean()))


# ---------------------------------------------------------------------- Fig. 11

JAW = 5.0  # mm of wall that a calliper touches at once
FROM_END = 10.0  # mm from the part's ends to the middle of the jaws, left and right
OUTER_WALLS = ("WALL-OUTER", "EXTERNAL PERIMETER", "OUTER WALL")  # Cura, PrusaSlicer, OrcaSlicer


def widths(printer: Printer, lines: Iterable[bytes], printed_window: bool = False) -> Widths:
    """Fig. 11 of a sliced prism whose long side lies along x, in the middle of the gantry.

    The width is what a calliper feels: from the outermost point of the front wall to that of
    the rear wall within its jaws, nozzle less intended path, on every layer. The planner's
    limits are the profile's. Raises HframeError, also where the part is no prism with walls.
    """
    lines = list(lines)
    printer = replace(printer, plant=replace(printer.plant, x_c=_middle(lines, printer)))
    window = "shipped"
    compensator = prepared(printer)
    if printed_window:
        window, compensator = "printed", Compensator(printer.plant, PRINTED_WINDOW)
    options = Options("racking", ("none", "fbs", "racking"), "printer", clamp=True)
    commands = Commands(lines, printer, options, compensator=compensator).computed()
    error: dict[str, list[Array]] = {name: [] for name in options.predict}
    for walls in _outer_walls(predict(commands, printer.plant)).values():
        wanted = _width(walls["path"], walls["path"])
        for name, rows in error.items():
            rows.append(_width(walls[name], walls["path"]) - wanted)
    if not error["none"]:
        raise GcodeError("no outer wall in this slice (;TYPE:WALL-OUTER or External perimeter)")
    return Widths(window, {name: np.array(rows) for name, rows in error.items()})


def _middle(lines: Iterable[bytes], printer: Printer) -> float:
    """Middle in x of what is extruded."""
    low, high = np.inf, -np.inf
    for item in read(lines, ReadOptions.of(printer, "file-all")):
        if isinstance(item, Moves):
            laid = np.flatnonzero(np.diff(item.points[:, E]) > 0.0)
            ends = item.points[np.concatenate([laid, laid + 1]), X]
            low, high = min(low, ends.min(initial=np.inf)), max(high, ends.max(initial=-np.inf))
    return float((low + high) / 2.0) if low < high else printer.plant.x_c


def _outer_walls(
    predicted: Iterable[tuple[Samples, dict[str, Array]]],
) -> dict[str, dict[str, Array]]:
    """Layer → strategy (and ``path``) → x, y of the outer wall's samples, (k, 2)."""
    labels = Labels()
    pieces: dict[str, dict[str, list[Array]]] = {}
    for block, nozzle in predicted:
        layer, feature = labels.of(block)
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
    """Width (3,) of a wall (k, 2) between the jaws: left, middle, right of its path (k, 2)."""
    (left, front), (right, rear) = path.min(axis=0), path.max(axis=0)
    in_rear = path[:, Y] > (front + rear) / 2.0
    widths = []
    for place in (left + FROM_END, (left + right) / 2.0, right - FROM_END):
        felt = np.abs(wall[:, X] - place) <= JAW / 2.0
        if not (felt & in_rear).any() or not (felt & ~in_rear).any():
            raise GcodeError(f"no two walls to measure at x = {place:.1f}: not the paper's prism")
        widths.append(wall[felt & in_rear, Y].max() - wall[felt & ~in_rear, Y].min())
    return np.array(widths)
