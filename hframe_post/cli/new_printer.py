"""``hframe-post printers new``: a profile of one's own, from answers or printer.cfg."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hframe_post.cli.options import LazyChoice, kinds

if TYPE_CHECKING:
    from hframe_post.printer.new_profile import Known


def _range(text: str) -> tuple[float, float]:
    """``0,280``: two numbers."""
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not two numbers such as 0,280") from None
    if not -1e4 <= low < high <= 1e4:
        raise click.BadParameter(f"{text!r}: the first must be below the second, both on a bed")
    return low, high


def _positive(text: str) -> float:
    """A number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < 1e6:
        raise click.BadParameter(f"{text!r} is no number above 0")
    return value


@click.command("new")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="PROFILE.TOML", help="The profile to write; must not be there yet.",
)  # fmt: skip
@click.option(
    "--printer-cfg", "config", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    metavar="FILE", help="Klipper's printer.cfg, which answers all questions but one.",
)  # fmt: skip
@click.option(
    "--kinematics", type=LazyChoice(kinds),
    help="How belts and nozzle hang together. Of printer.cfg's corexy: hbot, if not given.",
)  # fmt: skip
@click.option("--description", help="A line about the printer.")
def new(output: Path, config: Path | None, kinematics: str | None, description: str | None) -> None:
    """Write a commented profile, from printer.cfg or from the answers to a few questions.

    Nothing is compensated with it until the printer has been measured.

    \b
    Example:
      hframe-post printers new -o my.toml --printer-cfg printer.cfg
    """
    from hframe_post.errors import HframeError
    from hframe_post.printer.klipper_cfg import KlipperConfig
    from hframe_post.printer.new_profile import from_klipper, text
    from hframe_post.printer.profile import parse
    from hframe_post.writers.files.atomic_file import Outputs

    if output.exists():
        raise HframeError(f"{output}: is there already; name another file")
    if config is not None:
        known = from_klipper(KlipperConfig(config), description or output.stem, kinematics)
    else:
        known = _asked(kinematics, description, output.stem)
    written = text(known)
    parse(written, output.stem, str(output))  # whole and sound, or nothing is written
    with Outputs() as outputs:
        outputs.open(output).write(written.encode())
    click.echo(
        f"{output}: written; next: 'hframe-post use {output}', then measure the printer "
        "(docs/identify.md)"
    )


def _asked(kinematics: str | None, description: str | None, name: str) -> Known:
    from hframe_post.printer.new_profile import BASES
    from hframe_post.printer.new_profile import Known as Answers

    def number(question: str, usual: float) -> float:
        return float(click.prompt(question, default=f"{usual:g}", value_proc=_positive))

    described = description or click.prompt("What is the printer called", default=name)
    kind = kinematics or click.prompt(
        "hbot (one belt, H), corexy (two belts, crossed), hybrid-corexy, corexz or cartesian",
        type=click.Choice(list(BASES)), default="hbot", show_choices=False,
    )  # fmt: skip
    x = click.prompt("x from, to (mm)", default="0,250", value_proc=_range)
    y = click.prompt("y from, to (mm)", default="0,250", value_proc=_range)
    return Answers(
        described, kind, x, y,
        number("Highest speed (mm/s; max_velocity)", 300.0),
        number("Highest acceleration (mm/s²; max_accel)", 3000.0),
        number("Speed in a square corner (mm/s; square_corner_velocity)", 5.0),
        number("Highest speed of z (mm/s; max_z_velocity)", 15.0),
        number("Highest acceleration of z (mm/s²; max_z_accel)", 100.0),
        number("Highest speed of retractions (mm/s; max_extrude_only_velocity)", 60.0),
        number("Highest acceleration of retractions (mm/s²; max_extrude_only_accel)", 2000.0),
    )  # fmt: skip
