"""``hframe-post doctor``: check the installation, a profile and printer.cfg."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from itertools import chain
from pathlib import Path

import click

from hframe_post.cli.parameters import READ, coloured, quoted
from hframe_post.conversion.pipeline import prepared
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import firmware, source_of
from hframe_post.printer.choice import PROFILE, VARIABLE, choose, config_file
from hframe_post.printer.firmware_tables import MACROS
from hframe_post.printer.profile import check_identified, load, shipped
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__

PACKAGES = (
    "click", "numpy", "scipy", "ruckig", "tomlkit", "threadpoolctl", "platformdirs", "zstandard",
)  # fmt: skip
OK, NOTE, PROBLEM = "ok", "note", "PROBLEM"
UNCHECKED = ""  # label of a file that was not given; it is not printed

Findings = Iterator[tuple[str, str]]  # labels and texts


@click.command()
@click.option(
    "-p", "--printer", "requested", metavar="NAME|FILE",
    help="Printer profile. Default: the one that a command without -p takes.",
)  # fmt: skip
@click.option(
    "--printer-cfg", "config", type=READ, metavar="FILE",
    help="Compare Klipper's printer.cfg, with its includes and macros, or Marlin's answers to "
    "M503, with the profile.",
)  # fmt: skip
@click.pass_context
def doctor(context: click.Context, requested: str | None, config: Path | None) -> None:
    """Check the installation, the profile, printer.cfg, and which profile is the default.

    Exit status: 0 if there are no problems, 1 if there are. Please add the output to bug reports.

    \b
    Example:
      hframe-post doctor -p my.toml --printer-cfg printer.cfg
    """
    n, unchecked = 0, "printer.cfg" if config is None else ""
    for label, text in chain(_installation(), _profile(requested, config)):
        if label is UNCHECKED:
            unchecked = text
        else:
            click.echo(coloured(f"{label:9s}{text}"))
        n += label is PROBLEM
    but = f", but {unchecked} was not checked" if unchecked else ""
    click.echo(f"{n} problem{'s' * (n > 1)}" if n else f"no problems found{but}")
    context.exit(1 if n else 0)


def _installation() -> Findings:
    text = (
        f"hframe-post {__version__}, Python {platform.python_version()}, {platform.platform()}, "
        f"{os.cpu_count()} processors"
    )
    yield OK, text
    yield OK, f"installed in {Path(__file__).parents[1]}, runs with {sys.executable}"
    yield OK, ", ".join(f"{name} {metadata.version(name)}" for name in PACKAGES)


def _profile(requested: str | None, config: Path | None) -> Findings:
    """Check a profile and what goes with it."""
    try:
        choice = choose(requested, os.environ)
    except HframeError as error:
        yield NOTE if config is None else PROBLEM, str(error)
        return
    name = choice.profile
    try:
        profile = load(name)
        prepared(profile)  # raises where the compensation would be unstable
    except HframeError as error:
        yield PROBLEM, str(error)
        if "unknown key" in str(error):
            text = (
                f"hframe-post {__version__} does not know that key. If a newer version wrote the "
                "profile, install that version; if an older one did, see CHANGELOG.md"
            )
            yield NOTE, text
        return
    yield OK, f"profile {name} ({choice.why}): {profile.description or 'no description'}"
    try:
        check_identified(profile)
    except HframeError as error:
        yield NOTE, str(error)
    yield from _printer(profile, name, config)


def _printer(profile: Printer, name: str, config: Path | None) -> Findings:
    """Check whether a valid profile is that of the printer, and the default."""
    own = firmware(profile)
    if config is None:
        yield UNCHECKED, own.configuration
    if name in shipped():
        command = f"run 'hframe-post setup {quoted(config or own.configuration)}'"
        text = f"{name} comes with hframe-post and is not your printer: {command}"
        yield NOTE if config is None else PROBLEM, text
        return
    yield from _age(Path(name), profile)
    yield from _default(name)
    if stopped := own.code().when_stopped:
        yield NOTE, f"after a print that was stopped midway, send {stopped}"
    if config is None:
        yield NOTE, f"{own.configuration} was not checked: name it with --printer-cfg"
    else:
        yield from _compared(config, profile, name)


def _compared(path: Path, profile: Printer, name: str) -> Findings:
    """Compare printer.cfg with a profile of this name."""
    try:
        source = source_of([path])
        differences = list(source.findings(profile, *_remedies(path, name)))
    except HframeError as error:
        yield PROBLEM, str(error)
        return
    yield UNCHECKED, source.missing
    for difference in differences:
        yield PROBLEM if difference.wrong else NOTE, difference.text
    if not any(difference.wrong for difference in differences):
        yield OK, f"{path} agrees with the profile"


def _age(path: Path, profile: Printer) -> Findings:
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC).date()
    days = (datetime.now(UTC).date() - (profile.measured or written)).days
    if not profile.invented and days > 90:
        how = "measured" if profile.measured else "written"
        again = "Measure it again"
        if profile.firmware.kind.records:
            again = "Run 'hframe-post check', or record and identify again"
        text = (
            f"{path} was {how} {days} days ago, and printers change: a resonance of one moved from "
            f"52 to 85 Hz within a year. {again}"
        )
        yield NOTE, text


def _remedies(config: Path, name: str) -> tuple[str, str]:
    """Return what to do where a profile differs, and how what it gives is written again."""
    path = Path(name)
    remedy = f"change it there or in {name}"
    again = f"run 'hframe-post connect klipper -p {quoted(name)} > {MACROS}'"
    if path.name == PROFILE:
        here = path.absolute().parent == Path.cwd()
        folder = "" if here else f" -o {quoted(path.parent)}"
        again = f"run 'hframe-post setup {quoted(config)}{folder}' again"
        reset = f"hframe-post setup {quoted(config)}{folder} --reset"
        remedy += f", or overwrite the profile with '{reset}'"
    return remedy, again


def _default(printer: str) -> Findings:
    """Report which profile a slicer's line without -p takes, where it is not the checked one."""
    try:
        default = choose(None, os.environ)
    except HframeError as error:
        tell = PROBLEM if config_file().exists() else NOTE
        yield tell, f"a command without -p, such as the one in a slicer, fails: {error}"
        return
    if Path(default.profile).resolve() == Path(printer).resolve():
        return
    command = f"hframe-post setup {quoted(printer)}"
    if os.environ.get(VARIABLE):  # counts more than the default
        command = f"unset {VARIABLE}"
    text = (
        f"a command without -p, such as the one in a slicer, takes {default.profile} "
        f"({default.why}), not {printer}: run '{command}', or write "
        f"{VARIABLE}={Path(printer).absolute()} into the notes of the slicer's printer"
    )
    yield PROBLEM, text
