"""Tallies: what stages note of a stream, in dataclasses that say how two parts are joined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, fields, is_dataclass, replace
from typing import Any, TypeVar

T = TypeVar("T")


def tallied(default: Any, join: Callable[[Any, Any], Any]) -> Any:
    """Return a field of a tally that two parts join by a function, such as ``max``."""
    return field(default=default, metadata={"join": join})


def joined(one: T, later: T) -> T:
    """Return the tally of a stream from those of its two parts; it may change the first.

    Fields are added unless they are ``tallied`` in another way. Dictionaries are joined by key,
    and what has a method ``join`` by that. None is the tally of nothing.
    """
    return _joined(one, later)  # type: ignore[no-any-return]


def _joined(one: Any, later: Any) -> Any:
    if one is None or later is None:
        return later if one is None else one
    if isinstance(one, dict):
        both = (key for key in later if key in one)
        return {**one, **later, **{key: _joined(one[key], later[key]) for key in both}}
    if hasattr(one, "join"):
        one.join(later)
        return one
    if not is_dataclass(one) or isinstance(one, type):
        return one + later
    pairs = ((each, getattr(one, each.name), getattr(later, each.name)) for each in fields(one))
    kept = {each.name: each.metadata.get("join", _joined)(*pair) for each, *pair in pairs}
    return replace(one, **kept)
