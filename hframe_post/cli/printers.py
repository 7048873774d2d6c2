"""``hframe-post printers`` and ``use``: show, create and choose profiles."""

from __future__ import annotations

import os
from pathlib import Path

import click

from hframe_post.cli.options import number, old_option
from hframe_post.errors import HframeError, PrinterError
from hframe_post.model.kinematics import ROWS
from hframe_post.printer.choice import choose, config_file, set_default
from hframe_post.printer.edit import BASES, Known, from_klipper, text
from hframe_post.printer.klipper_cfg import KlipperConfig
from hframe_post.printer.profile import load, parse, shipped
from hframe_post.writers.files import Outputs


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


@printers.command()
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="PROFILE.TOML", help="The profile to write. An existing file is not replaced.",
)  # fmt: skip
@click.option(
    "--printer-cfg", "config", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE", help="Klipper's printer.cfg: its values are used and no questions are asked.",
)  # fmt: skip
@click.option(
    "--kinematics", type=click.Choice(tuple(ROWS)),
    help="How belts move the nozzle. Default: as in printer.cfg, where corexy is taken for hbot "
    "(Klipper calls both corexy).",
)  # fmt: skip
@old_option("--description", "change the first lines of the profile")
def new(output: Path, config: Path | None, kinematics: str | None, description: str | None) -> None:
    """Create a profile from Klipper's printer.cfg, or from answers to a few questions.

    The new profile compensates nothing until you have measured the printer (docs/identify.md).

    \b
    Example:
      hframe-post printers new -o my.toml --printer-cfg printer.cfg
    """
    if output.exists():
        raise HframeError(f"{output} exists already: choose another name")
    if config is not None:
        known = from_klipper(KlipperConfig(config), description or output.stem, kinematics)
    else:
        known = _ask(kinematics, description, output.stem)
    written = text(known)
    parse(written, output.stem, str(output))  # raises before anything is written
    with Outputs() as outputs:
        outputs.open(output).write(written.encode())
    click.echo(
        f"{output}: written. Next: 'hframe-post use {output}', then measure the printer "
        "(docs/identify.md)."
    )


def _ask(kinematics: str | None, description: str | None, name: str) -> Known:
    def asked(question: str, default: float) -> float:
        return float(click.prompt(question, default=f"{default:g}", value_proc=_positive))

    return Known(
        description or click.prompt("Name of the printer", default=name),
        kinematics or click.prompt(
            "Kinematics: hbot (one belt, H), corexy (two belts, crossed), hybrid-corexy, corexz "
            "or cartesian",
            type=click.Choice(list(BASES)), default="hbot", show_choices=False,
        ),
        click.prompt("x from, to (mm)", default="0,250", value_proc=_range),
        click.prompt("y from, to (mm)", default="0,250", value_proc=_range),
        asked("Maximum speed (mm/s; max_velocity)", 300.0),
        asked("Maximum acceleration (mm/s²; max_accel)", 3000.0),
        asked("Speed in a square corner (mm/s; square_corner_velocity)", 5.0),
        asked("Maximum speed of z (mm/s; max_z_velocity)", 15.0),
        asked("Maximum acceleration of z (mm/s²; max_z_accel)", 100.0),
        asked("Maximum speed of retractions (mm/s; max_extrude_only_velocity)", 60.0),
        asked("Maximum acceleration of retractions (mm/s²; max_extrude_only_accel)", 2000.0),
    )  # fmt: skip


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not two numbers such as 0,280") from None
    if not -1e4 <= low < high <= 1e4:
        raise click.BadParameter(f"{text!r}: the first must be the smaller, both within ±10000 mm")
    return low, high


def _positive(text: str) -> float:
    value = number(text)
    if not 0.0 < value < 1e6:
        raise click.BadParameter(f"{text!r} is not a number above 0")
    return value


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
    if profile is not None:
        load(profile)  # raises before anything is written
        set_default(profile if profile in shipped() else os.path.abspath(profile))
    click.echo(f"{choose(None, os.environ).as_text()}\nsetting     {config_file()}")
