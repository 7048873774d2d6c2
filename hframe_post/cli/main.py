"""The command line: the only place that opens files, prints and exits."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
from importlib import import_module
from typing import Any, NoReturn

import click

from hframe_post import process
from hframe_post.version import __version__

COMMANDS = {  # module of hframe_post.cli, its function
    "convert": "convert.convert",
    "batch": "batch.batch",
    "compare": "compare.compare",
    "simulate": "simulate.simulate",
    "paper": "paper.paper",
    "sweep": "sweep.sweep",
    "tune": "tune.tune",
    "calibrate-marlin": "calibrate.calibrate_marlin",
    "klipper-macros": "klipper_macros.klipper_macros",
    "identify": "identify.identify",
    "verify": "verify.verify",
    "use": "use.use",
    "cura-script": "cura.cura_script",
    "doctor": "doctor.doctor",
    "printers": "printers.printers",
}


class _Commands(click.Group):
    """What is no command's name belongs to ``convert``; errors become one line and status 1.

    A command is imported where it is called for: a slicer waits for it.
    """

    def list_commands(self, context: click.Context) -> list[str]:
        return sorted(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module, _, function = COMMANDS[name].rpartition(".")
        command: click.Command = getattr(import_module(f"hframe_post.cli.{module}"), function)
        return command

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in COMMANDS:
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


def run() -> NoReturn:
    """Run the command line and end the process: with status 0 only if all was done and printed."""
    process.open_closed_streams()
    process.clean_up_when_killed()
    process.end_with_parent()
    try:
        main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except MemoryError:
        status = _fail("there is not enough memory; nothing was written")
    except OSError as error:  # while click wrote to standard output
        status = _fail(error.strerror or str(error))
    except Exception as error:  # our mistake, not the user's
        status = _fail(_bug_report(error))
    failure = process.flush_streams()
    if failure is not None and status == 0:
        status = 1 if isinstance(failure, BrokenPipeError) else _fail(str(failure))
    sys.exit(status)


def _fail(message: str) -> int:
    with contextlib.suppress(OSError):
        click.echo(f"Error: {message}", err=True)
    return 1


def _bug_report(error: Exception) -> str:
    """One line from which the fault can be found."""
    frames = traceback.extract_tb(error.__traceback__)[-3:]
    places = ", ".join(f"{os.path.basename(f.filename)}:{f.lineno}" for f in reversed(frames))
    message = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return f"this is a bug in hframe-post, please report it: {message} ({places})"
