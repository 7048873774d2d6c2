"""``hframe-post setup``: from Klipper's printer.cfg to a profile and macros."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from hframe_post.cli.options import files_read
from hframe_post.errors import HframeError
from hframe_post.firmware.klipper.macros import FILE, macros
from hframe_post.printer.choice import set_default
from hframe_post.printer.edit import updated
from hframe_post.printer.klipper_cfg import KlipperConfig
from hframe_post.printer.profile import parse, text_of
from hframe_post.printer.settings import Printer
from hframe_post.printer.setup import Known, from_klipper, kinematics_in, profile_text
from hframe_post.writers.files import Outputs

PROFILE = "printer.toml"
QUESTION = (
    "Klipper calls two kinds of printer corexy. Is yours corexy (two belts, which cross) or hbot "
    "(one long belt in the shape of an H)?"
)


@click.command()
@click.argument(
    "config", metavar="PRINTER.CFG", type=click.Path(path_type=Path, exists=True, dir_okay=False)
)
@click.option(
    "-o", "--output", "folder", default=".", type=click.Path(path_type=Path, file_okay=False),
    help=f"Folder for {PROFILE} and {FILE}. Default: the present one.",
)  # fmt: skip
@click.option(
    "--kinematics", type=click.Choice(["corexy", "hbot"]),
    help="Which of the two printers that Klipper calls corexy. Default: asked on a terminal, "
    "otherwise corexy, which does not rack.",
)  # fmt: skip
def setup(config: Path, folder: Path, kinematics: str | None) -> None:
    """Make this printer's profile and macros from Klipper's printer.cfg.

    Writes printer.toml, the profile, and makes it the default; and hframe.cfg, to include in
    printer.cfg. printer.cfg itself is not changed. Run it again after a change of printer.cfg: what
    you changed in the profile stays, as does the measured model.

    \b
    Example:
      hframe-post setup printer.cfg
    """
    klipper, target = KlipperConfig(config), folder / PROFILE
    old = text_of(str(target)) if target.exists() else ""
    before = parse(old, "printer", str(target)) if old else None
    kind = _kinematics(klipper, kinematics, before)
    tables = {"kinematics": {"type": kind}, **from_klipper(klipper, str(kind.value))}
    text, changes = profile_text(tables, f"made from {config.name}"), list[str]()
    if old:
        text, changes = updated(old, tables, str(target))
    # raises before anything is written
    profile = parse(text, target.stem, str(target if old else config))
    sections = macros(profile, klipper)
    folder.mkdir(parents=True, exist_ok=True)
    with Outputs(files_read(config)) as outputs:
        outputs.open(target).write(text.encode())
        outputs.open(folder / FILE).write(sections.encode())
        set_default(os.path.abspath(target))
    if old:
        click.echo("\n".join([f"{target}: {len(changes) or 'no'} changes", *changes]))
    click.echo("\n".join(_summary(klipper, profile, target, kind)))
    click.echo(_next_steps(klipper, profile, target))


def _kinematics(config: KlipperConfig, requested: str | None, before: Printer | None) -> Known:
    """Return the printer's kinematics: asked for only if nothing else decides."""
    possible = kinematics_in(config)
    if requested is not None and requested not in possible:
        raise HframeError(f"--kinematics {requested}: {config.path} says {possible[0]}")
    if len(possible) == 1:
        return Known(possible[0], "kinematics of [printer]")
    if requested is not None:
        return Known(requested, "as you said")
    if before is not None and before.kinematics.type in possible:
        return Known(before.kinematics.type, "as before")
    if sys.stdin.isatty():
        return Known(
            click.prompt(QUESTION, type=click.Choice(possible), default=possible[0]), "as you said"
        )
    return Known(possible[0], f"assumed: for Klipper {' and '.join(possible)} are the same")


def _summary(config: KlipperConfig, profile: Printer, target: Path, kind: Known) -> Iterator[str]:
    limits, motors = profile.limits, profile.motors
    if config.unsaved:
        yield f"WARNING          {config.unsaved}"
    for name in config.missing:
        yield f"WARNING          [include {name}] was not found, so what it sets is not known"
    yield f"profile          {target}, from now on the default"
    yield f"kinematics       {kind.value} ({kind.origin})"
    if kind.origin.startswith("assumed"):
        yield f"                 for an H-bot: hframe-post setup {config.path} --kinematics hbot"
    yield f"path             at most {limits.velocity:g} mm/s, {limits.acceleration:g} mm/s²"
    yield (
        f"belts            at most {motors.belt_velocity:g} mm/s, {motors.belt_acceleration:g} "
        "mm/s², because compensation"
    )
    yield "                 moves harder than the path. If motors skip, lower both under [motors]"
    sensors = ", ".join(config.accelerometers()) or "none in printer.cfg; you need one to measure"
    yield f"accelerometer    {sensors}"


def _next_steps(config: KlipperConfig, profile: Printer, target: Path) -> str:
    sections = target.with_name(FILE)
    include = f"[include {sections.name}]"
    if config.has(include[1:-1]):
        first = f"Copy {sections} next to your printer.cfg, which includes it already."
    else:
        first = (
            f"Copy {sections} next to your printer.cfg, and add this line to printer.cfg, at its "
            f"end but above the SAVE_CONFIG block:\n     {include}"
        )
    if not profile.invented:
        return f"\nNext:\n  1. {first}\n  2. Restart Klipper."
    places = ", at three places 60 mm apart" if profile.kinematics.racks else ""
    return f"""
Next:
  1. {first}
  2. Restart Klipper, home, and run on its console TEST_RESONANCES AXIS=X OUTPUT=raw_data{places};
     then the same with AXIS=Y. docs/start.md has the commands, also for a bed that moves.
  3. Fetch raw_data_*.csv from /tmp of Klipper's host into a folder recordings, and run
     hframe-post identify recordings --printer-cfg {config.path} -o {target}"""
