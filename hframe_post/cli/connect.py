"""``hframe-post connect``: lets slicers, Cura, OctoPrint, Moonraker and Klipper use a profile."""

from __future__ import annotations

import os
import re
import subprocess  # nosec B404  only its quoting is used
import sys
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import click
from platformdirs import user_data_path

from hframe_post.cli.moonraker import RESTART, Moonraker, confirm, find_printer_cfg, make
from hframe_post.cli.parameters import READ, quoted, say
from hframe_post.cli.setup import NewProfile
from hframe_post.errors import HframeError
from hframe_post.firmware.klipper.macros import macros
from hframe_post.firmware.registry import firmware
from hframe_post.printer.choice import PROFILE, choose
from hframe_post.printer.profile import check_identified, load, shipped
from hframe_post.process import program, program_words
from hframe_post.writers.outputs import Outputs

PROGRAMS = ("slicer", "cura", "octoprint", "moonraker", "klipper")


@click.command()
@click.argument("target", metavar="PROGRAM", type=click.Choice(PROGRAMS))
@click.option(
    "-p", "--printer", metavar="NAME|FILE",
    help="Profile to use. Default: the default profile, whichever it is by then.",
)  # fmt: skip
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Cura's scripts folder, or OctoPrint's folder, if it is not found.",
)  # fmt: skip
@click.option(
    "--printer-cfg", "config", type=READ, metavar="FILE",
    help="printer.cfg for moonraker, if it is not found.",
)  # fmt: skip
@click.option("--remove", is_flag=True, help="Undo 'connect moonraker'.")
def connect(
    target: str, printer: str | None, folder: Path | None,
    config: Path | None, remove: bool,
) -> None:  # fmt: skip
    """Let another program run hframe-post.

    \b
    slicer     print the line to paste into PrusaSlicer or OrcaSlicer
    cura       install a script into every version of Cura; again after updates
    octoprint  install a plugin that converts each upload
    moonraker  on the printer's computer: measure and compensate there
    klipper    print the macros that 'setup' writes to hframe.cfg

    \b
    Examples:
      hframe-post connect slicer -p my.toml
      hframe-post connect moonraker
    """
    if target != "moonraker" and (remove or config is not None):
        raise click.UsageError("--remove and --printer-cfg are for 'connect moonraker'")
    if target == "moonraker":
        (_disconnect if remove else _connect)(config or find_printer_cfg())
    elif target == "slicer":
        _slicer(_anywhere(printer))
    elif target == "cura":
        _cura(_anywhere(printer), folder)
    elif target == "octoprint":
        _octoprint(choose(printer, os.environ).profile, folder)
    else:
        click.echo(macros(load(choose(printer, os.environ).profile)), nl=False)


def _anywhere(printer: str | None) -> str:
    """Return a profile as every folder finds it: a shipped name, an absolute path, or nothing."""
    if printer is None:
        return ""
    load(printer)  # raises before anything is written
    return printer if printer in shipped() else str(Path(printer).absolute())


# ---------------------------------------------------------------------- Moonraker

CALIBRATE = (
    "Then mount the accelerometer, clear the bed, heat as for a print, and type on the console of "
    "Mainsail or Fluidd: HFRAME_CALIBRATE"
)


def _connect(printer_cfg: Path) -> None:
    moonraker = Moonraker(printer_cfg)
    moonraker.choose_live()
    made = NewProfile((printer_cfg,), printer_cfg.parent / PROFILE)
    changes, done = moonraker.connecting(made.target), list[str]()
    confirm(changes)
    made.write(lambda outputs: done.extend([*make(changes, outputs), *moonraker.link(True)]))
    click.echo("\n".join([*made.conclude(), "", *done, "", RESTART, CALIBRATE]))


def _disconnect(printer_cfg: Path) -> None:
    moonraker = Moonraker(printer_cfg)
    changes = moonraker.disconnecting()
    confirm(changes)
    with Outputs() as outputs:
        done = [*make(changes, outputs), *moonraker.link(create=False)]
    click.echo("\n".join([*done, "", RESTART]))


# ---------------------------------------------------------------------- slicers


def _slicer(printer: str) -> None:
    """Print the line alone to standard output, and where it belongs to standard error."""
    words = [*program_words(), *(["-p", printer] if printer else [])]
    click.echo(line(words, windows=sys.platform == "win32"))
    say("PrusaSlicer, SuperSlicer: Print Settings, Output options, Post-processing scripts")
    say("OrcaSlicer: Process, Others, Post-processing scripts")


def line(words: Sequence[str], windows: bool) -> str:
    """Return words as a slicer takes them: for a shell, or for Windows, where there is none."""
    return subprocess.list2cmdline(words) if windows else " ".join(quoted(word) for word in words)


# ---------------------------------------------------------------------- Cura

NAME = "HframePost"  # of the file and its class: Cura finds one by the other
MENU = 'Extensions, Post Processing, Modify G-Code, Add a script, "Compensate racking and ringing"'


def _cura(printer: str, folder: Path | None) -> None:
    folders = [folder] if folder is not None else script_folders()
    if not folders:
        raise HframeError(
            "no configuration folder of Cura found: start Cura once, or name its scripts folder "
            "with --folder (Cura shows it: Help, Show Configuration Folder)"
        )
    text = script(program(), printer).encode()
    with Outputs() as outputs:
        for each in folders:
            each.mkdir(exist_ok=True)
            outputs.open(each / f"{NAME}.py").write(text)
    for each in folders:
        click.echo(each / f"{NAME}.py")
    click.echo(f"Restart Cura, then: {MENU}")


def script_folders() -> list[Path]:
    """Return the scripts folder, which may not exist yet, of each Cura version that has run."""
    roots = [
        user_data_path("cura", appauthor=False, roaming=True),
        Path.home() / ".var/app/com.ultimaker.cura/data/cura",  # Flatpak
    ]
    return [
        version / "scripts"
        for root in dict.fromkeys(roots)
        if root.is_dir()
        for version in sorted(root.iterdir())
        if re.fullmatch(r"\d+\.\d+", version.name) and version.is_dir()
    ]


def script(program: str, printer: str) -> str:
    text = (resources.files(__package__) / f"{NAME}.py.in").read_text("utf-8")
    return text.replace("@PROGRAM@", repr(program)).replace("@PROFILE@", repr(printer))


# ---------------------------------------------------------------------- OctoPrint

PLUGIN = "hframe_post"  # its folder


def _octoprint(printer: str, folder: Path | None) -> None:
    profile = load(printer)
    check_identified(profile)
    firmware(profile).check_serial()
    home = folder or Path.home() / ".octoprint"
    if not home.is_dir():
        raise HframeError(f"{home} does not exist: name OctoPrint's folder with --folder")
    plugins = home / "plugins"
    with Outputs() as outputs:
        for name, text in plugin_files(program_words(), _anywhere(printer)).items():
            (plugins / PLUGIN / name).parent.mkdir(parents=True, exist_ok=True)
            outputs.open(plugins / PLUGIN / name).write(text.encode())
    click.echo(f"{plugins / PLUGIN}\nRestart OctoPrint.")


def plugin_files(command: list[str], profile: str) -> dict[str, str]:
    """Return the plugin's files by name, for this command and profile."""
    folder = Path(str(resources.files("hframe_post.hosts") / "octoprint"))
    files = {
        str(path.relative_to(folder)): path.read_text("utf-8")
        for path in folder.rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    own = {"COMMAND": repr(command), "PROFILE": repr(profile)}
    files["__init__.py"] = re.sub(
        r"^(COMMAND|PROFILE) = .*$", lambda found: f"{found[1]} = {own[found[1]]}",
        files["__init__.py"], flags=re.MULTILINE,
    )  # fmt: skip
    return files
