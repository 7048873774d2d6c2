"""Every command of --help as owners run it, one after the other, with default options."""

import os
import re
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from hframe_post.cli.main import COMMANDS, main
from tests.command_line import run
from tests.gcode_tools import sliced
from tests.owners.owners import FILES, OWNERS

pytestmark = pytest.mark.slow

PART, FORM, HZ = "my part.gcode", "t.form.toml", 40.0  # of the waves on a tower
SUMMARY = "belts   .*at most |if you stop it   send M501"
MODEL = r"(\w)+(\.kernel \w+)?\.model\.toml \w+\.toml"  # the kernel is Klipper's
BOTH = tuple(OWNERS)
# the command, @ for the part; who runs it; the last line that it shows; the files that it writes
STEPS = (
    ("setup {}", BOTH, r"  .*hframe-post identify|OctoPrint do that: ",
     r"config/hframe-post/config\.toml( hframe\.cfg)? printer\.toml"),
    ("measure -o m.gcode", BOTH, "", r"(m\.gcode )?(m\.[-\w]+\.(csv|gcode) ?)+"),
    ("identify recordings -o printer.toml", BOTH, "Next: hframe-post PART.GCODE", MODEL),
    ("doctor", BOTH, "no problems found", ""),
    ("convert @ -o out.gcode", BOTH, SUMMARY, r"out\.gcode"),
    ("batch @ -o out", BOTH, "1 converted, 0 skipped, 0 failed", f"out/{PART}"),
    ("simulate @", BOTH, r"1( +[\d.]+){3}", ""),
    ("simulate", BOTH, r"0( +[\d.]+){3}", ""),
    ("@", BOTH, SUMMARY, PART),
    ("measure --for check -o c.gcode", ("voron",), "  hframe-post check", r"c\.\S+\.csv c\.gcode"),
    ("check", BOTH, "Nothing is written", ""),
    ("check checked", ("voron",), "Nothing is written. To keep it", ""),
    ("calibrate-print --heat 210,60 -o t.gcode", BOTH, r"Print t\.gcode\.", rf"{FORM} t\.gcode"),
    (f"calibrate-print --form {FORM} -o n.toml", BOTH,
     r"Next: hframe-post calibrate-print -p n\.toml --compare", MODEL),
    ("calibrate-print --compare 6% --heat 210,60 -o q.gcode", BOTH, r"Print q\.", r"q\.gcode"),
    ("calibrate-print --pick 6% 0 -o p.toml", BOTH, "Next: compare once more", MODEL),
    ("connect klipper", ("voron",), r"    _HFRAME_CANCEL_PRINT \{rawparams\}", ""),
    ("connect slicer", BOTH, "OrcaSlicer: Process", ""),
    ("connect cura --folder .", BOTH, "Restart Cura, then: ", r"HframePost\.py"),
    ("connect octoprint --folder .", ("voron",), r"Restart OctoPrint\.",
     r"(plugins/hframe_post/\S+ ?){3}"),
)  # fmt: skip
ADVICE = re.compile(
    r"(?:hframe-post |'(?!hframe-post))(?P<command>[a-z-]+) |(?<![\w-])(?P<option>--[a-z][a-z-]+)"
)


def foreign_options(words: list[str], output: str) -> Iterator[str]:
    """Yield the options that an answer names, but that the command which it is about lacks."""
    context = click.Context(main)
    for line in output.splitlines():
        about = words[0] if words[0] in COMMANDS else "convert"
        for found in ADVICE.finditer(line):
            if found["command"] in COMMANDS:
                about = found["command"]
            elif found["option"]:
                command = main.get_command(context, about)
                assert command is not None
                if found["option"] not in {name for each in command.params for name in each.opts}:
                    yield f"{about} {found['option']}"


def files() -> dict[str, bytes]:
    """Return the content of each file here."""
    found = (path for path in Path().rglob("*") if path.is_file())
    return {os.fspath(path): path.read_bytes() for path in found}


def fill_in(form: Path) -> None:
    """Write the same waves for each speed and axis."""
    text = form.read_text()
    for k, speed in enumerate(tomllib.loads(text)["print"]["speeds"], start=1):
        for axis in "xy":
            waves = f"{axis}{k} = [{3.0 * speed / HZ:.1f}, 3, 4]"
            text = text.replace(f"{axis}{k} = [0, 0, 0]", waves)
    form.write_text(text)


@pytest.mark.parametrize("name", OWNERS)
def test_an_owner_gets_an_answer(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The right status, last line and files, and no option that the command lacks."""
    owner = OWNERS[name]
    shutil.copytree(FILES / name, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    Path(PART).write_bytes(b"".join(sliced(2)))
    for command, who, last, written in STEPS:
        if name not in who:
            continue
        if command.startswith(("identify", "check checked")):
            owner.record("[mc].*.csv", command.split()[1])
            for motion in Path().glob("[mc].*.csv"):
                motion.unlink()
        elif "--form" in command:
            fill_in(Path(FORM))
        words = command.format(owner.configuration).split()
        before = files()
        done = run(
            *(PART if word == "@" else word for word in words),
            XDG_CONFIG_HOME=str(tmp_path / "config"), HOME=str(tmp_path), HFRAME_PRINTER="",
        )  # fmt: skip
        after = files()
        output = (done.stdout + done.stderr).decode()
        lines = (done.stderr.strip() or done.stdout.strip()).decode().splitlines() or [""]
        changed = sorted(path for path in after if before.get(path) != after[path])
        assert done.returncode == 0, (command, output[-2000:])
        assert not [*foreign_options(words, output)], (command, output)
        assert re.match(last, lines[-1]), (command, output[-2000:])
        assert re.fullmatch(written, " ".join(changed)), (command, changed)


def test_every_command_is_run() -> None:
    context = click.Context(main)
    commands = {name: main.get_command(context, name) for name in main.list_commands(context)}
    shown = {name for name, command in commands.items() if command and not command.hidden}
    assert {command.split()[0] for command, *_ in STEPS} - {"@"} == shown
