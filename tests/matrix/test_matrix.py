"""Every command of --help, as owners run it: with default options."""

import fcntl
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from hframe_post.cli.main import COMMANDS, main
from tests.matrix.cells import Cell, answer
from tests.matrix.owners import OWNERS, settle
from tests.matrix.table import cells, expected


@pytest.fixture(scope="session")
def homes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the owners' folders, which the processes of a session share."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if base.name.startswith("popen-") else base
    homes = shared / "owners"
    homes.mkdir(exist_ok=True)
    return homes


def home_of(printer: str, homes: Path, records: bool) -> Path:
    """Return the folder of an owner, made by the first who asks; the Voron's for others."""
    owner = OWNERS.get(printer, OWNERS["voron"])
    home = homes / ("recorded" if records else "known") / owner.name
    with (homes / f"{home.parent.name}-{owner.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not home.exists():
            settle(owner, home, records)
    return home


ADVICE = re.compile(
    r"(?:hframe-post |'(?!hframe-post))(?P<command>[a-z-]+) |(?<![\w-])(?P<option>--[a-z][a-z-]+)"
)


def foreign_options(words: str, output: str) -> Iterator[str]:
    """Yield the options that an answer names, but that the command which it is about lacks."""
    context = click.Context(main)
    for line in output.splitlines():
        about = words.split()[0] if words.split()[0] in COMMANDS else "convert"
        for found in ADVICE.finditer(line):
            if found["command"] in COMMANDS:
                about = found["command"]
            elif found["option"]:
                command = main.get_command(context, about)
                assert command is not None
                known = {name for each in command.params for name in each.opts}
                if found["option"] not in known:
                    yield f"{about} {found['option']}"


def check(cell: Cell, outcome: str, folder: Path, home: Path) -> None:
    """Check status, last line and files of a cell's answer, and that it is not a bug's."""
    found = answer(cell, folder, home)
    status, last_line, files = expected(cell, outcome)
    shown = f"{cell}: status {found.status}, {found.last_line!r}\n{found.output[-2000:]}"
    assert "Traceback" not in found.output, shown
    assert "this is a bug" not in found.output, shown
    assert found.status == status, shown
    assert not [*foreign_options(cell.words, found.output)], shown
    assert last_line.match(found.last_line), shown
    assert files.fullmatch(" ".join(found.changed)), f"{cell}: files {found.changed} changed"


@pytest.mark.parametrize(("cell", "outcome"), cells(fast=True), ids=str)
def test_an_owner_gets_an_answer(cell: Cell, outcome: str, tmp_path: Path, homes: Path) -> None:
    check(cell, outcome, tmp_path / "here", home_of(cell.printer, homes, records=False))


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "outcome"), cells(fast=False), ids=str)
def test_every_owner_gets_one(cell: Cell, outcome: str, tmp_path: Path, homes: Path) -> None:
    home = home_of(cell.printer, homes, records=cell.words.startswith("identify"))
    check(cell, outcome, tmp_path / "here", home)


def test_every_command_has_its_cells() -> None:
    context = click.Context(main)
    shown = {
        name
        for name in main.list_commands(context)
        if (command := main.get_command(context, name)) is not None and not command.hidden
    }
    driven = {cell.words.split()[0] for cell, _ in [*cells(True), *cells(False)]}
    assert driven - {"{print}"} == shown
