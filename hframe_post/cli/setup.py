"""``hframe-post setup``: from Klipper's printer.cfg or Marlin's M503 to a profile."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from hframe_post.cli.parameters import FOLDER, READ, ask, files_read, pair, quoted, write_kernel
from hframe_post.errors import HframeError
from hframe_post.firmware.base import Source
from hframe_post.firmware.klipper.macros import FILE
from hframe_post.firmware.registry import source_of
from hframe_post.model.kinematics import TYPES
from hframe_post.printer.choice import PROFILE, VARIABLE, set_default
from hframe_post.printer.model_file import named_model
from hframe_post.printer.new_profile import Known, Tables, differences, profile_text
from hframe_post.printer.profile import load, parse, text_of
from hframe_post.printer.settings import Printer
from hframe_post.writers.outputs import Outputs

SAID = "as you said"
TWO_BELTS = "corexy (two belts, which cross) or hbot (one long belt in the shape of an H)"
QUESTION = f"The firmware treats two kinds of printer alike. Is yours {TWO_BELTS}?"
ANY_KIND = f"How do the motors move the nozzle? cartesian (one motor for each axis), {TWO_BELTS}"


_size = pair("the width and depth of a bed, such as 220,220", (1.0, 1e4), (1.0, 1e4))


@click.command()
@click.argument(
    "files", metavar="PRINTER.CFG|M503.TXT [HEADERS]", nargs=-1, required=True, type=READ
)
@click.option(
    "-o", "--output", "folder", type=FOLDER,
    help=f"Folder for {PROFILE} and {FILE}. Default: the present one.",
)  # fmt: skip
@click.option(
    "--kinematics", type=click.Choice(tuple(TYPES)),
    help="How the motors move the nozzle: neither firmware tells an H-bot from a CoreXY. Default: "
    "asked on a terminal, otherwise the kind that does not rack.",
)  # fmt: skip
@click.option(
    "--bed", type=_size, metavar="X,Y",
    help="Width and depth of the bed in mm, where Marlin's answers leave them open.",
)  # fmt: skip
@click.option(
    "--reset", is_flag=True,
    help=f"Overwrite {PROFILE}. Your changes in it are lost; the measured model stays.",
)  # fmt: skip
def setup(
    files: tuple[Path, ...], folder: Path | None, kinematics: str | None,
    bed: tuple[float, float] | None, reset: bool,
) -> None:  # fmt: skip
    """Make this printer's profile from Klipper's printer.cfg or from Marlin's answer to M503.

    Writes printer.toml, the profile, and makes it the default; for Klipper also hframe.cfg, to
    include in printer.cfg. For Marlin, save the answers to M503, M115 and M211 in one file; its
    Configuration.h and Configuration_adv.h may follow. Where printer.toml exists, setup changes
    nothing in it and lists what differs. A profile instead of printer.cfg becomes the default.

    \b
    Examples:
      hframe-post setup printer.cfg
      hframe-post setup m503.txt --bed 220,220
      hframe-post setup other.toml
    """
    if len(files) == 1 and files[0].suffix == ".toml":
        load(str(files[0]))  # raises before anything is written
        set_default(os.path.abspath(files[0]))
        click.echo(f"profile          {files[0]}, from now on the default")
        return
    if folder is not None and folder.suffix == ".toml":
        raise click.UsageError(f"-o names the folder of {PROFILE}: write -o {folder.parent}")
    made = NewProfile(files, (folder or Path()) / PROFILE, kinematics, bed, reset)
    made.write()
    click.echo("\n".join(made.conclude()))
    click.echo(made.source.next_steps(made.printer, made.target, quoted))


class NewProfile:
    """A printer's profile, made from its firmware's files: what is written, and what is said of it.

    target: its file. kinematics, bed: as the owner says, if at all. reset: overwrite the target,
    but for its model. Raises HframeError, before anything is written.
    """

    def __init__(
        self, files: tuple[Path, ...], target: Path, kinematics: str | None = None,
        bed: tuple[float, float] | None = None, reset: bool = False,
    ) -> None:  # fmt: skip
        self.source, self.target, self._files, self._bed = source_of(files), target, files, bed
        if self.source.alone and (len(files) > 1 or bed is not None):
            raise click.UsageError(self.source.alone)
        self._old = text_of(str(target)) if target.exists() else ""
        self._before = parse(self._old, "printer", str(target)) if self._old else None
        self._kind = _kinematics(self.source, kinematics, self._before)
        own = self.source.tables(str(self._kind.value), bed or _bed(self.source))
        self._tables = {"kinematics": {"type": self._kind}, **own}
        self._text = self._old
        if reset or not self._old:
            model = _model_of(target, self._before)
            self._text = profile_text(self._tables, f"made from {files[0].name}", model)
        of = target if self._old else files[0]
        self.printer = parse(self._text, target.stem, str(of))
        self._companions = self.source.companions(self.printer)

    def write(self, more: Callable[[Outputs], None] = lambda _: None) -> None:
        """Write the profile, its kernel and what the printer needs next to its own files.

        more: opens other files, which appear together with these.
        """
        folder = self.target.parent
        folder.mkdir(parents=True, exist_ok=True)
        with Outputs(files_read(*self._files)) as outputs:
            if self._text != self._old:
                outputs.open(self.target).write(self._text.encode())
            write_kernel(outputs, self.target, self.printer)
            for name, content in self._companions.items():
                path, data = folder / name, content.encode()
                if not (path.is_file() and path.read_bytes() == data):
                    outputs.open(path).write(data)
            more(outputs)

    def conclude(self) -> list[str]:
        """Make the profile the default; return a summary, and where an older one differs."""
        written = f"{self.target}, {_made_default(self.target, self.source.warnings)}"
        kind = self._kind
        if self.printer.kinematics.type != kind.value:  # asked for, but the profile stays
            kind = Known(self.printer.kinematics.type, f"as {PROFILE} says")
        found = list(_summary(self.source, self.printer, written, kind))
        if self._before is None:
            return found
        again = quoted(self._files[0])
        if self._bed:
            again += f" --bed {self._bed[0]:g},{self._bed[1]:g}"
        if self._kind.origin == SAID:
            again += f" --kinematics {self._kind.value}"
        changed = self._text != self._old
        return [*_differences(self._tables, self._before, changed, self.target, again), *found]


def _bed(source: Source) -> tuple[float, float] | None:
    """Return the bed's width and depth, mm, asked for only if the source does not know them."""
    if not source.no_travel:
        return None
    unknown = HframeError(source.no_travel)
    size: tuple[float, float] = ask("Width and depth of the bed (mm)", unknown, value_proc=_size)
    return size


def _kinematics(source: Source, requested: str | None, before: Printer | None) -> Known:
    """Return the printer's kinematics: asked for only if nothing else decides."""
    possible = source.possible
    if requested is not None and requested not in possible:
        raise HframeError(
            f"--kinematics {requested}: {source.path} says {possible[0]} ({source.decided})"
        )
    if len(possible) == 1:
        return Known(possible[0], source.decided)
    if requested is not None:
        return Known(requested, SAID)
    if before is not None and before.kinematics.type in possible:
        return Known(before.kinematics.type, f"as {PROFILE} says")
    question = QUESTION if source.decided else ANY_KIND
    if said := ask(question, "", type=click.Choice(possible), default=possible[0]):
        return Known(said, SAID)
    if not source.decided:
        return Known(possible[0], "assumed: the answers do not tell")
    return Known(possible[0], f"assumed: for the firmware {' and '.join(possible)} are the same")


def _made_default(target: Path, warnings: list[str]) -> str:
    """Make a profile the default and say so, or add to the warnings why it is not."""
    try:
        set_default(os.path.abspath(target))
    except OSError as error:
        warnings.append(
            f"{error.filename} cannot be written ({error.strerror}), so {target} is not the "
            f"default: give -p {quoted(target)} to each command, or set {VARIABLE} to its path"
        )
        return "not the default"
    return "from now on the default"


def _model_of(target: Path, before: Printer | None) -> str:
    """Return the name of the model that a profile has, which a new text of it keeps.

    Raises HframeError if the profile contains what was measured: a new text would lose it.
    """
    if before is None:
        return ""
    if found := named_model(str(target)):
        return found[0].relative_to(target.parent).as_posix()
    if before.invented:
        return ""
    raise HframeError(
        f"{target} contains what was measured, which --reset would delete: move its tables [plant] "
        'and [compensation] into printer.model.toml, and write model = "printer.model.toml" in '
        "their place, as the first line"
    )


def _differences(
    tables: Tables, before: Printer, changed: bool, target: Path, source: str
) -> Iterator[str]:
    """Yield where a profile and what was found differ."""
    kept = [each.text for each in differences(tables, before)]
    if changed:
        yield f"{target}: overwritten" if kept else f"{target}: changed"
    elif not kept:
        yield f"{target}: no changes"
    else:
        yield f"{target} stays as it is, and differs from what was found:"
    yield from kept
    if kept and not changed:
        yield f"To overwrite it: hframe-post setup {source} --reset"


def _summary(source: Source, profile: Printer, target: str, kind: Known) -> Iterator[str]:
    limits, motors = profile.limits, profile.motors
    for warning in source.warnings:
        yield f"WARNING          {warning}"
    yield f"profile          {target}"
    yield f"kinematics       {kind.value} ({kind.origin})"
    if kind.origin.startswith("assumed"):
        other = "hbot" if source.decided else "corexy"
        shown = "an H-bot" if source.decided else "a CoreXY"
        command = f"hframe-post setup {quoted(source.path)} --kinematics {other} --reset"
        yield f"                 for {shown}: {command}"
    own = f"{limits.velocity:g} mm/s, {limits.acceleration:g} mm/s²"
    yield f"path             {own}, or what a file sets"
    known = profile.motors == profile.motors.stated
    how = "stated" if known else "guessed, more for files that ask for more"
    yield (
        f"belts            at most {motors.belt_velocity:g} mm/s, {motors.belt_acceleration:g} "
        f"mm/s² ({how});"
    )
    yield "                 if motors skip, state less: belt_acceleration below [motors]"
    yield f"accelerometer    {source.sensors}"
