"""The tool as functions: arrays in, arrays out; files in, files out.

This module defines what ``import hframe_post`` offers in addition to the classes of other modules.
Lengths are in mm, times in s, one sample is 1 ms. x and y are the printer's own coordinates,
because the lever arm of racking depends on x. Studies and pages are imported where they are used:
a slicer waits for a conversion, which needs none of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hframe_post.arrays import Array
from hframe_post.compensation.compensate import settling_samples
from hframe_post.conversion import whole_file
from hframe_post.conversion.options import Options, stamp
from hframe_post.conversion.pipeline import Chain, prepared
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.errors import (
    ArgumentError,
    GcodeError,
    LeftAloneError,
    OptionError,
    PrinterError,
)
from hframe_post.gcode.lines import Input, Source
from hframe_post.model.plant import nozzle
from hframe_post.model.strategies import STRATEGIES
from hframe_post.model.strategies import strategy as strategy_of
from hframe_post.native.linear import one_blas_thread
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.predict import contour_error as off_path
from hframe_post.printer import profile
from hframe_post.printer.settings import Printer
from hframe_post.process import release_memory
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:
    from hframe_post.studies.simulation import SimulationReport

DEFAULT = Options()


def load_printer(name_or_path: str | Path) -> Printer:
    """Return the shipped profile of that name or the one in that TOML file.

    Raises PrinterError.
    """
    return profile.load(str(name_or_path))


# ---------------------------------------------------------------------- arrays


@one_blas_thread()
def compensate(xy: ArrayLike, printer: Printer, strategy: str = "racking") -> Array:
    """Return the command for the motors under which the nozzle follows a path: eq. 12, 13, 19.

    xy: the path (n, 2), one sample a millisecond, at rest before its first sample and after its
    last. Returns (r + n + r, 2): the command leads the motion and settles after it, so the path
    gets r samples of rest before it and as many after it. r depends on the printer alone, is the
    same for every strategy, and suffices for the fastest start and stop within its limits.

    strategy: ``racking``, ``fbs`` (ringing only) or ``none``. Only ``convert`` checks the limits
    of bed and motors. Raises HframeError for a strategy or a profile that cannot be used, or an
    array that is not a path.
    """
    path, chosen = _points(xy, "xy"), strategy_of(strategy)
    compensator = prepared(printer)
    r = settling_samples(compensator, printer.limits, printer.travel)
    state = chosen.begin(compensator, path[0])
    final = state.feed(np.pad(path, ((r, r), (0, 0)), mode="edge"))
    return np.concatenate([final, state.finish()])


@one_blas_thread()
def predict(command: ArrayLike, printer: Printer) -> Array:
    """Return where the nozzle goes under a command (m, 2): x and y, (m, 2), eq. 1 and 2.

    The printer rests at the command's first sample before it begins. For a printer that differs
    from the model, give one with another plant: ``dataclasses.replace(printer, plant=...)``.
    Raises ArgumentError for an array that is not a command.
    """
    points = _points(command, "command")
    return nozzle(printer.plant, points[0], points)


def contour_error(nozzle: ArrayLike, path: ArrayLike) -> Array:
    """Return how far the nozzle is off the path at each sample of the path, (n,), mm.

    nozzle (r + n + r, 2): as ``predict`` returns it for a command with r ≥ 0 samples of rest
    before and after the path; the rests do not count. path (n, 2). The error is the distance to
    the polyline through the path's samples within 24 ms of the time in question, not to where the
    nozzle should be at that time. Raises ArgumentError if the lengths do not fit.
    """
    actual, desired = _points(nozzle, "nozzle"), _points(path, "path")
    r, odd = divmod(len(actual) - len(desired), 2)
    if r < 0 or odd:
        raise ArgumentError(
            f"{len(actual)} samples of the nozzle do not belong to a path of {len(desired)}: the "
            "path needs as many samples of rest before it as after it"
        )
    return off_path(desired, actual[r : r + len(desired)])


# ---------------------------------------------------------------------- files


def convert(
    source: Source,
    target: str | Path | None,
    printer: Printer,
    options: Options = DEFAULT,
    *,
    page: str | Path | None = None,
    title: str = "",
    notes: Iterable[str] = (),
    outputs: Outputs | None = None,
    progress: Callable[[int], object] | None = None,
) -> Report:
    """Convert sliced G-code, write it to the target, and return a report.

    source: a file's path, an open binary file, or lines; a path or a list where it is read several
    times, for a page or a greatest error. target: a path, which may be the source's; ``-`` writes
    to standard output; None writes nothing.

    page: also write an HTML page to this file, under this title, with these notes above the report.
    outputs: files that appear together with the target. progress: called with the number of bytes
    of each line read.

    Raises HframeError (GcodeError, PrinterError and LimitError name the line or the key;
    OptionError: the options do not go together; LeftAloneError: the source is not to be converted,
    or was with these options) and OSError; then no file is changed.
    """
    if options.firmware is not None:
        printer = profile.played_by(printer, options.firmware)
    given, output = Input(source, progress), None if target in (None, "-") else Path(str(target))
    options = whole_file.with_format(options.resolved(printer), printer, output, given.path)
    if given.once:
        _check_read_once(page, options)
    with ExitStack() as opened:
        opened.enter_context(_comparing_stamps(printer, options, given))
        if outputs is None:
            outputs = opened.enter_context(Outputs([given.path] if given.path else []))
        if given.path is not None:
            outputs.watch(given.path)
        page_file = outputs.open(Path(page)) if page is not None else None
        if page is not None:
            predicted = dict.fromkeys(("none", *options.strategies))
            options = replace(options, predict=tuple(predicted), picture=True)
        written = whole_file.Target(outputs, output, given.path) if target is not None else None
        report = _converted(given, written, printer, options)
        if page_file is not None:
            name = title or (given.path.name if given.path else "print")
            release_memory()
            _write_page(page_file, report, given, name, report.summary(notes).splitlines())
    return report


@one_blas_thread()
def simulate(
    source: Source,
    printer: Printer,
    options: Options = DEFAULT,
    *,
    simulated: Printer | None = None,
    model_error: Iterable[float] = (),
    draws: int = 50,
    seed: int = 0,
    steps: bool = False,
    page: str | Path | None = None,
    title: str = "",
    notes: Iterable[str] = (),
    outputs: Outputs | None = None,
    progress: Callable[[int], object] | None = None,
) -> SimulationReport:
    """Predict what every strategy would do for a print: in all, by layer and by feature.

    options: limits, extrusion and clamp; the motion is compensated for by every strategy.
    simulated: the printer whose plant is simulated, if not the one compensated for. model_error:
    for each share (0.05: frequencies, damping and racking gain off by up to 5 %) ``draws`` random
    printers are simulated, too; equal seeds give equal printers. steps: round commands to whole
    motor steps first. page, title, notes, outputs, progress: as in ``convert``. The source is read
    twice; one that can be read only once is kept in memory. Raises HframeError, OSError.
    """
    from hframe_post.studies import simulation

    if steps and printer.steps is None:
        raise PrinterError("the table is missing: whole steps need it", "steps", printer.name)
    actual = simulated or printer
    study = simulation.Study(
        actual.plant,
        {share: actual.plant.drawn(share, draws, seed) for share in dict.fromkeys(model_error)},
        printer.steps if steps else None, actual.name,
        Doubts.from_plant(actual.plant, actual.uncertainty),
    )  # fmt: skip
    options = replace(options, strategy="racking", predict=tuple(STRATEGIES))
    given = Input(source, progress)
    if given.once:
        given = Input(list(given.lines()))
    if page is not None:
        beginning = given.beginning(600_000)  # bytes, which suffice for a shaper within 2 %
        items = Chain(printer, options).read(beginning)
        shaping = SlicedFile.from_items(items, printer).shaping(actual.plant)
        options = replace(options, picture=True, shaping=shaping)
    with ExitStack() as opened:
        report = simulation.simulate(given.lines, printer, options, study)
        if page is not None:
            file = (outputs or opened.enter_context(Outputs([]))).open(Path(page))
            _write_page(file, report, given, title, list(notes))
    return report


# ---------------------------------------------------------------------- arguments


def _converted(
    given: Input, target: whole_file.Target | None, printer: Printer, options: Options
) -> Report:
    """Convert as the file asks, or as fast as the greatest error allows; return the report."""

    def converted(options: Options) -> Report:
        return whole_file.convert(given.lines(), target, printer, options)

    if options.speed is None:
        return converted(options)
    from hframe_post.studies.speed import fastest

    return fastest(options, converted)


def _write_page(
    file: IO[bytes], report: Report, given: Input, title: str, notes: list[str]
) -> None:
    from hframe_post.page.build import page

    file.write(page(report, given.again(), title, notes))


def _check_read_once(page: str | Path | None, options: Options) -> None:
    """Raise OptionError if a source that can be read only once would be read again."""
    if page is not None:
        raise OptionError("an HTML report reads the file twice: name a file instead of '-'")
    if options.speed is not None:
        raise OptionError(
            "--max-error (or speed.max_error of the profile) reads the file several times: name a "
            "file (in Python, also a list of lines), or use --max-error off"
        )


@contextmanager
def _comparing_stamps(printer: Printer, options: Options, source: Input) -> Iterator[None]:
    """Let no LeftAloneError pass if the source was converted with other settings."""
    present = stamp(printer, options) if source.path and options.format == "gcode" else ""
    try:
        yield
    except LeftAloneError as found:
        if found.stamp in ("", present):
            raise
        differs = f" with other settings ({found.stamp}; now {present})" if present else ""
        original = _original(source.path)
        advice = f"Convert {original} instead" if original else "Convert the slicer's file instead"
        cause = f"this file is converted already{differs}. {advice}"
        raise GcodeError(cause, found.line) from None


def _original(source: Path | None) -> Path | None:
    """Return ``part.gcode`` for ``part.compensated.gcode``, if it exists."""
    if source is None or len(source.suffixes) < 2:
        return None
    original = source.with_name(Path(source.stem).stem + source.suffix)
    return original if original.is_file() else None


def _points(values: ArrayLike, name: str) -> Array:
    """Return the values as an array (n, 2), n > 0, of finite numbers. Raises ArgumentError."""
    try:
        points = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} must be an array (n, 2) of numbers") from None
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise ArgumentError(f"{name} must be (n, 2), n > 0; it is {points.shape}")
    if not np.isfinite(points).all():
        raise ArgumentError(f"{name} must be finite")
    return points
