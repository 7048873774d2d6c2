"""A cell of the matrix: one command on one printer, run as its owner would."""

import hashlib
import os
import shutil
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path

from tests.command_line import run
from tests.matrix.material import put_form, put_print, put_recordings, put_run
from tests.matrix.owners import OWNERS, PROFILE

NO_PROFILE = ("setup",)  # commands without -p


@dataclass(frozen=True)
class Cell:
    """words: of the command, with places such as {print}."""

    words: str
    printer: str

    def __str__(self) -> str:
        return f"{self.words} | {self.printer}"


@dataclass(frozen=True)
class Answer:
    """What a command did. changed: files that it wrote, changed or removed."""

    status: int
    output: str
    last_line: str
    changed: tuple[str, ...]


def answer(cell: Cell, folder: Path, home: Path) -> Answer:
    """Run a cell's command in ``folder``, which is new. home: of the owner, or of another one."""
    own = OWNERS.get(cell.printer)
    if own is None:
        folder.mkdir()
    else:
        shutil.copytree(home, folder, ignore=shutil.ignore_patterns("recordings"))
    with chdir(folder):
        words = [each for word in cell.words.split() for each in _expanded(word, cell, home)]
        if cell.printer not in OWNERS and words[0] not in NO_PROFILE:
            words += ["-p", cell.printer]
        configuration = folder / "config"
        default = configuration / "hframe-post" / "config.toml"
        default.parent.mkdir(parents=True, exist_ok=True)
        if own is not None:
            default.write_text(f'printer = "{folder / PROFILE}"\n')
        before = listing(folder)
        done = run(
            *words, XDG_CONFIG_HOME=str(configuration), HOME=str(folder),
            HFRAME_PRINTER="" if own else cell.printer,
        )  # fmt: skip
        after = listing(folder)
    output = (done.stdout + done.stderr).decode()
    lines = (done.stderr.strip() or done.stdout.strip()).decode().splitlines() or [""]
    changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    return Answer(done.returncode, output, lines[-1], tuple(changed))


def listing(folder: Path) -> dict[str, str]:
    """Return a digest of each file below a folder; a folder has none."""
    return {
        os.fspath(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def _expanded(word: str, cell: Cell, home: Path) -> list[str]:
    """Return what stands for a word such as {print}; the files that it names are made."""
    printer = cell.printer
    if not word.startswith("{"):
        return [word]
    if word == "{print}":
        return put_print()
    if word == "{recordings}":
        return put_recordings(home / "recordings")
    if word == "{checked}":
        return put_run(printer)
    if word == "{form}":
        return put_form()
    if word == "{config}":
        return list(OWNERS[printer].configuration)
    assert word == "{folder}", word
    Path("there").mkdir()
    return ["there"]
