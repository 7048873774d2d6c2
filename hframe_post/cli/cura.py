"""``hframe-post cura-script``: a post-processing script for Cura, which runs no programs."""

from __future__ import annotations

import re
import sys
from importlib import resources
from pathlib import Path

import click

from hframe_post.process import own_command

NAME = "HframePost"  # of the file and of the class in it: Cura finds one by the other
_VERSION = re.compile(r"\d+\.\d+")


@click.command("cura-script")
@click.option(
    "-p", "--printer", default="", metavar="NAME|FILE",
    help="Profile that the script starts with. Default: the one chosen with 'hframe-post use'.",
)  # fmt: skip
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Cura's scripts folder, where it is not found. In Cura: Help, Show Configuration Folder.",
)  # fmt: skip
def cura_script(printer: str, folder: Path | None) -> None:
    """Install a post-processing script into Cura, into every version found.

    Then, in Cura: Extensions, Post Processing, Modify G-Code, Add a script, "Compensate racking
    and ringing". Run this again after an update of Cura or of hframe-post.

    \b
    Example:
      hframe-post cura-script -p my.toml
    """
    from hframe_post.errors import HframeError
    from hframe_post.printer.profile import load, shipped
    from hframe_post.writers.files.atomic_file import Outputs

    if printer:
        load(printer)  # whole and sound, before Cura gets to know it
        printer = printer if printer in shipped() else str(Path(printer).absolute())
    folders = [folder] if folder is not None else script_folders()
    if not folders:
        raise HframeError(
            "no configuration of Cura is found; start Cura once, or name its folder of scripts "
            "with --folder"
        )
    text = script(program(), printer).encode()
    with Outputs() as outputs:
        for each in folders:
            each.mkdir(exist_ok=True)
            outputs.open(each / f"{NAME}.py").write(text)
    for each in folders:
        click.echo(each / f"{NAME}.py")
    click.echo("restart Cura; then Extensions, Post Processing, Modify G-Code, Add a script")


def script_folders() -> list[Path]:
    """The folder for scripts of each version of Cura that has run here, there or not."""
    from platformdirs import user_data_path

    roots = [
        user_data_path("cura", appauthor=False, roaming=True),
        Path.home() / ".var/app/com.ultimaker.cura/data/cura",  # Flatpak
    ]
    return [
        version / "scripts"
        for root in dict.fromkeys(roots)
        if root.is_dir()
        for version in sorted(root.iterdir())
        if _VERSION.fullmatch(version.name) and version.is_dir()
    ]


def program() -> str:
    """How another process runs this tool: one word, or a command with quotes."""
    for name in ("hframe-post", "hframe-post.exe"):
        if (own := Path(sys.executable).parent / name).is_file():
            return str(own)
    python, *rest = own_command()
    return " ".join((f'"{python}"', *rest)) if rest else python


def script(program: str, printer: str) -> str:
    """The script's text, with what its settings start with."""
    text = (resources.files(__package__) / f"{NAME}.py.in").read_text("utf-8")
    return text.replace("@PROGRAM@", repr(program)).replace("@PROFILE@", repr(printer))
