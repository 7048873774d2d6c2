"""Profiles with new settings from `setup`: what their owner changed by hand stays."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.items import Item, Table

from hframe_post.printer.profile import parse, without_guesses
from hframe_post.printer.setup import AS_BEFORE, Known, Tables

COMMENT = re.compile(r"# *(\[.*?\]|\".*?\"|[^\s(]+) \(")  # the value that `setup` wrote


@dataclass(frozen=True, slots=True)
class Updated:
    """A profile's text with newly found settings, and a line for each that it changes or keeps.

    kept: settings that differ from what was found, because their owner changed them.
    """

    text: str
    changes: list[str]
    kept: list[str]


def updated(text: str, tables: Tables, source: str = "") -> Updated:
    """Return a profile's text with newly found settings.

    A value that differs from the one that its comment begins with was changed by its owner, and
    stays. A table without settings is removed unless its owner changed it. Nothing else changes.
    Raises PrinterError.
    """
    document: Any = tomlkit.parse(without_guesses(text))
    own = changed_by_hand(text)
    changes, kept = list[str](), list[str]()
    if without_guesses(text) != text:
        changes.append("jerk, deceleration, motors: removed where nobody had changed them")
        if not document.get("motors", True):
            document.remove("motors")
    for name, table in tables.items():
        if not table and name in document and not any(key.startswith(f"{name}.") for key in own):
            document.remove(name)
            changes.append(f"[{name}]: removed, because the printer has none any more")
        for key, known in table.items():
            _update(_table_in(document, name), key, known, f"{name}.{key}", changes, kept)
    changed: str = document.as_string()
    parse(changed, "changed", source)  # raises if it cannot be loaded
    return Updated(changed, changes, kept)


def changed_by_hand(text: str) -> list[str]:
    """Return the settings of a profile that differ from what `setup` found, as "table.key"."""
    return list(_changed_in(tomlkit.parse(text), ""))


def _changed_in(table: Any, prefix: str) -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _changed_in(value, f"{prefix}{key}.")
        elif isinstance(value, Item):  # not true and false
            found = COMMENT.match(value.trivia.comment)
            if found and tomllib.loads(f"value = {found[1]}")["value"] != value.unwrap():
                yield f"{prefix}{key}"


def _table_in(document: Any, name: str) -> Any:
    for key, item in document.body:  # [firmware] may stand behind [firmware.klipper]
        if key and key.key == name and isinstance(item, Table) and not item.is_super_table():
            return item
    for part in name.split("."):
        if part not in document:
            document.add(part, tomlkit.table())
        document = document[part]
    return document


def _update(
    table: Any, key: str, known: Known, name: str, changes: list[str], kept: list[str]
) -> None:
    """Set a value unless it was changed by hand; add what is worth saying."""
    new = tomllib.loads(f"value = {known.as_toml()}")["value"]
    if key not in table:
        table.add(key, new)
        table.value.item(key).comment(known.comment())
        changes.append(f"{name} = {known.comment()}: added")
        return
    item = table.value.item(key)  # table[key] is a plain bool for true and false
    before = item.unwrap()
    found = COMMENT.match(item.trivia.comment)
    written = found[1] if found else None
    if before != new and (
        written is None or tomllib.loads(f"value = {written}")["value"] != before
    ):
        kept.append(
            f"{name} = {item.as_string()}: kept, because it was changed by hand; to take the "
            f"printer's, write {known.comment()}"
        )
    elif before != new:
        table[key] = new
        item = table.value.item(key)
        changes.append(f"{name} = {known.comment()}: it was {written}")
    if known.origin != AS_BEFORE and item.trivia.comment != (comment := f"# {known.comment()}"):
        space = item.trivia.comment_ws
        item.comment(comment)
        item.trivia.comment_ws = space or item.trivia.comment_ws
