"""``--help`` of each command: an example that would be taken, and every option explained."""

import re
import shlex
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from hframe_post.cli.main import GONE, GROUPS, main
from tests.command_line import COMMANDS
from tests.conftest import ROOT

EXAMPLE = re.compile(r"^ *hframe-post (.+?)(?:  .*)?$", re.MULTILINE)


def called(words: list[str]) -> tuple[click.Command, list[str]]:
    """The command of an example, and its arguments."""
    for length in (2, 1):
        if (name := " ".join(words[:length])) in COMMANDS:
            return COMMANDS[name], words[length:]
    return COMMANDS["convert"], words


def test_help_does_not_wait_for_scipy() -> None:
    """Importing SciPy takes a second."""
    code = (
        "import sys, hframe_post.cli.main as m; c = m.click.Context(m.main)\n"
        "for name in m.COMMANDS: m.main.get_command(c, name)\n"
        "print(*(name for name in sys.modules if name.startswith('scipy')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert not done.stdout.strip()


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_an_example_and_says_what_options_do(name: str) -> None:
    command = COMMANDS[name]
    examples = EXAMPLE.findall(str(command.help))
    assert examples
    assert command in [called(shlex.split(example))[0] for example in examples]
    for example in examples:
        chosen, words = called(shlex.split(example))
        known = {option for parameter in chosen.params for option in parameter.opts}
        assert {word for word in words if word.startswith("-")} <= {*known, "--help"}
    for parameter in command.params:
        if isinstance(parameter, click.Option) and not parameter.hidden:
            assert parameter.help, parameter.name


def test_help_and_the_man_page_name_every_command_in_a_screen() -> None:
    """Thirty lines of 80 columns are a terminal's; the man page has the same words."""
    man = (ROOT / "docs" / "man" / "hframe-post.1").read_text("utf-8")
    for name, command in COMMANDS.items():
        text = command.get_help(click.Context(command, info_name=name, max_content_width=80))
        assert len(text.splitlines()) <= 30, name
        summary = next(commands[name][1] for commands in GROUPS.values() if name in commands)
        assert f".B {name}\n{summary}\n" in man
    assert len(main.get_help(click.Context(main, info_name="hframe-post")).splitlines()) <= 30


def test_a_former_command_or_option_says_the_new_one() -> None:
    for name, instead in GONE.items():
        done = CliRunner().invoke(main, [*name.split(), "file.gcode"])
        assert done.exit_code == 2
        shown = name.partition(" ")[2] or repr(name)
        assert f"{shown} is gone: {instead}" in done.output
