"""``hframe-post doctor``: check the installation, a profile and printer.cfg."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import click

from hframe_post.cli.parameters import coloured, quoted
from hframe_post.conversion.pipeline import prepared
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import firmware, source_of
from hframe_post.printer.choice import PROFILE, VARIABLE, Choice, choose, config_file
from hframe_post.printer.firmware_tables import MACROS
from hframe_post.printer.profile import load, shipped
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__

PACKAGES = (
    "click",
    "numpy",
    "scipy",
    "ruckig",
    "tomlkit",
    "threadpoolctl",
    "platformdirs",
    "zstandard",
)


STALE_DAYS = 90  # days, from which a model is to be checked


class _Findings:
    """Prints findings and keeps them, with their labels. unchecked: a file that was not given."""

    def __init__(self, unchecked: str) -> None:
        self.all, self.unchecked = list[tuple[str, str]](), unchecked

    @property
    def problems(self) -> int:
        return sum(label == "PROBLEM" for label, _ in self.all)

    def ok(self, text: str) -> None:
        self._add("ok", text)

    def note(self, text: str) -> None:
        self._add("note", text)

    def problem(self, text: str) -> None:
        self._add("PROBLEM", text)

    def _add(self, label: str, text: str) -> None:
        self.all.append((label, text))
        click.echo(coloured(f"{label:9s}{text}"))


@click.command()
@click.option(
    "-p", "--printer", "requested", metavar="NAME|FILE",
    help="Printer profile. Default: the one that a command without -p takes.",
)  # fmt: skip
@click.option(
    "--printer-cfg", "config", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE", help="Compare Klipper's printer.cfg, with its includes and macros, or Marlin's "
    "answers to M503, with the profile.",
)  # fmt: skip
@click.pass_context
def doctor(
    context: click.Context,
    requested: str | None,
    config: Path | None,
) -> None:
    """Check the installation, the profile, printer.cfg, and which profile is the default.

    Exit status: 0 if there are no problems, 1 if there are. Please add the output to bug reports.

    \b
    Example:
      hframe-post doctor -p my.toml --printer-cfg printer.cfg
    """
    findings = _Findings("printer.cfg" if config is None else "")
    _check_installation(findings)
    _check_folders(findings)
    try:
        choice = choose(requested, os.environ)
    except HframeError as error:
        (findings.note if config is None else findings.problem)(str(error))
    else:
        _check_profile(findings, choice, config)
    n = findings.problems
    unchecked = f", but {findings.unchecked} was not checked" if findings.unchecked else ""
    click.echo(f"{n} problem{'s' * (n > 1)}" if n else f"no problems found{unchecked}")
    context.exit(1 if n else 0)


def _check_installation(findings: _Findings) -> None:
    findings.ok(
        f"hframe-post {__version__}, Python {platform.python_version()}, {platform.platform()}, "
        f"{os.cpu_count()} processors"
    )
    findings.ok(f"installed in {Path(__file__).parents[1]}, runs with {sys.executable}")
    found = {name: _version(name) for name in PACKAGES}
    findings.ok(", ".join(f"{name} {version}" for name, version in found.items() if version))
    for name in PACKAGES:
        if not found[name]:
            findings.problem(f"the package {name} is missing: install hframe-post again")


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _check_folders(findings: _Findings) -> None:
    for place in (Path.cwd(), Path(tempfile.gettempdir())):
        try:
            with tempfile.TemporaryFile(dir=place):
                findings.ok(f"files can be written in {place}")
        except OSError as error:
            findings.problem(f"files cannot be written in {place}: {error.strerror or error}")


def _check_profile(findings: _Findings, choice: Choice, config: Path | None) -> None:
    """Check a profile and what goes with it."""
    printer, profile = choice.profile, _loaded(findings, choice.profile)
    if profile is None:
        return
    findings.ok(f"profile {printer} ({choice.why}): {profile.description or 'no description'}")
    if profile.invented:
        findings.note(
            "its resonances are not measured, so nothing is compensated: run 'hframe-post measure' "
            "or, without an accelerometer, 'hframe-post calibrate-print' (docs/start.md)"
        )
    own = firmware(profile)
    if config is None:
        findings.unchecked = own.configuration
    if printer in shipped():
        tell = findings.note if config is None else findings.problem
        source = quoted(config or own.configuration)
        tell(
            f"{printer} comes with hframe-post and is not your printer: run 'hframe-post setup "
            f"{source}'"
        )
        return
    _check_age(findings, Path(printer), profile)
    _check_default(findings, printer)
    if stopped := own.code().when_stopped:
        findings.note(f"after a print that was stopped midway, send {stopped}")
    if config is None:
        findings.note(f"{own.configuration} was not checked: name it with --printer-cfg")
    else:
        _check_config(findings, config, profile, printer)


def _loaded(findings: _Findings, name: str) -> Printer | None:
    """Return a profile that can be used; None: it was said why not."""
    try:
        profile = load(name)
        prepared(profile)  # raises where the compensation would be unstable
    except HframeError as error:
        findings.problem(str(error))
        if "unknown key" in str(error):
            findings.note(
                f"hframe-post {__version__} does not know that key. If a newer version wrote the "
                "profile, install that version; if an older one did, see CHANGELOG.md"
            )
        return None
    return profile


def _check_config(findings: _Findings, path: Path, profile: Printer, name: str) -> None:
    """Compare printer.cfg with a profile of this name."""
    try:
        source = source_of([path])
        differences = list(source.findings(profile, *_remedies(path, name)))
    except HframeError as error:
        findings.problem(str(error))
        return
    findings.unchecked = source.missing
    for difference in differences:
        (findings.problem if difference.wrong else findings.note)(difference.text)
    if not any(difference.wrong for difference in differences):
        findings.ok(f"{path} agrees with the profile")


def _check_age(findings: _Findings, path: Path, profile: Printer) -> None:
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC).date()
    days = (datetime.now(UTC).date() - (profile.measured or written)).days
    if not profile.invented and days > STALE_DAYS:
        how = "measured" if profile.measured else "written"
        again = "Measure it again"
        if profile.firmware.kind.records:
            again = "Run 'hframe-post check', or record and identify again"
        findings.note(
            f"{path} was {how} {days} days ago, and printers change: a resonance of one moved from "
            f"52 to 85 Hz within a year. {again}"
        )


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


def _check_default(findings: _Findings, printer: str) -> None:
    """Report which profile a slicer's line without -p takes, where it is not the checked one."""
    try:
        default = choose(None, os.environ)
    except HframeError as error:
        tell = findings.problem if config_file().exists() else findings.note
        tell(f"a command without -p, such as the one in a slicer, fails: {error}")
        return
    if not _same(default.profile, printer):
        command = f"hframe-post setup {quoted(printer)}"
        if os.environ.get(VARIABLE):  # counts more than the default
            command = f"unset {VARIABLE}"
        findings.problem(
            f"a command without -p, such as the one in a slicer, takes {default.profile} "
            f"({default.why}), not {printer}: run '{command}', or write "
            f"{VARIABLE}={Path(printer).absolute()} into the notes of the slicer's printer"
        )


def _same(one: str, other: str) -> bool:
    return Path(one).resolve() == Path(other).resolve()
