"""``--help`` of each command: an example, and every option explained."""

from __future__ import annotations

import click
import pytest

from hframe_post.cli.main import main

COMMANDS = {name: each for name, each in main.commands.items() if name != "printers"}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_an_example_and_says_what_options_do(name: str) -> None:
    command = COMMANDS[name]
    assert f"hframe-post {name}" in str(command.help) or "hframe-post in.gcode" in str(command.help)
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.name
