"""TOML tables → frozen dataclasses: every key known, typed and within its bounds."""

from __future__ import annotations

import codecs
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, asdict, field, fields, is_dataclass
from datetime import date
from difflib import get_close_matches
from operator import ge, gt, le, lt
from pathlib import Path
from types import NoneType
from typing import Any, TypeAlias, TypeVar, get_args, get_type_hints

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import PrinterError

T = TypeVar("T")
Rules: TypeAlias = Mapping[str, Any]  # a field's bounds, choices, ascending, count, pattern

KINDS = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}
BOUNDS: dict[str, tuple[Callable[[Any, Any], bool], str]] = {
    "above": (gt, "above"),
    "least": (ge, "at least"),
    "below": (lt, "below"),
    "most": (le, "at most"),
}


def positive(default: Any = MISSING, **bounds: float) -> Any:
    """Return a field that must be above zero and within these ``BOUNDS``."""
    return field(default=default, metadata={"above": 0.0, **bounds})


def not_negative(default: Any = MISSING, **bounds: float) -> Any:
    """Return a field that must be at least zero and within these ``BOUNDS``."""
    return field(default=default, metadata={"least": 0.0, **bounds})


def within(least: float, most: float, default: Any = MISSING) -> Any:
    return field(default=default, metadata={"least": least, "most": most})


def checked(kind: type[T], table: Any, path: str) -> T:
    """Return a dataclass from a TOML table. Raises PrinterError for a bad key or value."""
    if not isinstance(table, dict):
        raise PrinterError("the table is missing", path)
    hints = get_type_hints(kind)
    members: tuple[Field[Any], ...] = fields(kind)  # type: ignore[arg-type]
    known_keys(table, tuple(m.name for m in members), path)
    values = {}
    for member in members:
        key = f"{path}.{member.name}"
        if member.name in table:
            hint = hints[member.name]
            values[member.name] = checked_value(hint, table[member.name], member.metadata, key)
        elif member.default is MISSING and member.default_factory is MISSING:
            raise PrinterError("the key is missing", key)
    try:
        return kind(**values)
    except ValueError as error:  # values that do not go together
        raise PrinterError(str(error), path) from None


def checked_value(hint: Any, value: Any, rules: Rules, key: str) -> Any:
    """Return a value of the type ``hint``. Raises PrinterError if it breaks its field's rules.

    A list of ``count`` pairs or numbers has at most so many.
    """
    if NoneType in get_args(hint):  # such a default cannot be written, but left out
        hint = get_args(hint)[0]
    if hint in LISTS:
        return _list(hint, value, rules, key)
    if hint in (int, float):
        value = _number(hint, value, rules, key)
    elif hint in (str, bool) and not isinstance(value, hint):
        raise PrinterError(f"must be {KINDS[hint]}, not {value!r}", key)
    elif hint is str and not value.isprintable():
        raise PrinterError("must be one line of printable text", key)
    elif "pattern" in rules and not rules["pattern"].fullmatch(value):
        raise PrinterError(f"{value!r} is not the name of a command or macro", key)
    elif hint is date:
        return _day(value, key)
    choices = rules.get("choices")
    if choices is not None and value not in choices:
        shown = (choice if isinstance(choice, str) else f"{choice:g}" for choice in choices)
        raise PrinterError(f"must be one of {', '.join(shown)}", key)
    return value


def _list(hint: Any, value: Any, rules: Rules, key: str) -> Any:
    of, least, most, words, made = LISTS[hint]
    most = most or rules.get("count", math.inf)
    if not isinstance(value, list) or not least <= len(value) <= most:
        raise PrinterError(f"must be a list of {words.format(most)}", key)
    found = made([checked_value(of, each, rules, key) for each in value])
    if hint == PAIR and rules.get("ascending") and not found[0] < found[1]:
        raise PrinterError(f"least {found[0]:g} is not below greatest {found[1]:g}", key)
    return found


def _roots(pairs: list[tuple[float, float]]) -> Complex:
    return np.array([complex(*pair) for pair in pairs], dtype=np.complex128)


# By type: that of its members, how many at least and at most (0: the field's count), in words, and
# what makes it of a list
PAIR = tuple[float, float]
LISTS: dict[Any, tuple[Any, int, int, str, Callable[[list[Any]], Any]]] = {
    PAIR: (float, 2, 2, "two numbers", tuple),
    tuple[PAIR, ...]: (PAIR, 0, 0, "at most {} pairs of numbers", tuple),
    tuple[str, ...]: (str, 0, 0, "names", tuple),
    Array: (float, 1, 0, "1 to {} numbers", np.array),
    Complex: (PAIR, 0, 0, "at most {} roots, pairs [real, imaginary]", _roots),
}


def _day(value: Any, key: str) -> date:
    try:
        return date.fromisoformat(value)
    except (TypeError, ValueError):
        raise PrinterError(f'must be a day such as "2026-01-31", it is {value!r}', key) from None


def _number(hint: type[float], value: Any, rules: Rules, key: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not abs(value) < 1e15 or (hint is int and value != int(value)):
        raise PrinterError(f"must be {KINDS[hint]}", key)
    for rule, (holds, words) in BOUNDS.items():
        if rule in rules and not holds(value, rules[rule]):
            raise PrinterError(f"must be {words} {rules[rule]:g}, it is {value:g}", key)
    return hint(value)


STROKES = "Klipper is measured by strokes within [limits] ('hframe-post measure')"
FEED_RATES = "feed rates, and so the least time of layers, stay those of the slicer"


def digest_of(settings: Mapping[str, Any]) -> str:
    """Return a hash of settings by their names, in whatever order they stand."""

    def plain(value: Any) -> Any:
        return asdict(value) if is_dataclass(value) and not isinstance(value, type) else str(value)

    text = json.dumps(settings, sort_keys=True, default=plain)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


ONE_PLACE = "one response holds all along x: keep lead, lag and deviation, delete x and places"
OLD_KEYS = {
    **{f"sweep.{key}": STROKES for key in ("start_hz", "stroke", "sway", "quiet")},
    **dict.fromkeys(("limits.min_layer_time", "limits.min_print_speed"), FEED_RATES),
    "limits.deceleration": "prints brake as hard as they accelerate: limits.acceleration has both",
    "speed.speed_up": FEED_RATES,
    "speed.filament_acceleration": "limits.extruder_acceleration holds for any print",
    "speed.model_error": "max_error is compared with the range of the measured model",
    "speed.max_width_error": "the summary shows the error of the lines' width",
    **dict.fromkeys(
        ("limits.travel_velocity", "limits.travel_acceleration"), "slicers have both for travel"
    ),
    **{f"plant.{G}.{key}": ONE_PLACE for G in ("Gxx", "Gyy", "Gxtheta") for key in ("x", "places")},
    "plant.cross": "what x does to y differs from day to day, but for racking, which stays",
    "firmware.klipper.begin_macro": "the file sets the limits of its stream itself",
    "speed.avoid": "in the slicer, give outer walls a speed at which the motors shake less",
}


def known_keys(table: dict[str, Any], known: tuple[str, ...], path: str) -> None:
    """Raise PrinterError for an unknown key, with the nearest known one."""
    for key in table:
        if key not in known:
            if (gone := OLD_KEYS.get(f"{path}.{key}")) is not None:
                raise PrinterError(f"is gone, delete it: {gone}", f"{path}.{key}")
            near = get_close_matches(key, known, n=1, cutoff=0.0)
            where = f"{path}.{key}" if path else key
            raise PrinterError(f"unknown key; nearest known is {near[0]!r}", where)


# ----------------------------------------------------------------------
# Files of settings → text, whatever editor or shell wrote them.

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)  # as PowerShell's > writes it


MAX_FILE_BYTES = 1 << 22  # of a printer's description: no profile, printer.cfg or M503 has as many


def file_text(path: Path, hint: str) -> str:
    """Return a file's text without a byte order mark.

    Raises OSError, and PrinterError if it is too large (then with the hint) or not text.
    """
    with path.open("rb") as file:
        content = file.read(MAX_FILE_BYTES + 1)
    if len(content) > MAX_FILE_BYTES:
        raise PrinterError(f"larger than {MAX_FILE_BYTES} bytes: {hint}", source=str(path))
    try:
        return content.decode("utf-16" if content.startswith(UTF_16) else "utf-8-sig")
    except UnicodeError:
        cause = "cannot be read as text: save it as UTF-8"
        raise PrinterError(cause, source=str(path)) from None
