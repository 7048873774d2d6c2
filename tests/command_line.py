"""Run the command line in a process of its own, as its users do."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from hframe_post.cli.main import main
from hframe_post.process import CHILD
from tests.command_server import call
from tests.conftest import SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"
WAIT = 60.0  # s


def run(
    *arguments: str | Path, stdin: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[bytes]:
    """Run ``hframe-post`` with these arguments to its end.

    The process is a fork of one that has imported the package, which saves most of its time. Where
    ``environment`` changes how Python starts, it is a new process.
    """
    command = [sys.executable, "-m", "hframe_post", *map(str, arguments)]
    changed = {**os.environ, **environment}
    if any(name.startswith("PYTHON") for name in environment):
        return subprocess.run(command, input=stdin, capture_output=True, check=False, env=changed)
    return call("hframe_post.__main__", ["hframe-post", *command[3:]], changed, stdin=stdin)


@contextmanager
def started(*arguments: str | Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start ``hframe-post``; at the end of the block, or of this process, it is gone."""
    reading_end, writing_end = os.pipe()  # which closes with this process: see ``process``
    process = subprocess.Popen(
        [sys.executable, "-m", "hframe_post", *map(str, arguments)],
        stdin=reading_end, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, CHILD: "1"},
    )  # fmt: skip
    os.close(reading_end)
    with process:
        try:
            yield process
        finally:
            process.kill()
            os.close(writing_end)


def until(holds: Callable[[], bool]) -> None:
    """Wait until ``holds()`` is true; fail after a minute."""
    deadline = time.monotonic() + WAIT
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def commands(group: click.Group, name: str = "") -> dict[str, click.Command]:
    """All of them, by the words that call them; groups, too."""
    found: dict[str, click.Command] = {}
    context = click.Context(group)
    for word in group.list_commands(context):
        command = group.get_command(context, word)
        assert command is not None
        if command.hidden:
            continue
        found[f"{name} {word}".strip()] = command
        if isinstance(command, click.Group):
            found |= commands(command, f"{name} {word}".strip())
    return found


COMMANDS = commands(main)
