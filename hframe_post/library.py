"""The tool as functions: arrays in, arrays out; files in, files out.

What ``import hframe_post`` offers and no room has ready. Lengths are mm, times s, one sample is
1 ms; x and y are the printer's own coordinates, since the lever arm of racking depends on x.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hframe_post.arrays import Array
from hframe_post.compensation.compensate import settling_samples
from hframe_post.conversion import files
from hframe_post.conversion.pipeline import TOLERANCE, Options, prepared
from hframe_post.conversion.report import Report
from hframe_post.errors import HframeError, PrinterError
from hframe_post.gcode.lines import lines_of, reread
from hframe_post.gcode.options import Extrusion, LimitSource
from hframe_post.model.plant import Response
from hframe_post.model.strategies import STRATEGIES
from hframe_post.model.strategies import strategy as strategy_of
from hframe_post.prediction import contour
from hframe_post.printer import profile
from hframe_post.printer.settings import STOPS, Printer, Speed
from hframe_post.resources import one_blas_thread
from hframe_post.studies.simulation import simulate as simulation
from hframe_post.studies.simulation.report import SimulationReport
from hframe_post.studies.simulation.uncertainty import draws as drawn
from hframe_post.studies.speed.search import hastened
from hframe_post.studies.tuning import tune as tuning
from hframe_post.studies.tuning.tune import StopsTrial, Trial
from hframe_post.writers.files.atomic_file import Outputs

UNKNOWN = 0.05  # by which a printer may differ from its model, where nothing is known of that
Source = str | Path | Iterable[bytes]  # a file of G-code, or its lines


def load_printer(name_or_path: str | Path) -> Printer:
    """The shipped profile of that name, or the one in that TOML file. Raises PrinterError."""
    return profile.load(str(name_or_path))


@one_blas_thread()
def compensate(xy: ArrayLike, printer: Printer, strategy: str = "racking") -> Array:
    """The command for the motors under which the nozzle follows a path: eq. 12, 13 and 19.

    xy: the path (n, 2), one sample a millisecond, at rest before its first sample and after its
    last. Returns (r + n + r, 2): the command leads the motion and settles after it, so r samples
    of rest are put before the path and as many after it. r depends on the printer alone, is the
    same for every strategy, and suffices for the fastest start and stop within its limits.

    strategy: ``racking``, ``fbs`` (ringing only) or ``none``. Limits of bed and motors are not
    checked: that is for ``convert``, which writes what machines obey. Raises HframeError for a
    strategy or a profile that cannot be used, ValueError for an array that is no path.
    """
    path, chosen = _places(xy, "xy"), strategy_of(strategy)
    compensator = prepared(printer)
    r = settling_samples(compensator, printer.limits, printer.travel)
    course = chosen.begin(compensator, path[0])
    done = course.feed(np.pad(path, ((r, r), (0, 0)), mode="edge"))
    return np.concatenate([done, course.finish()])


@one_blas_thread()
def predict(command: ArrayLike, printer: Printer) -> Array:
    """Where the nozzle goes under a command (m, 2): x and y, (m, 2), eq. 1 and 2.

    The printer stands at the command's first sample before it begins. For a printer that is not
    quite the model give one with another plant: ``dataclasses.replace(printer, plant=...)``.
    Raises ValueError for an array that is no command.
    """
    given = _places(command, "command")
    return Response(printer.plant, given[0]).run(given)


def contour_error(nozzle: ArrayLike, path: ArrayLike) -> Array:
    """How far the nozzle is off the path at each of its samples, (n,), mm.

    nozzle (r + n + r, 2): as ``predict`` gives it for a command with r samples of rest before and
    after the path, r ≥ 0; the rests do not count. path (n, 2). It is the distance to the polyline
    through the path's samples within 24 ms of the time in question, not to where the nozzle should
    be at that time. Raises ValueError where the lengths do not fit.
    """
    actual, desired = _places(nozzle, "nozzle"), _places(path, "path")
    r, odd = divmod(len(actual) - len(desired), 2)
    if r < 0 or odd:
        raise ValueError(
            f"{len(actual)} samples of the nozzle do not belong to a path of {len(desired)}: as "
            "many samples of rest are needed before it as after it"
        )
    at = np.arange(len(desired))
    return contour.contour_error(desired, actual[r : r + len(desired)], at)


def convert(
    source: Source,
    target: str | Path,
    printer: Printer,
    *,
    strategy: str | None = None,
    predict: Iterable[str] | None = None,
    limits: LimitSource = "file",
    extrusion: Extrusion | None = None,
    clamp: bool = False,
    tolerance: float | None = TOLERANCE,
    format: str | None = None,  # noqa: A002, the option is called so
    speed: Speed | None = None,
) -> Report:
    """Converts sliced G-code to a file, all of it or nothing, and tells what it did.

    target: may be the source. strategy: the profile's, if not given. predict: strategies whose
    contour error is reported; ``none`` and the chosen one, if not given. limits: which of the
    file's own limits lower the printer's: those that its firmware obeys (``file``), all
    (``file-all``) or none (``printer``). extrusion: what E is where the file does not say. clamp:
    whether a command beyond a limit is taken back there instead of being an error. tolerance: mm
    that G-code for Klipper may be off the command; None writes every millisecond. format:
    ``gcode``, ``steps``, ``step-bits`` or ``samples``; what the target's suffix says, if not given.
    speed: how accuracy is spent on it; as the profile asks, if not given, and ``Speed()`` spends
    none. Then the source is read several times: a file, or lines that can be had again.

    Raises HframeError (GcodeError, PrinterError, LimitError: they name the line or the key) and
    OSError; then the target is as it was.
    """
    chosen = strategy_of(strategy or printer.compensation.strategy).name
    reported = ("none", chosen) if predict is None else predict
    asked = printer.asked_speed if speed is None else speed if speed.max_error else None
    options = Options(
        chosen, tuple(dict.fromkeys(strategy_of(name).name for name in reported)),
        limits, clamp, tolerance, extrusion, speed=asked,
    )  # fmt: skip
    if asked is not None:
        found = hastened(_again(source), printer, options)
        printer, options = found.printer, found.options
    output = Path(target)
    kind = files.chosen_format(output, format)
    own = Path(source) if isinstance(source, str | Path) else None
    with _lines_of(source) as lines, Outputs([own] if own else []) as outputs:
        if own and isinstance(lines, BufferedReader):
            outputs.watch(lines, own)
        return files.convert(lines, files.Target(outputs, output, own), printer, options, kind)


@one_blas_thread()
def simulate(
    source: Source,
    printer: Printer,
    *,
    simulated: Printer | None = None,
    model_error: Iterable[float] = (),
    draws: int = 50,
    seed: int = 0,
    steps: bool = False,
    limits: LimitSource = "file",
    extrusion: Extrusion | None = None,
    clamp: bool = False,
) -> SimulationReport:
    """What every strategy would do for a print: figures of the whole, by layer and by feature.

    simulated: the printer whose plant answers, where it is not the one compensated for.
    model_error: for each share (0.05: frequencies, damping and racking gain off by up to 5 %)
    ``draws`` printers are drawn and simulated, too; equal seeds draw equal printers. steps: the
    motors' whole steps stand between command and plant. Raises HframeError, OSError.
    """
    if steps and printer.steps is None:
        raise PrinterError("the table is missing: whole steps need it", "steps", printer.name)
    answers = simulated or printer
    study = simulation.Study(
        answers.plant,
        {share: drawn(answers.plant, share, draws, seed) for share in dict.fromkeys(model_error)},
        printer.steps if steps else None,
        answers.name,
    )
    options = Options("racking", tuple(STRATEGIES), limits, clamp, extrusion=extrusion)
    with _lines_of(source) as lines:
        return simulation.simulate(lines, printer, options, study)


@dataclass(frozen=True, slots=True)
class Tuning:
    """Every candidate that was tried; best: the recommended one, None if no motor can follow.

    stops: the settings of ``compensation.stops``, with their print times.
    """

    trials: tuple[Trial, ...]
    best: Trial | None
    stops: tuple[StopsTrial, ...] = ()


@one_blas_thread()
def tune(
    source: Source,
    printer: Printer,
    *,
    knots: Iterable[int] = tuning.KNOTS,
    efforts: Iterable[float] = tuning.EFFORTS,
    model_error: float | None = None,
    draws: int = 10,
    seed: int = 0,
    limits: LimitSource = "file",
    extrusion: Extrusion | None = None,
) -> Tuning:
    """Which window and weight suit this printer and this kind of print.

    knots: L, samples between knots; efforts: λ of x. Each pair is judged on the model and on
    ``draws`` printers that are off by up to ``model_error`` (None: ``known_to``). Recommended is
    the gentlest of those that are about as good as the best the motors can follow. Raises
    HframeError, OSError.
    """
    grid = tuning.candidates(printer.compensation, knots, tuple(efforts))
    share = known_to(printer) if model_error is None else model_error
    plants = drawn(printer.plant, share, draws, seed)
    with _lines_of(source) as lines:
        options = Options("racking", limits=limits, extrusion=extrusion)
        stops = tuple(tuning.StopsTrial(name) for name in STOPS)
        trials = tuning.tune(lines, printer, grid, plants, options, stops)
    tried = tuple(trial for trial in stops if trial.samples)
    return Tuning(tuple(trials), tuning.recommended(trials, printer.motors), tried)


def known_to(printer: Printer) -> float:
    """Share by which the printer may differ from its model: as `identify` measured it, or 0.05."""
    return UNKNOWN if printer.uncertainty is None else printer.uncertainty


def _again(source: Source) -> Callable[[], Iterable[bytes]]:
    """The lines, anew at each call. Raises HframeError where they can be had but once."""
    if isinstance(source, str | Path):
        return reread(Path(source))
    if isinstance(source, Iterator):
        raise HframeError(
            "lines that are read several times are no iterator: give a list or a file"
        )
    return lambda: source


@contextmanager
def _lines_of(source: Source) -> Iterator[Iterable[bytes]]:
    """The lines of a file, or those given."""
    if isinstance(source, str | Path):
        with Path(source).open("rb") as file:
            yield lines_of(file)
    else:
        yield source


def _places(given: ArrayLike, name: str) -> Array:
    """The array as (n, 2) numbers, n > 0. Raises ValueError."""
    places = np.asarray(given, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise ValueError(f"{name} must be (n, 2), n > 0; it is {places.shape}")
    if not np.isfinite(places).all():
        raise ValueError(f"{name} must be finite")
    return places
