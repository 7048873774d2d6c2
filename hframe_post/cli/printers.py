"""``hframe-post printers``: the shipped profiles, and new ones."""

from __future__ import annotations

import click

from hframe_post.cli.new_printer import new


@click.group(invoke_without_command=True)
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
