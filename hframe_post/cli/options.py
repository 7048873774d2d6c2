"""Options, types of values and output that several commands share."""

from __future__ import annotations

import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hframe_post.model.strategies import STRATEGIES
from hframe_post.printer.choice import Choice, choose

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer

Command = TypeVar("Command", bound=Callable[..., Any])
SPECIAL = re.compile(r"[^\w@%+=:,./\\~-]")  # what a shell would not take as it stands
_CHOICE = "hframe_post.choice"  # in a context's meta


def _choose_printer(context: click.Context, _: click.Parameter, requested: str | None) -> str:
    choice = choose(requested, os.environ)
    context.meta[_CHOICE] = choice
    return choice.profile


def chosen_printer() -> Choice:
    choice: Choice = click.get_current_context().meta[_CHOICE]
    return choice


printer_option = click.option(
    "-p", "--printer", metavar="NAME|FILE", callback=_choose_printer,
    help="Printer profile: the name of a shipped one, or a TOML file. Default: the variable "
    "HFRAME_PRINTER, then the profile that 'hframe-post setup' or 'use' made the default.",
)  # fmt: skip

compensation_option = click.option(
    "-c", "--compensation", type=click.Choice(tuple(STRATEGIES)),
    help="Compensate ringing, racking and other couplings (racking), ringing only (fbs) or nothing "
    "(none). Default: compensation.strategy of the profile.",
)  # fmt: skip

limits_option = click.option(
    "--limits", type=click.Choice(["file", "file-all", "printer"]), default="file",
    show_default=True, help="Which limits set in the file lower the profile's: those that the "
    "firmware obeys (Klipper: M204, SET_VELOCITY_LIMIT; Marlin: M201, M203, M204, M205), all "
    "(file-all), or none (printer).",
)  # fmt: skip

extrusion_option = click.option(
    "--extrusion", type=click.Choice(["absolute", "relative"]),
    help="Meaning of E before the first M82 or M83 in the file, if a start macro of the printer "
    "sets it.",
)  # fmt: skip

on_limit_option = click.option(
    "--on-limit", type=click.Choice(["error", "clamp"]), default="clamp", show_default=True,
    help="If the compensated motion would leave the bed or exceed a motor's limits: stop with an "
    "error, or compensate less there and say so.",
)  # fmt: skip


force_option = click.option(
    "--force", is_flag=True,
    help="Compensate even if the profile's plant was not measured on your printer.",
)  # fmt: skip


seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Random seed.",
)  # fmt: skip

page_option = click.option(
    "--report", "report_file", type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.HTML", help="Write a report with plots, for a browser.",
)  # fmt: skip


def say(text: str) -> None:
    """Print to standard error. That it cannot be printed does not undo what was done."""
    with suppress(OSError):
        click.echo(text, err=True)


def quoted(path: str | Path) -> str:
    """Return a path as a shell takes it."""
    text = str(path)
    if os.name == "posix":
        text = re.sub(r'(["$`\\])', r"\\\1", text)  # which it would read even between quotes
    return f'"{text}"' if SPECIAL.search(text) else text


def files_read(*names: str | Path | None) -> list[Path]:
    """Return the files among names of sources and profiles."""
    return [Path(name) for name in names if name is not None and Path(name).is_file()]


def dashed(path: Path | None) -> Path | None:
    """Return the path; None for '-', standard output."""
    return None if str(path) == "-" else path


def number(text: str) -> float:
    """Return the number; nan for any other text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def share(text: str) -> float:
    """Read ``5%`` or ``0.05`` as 0.05."""
    value = number(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    if not 0.0 <= value < 1.0:
        hint = f"; for {value:g} percent type {text}%" if 1.0 <= value < 100.0 else ""
        raise click.BadParameter(f"{text!r} is not a share from 0% to below 100%{hint}")
    return value


def position(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not X,Y in mm") from None
    if not (abs(x) < 1e4 and abs(y) < 1e4):
        raise click.BadParameter(f"{text!r} is more than 10 m away")
    return round(x, 3), round(y, 3)


def print_options(command: Command) -> Command:
    """Add the options of a print to study: the file, its printer, and how it is read."""
    options = (
        click.argument(
            "source", metavar="[IN.GCODE]", required=False,
            type=click.Path(path_type=Path, allow_dash=True),
        ),
        printer_option, limits_option, extrusion_option,
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


@contextmanager
def opened(source: Path | None, printer: Printer, quiet: bool) -> Iterator[Iterable[bytes]]:
    """Yield the lines of the file; without one, of the paper's rectangle."""
    from hframe_post.gcode.lines import lines_of
    from hframe_post.studies.inputs import rectangle

    if source is None:
        yield rectangle(printer)
        return
    with click.open_file(str(source), "rb") as file, progress_bar(source, quiet) as advance:

        def lines() -> Iterator[bytes]:
            for line in lines_of(file):
                if advance is not None:
                    advance(len(line))
                yield line

        yield lines()


BAR_FROM = 2_000_000  # bytes; smaller files take no time
START = time.monotonic()
_VERBOSE = "hframe_post.verbose"  # in a context's meta


@contextmanager
def progress_bar(source: Path, quiet: bool) -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar on a terminal if the file is large, or log the progress with ``-v``.

    Yields the function to call with each number of bytes read; None if nothing is shown.
    """
    size = source.stat().st_size if source.is_file() else 0
    if quiet or size < BAR_FROM or not sys.stderr.isatty():
        yield _log_progress(size) if size and _is_verbose() else None
        return
    with click.progressbar(
        length=size, label=source.name, file=sys.stderr, update_min_steps=size // 200
    ) as bar:
        yield bar.update


def _log_progress(size: int) -> Callable[[int], None]:
    done = 0

    def advance(length: int) -> None:
        nonlocal done
        before, done = done, done + length
        if (tenth := 10 * done // size) > 10 * before // size:
            log(f"{10 * tenth} % is read")

    return advance


def _is_verbose() -> bool:
    return bool(click.get_current_context().meta.get(_VERBOSE))


def _set_verbose(context: click.Context, _: click.Parameter, verbose: bool) -> None:
    context.meta[_VERBOSE] = verbose


verbose_option = click.option(
    "-v", "--verbose", is_flag=True, expose_value=False, callback=_set_verbose,
    help="Log stages and their duration to standard error.",
)  # fmt: skip


def log(text: str) -> None:
    """Print a line with the seconds since the start, if the running command has ``-v``."""
    if _is_verbose():
        click.echo(f"{time.monotonic() - START:9.3f} s  {text}", err=True)
