"""What commands share: options, files, JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hframe_post.cli.progress import progress
from hframe_post.printer.choice import Choice, choose

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer
    from hframe_post.writers.files.atomic_file import Outputs

Command = TypeVar("Command", bound=Callable[..., Any])
_CHOICE = "hframe_post.choice"  # in a context's meta


class LazyChoice(click.Choice[str]):
    """A choice among names that are known only where they are asked for: imports take time."""

    def __init__(self, names: Callable[[], Iterable[str]]) -> None:
        super().__init__(())
        self._names = names

    @property
    def choices(self) -> tuple[str, ...]:
        """The names."""
        return tuple(self._names())

    @choices.setter
    def choices(self, given: tuple[str, ...]) -> None:
        """Click's constructor has none to give."""


class FirmwareChoice(LazyChoice):
    """A firmware that the output can be written for."""

    def __init__(self) -> None:
        super().__init__(firmwares)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name. Raises PrinterError for a firmware that is not supported any more."""
        if value == "reprapfirmware":
            from hframe_post.printer.firmware_tables import named

            named(value, "--firmware")
        return super().convert(value, param, ctx)


def firmwares() -> Iterable[str]:
    """Those that the output can be written for."""
    from hframe_post.firmware.registry import FIRMWARES

    return FIRMWARES


def strategies() -> Iterable[str]:
    """From doing nothing to doing all."""
    from hframe_post.model.strategies import STRATEGIES

    return STRATEGIES


def kinds() -> Iterable[str]:
    """Of kinematics."""
    from hframe_post.model.kinematics import ROWS

    return ROWS


def formats() -> Iterable[str]:
    """Those that the output can have."""
    from hframe_post.conversion.files import FORMATS

    return FORMATS


def _choose_printer(context: click.Context, _: click.Parameter, requested: str | None) -> str:
    choice = choose(requested, os.environ)
    context.meta[_CHOICE] = choice
    return choice.profile


def chosen_printer() -> Choice:
    """Return which profile the running command uses, and why."""
    choice: Choice = click.get_current_context().meta[_CHOICE]
    return choice


printer_option = click.option(
    "-p", "--printer", metavar="NAME|FILE", callback=_choose_printer,
    help="Printer profile: a shipped one's name, or a TOML file. Default: the variable "
    "HFRAME_PRINTER, then the profile set with 'hframe-post use', then 'paper'.",
)  # fmt: skip

limits_option = click.option(
    "--limits", type=click.Choice(["file", "file-all", "printer"]), default="file",
    show_default=True, help="Which limits in the file lower the profile's: those that the "
    "firmware obeys (Klipper: M204, SET_VELOCITY_LIMIT; Marlin: M201, M203, M204, M205), all of "
    "them, or none.",
)  # fmt: skip

extrusion_option = click.option(
    "--extrusion", type=click.Choice(["absolute", "relative"]),
    help="What E is before the first M82 or M83, where a macro of the printer sets it.",
)  # fmt: skip

on_limit_option = click.option(
    "--on-limit", type=click.Choice(["error", "clamp"]), default="error", show_default=True,
    help="Where a command would leave the bed or outrun a motor: stop, or compensate less.",
)  # fmt: skip


def renamed_option(
    old: str, new: str, value: Any = None, advice: str = "", **settings: Any
) -> Callable[[Command], Command]:
    """Return the decorator for an option's old name: it warns and is otherwise the new option.

    new: the option, or its parameter's name where that is another. value: what a flag means for
    the new option, if that is more than the flag. advice: what to type instead, if not ``new``.
    """

    def use_new(context: click.Context, _: click.Parameter, given: Any) -> None:
        if given is None or given is False or given == ():
            return
        say(f"Warning: {old} will be removed: use {advice or new}")
        name = new.lstrip("-").replace("-", "_")
        context.default_map = {
            **(context.default_map or {}), name: given if value is None else value,
        }  # fmt: skip

    return click.option(
        old, hidden=True, expose_value=False, is_eager=True, callback=use_new, **settings
    )


def removed_option(old: str, advice: str, **settings: Any) -> Callable[[Command], Command]:
    """Return the decorator for an option that does nothing any more but print this advice."""

    def warn(context: click.Context, _: click.Parameter, given: Any) -> None:
        if given is not None and given is not False:
            say(f"Warning: {old} will be removed: {advice}")

    return click.option(old, hidden=True, expose_value=False, callback=warn, **settings)


def force_option(command: Command) -> Command:
    """Add ``--force``."""
    command = renamed_option("--i-know", "--force", is_flag=True)(command)
    return click.option(
        "--force", is_flag=True,
        help="Compensate even though the profile's plant was not measured on your printer.",
    )(command)  # fmt: skip


seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Random seed.",
)  # fmt: skip

json_option = click.option(
    "--json", "json_file", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    metavar="FILE", help="Write the summary as JSON; '-' for standard output.",
)  # fmt: skip


page_option = click.option(
    "--report", "report_file", type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.HTML", help="Write a page for a browser, with all that can be drawn.",
)  # fmt: skip


def open_json(outputs: Outputs, path: Path | None) -> Callable[[dict[str, Any]], None]:
    """What writes a summary, indented, to a file or standard output; None: nowhere.

    The file is opened at once, so that one which cannot be written is told of before any work.
    """
    if path is None:
        return lambda summary: None
    file = outputs.open(dashed(path))

    def write(summary: dict[str, Any]) -> None:
        file.write((json.dumps(summary, indent=2) + "\n").encode())

    return write


def say(text: str) -> None:
    """Tells a person how it went. That nobody can be told does not undo what was done."""
    with suppress(OSError):
        click.echo(text, err=True)


def files_read(*given: str | Path | None) -> list[Path]:
    """Of sources and profiles, as they were given: the files among them."""
    return [Path(name) for name in given if name is not None and Path(name).is_file()]


def dashed(path: Path | None) -> Path | None:
    """A path as it was given; None for '-', standard output."""
    return None if str(path) == "-" else path


def share(text: str) -> float:
    """A percentage, ``5%`` or ``0.05``, as a number."""
    try:
        value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1.0:
        raise click.BadParameter(f"{text!r} is not a share from 0% to below 100%")
    return value


def position(text: str) -> tuple[float, float]:
    """``X,Y`` in mm."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not X,Y in mm") from None
    if not (abs(x) < 1e4 and abs(y) < 1e4):
        raise click.BadParameter(f"{text!r} is not on any bed")
    return round(x, 3), round(y, 3)


def weight(text: str) -> float:
    """A number from 0 to below ``LARGEST``."""
    from hframe_post.printer.schema import LARGEST

    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < LARGEST:
        raise click.BadParameter(f"{text!r} is not a number from 0 to below {LARGEST:g}")
    return value


source_argument = click.argument(
    "source", metavar="[IN.GCODE]", required=False,
    type=click.Path(path_type=Path, allow_dash=True),
)  # fmt: skip

path_option = click.option(
    "--path", type=click.Choice(["rectangle"]),
    help="Instead of a file: the paper's 120 × 20 mm rectangle (Fig. 7).",
)  # fmt: skip


def print_options(command: Command) -> Command:
    """A print to study: where it is, for which printer, and how it is read."""
    options = (source_argument, path_option, printer_option, limits_option, extrusion_option)
    for option in reversed(options):
        command = option(command)
    return command


@contextmanager
def opened(
    source: Path | None, path: str | None, printer: Printer, quiet: bool
) -> Iterator[Iterable[bytes]]:
    """The lines of the file or of the path."""
    from hframe_post.studies.simulation.reference_path import rectangle

    if (source is None) == (path is None):
        raise click.UsageError("give either a file or --path")
    if source is None:
        yield rectangle(printer)
    else:
        with click.open_file(str(source), "rb") as file, progress(file, source, quiet) as lines:
            yield lines


def figure_option(what: str) -> Callable[[Command], Command]:
    """``--figure FILE``, which draws that."""
    return click.option(
        "--figure", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
        help=f"Draw {what} (.png or .svg); needs matplotlib.",
    )  # fmt: skip


def check_figure(figure: Path | None) -> None:
    """Says at once that it cannot be drawn."""
    from hframe_post import plotting

    if figure is not None:
        if figure.suffix not in (".png", ".svg"):
            raise click.UsageError("--figure must end in .png or .svg")
        plotting.canvas(1, 1, (1.0, 1.0))
