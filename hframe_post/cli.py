"""The command line: the only place that opens files, prints and exits."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click

from hframe_post import __version__

if TYPE_CHECKING:
    from hframe_post.pipeline import Options
    from hframe_post.printer import Printer
    from hframe_post.report import Report

# One thread of linear algebra, wherever it runs: equal bytes need equal sums. It must be said
# before numpy is imported, and the matrices are too small to gain from more.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

STRATEGIES = ("racking", "fbs", "none")
BAR_FROM = 2_000_000  # bytes of input that deserve a progress bar
BAR_EVERY = 500  # lines between its steps


class _Commands(click.Group):
    """What is no command's name belongs to ``convert``; errors become one line and status 1."""

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in self.commands:
            args = ["convert", *args]
        return super().resolve_command(context, args)

    def invoke(self, context: click.Context) -> Any:
        from hframe_post.errors import HframeError

        try:
            return super().invoke(context)
        except HframeError as error:
            raise click.ClickException(str(error)) from None
        except BrokenPipeError:
            raise
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            raise click.ClickException(f"{where}{error.strerror or error}") from None


@click.group(
    cls=_Commands,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "ignore_unknown_options": True},
)
@click.version_option(__version__, prog_name="hframe-post")
def main() -> None:
    """Rewrites sliced G-code so that an H-frame (H-bot) printer does not rack or ring.

    \b
    hframe-post in.gcode -o out.gcode     convert a file
    hframe-post in.gcode                  convert it in place (slicers' hook)
    hframe-post convert --help            all options of it
    """


@main.command()
@click.argument("source", metavar="IN.GCODE", type=click.Path(path_type=Path, allow_dash=True))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    help="Output file; '-' for standard output. Without it the input is replaced.",
)  # fmt: skip
@click.option(
    "-p", "--printer", default="paper", show_default=True, metavar="NAME|FILE",
    envvar="HFRAME_PRINTER", help="Profile: a shipped one's name, or a TOML file.",
)  # fmt: skip
@click.option(
    "-c", "--compensation", type=click.Choice(STRATEGIES),
    help="Racking and ringing, ringing only (fbs), or none. Default: the profile's.",
)  # fmt: skip
@click.option(
    "--limits", type=click.Choice(["file", "printer"]), default="file", show_default=True,
    help="Whether M201, M203, M204, M205 and SET_VELOCITY_LIMIT in the file lower the "
    "profile's limits.",
)  # fmt: skip
@click.option(
    "--on-limit", type=click.Choice(["error", "clamp"]), default="error", show_default=True,
    help="Where a command would leave the bed or outrun a motor: stop, or compensate less.",
)  # fmt: skip
@click.option(
    "--tolerance", type=click.FloatRange(1e-4, 0.1), default=0.002, show_default=True,
    metavar="MM", help="How far the written command may be off the computed one.",
)  # fmt: skip
@click.option("--every-sample", is_flag=True, help="Write a line for every millisecond.")
@click.option(
    "--predict", type=click.Choice(["chosen", "all", "off"]), default="chosen", show_default=True,
    help="Contour error to predict: of no compensation and the chosen one, of all, of none.",
)  # fmt: skip
@click.option(
    "--json", "json_file", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    metavar="FILE", help="Write the summary as JSON; '-' for standard output.",
)  # fmt: skip
@click.option("-n", "--dry-run", is_flag=True, help="Report, but write no G-code.")
@click.option("-q", "--quiet", is_flag=True, help="No summary, no progress bar.")
def convert(
    source: Path, output: Path | None, printer: str, compensation: str | None, limits: str,
    on_limit: str, tolerance: float, every_sample: bool, predict: str, json_file: Path | None,
    dry_run: bool, quiet: bool,
) -> None:  # fmt: skip
    """Convert a sliced file. '-' reads standard input.

    The nozzle's motion is predicted with the printer's model, and the commands are changed
    so that the nozzle, not the motors, follows the slicer's path. Exit status 0 is success, 1
    an error in the input or the profile (nothing is written then), 2 wrong usage.
    """
    from hframe_post.pipeline import Options
    from hframe_post.printer import load

    profile = load(printer)
    strategy = compensation or profile.compensation.strategy
    wanted = {"chosen": ("none", strategy), "all": STRATEGIES, "off": ()}[predict]
    options = Options(
        strategy,
        tuple(dict.fromkeys(wanted)),
        file_limits=limits == "file",
        clamp=on_limit == "clamp",
        tolerance=None if every_sample else tolerance,
    )
    to_stdout = str(output) == "-" or (output is None and str(source) == "-")
    if to_stdout and str(json_file) == "-":
        raise click.UsageError("G-code and JSON cannot both go to standard output")
    target = None if to_stdout else output or source
    report = _converted(source, target, profile, options, dry_run, quiet)
    if json_file is not None:
        text = json.dumps(report.as_json(), indent=2) + "\n"
        with click.open_file(str(json_file), "w", encoding="utf-8") as file:
            file.write(text)
    if not quiet:
        click.echo(report.as_text(), err=True)


def _converted(
    source: Path, target: Path | None, printer: Printer, options: Options, dry: bool, quiet: bool
) -> Report:
    """Runs the conversion from file to file."""
    from hframe_post.output import OutputFile
    from hframe_post.pipeline import convert as conversion
    from hframe_post.report import Report

    report = Report(options.strategy)
    with click.open_file(str(source), "rb") as file, _progress(file, source, quiet) as lines:
        output = conversion(lines, printer, options, report)
        if dry:
            for _ in output:
                pass
        else:
            with OutputFile(target, sys.stdout.buffer) as out:
                out.write(output, lambda: report.time_after)
    return report


@contextmanager
def _progress(file: IO[bytes], source: Path, quiet: bool) -> Iterator[Iterable[bytes]]:
    """The file's lines, with a bar on a terminal if there are many."""
    size = source.stat().st_size if source.is_file() else 0
    if quiet or size < BAR_FROM or not sys.stderr.isatty():
        yield file
        return
    with click.progressbar(length=size, label=source.name, file=sys.stderr) as bar:

        def lines() -> Iterator[bytes]:
            read = 0
            for number, line in enumerate(file):
                read += len(line)
                if number % BAR_EVERY == 0:
                    bar.update(read)
                    read = 0
                yield line
            bar.update(read)

        yield lines()


@main.group(invoke_without_command=True)
@click.pass_context
def printers(context: click.Context) -> None:
    """List the shipped printer profiles."""
    from hframe_post.printer import load, shipped

    if context.invoked_subcommand is None:
        for name in shipped():
            click.echo(f"{name:16s}{load(name).description}")


@printers.command()
@click.argument("name")
def show(name: str) -> None:
    """Print a profile as TOML, to start one's own from."""
    from hframe_post.errors import PrinterError
    from hframe_post.printer import shipped

    profiles = shipped()
    if name not in profiles:
        raise PrinterError(f"no such profile; shipped are: {', '.join(profiles)}", source=name)
    click.echo(profiles[name], nl=False)
