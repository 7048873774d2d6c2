"""``hframe-post printers`` and ``use``: show, create and choose profiles."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click

from hframe_post.cli.options import number, old_option
from hframe_post.errors import HframeError, PrinterError
from hframe_post.model.kinematics import ROWS
from hframe_post.printer.choice import choose, config_file, set_default
from hframe_post.printer.profile import load, parse, shipped
from hframe_post.printer.setup import (
    CLOCK,
    Known,
    Tables,
    as_float,
    jerk,
    motors,
    profile_text,
)
from hframe_post.writers.files import Outputs

ANSWER = "your answer"
KLIPPERS = ("velocity", "acceleration", "square_corner_velocity")  # limits that its table repeats


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
@old_option("--printer-cfg", "run 'hframe-post setup printer.cfg' instead", removed=True)
@old_option("--kinematics", "answer the question instead", removed=True)
@old_option("--description", "change the first lines of the profile", removed=True)
def new(output: Path) -> None:
    """Create a profile from answers, for a printer without a printer.cfg, such as one with Marlin.

    For Klipper use 'hframe-post setup printer.cfg'. The new profile compensates nothing until you
    have measured the printer (docs/identify.md).

    \b
    Example:
      hframe-post printers new -o my.toml
    """
    if output.exists():
        raise HframeError(f"{output} exists already: choose another name")
    written = profile_text(_asked(), click.prompt("Name of the printer", default=output.stem))
    parse(written, output.stem, str(output))  # raises before anything is written
    with Outputs() as outputs:
        outputs.open(output).write(written.encode())
    click.echo(
        f"{output}: written. Next: 'hframe-post use {output}', then measure the printer "
        "(docs/identify.md)."
    )


def _asked() -> Tables:
    """Ask for all settings; M… names the line of Marlin's M503 that has them."""
    marlin = _choice("Firmware: marlin or klipper", ["marlin", "klipper"]) == "marlin"
    kinematics = _choice(
        "Kinematics: cartesian, corexy (two belts, crossed), hbot (one belt, H), hybrid-corexy or "
        "corexz",
        list(ROWS)[::-1],
    )
    travel = {
        axis: Known(
            click.prompt(f"{axis} from, to (mm)", default="0,220", value_proc=_range), ANSWER
        )
        for axis in "xy"
    }
    velocity = _number("Maximum speed of x and y (mm/s; M203 X Y)", 200.0)
    acceleration = _number("Acceleration of prints (mm/s²; M204 P)", 1500.0)
    limits = {
        "velocity": velocity,
        "acceleration": acceleration,
        "jerk": jerk(acceleration),
        "square_corner_velocity": _number("Speed in a square corner (mm/s)", 5.0),
        "z_velocity": _number("Maximum speed of z (mm/s; M203 Z)", 5.0),
        "z_acceleration": _number("Maximum acceleration of z (mm/s²; M201 Z)", 100.0),
        "extruder_velocity": _number("Maximum speed of filament (mm/s; M203 E)", 25.0),
        "extruder_acceleration": _number("Acceleration of retractions (mm/s²; M204 R)", 1000.0),
    }
    tables: Tables = {
        "kinematics": {"type": Known(kinematics, ANSWER)},
        "travel": travel,
        "limits": limits,
        "motors": motors(kinematics, velocity, acceleration),
        "speed": {"acceleration": acceleration},
    }
    if not marlin:
        return tables | {"firmware.klipper": {key: limits[key] for key in KLIPPERS}}
    return tables | {"steps": _steps(), "firmware.marlin": _marlin(limits)}


def _steps() -> dict[str, Known]:
    usual = {"belt": ("x and y; M92 X", 80.0), "z": ("z; M92 Z", 400.0), "e": ("E; M92 E", 93.0)}
    sizes = {
        key: replace(_number(f"Steps per mm of {axis}", steps), origin=f"1 / {ANSWER}")
        for key, (axis, steps) in usual.items()
    }
    inverted = {key: replace(known, value=1.0 / as_float(known)) for key, known in sizes.items()}
    return inverted | {"clock_hz": CLOCK}


def _marlin(limits: dict[str, Known]) -> dict[str, Known]:
    velocity, acceleration = as_float(limits["velocity"]), as_float(limits["acceleration"])
    greatest = as_float(_number("Highest acceleration of x and y (mm/s²; M201 X Y)", acceleration))
    deviation = _number("Junction deviation (mm; M205 J; 0 if M205 shows X and Y instead)", 0.08, 0)
    corners = {"junction_deviation": deviation}
    if not deviation.value:
        instant = as_float(_number("Jerk of x and y (mm/s; M205 X Y)", 8.0))
        of_filament = _number("Jerk of filament (mm/s; M205 E)", 5.0)
        corners = {"jerk": Known((instant, instant), ANSWER), "jerk_e": of_filament}
    return {
        "max_velocity": Known((velocity, velocity), ANSWER),
        "max_acceleration": Known((greatest, greatest), ANSWER),
        "acceleration": limits["acceleration"],
        "travel_acceleration": _number("Acceleration of travel (mm/s²; M204 T)", acceleration),
        "retract_acceleration": limits["extruder_acceleration"],
        **corners,
    }


def _choice(question: str, kinds: Sequence[str]) -> str:
    answer: str = click.prompt(
        question, type=click.Choice(kinds), default=kinds[0], show_choices=False
    )
    return answer


def _number(question: str, default: float, least: float = 1e-9) -> Known:
    def value(text: str) -> float:
        given = number(text)
        if not least <= given < 1e6:
            raise click.BadParameter(f"{text!r} is not a number above 0")
        return given

    return Known(click.prompt(question, default=f"{default:g}", value_proc=value), ANSWER)


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not two numbers such as 0,280") from None
    if not -1e4 <= low < high <= 1e4:
        raise click.BadParameter(f"{text!r}: the first must be the smaller, both within ±10000 mm")
    return low, high


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
        click.echo("no profile is the default now")
        return
    if profile is not None:
        load(profile)  # raises before anything is written
        set_default(profile if profile in shipped() else os.path.abspath(profile))
    click.echo(f"{choose(None, os.environ).as_text()}\nsetting     {config_file()}")
