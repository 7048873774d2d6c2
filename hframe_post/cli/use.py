"""``hframe-post use``: the profile of those who do not ask for one."""

from __future__ import annotations

import os
from pathlib import Path

import click


@click.command()
@click.argument("profile", required=False, metavar="[NAME|FILE]")
@click.option("--forget", is_flag=True, help="Back to no choice of your own.")
def use(profile: str | None, forget: bool) -> None:
    """Choose the profile that is used where none is asked for, or show which that is.

    It is checked, and its place noted in the platform's configuration folder. -p, the notes
    of the slicer's printer (HFRAME_PRINTER=my.toml in PrusaSlicer and its kin) and the variable
    HFRAME_PRINTER go before it.

    \b
    Example:
      hframe-post use my.toml
    """
    from hframe_post.printer.choice import choose, config_file
    from hframe_post.printer.profile import load, shipped

    if forget and profile is not None:
        raise click.UsageError("--forget takes no profile")
    if forget:
        config_file().unlink(missing_ok=True)
    if profile is not None:
        load(profile)  # whole and sound, or nothing is noted
        _note(config_file(), profile if profile in shipped() else os.path.abspath(profile))
    chosen = choose(None, os.environ)
    click.echo(f"{chosen.as_text()}\nnoted in    {config_file()}")


def _note(config: Path, profile: str) -> None:
    import tomlkit

    from hframe_post.writers.files.atomic_file import Outputs

    document = tomlkit.document()
    document["printer"] = profile
    config.parent.mkdir(parents=True, exist_ok=True)
    with Outputs() as outputs:
        outputs.open(config).write(tomlkit.dumps(document).encode())
