"""Commands that set up other programs: Klipper, Marlin, Cura and OctoPrint."""

from __future__ import annotations

import re
import sys
from importlib import resources
from pathlib import Path

import click
from platformdirs import user_data_path

from hframe_post.cli.options import files_read, printer_option, say
from hframe_post.errors import HframeError
from hframe_post.firmware.klipper.macros import macros
from hframe_post.firmware.marlin.calibration import LINE, LINES, calibration
from hframe_post.firmware.registry import firmware
from hframe_post.printer.profile import check_identified, load, shipped
from hframe_post.process import own_command
from hframe_post.writers.outputs import Outputs


@click.command("klipper-macros")
@printer_option
def klipper_macros(printer: str) -> None:
    """Print macros for Klipper, with this printer's limits.

    A converted file changes Klipper's limits while it prints. The macros restore the printer's
    limits when a print is paused, cancelled or fails, and the file's when it is resumed. They call
    your PAUSE, RESUME and CANCEL_PRINT. Save them in a file next to printer.cfg. Make the line
    [include hframe.cfg] the last one before the block that Klipper's SAVE_CONFIG writes.

    \b
    Example:
      hframe-post klipper-macros -p my.toml > hframe.cfg
    """
    click.echo(macros(load(printer)), nl=False)


@click.command("calibrate-marlin")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False),
    metavar="CALIBRATION.GCODE", help="G-code to print without filament.",
)  # fmt: skip
@printer_option
def calibrate_marlin(output: Path, printer: str) -> None:
    """Write G-code whose duration shows which planner and timer a Marlin board has.

    x moves along the middle of y, in two parts of about two minutes each. Home the printer, print
    the file from SD, and note the duration of each part: from the print time that M31 reports after
    it, from "begins" and "ends" in the host's log, or with a stopwatch. Then look the pair up in
    the table that this command prints; it shows the keys for [firmware.marlin]. A third part is
    10 000 lines that move nothing: printed over your serial line, they show its latency.

    \b
    Example:
      hframe-post calibrate-marlin -p my.toml -o calibrate.gcode
    """
    found = calibration(load(printer))
    with Outputs(files_read(printer)) as outputs:
        outputs.open(output).writelines(found.lines)
    say(" " * 44 + "".join(f"{part:>10s}" for part in found.parts))
    for board, durations in found.durations.items():
        say(f"{board:44s}" + "".join(f"{seconds:9.2f}s" for seconds in durations))
    say(
        "If the steady part is shorter than in every row, the board smooths steps: set "
        "firmware.marlin.adaptive_step_smoothing."
    )
    if found.table.classic_jerk:
        say("Built with CLASSIC_JERK, only the steady part is as in the table: it shows the timer.")
    sent = " or ".join(f"{LINES * LINE_BITS / baud:.1f} at {baud} baud" for baud in BAUDS)
    usual = LINES / found.table.lines_per_second
    say(
        f"The part 'lines' is {LINES} lines. From SD: if it takes more than {usual:.0f} s, "
        f"set lines_per_second to {LINES} / its seconds. Over a serial line: set latency to "
        f"(its seconds - {sent}) / {LINES}."
    )


# bits of a line of the part 'lines', with number, checksum and line feed, and of its ok
LINE_BITS = 10 * (len(f"N{LINES} {LINE}*99\n") + len("ok\n"))
BAUDS = (115_200, 250_000)
NAME = "HframePost"  # of the file and its class: Cura finds one by the other
MENU = 'Extensions, Post Processing, Modify G-Code, Add a script, "Compensate racking and ringing"'


@click.command("cura-script")
@click.option(
    "-p", "--printer", default="", metavar="NAME|FILE",
    help="Profile that the script uses. Default: the one set with 'hframe-post use'.",
)  # fmt: skip
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Cura's scripts folder, if it is not found: see Help, Show Configuration Folder in Cura.",
)  # fmt: skip
def cura_script(printer: str, folder: Path | None) -> None:
    """Install a post-processing script into every version of Cura.

    Then, in Cura: Extensions, Post Processing, Modify G-Code, Add a script, "Compensate racking
    and ringing". Run this command again after updating Cura or hframe-post.

    \b
    Example:
      hframe-post cura-script -p my.toml
    """
    if printer:
        load(printer)  # raises before anything is written
        printer = anywhere(printer)
    folders = [folder] if folder is not None else script_folders()
    if not folders:
        raise HframeError(
            "no configuration folder of Cura found: start Cura once, or name its scripts folder "
            "with --folder"
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


def anywhere(printer: str) -> str:
    """Return the profile as every folder finds it: a shipped one's name, or an absolute path."""
    return printer if printer in shipped() else str(Path(printer).absolute())


def program() -> str:
    """Return how another process runs this tool: a path, or a command with quotes."""
    python, *rest = program_words()
    return " ".join((f'"{python}"', *rest)) if rest else python


def program_words() -> list[str]:
    for name in ("hframe-post", "hframe-post.exe"):
        if (installed := Path(sys.executable).parent / name).is_file():
            return [str(installed)]
    return own_command()


def script(program: str, printer: str) -> str:
    text = (resources.files(__package__) / f"{NAME}.py.in").read_text("utf-8")
    return text.replace("@PROGRAM@", repr(program)).replace("@PROFILE@", repr(printer))


# ---------------------------------------------------------------------- OctoPrint

PLUGIN = "hframe_post"  # its folder


@click.command("octoprint-plugin")
@printer_option
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="OctoPrint's folder. Default: .octoprint in the home folder.",
)  # fmt: skip
def octoprint_plugin(printer: str, folder: Path | None) -> None:
    """Install a plugin into OctoPrint on this computer, which converts each uploaded file.

    Its page in OctoPrint's settings has the profile, what to do with files that are refused, and a
    switch. Summaries and warnings are in the terminal tab, in octoprint.log and in the list of
    files. OctoPrint prints over a serial line, so a profile for Marlin needs baud. Run this command
    again after moving hframe-post. To remove the plugin, delete its folder.

    \b
    Example:
      hframe-post octoprint-plugin -p my.toml
    """
    profile = load(printer)
    check_identified(profile)
    firmware(profile).check_serial()
    home = folder or Path.home() / ".octoprint"
    if not home.is_dir():
        raise HframeError(f"{home} does not exist: name OctoPrint's folder with --folder")
    plugins = home / "plugins"
    with Outputs() as outputs:
        for name, text in plugin_files(program_words(), anywhere(printer)).items():
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
