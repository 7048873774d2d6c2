"""``hframe-post slicer-line``: what to paste into a slicer to run this installation."""

from __future__ import annotations

import subprocess  # nosec B404  only its quoting is used
import sys
from collections.abc import Sequence

import click

from hframe_post.cli.integrations import MENU, anywhere, program, program_words
from hframe_post.cli.options import quoted, say
from hframe_post.printer.profile import load


@click.command("slicer-line")
@click.option(
    "-p", "--printer", default="", metavar="NAME|FILE",
    help="Profile that the line names. Default: none, see 'hframe-post use'.",
)  # fmt: skip
def slicer_line(printer: str) -> None:
    """Print the line to paste into a slicer's post-processing scripts.

    It names this installation by its full path, with the quotes that this system needs. Standard
    output is the line alone; where it belongs is on standard error.

    \b
    Example:
      hframe-post slicer-line -p my.toml
    """
    words = program_words()
    if printer:
        load(printer)  # raises before a wrong line is printed
        words = [*words, "-p", anywhere(printer)]
    click.echo(line(words, windows=sys.platform == "win32"))
    say("PrusaSlicer, SuperSlicer: Print Settings, Output options, Post-processing scripts")
    say("OrcaSlicer: Process, Others, Post-processing scripts")
    say(f"Cura: 'hframe-post cura-script' installs a script. {MENU}. Its field Program:")
    say(program())


def line(words: Sequence[str], windows: bool) -> str:
    """Return words as a slicer takes them: for a shell, or for Windows, where there is none."""
    return subprocess.list2cmdline(words) if windows else " ".join(quoted(word) for word in words)
