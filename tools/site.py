"""Hooks of mkdocs: pages from outside docs/, links by title, and what is made from the code.

Made from the code are the keys of a profile, the options of all commands, and a reference of the
library.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import hframe_post as hp
from hframe_post.cli.main import COMMANDS, main
from hframe_post.printer import firmware_tables, profile

if TYPE_CHECKING:  # an extra, for the site alone
    from mkdocs.structure.files import Files

ROOT = Path(__file__).resolve().parents[1]
PAGES = {  # files of the project that are pages under another name
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
LINK = re.compile(r"\[([^][]*)\]\(([\w./-]+\.md)(#[^)]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not files of docs/."""
    from mkdocs.structure.files import File

    for source, page in PAGES.items():
        text = (ROOT / source).read_text("utf-8").replace("](docs/paper/", "](paper/")
        files.append(File.generated(config, page, content=text))
    names = [where(name) for name in hp.__all__ if name != "__version__"]
    text = "# Reference\n\n" + "\n".join(f"::: {name}" for name in names)
    files.append(File.generated(config, "reference.md", content=text))
    files.append(File.generated(config, "keys.md", content=keys()))
    files.append(File.generated(config, "options.md", content=options()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links lead to pages of the site, and name a page by its title instead of its file."""
    sources = {name: source for source, name in PAGES.items()}
    uri = page.file.src_uri
    folder = (ROOT / sources.get(uri, f"docs/{uri}")).parent

    def linked(found: re.Match[str]) -> str:
        words, target, anchor = found[1], found[2], found[3] or ""
        path = (folder / target).resolve()
        source = str(path.relative_to(ROOT))
        if words.removeprefix("docs/") in (target, path.name):
            words = path.read_text("utf-8").partition("\n")[0].removeprefix("# ")
        return f"[{words}]({PAGES.get(source, source.removeprefix('docs/'))}{anchor})"

    return LINK.sub(linked, markdown)


def where(name: str) -> str:
    """Return the full name of a public object, by the module that defines it."""
    thing = getattr(hp, name)
    return f"{thing.__module__}.{thing.__qualname__}"


TABLES = {  # of a profile, and what holds their keys
    **profile.TABLES,
    **{f"firmware.{name}": table for name, table in firmware_tables.TABLES.items()},
}  # fmt: skip


def keys() -> str:
    """Return the keys of a profile by table, with their bounds and defaults."""
    text = "# Keys of a profile\n\nIn mm and s; [printers.md](printers.md): what for.\n"
    for name, kind in TABLES.items():
        text += (
            f"\n## [{name}]\n\n{inspect.getdoc(kind) or ''}\n\n| key | type | bounds | default |\n"
        )
        text += "|---|---|---|---|\n"
        for one in fields(kind):
            row = one.name, f"`{one.type}`", _bounds(one.metadata), _default(one)
            text += f"| `{row[0]}` | {' | '.join(row[1:])} |\n"
    return text


def _bounds(rules: Mapping[str, Any]) -> str:
    words = {"above": ">", "least": "≥", "below": "<", "most": "≤"}
    found = [f"{sign} {rules[name]:g}" for name, sign in words.items() if name in rules]
    if "choices" in rules:
        found.append(", ".join(f"`{each}`" for each in rules["choices"]))
    return ", ".join(found)


def _default(one: Field[Any]) -> str:
    if one.default is MISSING and one.default_factory is MISSING:
        return "must be given"
    value = one.default if one.default_factory is MISSING else one.default_factory()
    return f"`{value}`"


def options() -> str:
    """Return what ``--help`` of each command says."""
    text = "# Options of the commands\n"
    for name in COMMANDS:
        command = main.get_command(click.Context(main), name)
        assert command is not None
        shown = command.get_help(click.Context(command, info_name=f"hframe-post {name}"))
        text += f"\n## {name}\n\n```\n{shown}\n```\n"
    return text
