"""``hframe-post doctor``: is all there that a conversion needs, and does the printer agree?"""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from importlib import metadata
from pathlib import Path

import click

from hframe_post.cli.options import chosen_printer, printer_option
from hframe_post.version import __version__

PACKAGES = ("click", "numpy", "scipy", "ruckig", "tomlkit", "threadpoolctl", "platformdirs")
EXTRAS = ("matplotlib", "pyarrow", "zstandard", "watchfiles", "distributed")


class _Told:
    """Lines as they are found, and how many of them are wrong."""

    def __init__(self) -> None:
        self.wrong = 0

    def ok(self, text: str) -> None:
        click.echo(f"ok     {text}")

    def note(self, text: str) -> None:
        click.echo(f"note   {text}")

    def bad(self, text: str) -> None:
        self.wrong += 1
        click.echo(f"WRONG  {text}")


@click.command()
@printer_option
@click.option(
    "--printer-cfg", "config", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE", help="Klipper's printer.cfg, to be checked against the profile.",
)  # fmt: skip
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), default=Path(),
    help="Where converted files are to be written. Default: here.",
)  # fmt: skip
@click.pass_context
def doctor(context: click.Context, printer: str, config: Path | None, folder: Path) -> None:
    """Check installation, profile, permission to write, and Klipper's printer.cfg.

    Exit status 0: all is well; 1: something is WRONG. The output belongs in a bug report.

    \b
    Example:
      hframe-post doctor -p my.toml --printer-cfg printer.cfg
    """
    told = _Told()
    _installation(told)
    _writable(told, folder)
    _profile(told, printer, config)
    click.echo("all is well" if not told.wrong else f"{told.wrong} wrong")
    context.exit(1 if told.wrong else 0)


def _installation(told: _Told) -> None:
    told.ok(
        f"hframe-post {__version__}, Python {platform.python_version()}, {platform.platform()}, "
        f"{os.cpu_count()} processors"
    )
    told.ok(f"runs from {Path(__file__).parents[1]} with {sys.executable}")
    found = {name: _version(name) for name in (*PACKAGES, *EXTRAS)}
    told.ok(", ".join(f"{name} {version}" for name, version in found.items() if version))
    for name in PACKAGES:
        if not found[name]:
            told.bad(f"the package {name} is missing: install hframe-post again")
    if absent := [name for name in EXTRAS if not found[name]]:
        names = ", ".join(absent)
        told.note(f"not installed; figures, some formats, --watch and --scheduler need: {names}")


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _writable(told: _Told, folder: Path) -> None:
    for place in (folder.resolve(), Path(tempfile.gettempdir())):
        try:
            with tempfile.TemporaryFile(dir=place):
                told.ok(f"{place} can be written")
        except OSError as error:
            told.bad(f"{place} cannot be written: {error.strerror or error}")


def _profile(told: _Told, printer: str, config: Path | None) -> None:
    """The profile whole and its compensator certified; then printer.cfg, and a conversion."""
    from hframe_post.conversion.pipeline import prepared
    from hframe_post.errors import HframeError
    from hframe_post.printer.klipper_cfg import KlipperConfig, check
    from hframe_post.printer.profile import load, shipped

    chosen = chosen_printer()
    try:
        profile = load(printer)
        prepared(profile)
    except HframeError as error:
        told.bad(str(error))
        if "unknown key" in str(error):
            told.note(
                f"hframe-post {__version__} does not know that key: if a newer one wrote the "
                "profile, install that; if an older one did, CHANGELOG.md says what became of it"
            )
        return
    told.ok(f"profile {printer} ({chosen.why}): {profile.description or 'no description'}")
    if profile.invented:
        told.note(
            "its plant is not measured, so nothing is compensated until 'hframe-post identify' "
            "has written yours: docs/identify.md"
        )
    if printer in shipped():
        told.note(
            f"{printer} comes with hframe-post and is not your printer: "
            "'hframe-post printers new', then docs/identify.md"
        )
    if config is None:
        told.note("printer.cfg was not checked: give it with --printer-cfg")
        return
    try:
        findings = list(check(KlipperConfig(config), profile))
    except HframeError as error:
        told.bad(str(error))
        return
    for finding in findings:
        (told.bad if finding.wrong else told.note)(finding.text)
    if not any(finding.wrong for finding in findings):
        told.ok(f"{config} agrees with the profile")
