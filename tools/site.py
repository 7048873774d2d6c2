"""Hooks of mkdocs: pages from outside docs/, and a reference from the docstrings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

import hframe_post as hp

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = {"README.md": "overview.md", "CONTRIBUTING.md": "contributing.md",
           "CHANGELOG.md": "changelog.md"}  # fmt: skip


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not files of docs/."""
    for source, page in OUTSIDE.items():
        text = (ROOT / source).read_text("utf-8").replace("](docs/", "](")
        files.append(File.generated(config, page, content=linked(text)))
    names = [where(name) for name in hp.__all__ if name != "__version__"]
    text = "# Reference\n\n" + "\n".join(f"::: {name}" for name in names)
    files.append(File.generated(config, "reference.md", content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Let links lead to the pages that were added."""
    return linked(markdown.replace("](../", "]("))


def linked(text: str) -> str:
    return re.sub(
        rf"\]\(({'|'.join(map(re.escape, OUTSIDE))})", lambda found: f"]({OUTSIDE[found[1]]}", text
    )


def where(name: str) -> str:
    """Return the full name of a public object, by the module that defines it."""
    thing = getattr(hp, name)
    return f"{thing.__module__}.{thing.__qualname__}"
