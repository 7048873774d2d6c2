"""TOML tables → frozen dataclasses: every key known, typed and within its bounds."""

from __future__ import annotations

from dataclasses import MISSING, Field, field, fields
from difflib import get_close_matches
from typing import Any, TypeVar, get_type_hints

import numpy as np

from hframe_post.arrays import Complex
from hframe_post.errors import PrinterError

T = TypeVar("T")
LARGEST = 1e15  # a number beyond is a mistake


def positive(default: float | None = None, **bounds: float) -> Any:
    """A field that must be above zero, and within more ``bounds`` (``least``, ``below``)."""
    rules = {"above": 0.0, **bounds}
    if default is None:
        return field(metadata=rules)
    return field(default=default, metadata=rules)


def not_negative(default: float | None = None) -> Any:
    """A field that may be zero."""
    if default is None:
        return field(metadata={"least": 0.0})
    return field(default=default, metadata={"least": 0.0})


def roots(pairs: Any, key: str) -> Complex:
    """Complex roots from pairs [real, imaginary]."""
    if not isinstance(pairs, list):
        raise PrinterError("must be a list of pairs [real, imaginary]", key)
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2:
            raise PrinterError("roots are pairs [real, imaginary] of numbers", key)
    numbers = [[checked_value(float, number, {}, key) for number in pair] for pair in pairs]
    return np.array([complex(*pair) for pair in numbers], dtype=np.complex128)


def checked(kind: type[T], table: dict[str, Any], path: str) -> T:
    """A dataclass from a TOML table: every key known, typed and within its bounds."""
    hints = get_type_hints(kind)
    members: tuple[Field[Any], ...] = fields(kind)  # type: ignore[arg-type]
    known_keys(table, tuple(m.name for m in members), path)
    values = {}
    for member in members:
        key = f"{path}.{member.name}"
        if member.name in table:
            hint = hints[member.name]
            values[member.name] = checked_value(hint, table[member.name], member.metadata, key)
        elif member.default is MISSING:
            raise PrinterError("the key is missing", key)
    return kind(**values)


def checked_value(hint: Any, value: Any, rules: Any, key: str) -> Any:
    """One value of the type ``hint``, within the rules of its field."""
    if hint in (str, bool):
        if not isinstance(value, hint):
            kind = "text" if hint is str else "true or false"
            raise PrinterError(f"must be {kind}, not {value!r}", key)
        _known_choice(value, rules, key)
        return value
    if hint == tuple[float, float]:
        if not isinstance(value, list) or len(value) != 2:
            raise PrinterError("must be a list of two numbers", key)
        low, high = (checked_value(float, v, rules, key) for v in value)
        if rules.get("ascending") and not low < high:
            raise PrinterError(f"least {low:g} is not below greatest {high:g}", key)
        return low, high
    if hint not in (int, float):
        return value
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not abs(value) < LARGEST or (hint is int and value != int(value)):
        raise PrinterError(f"must be a {'whole ' if hint is int else ''}number", key)
    if "above" in rules and not value > rules["above"]:
        raise PrinterError(f"must be above {rules['above']:g}, it is {value:g}", key)
    if "least" in rules and not value >= rules["least"]:
        raise PrinterError(f"must be at least {rules['least']:g}, it is {value:g}", key)
    if "below" in rules and not value < rules["below"]:
        raise PrinterError(f"must be below {rules['below']:g}, it is {value:g}", key)
    _known_choice(value, rules, key)
    return hint(value)


def _known_choice(value: Any, rules: Any, key: str) -> None:
    if value not in rules.get("choices", (value,)):
        choices = (c if isinstance(c, str) else f"{c:g}" for c in rules["choices"])
        raise PrinterError(f"must be one of {', '.join(choices)}", key)


def known_keys(table: dict[str, Any], known: tuple[str, ...], path: str) -> None:
    """Raises PrinterError, with the nearest known key, where one is unknown."""
    for key in table:
        if key not in known:
            near = get_close_matches(key, known, n=1, cutoff=0.0)
            where = f"{path}.{key}" if path else key
            raise PrinterError(f"unknown key; nearest known is {near[0]!r}", where)
