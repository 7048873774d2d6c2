"""Hooks of mkdocs: pages from outside docs/, links by title, a reference from the docstrings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

import hframe_post as hp

ROOT = Path(__file__).resolve().parents[1]
PAGES = {  # files of the project that are pages under another name
    "README.md": "index.md",
    "docs/index.md": "pages.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
LINK = re.compile(r"\[([^][]*)\]\(([\w./-]+\.md)(#[^)]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not files of docs/."""
    for source, page in PAGES.items():
        text = (ROOT / source).read_text("utf-8").replace("](docs/paper/", "](paper/")
        files.append(File.generated(config, page, content=text))
    names = [where(name) for name in hp.__all__ if name != "__version__"]
    text = "# Reference\n\n" + "\n".join(f"::: {name}" for name in names)
    files.append(File.generated(config, "reference.md", content=text))
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
