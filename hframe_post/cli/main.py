"""The command line: the only place that opens files, prints and exits."""

from __future__ import annotations

from typing import Any

import click

from hframe_post.cli.batch.command import batch
from hframe_post.cli.calibrate import calibrate_marlin
from hframe_post.cli.compare import compare
from hframe_post.cli.convert import convert
from hframe_post.cli.cura import cura_script
from hframe_post.cli.doctor import doctor
from hframe_post.cli.identify import identify
from hframe_post.cli.klipper_macros import klipper_macros
from hframe_post.cli.new_printer import new
from hframe_post.cli.paper import paper
from hframe_post.cli.simulate import simulate
from hframe_post.cli.sweep import sweep
from hframe_post.cli.tune import tune
from hframe_post.cli.use import use
from hframe_post.cli.verify import verify
from hframe_post.version import __version__


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


main.add_command(convert)
main.add_command(batch)
main.add_command(compare)
main.add_command(simulate)
main.add_command(paper)
main.add_command(sweep)
main.add_command(tune)
main.add_command(calibrate_marlin)
main.add_command(klipper_macros)
main.add_command(identify)
main.add_command(verify)
main.add_command(use)
main.add_command(cura_script)
main.add_command(doctor)


@main.group(invoke_without_command=True)
@click.pass_context
def printers(context: click.Context) -> None:
    """List the shipped printer profiles.

    \b
    Example:
      hframe-post printers
    """
    from hframe_post.printer.profile import load, shipped

    if context.invoked_subcommand is None:
        for name in shipped():
            profile = load(name)
            mark = " [invented plant]" if profile.invented else ""
            click.echo(f"{name:18s}{profile.description}{mark}")


@printers.command()
@click.argument("name")
def show(name: str) -> None:
    """Print a profile as TOML, to start one's own from.

    \b
    Example:
      hframe-post printers show paper
    """
    from hframe_post.errors import PrinterError
    from hframe_post.printer.profile import shipped

    profiles = shipped()
    if name not in profiles:
        raise PrinterError(f"no such profile; shipped are: {', '.join(profiles)}", source=name)
    click.echo(profiles[name], nl=False)


printers.add_command(new)
