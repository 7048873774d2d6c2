"""``hframe-post connect moonraker``: connect Klipper and Moonraker, or disconnect them."""

from __future__ import annotations

import difflib
import glob
import os
import re
import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import click

from hframe_post.cli.parameters import agrees
from hframe_post.errors import HframeError
from hframe_post.firmware.klipper.macros import FILE
from hframe_post.firmware.klipper.printer_cfg import HEADING, KlipperConfig
from hframe_post.hosts import klipper, moonraker
from hframe_post.hosts.moonraker.recordings import NAME
from hframe_post.process import program
from hframe_post.writers.outputs import Outputs

CONFIG = "moonraker.conf"
BACKUP = ".before-hframe-post"  # added to the name of a file that is changed
INSTANCES = ("*_data/config/printer.cfg", "klipper_config/printer.cfg")
PLACES = ("moonraker/moonraker", "moonraker-env/lib/python3*/site-packages/moonraker")
# a header and the lines below it, as far as the next empty line; earlier versions added two
SECTIONS = re.compile(
    r"(?:\n*^\[(?:update_manager )?hframe_post\].*(?:\n(?!\[)[^\r\n]+)*\n?)+", re.MULTILINE
)
COMMAND = re.compile(  # in our section: what is before it, the program, and its first word
    rf"^(\[{NAME}\]\n(?:(?!\[).*\n)*?command: )((\S+).*?)(?= -p )", re.MULTILINE
)
ADDED = "# added by hframe-post connect moonraker"
INCLUDE = f"{ADDED}\n[include {FILE}]\n"
LIVE = "hframe_live"
LIVE_SECTION = f"{ADDED}: compensation in Klipper\n[{LIVE}]\nkernel: printer.kernel\n"
LIVE_QUESTION = (
    "Compensate inside Klipper, on files as they are sliced? Otherwise the slicer converts them"
)
RESTART = (
    "Restart Klipper and Moonraker, while nothing is printed: in the power menu of Mainsail or "
    "Fluidd, or by sudo systemctl restart klipper moonraker"
)


class Change(NamedTuple):
    """A file that is to be changed. new: its text then; None: it is removed."""

    path: Path
    old: str
    new: str | None
    done: str

    def diff(self) -> str:
        if self.new is None:
            return f"{self.path}: {self.done}\n"
        old, new = (text.splitlines(keepends=True) for text in (self.old, self.new))
        return "".join(difflib.unified_diff(old, new, str(self.path), str(self.path), n=2))


class Moonraker:
    """Configuration and code of Klipper and Moonraker. Raises HframeError if any is not found."""

    def __init__(self, printer_cfg: Path) -> None:
        self._printer, self._config = printer_cfg, printer_cfg.with_name(CONFIG)
        if not self._config.is_file():
            raise HframeError(
                f"{self._config} was not found. Run this on the printer's computer, with the "
                "printer.cfg next to moonraker.conf"
            )
        found = [place for name in PLACES for place in Path.home().glob(f"{name}/components")]
        if not found:
            raise HframeError(f"Moonraker was not found as {' or '.join(PLACES)} in {Path.home()}")
        self._components = found[0]
        homes = (Path.home() / name / "klippy" for name in ("klipper", "kalico"))
        self._klippy = next((home for home in homes if (home / "extras").is_dir()), None)
        self._live = False

    def choose_live(self) -> None:
        """Ask, on a terminal, whether Klipper itself compensates; it does where it can."""
        self._live = self._klippy is not None and agrees(LIVE_QUESTION)

    def connecting(self, profile: Path) -> list[Change]:
        """Return the changes that connect a profile. Raises HframeError."""
        self._component()  # raises before anything is written
        here = profile.absolute().parent == self._printer.absolute().parent
        found = (self._with_command(profile), self._with_sections(here))
        return [change for change in found if change is not None]

    def disconnecting(self) -> list[Change]:
        """Return the changes that undo all that ``connecting`` did but the profile."""
        changes = []
        text = _text(self._config)
        if SECTIONS.search(text):
            done = f"section [{NAME}] removed"
            changes.append(Change(self._config, text, SECTIONS.sub("\n", text), done))
        text, macros = _text(self._printer), self._printer.with_name(FILE)
        new, gone = _without(text, {LIVE: LIVE_SECTION, f"include {FILE}": INCLUDE})
        if gone:
            changes.append(Change(self._printer, text, new, f"{' and '.join(gone)} removed"))
            if f"[include {FILE}]" in gone and macros.is_file():
                changes.append(Change(macros, "", None, "removed"))
        return changes

    def _with_command(self, profile: Path) -> Change | None:
        """Return the change of moonraker.conf that lets the component run hframe-post."""
        ours = program()
        command = f"{ours} -p {shlex.quote(str(profile.absolute()))}"
        text, known = _text(self._config), "\n".join(_with_includes(self._config))
        if not re.search(rf"^\[{NAME}\]", known, re.MULTILINE):
            new = f"{text.rstrip()}\n\n[{NAME}]\ncommand: {command}\n"
            return Change(self._config, text, new, f"section [{NAME}] added")
        if (gone := COMMAND.search(text)) and not shutil.which(gone[3]):
            new = f"{text[: gone.start(2)]}{ours}{text[gone.end(2) :]}"
            done = f"command corrected, because {gone[3]} is gone"
            return Change(self._config, text, new, done)
        return None

    def _with_sections(self, here: bool) -> Change | None:
        """Return the change of printer.cfg. here: whether the profile is next to it."""
        config, text = KlipperConfig(self._printer), _text(self._printer)
        wanted = {LIVE: LIVE_SECTION} if self._live else {}
        wanted[f"include {FILE}"] = INCLUDE
        missing = {name: each for name, each in wanted.items() if here and not config.has(name)}
        new, gone = (text, []) if self._live else _without(text, {LIVE: LIVE_SECTION})
        if missing:
            new = _with_lines(new, missing.values())
        done = [f"[{name}] added" for name in missing] + [f"{each} removed" for each in gone]
        return Change(self._printer, text, new, ", ".join(done)) if done else None

    def link(self, create: bool) -> list[str]:
        """Link our modules into Moonraker and Klipper, or remove the links; say what was done."""
        done = [_linked(self._component(), moonraker if create else None, "Moonraker")]
        if self._klippy is not None:
            plugins = self._klippy / "plugins"  # of Kalico
            link = (plugins if plugins.is_dir() else self._klippy / "extras") / LIVE
            wanted = klipper if create and self._live else None
            if wanted or link.is_symlink():
                done.append(_linked(link, wanted, "Klipper", self._klippy.parent))
        return done

    def _component(self) -> Path:
        """Return the place of the link in Moonraker. Raises HframeError if it is taken."""
        link = self._components / NAME
        if link.exists() and not link.is_symlink():
            raise HframeError(f"{link} is not hframe-post's: remove it first")
        return link


def _linked(link: Path, package: ModuleType | None, owner: str, clone: Path | None = None) -> str:
    """Link to a package of ours, or for None remove the link; return what was done.

    clone: of Git, which the update manager calls dirty unless it ignores the link.
    """
    exclude = None if clone is None else clone / ".git/info/exclude"
    try:
        link.unlink(missing_ok=True)
        if package is not None:
            link.symlink_to(Path(str(package.__file__)).parent, target_is_directory=True)
            if clone is not None and exclude is not None and exclude.parent.is_dir():
                name = f"/{link.relative_to(clone)}\n"
                if not exclude.is_file() or name not in exclude.read_text("utf-8"):
                    with exclude.open("a", encoding="utf-8") as file:
                        file.write(name)
    except OSError as error:
        cause = f"{link}: {error.strerror}. Run this as the user who installed {owner}"
        raise HframeError(cause) from None
    return f"{link}: {'linked' if package else 'removed'}"


def find_printer_cfg() -> Path:
    """Return the one printer.cfg in the places where Klipper keeps it. Raises HframeError."""
    found = sorted(path for name in INSTANCES for path in Path.home().glob(name))
    if len(found) == 1:
        return found[0]
    several = f"there are several printer.cfg: {', '.join(map(str, found))}"
    none = (
        f"no printer.cfg was found as {' or '.join(INSTANCES)} in {Path.home()}. Run this on the "
        "printer's computer, as the user who runs Klipper, without sudo"
    )
    which = "Name it: hframe-post connect moonraker --printer-cfg FILE"
    raise HframeError(f"{several if found else none}. {which}")


def confirm(changes: Sequence[Change]) -> None:
    """Show changes and, on a terminal, ask once whether to make them; else end the command."""
    if not changes:
        return
    click.echo("\n".join(change.diff() for change in changes))
    if not agrees("Make these changes?"):
        click.echo("nothing was changed")
        raise click.exceptions.Exit(0)


def make(changes: Sequence[Change], outputs: Outputs) -> list[str]:
    """Write changes, and each file as it was before next to it; return what was done."""
    for path, old, new, _ in changes:
        if new is None:
            path.unlink()
            continue
        outputs.open(path.with_name(path.name + BACKUP)).write(_bytes(old))
        outputs.open(path, instead_of=path).write(_bytes(new))
    return [f"{change.path}: {change.done}" for change in changes]


def _with_lines(text: str, sections: Iterable[str]) -> str:
    """Return printer.cfg with sections as the last lines before what SAVE_CONFIG wrote."""
    saved = HEADING.search(text)
    at = len(text) if saved is None else saved.start()
    before = text[:at]
    end = "\r\n" if "\r\n" in text else "\n"
    gap = "" if not before or before.endswith("\n") else end
    added = "".join(f"{end}{each.replace(chr(10), end)}" for each in sections)
    return f"{before}{gap}{added}{text[at:]}"


def _without(text: str, sections: Mapping[str, str]) -> tuple[str, list[str]]:
    """Return printer.cfg without those of these sections that were added, and their names."""
    gone = list[str]()
    for name, ours in sections.items():
        lines = r"(?:\r?\n)?" + re.escape(ours).replace("\\\n", "\r?\n")  # whatever ends them
        text, count = re.subn(lines, "", text, count=1)
        gone += [f"[{name}]"] * count
    return text, gone


def _with_includes(path: Path, within: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the text of moonraker.conf and of the files that it includes."""
    text, here = _text(path), (*within, os.path.abspath(path))
    yield text
    for pattern in re.findall(r"^\[include\s+([^]\n]+)\]", text, re.MULTILINE):
        for name in sorted(glob.glob(os.path.join(path.parent, pattern.strip()))):
            if os.path.isfile(name) and os.path.abspath(name) not in here:
                yield from _with_includes(Path(name), here)


def _text(path: Path) -> str:
    return path.read_bytes().decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")
