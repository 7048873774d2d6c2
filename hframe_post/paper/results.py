"""The paper's figures of plant and rectangle, computed again.

Each function answers one figure of arXiv 2105.09878; ``figures`` draws them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from hframe_post.arrays import TS, Array, Complex, X, Z
from hframe_post.compensation.compensate import compensate
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import planned, sampled
from hframe_post.model.plant import Plant, nozzle
from hframe_post.model.strategies import Compensator
from hframe_post.paper.commands import WholeTrajectory, windowed
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.studies.inputs import rectangle

N_FIG_9 = 125  # control points, counted as the paper's n
SHARES = (0.01, 0.05, 0.10, 0.15, 0.20, 0.25)  # n/E of Fig. 8
CORNER_REST = 3  # samples at each corner: with them the path has the paper's 1944 samples
TIMED = 3  # runs of which the fastest counts


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
    chunks = sampled(planned(rectangle(printer), printer, options), printer, options)
    xy = np.concatenate([chunk.xyze[:, :Z] for chunk in chunks])
    corners = xy[0] + np.array([[120, 0], [120, 20], [0, 20], [0, 0]])
    repeats = np.ones(len(xy), dtype=np.int64)
    repeats[0] = 2
    for corner in corners:
        off = np.abs(xy - corner).max(axis=1)
        repeats[len(xy) - 1 - np.argmin(off[::-1])] += CORNER_REST
    return np.repeat(xy, repeats, axis=0)


def contour(plant: Plant, xy: Array, command: Array) -> tuple[Array, Array]:
    """Return the nozzle (k, 2) under a command (k, 2), and its contour error (k,), mm."""
    places = nozzle(plant, xy[0], command)
    return places, contour_error(xy, places)


def approximations(plant: Plant, xy: Array) -> list[Approximation]:
    """Compute Fig. 8: coupled (eq. 18) against decoupled (eq. 12 and 19)."""
    rows = []
    for share in SHARES:
        n = round(share * (len(xy) - 1))
        whole = WholeTrajectory(plant, xy, n)
        timed = [_timed(solve) for solve in (whole.decoupled, whole.coupled)]
        rms = [_rms(contour(plant, xy, command)[1]) for command, _ in timed]
        rows.append(Approximation(share, n, (rms[0], rms[1]), (timed[0][1], timed[1][1])))
    return rows


def time_responses(plant: Plant, xy: Array) -> list[TimeResponse]:
    """Compute Fig. 9: no control, and n = 125 without and with racking compensation."""
    whole = WholeTrajectory(plant, xy, N_FIG_9)
    commands = {"none": xy, "fbs": whole.decoupled(racking=False), "racking": whole.decoupled()}
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    responses = []
    for name, command in commands.items():
        nozzle, error = contour(plant, xy, command)
        responses.append(TimeResponse(name, xy, along, nozzle, error))
    return responses


def previews(printer: Printer, xy: Array) -> list[Preview]:
    """Compute Appendix B and C on the rectangle: coupled, decoupled, and as the tool streams it.

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
    """Return the result of a function and the duration of the fastest of TIMED runs (s)."""
    fastest = np.inf
    for _ in range(TIMED):
        start = perf_counter()
        answer = solve()
        fastest = min(fastest, perf_counter() - start)
    return answer, float(fastest)


def _rms(error: Array) -> float:
    return float(np.sqrt(np.square(error).mean()))
