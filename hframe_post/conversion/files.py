"""Output formats, chosen by suffix or by name, and how each is saved.

To add a format, write a generator of ``WholeFile`` and a row of ``FORMATS`` here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

from hframe_post.arrays import Array
from hframe_post.conversion.options import TOLERANCE, Kind, Options, stamp
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import OptionError
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.lines import BINARY
from hframe_post.printer.profile import check_identified
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread
from hframe_post.writers.outputs import Outputs, compressing
from hframe_post.writers.print_time import Output, write_output
from hframe_post.writers.tables import COLUMNS, EVENTS_HEADER, Note, as_csv, inlined, write_npz


@dataclass(frozen=True, slots=True)
class Target:
    """Where a conversion is written, and the other files that appear together with it.

    path: None is standard output. instead_of: the input, which may be replaced.
    """

    outputs: Outputs
    path: Path | None
    instead_of: Path | None = None
    _files: dict[str, IO[bytes]] = field(default_factory=dict)

    def open(self, suffix: str = "") -> IO[bytes]:
        """Return the empty file, or for a suffix the one whose name has that in addition.

        What an earlier conversion wrote to it is dropped.
        """
        if suffix not in self._files:
            path, source = self.path, self.instead_of
            if path is not None and suffix:
                path, source = path.with_name(path.name + suffix), None
            self._files[suffix] = self.outputs.open(path, source)
        file = self._files[suffix]
        file.seek(0)
        file.truncate()
        return file


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of output: what makes it of a file, and the function that saves it.

    save: takes what is made, the target and the file. suffixes: those that choose this format.
    """

    make: Callable[[WholeFile], Iterable[Any]]
    save: Callable[[Any, Target, WholeFile], None]
    suffixes: tuple[str, ...] = ()


@one_blas_thread()
def convert(
    lines: Iterable[bytes], target: Target | None, printer: Printer, options: Options
) -> Report:
    """Convert lines and write the target, which appears with its outputs.

    target None: nothing is written. Raises HframeError, OSError.
    """
    if target is not None and options.strategy != "none" and not options.force:
        check_identified(printer)
    chosen, file = FORMATS[options.format or "gcode"], WholeFile(lines, printer, options)
    pieces = chosen.make(file)
    if target is None:
        for _ in pieces:
            pass
    else:
        chosen.save(pieces, target, file)
    return file.report


def with_format(
    options: Options, printer: Printer, output: Path | None, source: Path | None
) -> Options:
    """Return the options with the format for ``output``, or for None: standard output.

    source: the input. Raises OptionError for what the format or the printer's firmware cannot have.
    """
    in_place = source is not None and output is not None and _is_same(source, output)
    kind = chosen_format(output, options.format)
    if in_place and kind != "gcode":
        raise OptionError(f"{kind} would replace the G-code: name an output file with -o")
    if options.tolerance != TOLERANCE and kind != "gcode":
        raise OptionError("--tolerance is for G-code")
    if options.tolerance != TOLERANCE and not firmware(printer).decimates:
        raise OptionError("--tolerance is for Klipper")
    return replace(options, format=kind, tolerance=options.tolerance if kind == "gcode" else None)


def _is_same(source: Path, target: Path) -> bool:
    return source.exists() and target.exists() and source.samefile(target)


def chosen_format(output: Path | None, asked: Kind | None) -> Kind:
    """Return the format for a file, or for None: standard output. Raises OptionError."""
    suffix, packing = _suffixes(output)
    by_suffix = next((name for name, known in FORMATS.items() if suffix in known.suffixes), None)
    kind: Kind = asked or by_suffix or "gcode"
    if suffix == BINARY:
        raise OptionError(f"{output}: binary G-code is not written: name a .gcode file")
    if suffix in TABLES and kind != "samples":
        raise OptionError(f"a {suffix} file holds samples, not {kind}")
    if packing and output is not None and (kind == "gcode" or suffix in TABLES):
        why = f"{suffix} is compressed already" if suffix in TABLES else "printers cannot read it"
        raise OptionError(
            f"{output}: {kind} is not written compressed, because {why}: leave out {packing}"
        )
    return kind


def _suffixes(path: Path | None) -> tuple[str, str]:
    """Return the suffix that chooses the format, and that of the compression."""
    suffixes = path.suffixes if path is not None else []
    packing = suffixes.pop() if suffixes and suffixes[-1] == ".gz" else ""
    return (suffixes[-1] if suffixes else ""), packing


def _save_gcode(pieces: Iterable[Output], target: Target, file: WholeFile) -> None:
    write_output(target.open(), pieces, lambda: file.times, lambda: file.report.as_text())


def _save_steps(pieces: Iterable[bytes | Note], target: Target, _: WholeFile) -> None:
    """Write the step file and, next to a regular file, the file of its events."""
    out = target.open()
    if target.path is None:
        out.writelines(inlined(pieces))
        return
    events = target.open(".events")
    events.write(EVENTS_HEADER)
    with compressing(out, _suffixes(target.path)[1]) as packed:
        for piece in pieces:
            if isinstance(piece, bytes):
                packed.write(piece)
            else:
                events.write(piece.line())


def _save_samples(tables: Iterable[Array], target: Target, file: WholeFile) -> None:
    kind, packing = _suffixes(target.path)
    out = target.open()
    if target.path is not None and kind == ".npz":
        made_by = stamp(file.printer, file.chain.options)
        write_npz(out, tables, COLUMNS, made_by, target.path.resolve().parent)
    else:
        with compressing(out, packing) as packed:
            packed.writelines(as_csv(tables))


TABLES = (".npz",)  # of samples, which are CSV under any other suffix
FORMATS: dict[Kind, Format] = {
    "gcode": Format(WholeFile.gcode, _save_gcode),
    "steps": Format(WholeFile.steps, _save_steps, (".csv",)),
    "samples": Format(WholeFile.rows, _save_samples, TABLES),
}
