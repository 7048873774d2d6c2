"""``hframe-post printers`` and ``use``: show and choose profiles."""

from __future__ import annotations

import os

import click

from hframe_post.errors import PrinterError
from hframe_post.printer.choice import choose, config_file, set_default
from hframe_post.printer.profile import load, shipped


@click.group(invoke_without_command=True)
@click.pass_context
def printers(context: click.Context) -> None:
    """List the printer profiles that come with hframe-post.

    \b
    Example:
      hframe-post printers
    """
    if context.invoked_subcommand is None:
        for name in shipped():
            profile = load(name)
            mark = " [example: not measured on a printer]" if profile.invented else ""
            click.echo(f"{name:18s}{profile.description}{mark}")


@printers.command()
@click.argument("name")
def show(name: str) -> None:
    """Print one of these profiles, as TOML with comments.

    \b
    Example:
      hframe-post printers show paper
    """
    profiles = shipped()
    if name not in profiles:
        raise PrinterError(f"no such profile; there are: {', '.join(profiles)}", source=name)
    click.echo(profiles[name], nl=False)


@click.command()
@click.argument("profile", required=False, metavar="[NAME|FILE]")
@click.option("--forget", is_flag=True, help="Remove your choice.")
def use(profile: str | None, forget: bool) -> None:
    """Set the default profile, or show which profile is the default.

    A file is not copied: its place is remembered. Three settings override the default: -p, a line
    HFRAME_PRINTER=my.toml in the printer notes of PrusaSlicer or OrcaSlicer, and the environment
    variable HFRAME_PRINTER.

    \b
    Example:
      hframe-post use my.toml
    """
    if forget and profile is not None:
        raise click.UsageError("--forget takes no profile")
    if forget:
        config_file().unlink(missing_ok=True)
        click.echo("no profile is the default now")
        return
    if profile is not None:
        load(profile)  # raises before anything is written
        set_default(profile if profile in shipped() else os.path.abspath(profile))
    click.echo(f"{choose(None, os.environ).as_text()}\nsetting     {config_file()}")
