"""What ``convert`` writes: the format, by suffix or option, and the files of each."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from hframe_post.arrays import Array
    from hframe_post.conversion.pipeline import Options
    from hframe_post.conversion.report import Report
    from hframe_post.printer.settings import Printer
    from hframe_post.writers.step_file import Note

FORMATS = ("gcode", "steps", "step-bits", "samples")
PACKED = (".gz", ".zst")
TABLES = (".npz", ".parquet")  # of samples, which are CSV under any other suffix
BY_SUFFIX = {".csv": "steps", **dict.fromkeys(TABLES, "samples")}


def chosen_format(output: Path | None, asked: str | None) -> str:
    """The format for the file ``output``; None: another or no file. Raises UsageError."""
    kind, packing = _suffixes(output)
    chosen = asked or BY_SUFFIX.get(kind, "gcode")
    if kind in TABLES and chosen != "samples":
        raise click.UsageError(f"a {kind} file holds samples, not {chosen}")
    if packing and (chosen == "gcode" or kind in TABLES):
        what = "G-code" if chosen == "gcode" else kind
        raise click.UsageError(f"{what} is not written as {packing}; CSV is")
    return chosen


def _suffixes(path: Path | None) -> tuple[str, str]:
    """The suffix that tells the format, and that of packing."""
    suffixes = path.suffixes if path is not None else []
    packing = suffixes.pop() if suffixes and suffixes[-1] in PACKED else ""
    return (suffixes[-1] if suffixes else ""), packing


def write(
    kind: str, lines: Iterable[bytes], target: Path | None, printer: Printer, options: Options,
    report: Report,
) -> None:  # fmt: skip
    """Converts and writes all of it, or nothing. target None: standard output."""
    from hframe_post.conversion import pipeline
    from hframe_post.writers.atomic_file import OutputFile

    if kind == "gcode":
        with OutputFile(target, sys.stdout.buffer) as out:
            output = pipeline.convert(lines, printer, options, report)
            out.write(output, lambda: report.time_after)
    elif kind == "samples":
        tables = pipeline.convert_to_samples(lines, printer, options, report)
        _write_samples(tables, target, pipeline.stamp(printer, options))
    else:
        inline = target is None
        pieces = pipeline.convert_to_steps(lines, printer, options, report, kind, inline)
        _write_steps(pieces, target)


def run(
    kind: str, lines: Iterable[bytes], printer: Printer, options: Options, report: Report
) -> None:
    """Converts and writes nothing."""
    from hframe_post.conversion import pipeline

    given = (lines, printer, options, report)
    output: Iterable[object]
    if kind == "gcode":
        output = pipeline.convert(*given)
    elif kind == "samples":
        output = pipeline.convert_to_samples(*given)
    else:
        output = pipeline.convert_to_steps(*given, kind)
    for _ in output:
        pass


def _write_steps(pieces: Iterable[bytes | Note], target: Path | None) -> None:
    """The step file and, where it is a file, the one of its events beside it."""
    from contextlib import ExitStack

    from hframe_post.writers.atomic_file import OutputFile
    from hframe_post.writers.compression import compressing
    from hframe_post.writers.step_file import EVENTS_HEADER

    with ExitStack() as files:
        out = files.enter_context(OutputFile(target, sys.stdout.buffer)).file
        if target is None:
            for piece in pieces:
                out.write(piece)  # type: ignore[arg-type]
            return
        beside = target.with_name(target.name + ".events")
        events = files.enter_context(OutputFile(beside, sys.stdout.buffer)).file
        events.write(EVENTS_HEADER)
        with compressing(out, _suffixes(target)[1]) as packed:
            for piece in pieces:
                if isinstance(piece, bytes):
                    packed.write(piece)
                else:
                    events.write(piece.line())
        for file in (out, events):  # what a full disk refuses must be refused before either appears
            file.flush()


def _write_samples(tables: Iterable[Array], target: Path | None, stamp: str) -> None:
    """The table of samples as its suffix says."""
    from hframe_post.writers.atomic_file import OutputFile
    from hframe_post.writers.compression import compressing
    from hframe_post.writers.samples import COLUMNS, as_csv
    from hframe_post.writers.table_file import write_npz, write_parquet

    kind, packing = _suffixes(target)
    with OutputFile(target, sys.stdout.buffer) as out:
        if target is not None and kind == ".npz":
            write_npz(out.file, tables, COLUMNS, stamp, target.resolve().parent)
        elif kind == ".parquet":
            write_parquet(out.file, tables, COLUMNS, stamp)
        else:
            with compressing(out.file, packing) as packed:
                for piece in as_csv(tables):
                    packed.write(piece)
