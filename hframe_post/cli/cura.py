"""``hframe-post cura-script``: a script for Cura, which cannot run post-processing programs."""

from __future__ import annotations

import re
import sys
from importlib import resources
from pathlib import Path

import click
from platformdirs import user_data_path

from hframe_post.errors import HframeError
from hframe_post.printer.profile import load, shipped
from hframe_post.process import own_command
from hframe_post.writers.files import Outputs

NAME = "HframePost"  # of the file and its class: Cura finds one by the other
MENU = 'Extensions, Post Processing, Modify G-Code, Add a script, "Compensate racking and ringing"'


@click.command("cura-script")
@click.option(
    "-p", "--printer", default="", metavar="NAME|FILE",
    help="Profile that the script uses. Default: the one set with 'hframe-post use'.",
)  # fmt: skip
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Cura's scripts folder, if it is not found: see Help, Show Configuration Folder in Cura.",
)  # fmt: skip
def cura_script(printer: str, folder: Path | None) -> None:
    """Install a post-processing script into every version of Cura.

    Then, in Cura: Extensions, Post Processing, Modify G-Code, Add a script, "Compensate racking
    and ringing". Run this command again after updating Cura or hframe-post.

    \b
    Example:
      hframe-post cura-script -p my.toml
    """
    if printer:
        load(printer)  # raises before anything is written
        printer = printer if printer in shipped() else str(Path(printer).absolute())
    folders = [folder] if folder is not None else script_folders()
    if not folders:
        raise HframeError(
            "no configuration folder of Cura found: start Cura once, or name its scripts folder "
            "with --folder"
        )
    text = script(program(), printer).encode()
    with Outputs() as outputs:
        for each in folders:
            each.mkdir(exist_ok=True)
            outputs.open(each / f"{NAME}.py").write(text)
    for each in folders:
        click.echo(each / f"{NAME}.py")
    click.echo(f"Restart Cura, then: {MENU}")


def script_folders() -> list[Path]:
    """Return the scripts folder, which may not exist yet, of each Cura version that has run."""
    roots = [
        user_data_path("cura", appauthor=False, roaming=True),
        Path.home() / ".var/app/com.ultimaker.cura/data/cura",  # Flatpak
    ]
    return [
        version / "scripts"
        for root in dict.fromkeys(roots)
        if root.is_dir()
        for version in sorted(root.iterdir())
        if re.fullmatch(r"\d+\.\d+", version.name) and version.is_dir()
    ]


def program() -> str:
    """Return how another process runs this tool: a path, or a command with quotes."""
    for name in ("hframe-post", "hframe-post.exe"):
        if (installed := Path(sys.executable).parent / name).is_file():
            return str(installed)
    python, *rest = own_command()
    return " ".join((f'"{python}"', *rest)) if rest else python


def script(program: str, printer: str) -> str:
    """Return the script's text with this program and default profile."""
    text = (resources.files(__package__) / f"{NAME}.py.in").read_text("utf-8")
    return text.replace("@PROGRAM@", repr(program)).replace("@PROFILE@", repr(printer))
