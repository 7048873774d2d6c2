"""Options, types of values and output that several commands share."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar, cast

import click

from hframe_post.conversion.options import SHOWN, Options, Shown
from hframe_post.errors import ArgumentError, HframeError, OptionError
from hframe_post.printer.choice import CHOICE, Choice, choose
from hframe_post.version import __version__
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer

Command = TypeVar("Command", bound=Callable[..., Any])
COLOURS = (  # of the first words of lines
    (re.compile(r"^(Error:|PROBLEM)", re.MULTILINE), "red"),
    (re.compile(r"^(WARNING|SLICER|LOOK AGAIN)", re.MULTILINE), "yellow"),
    (re.compile(r"^(result|print time|Next\b|ok\b)", re.MULTILINE), "green"),
)
LARGE_BYTES = 2_000_000  # of a file, from which on its conversion takes more than a second
SCHEMA = 2  # of --json, raised when a key goes or changes its meaning
SUMMARY = "hframe_post.json"  # in a context's meta
SPECIAL = re.compile(r"[^\w@%+=:,./\\~-]")  # what a shell would not take as it stands


def _choose_printer(context: click.Context, _: click.Parameter, requested: str | None) -> str:
    choice = choose(requested, os.environ)
    context.meta[CHOICE] = choice
    return choice.profile


def chosen_printer() -> Choice:
    choice: Choice = click.get_current_context().meta[CHOICE]
    return choice


def shared(*names: str) -> Callable[[Command], Command]:
    """Return the decorator that adds options to a command: of ``SHARED``, or fields of ``Options``.

    The command gets the latter as one argument, ``options``. An OptionError is wrong usage.
    """

    def add(command: Command) -> Command:
        @wraps(command)
        def collected(*arguments: Any, **given: Any) -> Any:
            asked = {name: given.pop(name) for name in names if name in SHOWN}
            values = {
                name: SHOWN[name].choices[value] if SHOWN[name].choices else value
                for name, value in asked.items()
                if value is not None
            }
            try:
                return command(*arguments, options=Options(**values), **given)
            except OptionError as error:
                raise click.UsageError(str(error)) from None

        made: Any = command if SHOWN.keys().isdisjoint(names) else collected
        for name in reversed(names):
            made = (SHARED.get(name) or _click_option(name, SHOWN[name]))(made)
        return cast(Command, made)

    return add


def _click_option(name: str, shown: Shown) -> Callable[[Command], Command]:
    settings: dict[str, Any] = {"type": float, "show_default": str(shown.default)}
    if shown.choices:
        word = shown.word(shown.default)
        settings = {"type": click.Choice(tuple(shown.choices)), "default": word}
        settings["show_default"] = word is not None
    elif shown.default is False:
        settings = {"is_flag": True}
    elif shown.read is not None:
        settings = {"type": typed(shown.read)}
    elif shown.least is not None:
        settings = {"type": click.IntRange(shown.least), "default": shown.unset}
    settings |= {"help": shown.help, "metavar": shown.metavar, "hidden": shown.rare}
    return click.option(*shown.flags, name, **settings)


def _show_all(context: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked:
        for each in context.command.params:
            if isinstance(each, click.Option) and each.help:  # without help: it is gone
                each.hidden = False
        click.echo(context.get_help())
        context.exit()


def typed(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return a type of options: ``read`` whose ArgumentError is wrong usage."""

    def convert(text: str) -> Any:
        try:
            return read(text)
        except ArgumentError as error:
            raise click.BadParameter(str(error)) from None

    return convert


def say(text: str) -> None:
    """Print to standard error. That it cannot be printed does not undo what was done."""
    with suppress(OSError):
        click.echo(coloured(text), err=True)


def coloured(text: str) -> str:
    """Return a text with colours, which click removes where the output is not a terminal."""
    if os.environ.get("NO_COLOR"):
        return text
    for pattern, colour in COLOURS:
        text = pattern.sub(click.style(r"\g<0>", colour, bold=True), text)
    return text


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


def percent(text: str) -> float:
    """Return ``5%`` or ``0.05`` as 0.05; nan for any other text."""
    return number(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)


def share(text: str) -> float:
    """Read a share that an error or a change may have."""
    value = percent(text)
    if not 0.0 <= value < 1.0:
        hint = f"; for {value:g} percent type {text}%" if 1.0 <= value < 100.0 else ""
        raise click.BadParameter(f"{text!r} is not a share from 0% to below 100%{hint}")
    return value


def pair(
    what: str, of_x: tuple[float, float], of_y: tuple[float, float]
) -> Callable[[str], tuple[float, float]]:
    """Return a reader of ``X,Y``, two numbers within ranges. what: their name in a message."""

    def convert(text: str) -> tuple[float, float]:
        x, y = (round(number(part), 3) for part in text.partition(",")[::2])
        if not (of_x[0] <= x <= of_x[1] and of_y[0] <= y <= of_y[1]):
            raise click.BadParameter(f"{text!r} is not {what}")
        return x, y

    return convert


position = pair("X,Y in mm, at most 10 m away", (-1e4, 1e4), (-1e4, 1e4))


def ask(question: str, otherwise: Any, **settings: Any) -> Any:
    """Return what the owner answers; without a terminal ``otherwise``, raised if it is an error.

    settings: of ``click.prompt``.
    """
    if sys.stdin.isatty():
        return click.prompt(question, **settings)
    if isinstance(otherwise, Exception):
        raise otherwise
    return otherwise


def agrees(question: str) -> bool:
    """Return whether the owner agrees; without a terminal, as asked for by the command."""
    return not sys.stdin.isatty() or click.confirm(question, default=True)


@contextmanager
def progress_bar(source: Path | None, quiet: bool) -> Iterator[Callable[[int], object] | None]:
    """Show on a terminal how much of a file was read.

    Yields the function to call with each number of bytes read; None if nothing is shown.
    """
    size = source.stat().st_size if source is not None and source.is_file() else 0
    if source is None or quiet or size < LARGE_BYTES or not sys.stderr.isatty():
        yield None
        return
    with click.progressbar(length=size, label=source.name, file=sys.stderr) as bar:
        yield bar.update


def write_kernel(outputs: Outputs, profile: Path, printer: Printer) -> None:
    """Write the kernel of a printer next to its profile, if Klipper may use one."""
    from hframe_post.firmware.klipper.live import kernel_file

    if (data := kernel_file(printer)) is not None:
        outputs.open(profile.with_suffix(".kernel")).write(data)


# ---------------------------------------------------------------------- summaries


@dataclass(slots=True)
class Summary:
    """A summary as JSON of what a command did, or of why it failed (docs/interfaces.md).

    path: None for nowhere, where nobody asked for one. final: whether it holds the failure.
    """

    path: Path | None = None
    context: click.Context | None = None
    final: bool = False
    _outputs: Outputs | None = None
    _file: IO[bytes] | None = None

    @property
    def to_stdout(self) -> bool:
        return str(self.path) == "-"

    def open(self, outputs: Outputs) -> None:
        """Open the file, so that one that cannot be written is reported before any work."""
        if self.path is not None:
            self._outputs, self._file = outputs, outputs.open(dashed(self.path))

    def write(self, own: dict[str, Any], status: int = 0, error: HframeError | None = None) -> None:
        """Write the keys of a command, and its error if it is going to fail."""
        if self._file is not None:
            self.final = error is not None
            failure = {} if error is None else _failure(str(error), error)
            self._file.write(self._document(status or int(self.final), {**failure, **own}))

    def fail(self, status: int, text: str, error: Exception) -> None:
        """Write why the command failed.

        It replaces an earlier summary, but no other file: neither one that the command reads or
        writes, nor one that is not JSON.
        """
        printed = self.to_stdout and self._outputs is not None and self._outputs.appeared
        if self.path is None or self.final or printed:  # and the failure came after it
            return
        with suppress(HframeError, OSError):
            if self.path.is_file():
                with self.path.open("rb") as file:
                    if file.read(1) not in (b"", b"{"):
                        return
            with Outputs(self._others()) as outputs:
                document = self._document(status, _failure(text, error))
                outputs.open(dashed(self.path)).write(document)

    def _document(self, status: int, own: dict[str, Any]) -> bytes:
        assert self.context is not None
        head = {"schema": SCHEMA, "version": __version__, "command": self.context.info_name}
        return (json.dumps({**head, "status": status, **own}, indent=2) + "\n").encode()

    def _others(self) -> Iterator[Path]:
        """Yield what the command's other parameters name, which may be files."""
        assert self.context is not None
        for value in self.context.params.values():
            for one in value if isinstance(value, tuple) else (value,):
                if isinstance(one, str | Path):
                    yield Path(one)


def _failure(text: str, error: Exception) -> dict[str, Any]:
    line = getattr(error, "line", None)
    return {"error": text, **({"line": line} if line is not None else {})}


def _summary(context: click.Context, _: click.Parameter, path: Path | None) -> Summary:
    summary = context.meta[SUMMARY] = Summary(path, context)
    return summary


# ---------------------------------------------------------------------- shared options

READ = click.Path(path_type=Path, exists=True, dir_okay=False)
WRITTEN = click.Path(path_type=Path, dir_okay=False)
STREAMED = click.Path(path_type=Path, allow_dash=True, dir_okay=False)  # '-': standard output
FOLDER = click.Path(path_type=Path, file_okay=False)
SHARED = {
    "printer": click.option(
        "-p", "--printer", metavar="NAME|FILE", callback=_choose_printer,
        help="Your printer's profile. Default: from 'setup'.",
    ),
    "report": click.option(
        "--report", "report_file", type=WRITTEN, metavar="FILE.HTML",
        help="Write a report for a browser.",
    ),
    "json": click.option(
        "--json", "summary", type=STREAMED, metavar="FILE", callback=_summary, is_eager=True,
        help="Summary as JSON; '-' is standard output.",
    ),
    "help_all": click.option(
        "--help-all", is_flag=True, is_eager=True, expose_value=False, callback=_show_all,
        help="Show rare options, too.",
    ),
    "quiet": click.option(
        "-q", "--quiet", is_flag=True, help="Print no summary and no progress bar."
    ),
}  # fmt: skip
