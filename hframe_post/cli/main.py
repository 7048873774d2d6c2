"""The command line. Only this package prints and ends the process."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

import click

from hframe_post import process
from hframe_post.errors import HframeError, PrinterError
from hframe_post.version import __version__

if TYPE_CHECKING:
    from hframe_post.printer.choice import Choice

GROUPS = {  # by group and command: its module in hframe_post.cli, a line of help
    "Start": {
        "setup": ("setup", "Make a profile from Klipper's printer.cfg or Marlin's M503."),
        "measure": ("measure", "Write the G-code that measures a printer."),
        "identify": ("measurements", "Compute the printer's model from the recordings."),
        "calibrate-print": ("calibrate_print", "Measure a printer without a sensor."),
    },
    "Every print": {
        "convert": ("convert", "Convert a sliced file. This is the default command."),
        "batch": ("batch", "Convert many files and folders."),
        "check": ("measurements", "Find what has drifted, and what compensation brings."),
        "doctor": ("doctor", "Check the installation, a profile and printer.cfg."),
    },
    "Study": {
        "simulate": ("convert", "Predict what compensation does for a print."),
    },
    "Other programs": {
        "connect": ("connect", "Connect a slicer, Cura, OctoPrint or Moonraker."),
    },
}
COMMANDS = {name: found[0] for group in GROUPS.values() for name, found in group.items()}
MOUNTED = "the recordings show how the sensor is mounted"
BY_VERSION = "'hframe-post setup' reads the planner from Marlin's answers to M503 and M115"
GONE = {  # former commands, options and values, and what replaced them
    "compare": "equal input gives equal bytes: compare files with cmp or diff",
    "speed": "'hframe-post IN.GCODE --max-error 100um --dry-run' shows the time within an error",
    "paper": "run 'python -m examples.paper.tables' in the folder of hframe-post",
    "tune": "'hframe-post identify' writes the best window; 'simulate --shapers' has the shapers",
    "use": "'hframe-post setup PROFILE.TOML' makes it the default, 'hframe-post doctor' shows it",
    "printers": "'hframe-post doctor -p paper' shows where a shipped profile is",
    "sweep": "'hframe-post measure' writes it for Marlin",
    "bands": "Shake&Tune's CREATE_VIBRATIONS_PROFILE shows them; give outer walls another speed",
    "verify": "'hframe-post check' tells what compensation brings, from 'measure --for check'",
    "klipper-macros": "'hframe-post setup' writes them, 'hframe-post connect klipper' prints them",
    "calibrate-marlin": BY_VERSION,
    "slicer-line": "'hframe-post connect slicer'",
    "cura-script": "'hframe-post connect cura'",
    "octoprint-plugin": "'hframe-post connect octoprint'",
    "batch --watch": "name the folder with --resume, for example from cron",
    "batch --scheduler": "run 'hframe-post batch' on each machine with its share of the files",
    **dict.fromkeys(("batch -d", "batch --directory"), "-o names the folder"),
    **dict.fromkeys(("convert -v", "convert --verbose"), "a terminal shows a bar"),
    "calibrate-print --advance-lines": "slicers print such a pattern, as OrcaSlicer does",
    "calibrate-print --advance": "write extruder.advance into the profile",
    "check --report": "it was for verify; the line effect says what the profile leaves",
    "check --gcode": "write the run with 'hframe-post measure --for check -o CHECK.GCODE'",
    "check --axis": "the run moves both axes; where the bed moves, each has its file",
    **dict.fromkeys(("check --axes", "identify --axes"), MOUNTED),
    "convert --retract": "retractions are made before the travel, as in the file",
    "doctor --klippy-log": "docs/klipper.md names the versions of Klipper that cannot do it",
    "doctor --report": "its output says all",
    "doctor --history": "the console says what each check has found",
    "measure --for planner": BY_VERSION,
    "measure --motion": "the run is a rectangle and a zigzag",
    "setup --moonraker": "'hframe-post connect moonraker'",
    "setup --no-moonraker": "'hframe-post connect moonraker --remove'",
}
UNBROKEN = "\N{NON-BREAKING HYPHEN}"


class _Formatter(click.HelpFormatter):
    """Help whose words are not broken at their hyphens: no option or command is torn apart."""

    def write_text(self, text: str) -> None:
        super().write_text(text.replace("-", UNBROKEN))

    def write_dl(self, rows: Any, *widths: Any, **more: Any) -> None:
        super().write_dl([(left, text.replace("-", UNBROKEN)) for left, text in rows], **more)

    def getvalue(self) -> str:
        return super().getvalue().replace(UNBROKEN, "-")


click.Context.formatter_class = _Formatter


class _Failure(click.ClickException):
    """A failure, in one line."""

    def show(self, file: IO[Any] | None = None) -> None:
        from hframe_post.cli.parameters import coloured

        click.echo(coloured(f"Error: {self.format_message()}"), err=True)


class _Commands(click.Group):
    """The commands. Each is imported when it is called, since slicers wait for the tool."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module = import_module(f"hframe_post.cli.{COMMANDS[name]}")
        command: click.Command = getattr(module, name.replace("-", "_"))
        return command

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, COMMANDS))
        for group, commands in GROUPS.items():
            with formatter.section(click.style(group, bold=True)):
                for name, (_, text) in commands.items():
                    formatter.write(f"  {name:{width}s}  {text}\n")

    def format_options(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        self.format_commands(context, formatter)  # --version and --help say nothing new

    def parse_args(self, context: click.Context, args: list[str]) -> list[str]:
        """Treat an unknown command as an argument of ``convert``, unless it looks mistyped."""
        if args and args[0] not in COMMANDS and args[0] not in ("-h", "--help", "--version"):
            if _looks_like_a_command(args[0]):
                if args[0] in GONE:
                    raise click.UsageError(f"{args[0]!r} is gone: {GONE[args[0]]}", context)
                from difflib import get_close_matches

                similar = get_close_matches(args[0].lower(), COMMANDS, n=1, cutoff=0.6)
                advice = f"did you mean 'hframe-post {similar[0]}'?" if similar else "see --help"
                raise click.UsageError(
                    f"{args[0]!r} is neither a command nor a file; {advice}", context
                )
            args = ["convert", *args]
        return super().parse_args(context, args)

    def invoke(self, context: click.Context) -> Any:
        """Turn every failure into one line, its status and, if asked for, a summary as JSON."""
        try:
            return super().invoke(context)
        except (click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except Exception as error:
            from hframe_post.cli.parameters import SUMMARY  # imported by the command by now
            from hframe_post.printer.choice import CHOICE

            failure = _naming_the_file(error, context.meta.get(CHOICE))
            shown = _shown(failure)
            if summary := context.meta.get(SUMMARY):
                summary.fail(shown.exit_code, shown.format_message(), failure)
            raise shown from None


def _shown(failure: Exception) -> click.ClickException:
    """Return what the command line shows of a failure."""
    if not isinstance(failure, click.ClickException):
        return _Failure(_text(failure))
    if not isinstance(failure, click.UsageError) or failure.ctx is None:
        return failure
    option = failure.option_name if isinstance(failure, click.NoSuchOption) else ""
    if isinstance(failure, click.BadParameter) and failure.param is not None:
        value = re.match(r"'([\w-]+)' is not", failure.message)
        option = f"{failure.param.opts[-1]} {value[1]}" if value else ""
    if advice := GONE.get(f"{failure.ctx.info_name} {option}"):
        return click.UsageError(f"{option} is gone: {advice}", failure.ctx)
    return failure


def _naming_the_file(error: Exception, choice: Choice | None) -> Exception:
    """Return the error of a profile with its file instead of its name."""
    if isinstance(error, PrinterError) and choice and error.source == Path(choice.profile).stem:
        return PrinterError(error.cause, error.key, choice.profile)
    return error


def _text(error: Exception) -> str:
    if isinstance(error, HframeError):
        return str(error)
    if isinstance(error, OSError):
        return _cause(error)
    if isinstance(error, MemoryError):
        return "there is not enough memory; nothing was written"
    return _bug_report(error)  # our mistake, not the user's


def _looks_like_a_command(word: str) -> bool:
    return re.fullmatch(r"[A-Za-z][A-Za-z-]*", word) is not None and not Path(word).exists()


def _cause(error: OSError) -> str:
    """Return what is wrong with a file, and with its folder if that is the cause."""
    if not error.filename:
        return error.strerror or str(error)
    from hframe_post.writers.outputs import FULL

    path = Path(os.fsdecode(error.filename))
    cause = error.strerror or str(error)
    if isinstance(error, FileNotFoundError) and not path.parent.exists():
        cause = f"the folder {path.parent} does not exist"
    elif isinstance(error, IsADirectoryError):
        cause = "is a folder; name a file in it"
    elif error.errno in FULL:
        cause += "; make room there, or write to another folder"
    return f"{path}: {cause}"


@click.group(
    cls=_Commands,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="hframe-post")
def main() -> None:
    """Rewrite sliced G-code so that the printer does not ring, and an H-bot does not rack.

    \b
    hframe-post in.gcode -o out.gcode     convert a file
    hframe-post in.gcode                  convert it in place, as slicers need it
    hframe-post COMMAND --help            show a command's options and an example
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
    except OSError as error:  # while click wrote to standard output
        status = _fail(error.strerror or str(error))
    except Exception as error:
        status = _fail(_text(error))
    failure = process.flush_streams()
    if failure is not None and status == 0:
        status = 1 if isinstance(failure, BrokenPipeError) else _fail(str(failure))
    sys.exit(status)


def _fail(message: str) -> int:
    with contextlib.suppress(OSError):
        click.echo(f"Error: {message}", err=True)
    return 1


def _bug_report(error: Exception) -> str:
    import traceback

    frames = traceback.extract_tb(error.__traceback__)[-3:]
    places = ", ".join(f"{os.path.basename(f.filename)}:{f.lineno}" for f in reversed(frames))
    message = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return f"this is a bug in hframe-post, please report it: {message} ({places})"
