"""New profiles, from what a firmware says of itself: each number, and where it came from.

A line of such a profile is ``acceleration = 8000    # max_accel of [printer]``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from hframe_post.printer.firmware_tables import TABLES as FIRMWARES
from hframe_post.printer.profile import TABLES
from hframe_post.printer.settings import Printer, Sweep

Value = float | tuple[float, ...] | tuple[tuple[float, float], ...] | tuple[str] | str | bool


@dataclass(frozen=True, slots=True)
class Known:
    """A value of a profile and its origin, in words.

    place: file and line that give it, if any. assumed: a file that was not found may say otherwise.
    """

    value: Value
    origin: str
    place: str = ""
    assumed: bool = False

    def as_toml(self) -> str:
        return _toml(self.value)


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return (
        json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else f"{value:.9g}"
    )


Tables = dict[str, dict[str, Known]]  # settings by table; a table without any does not exist


def as_float(known: Known) -> float:
    assert isinstance(known.value, float)
    return known.value


def sweep(acceleration: Known) -> dict[str, Known]:
    if as_float(acceleration) < (usual := Sweep().amplitude):
        return {"amplitude": acceleration}
    return {"amplitude": Known(usual, "usual; the acceleration above allows it")}


TITLES = {
    "kinematics": "how the belts move the nozzle",
    "travel": "where the nozzle may go",
    "limits": "until a file sets others; what differs from [firmware] also binds files",
    "steps": "mm per step",
    "retraction": "what G10 and G11 do",
    "extruder": "how late the flow follows it: pressure advance",
    "sweep": "the motion that measures the printer",
    "speed": "of --max-error: largest acceleration of the path",
}
# about what prints have without compensation
MAX_ERROR = """\
# max_error = 0.1
#   mm: print as fast as that allows; '--max-error 100um --dry-run' shows the time of an error."""
FIRMWARE = "firmware."  # how the name of a firmware's table begins


def profile_text(tables: Tables, description: str, model: str = "") -> str:
    """Return a new profile as TOML. model: file of its model, which 'identify' writes, if any."""
    (dialect,) = (name[len(FIRMWARE) :] for name in tables if name.startswith(FIRMWARE))
    others = dict(tables)
    firmware = "".join(f"{_line(*item)}\n" for item in others.pop("firmware", {}).items())
    named = f"model = {json.dumps(model)}\n" if model else ""
    settings = "\n".join(line for name, table in others.items() for line in _table(name, table))
    return f"""\
{named}# A profile for hframe-post, in mm and s. A comment says where a value was found; what is not
# here has its default. No command changes a value; what is measured goes into another file.

description = {json.dumps(description, ensure_ascii=False)}

{settings}
[firmware]
dialect = "{dialect}"
{firmware}
"""


def _table(name: str, table: dict[str, Known]) -> Iterator[str]:
    usual = {each.name: each.default for each in fields(_kind(name))}
    kept = [key for key, known in table.items() if known.value != usual[key] or key == "type"]
    if not table:
        return
    title = TITLES[name] if name in TITLES else _kind(name).title
    yield f"{f'[{name}]':24s}# {title}"
    for key in kept or [*table][:1]:  # that there is a table says something, too
        yield _line(key, table[key])
    if name == "speed":
        yield MAX_ERROR
    yield ""


def _kind(name: str) -> Any:
    """Return what a table of a profile becomes."""
    return FIRMWARES[name[len(FIRMWARE) :]] if name.startswith(FIRMWARE) else TABLES[name]


def _line(key: str, known: Known) -> str:
    return f"{f'{key} = {known.as_toml()}':32s}# {known.origin}"


# ----------------------------------------------------------------------
# What a firmware says, compared with a profile that exists.

ROUNDING = 1e-3  # share, mm and so on by which two numbers may differ
# what an owner chooses or calibrates, whatever the firmware says
CHOSEN = (
    "limits.velocity", "limits.acceleration", "limits.square_corner_velocity",
    "limits.junction_deviation", "speed.", "sweep.", "kinematics.",
    "firmware.other_tools", "firmware.klipper.end_macro", "steps.e",
)  # fmt: skip


class Finding(NamedTuple):
    """A difference from a profile, or what else is wrong with the files of a printer.

    wrong: the printer would not move as computed. place: file and line, if the text has none.
    """

    wrong: bool
    text: str
    place: str = ""


def differences(tables: Tables, printer: Printer) -> Iterator[Finding]:
    """Yield where a profile differs from what a firmware says of itself."""
    for name, table in tables.items():
        own = _table_of(printer, name)
        if own is None or not table:
            if own is not None:
                yield Finding(True, f"[{name}]: the printer has none any more")
            elif name.startswith(FIRMWARE):
                yield Finding(True, f"[{name}]: the profile has none")
            continue
        for key, known in table.items():
            has = getattr(own, key)
            if key == "return_speed":
                has = has or own.speed
            if known.assumed or _equal(known.value, has):
                continue
            inside = name == "travel" and _inside(has, known.value)
            wrong = not f"{name}.{key}".startswith(CHOSEN) and not inside
            found = f"{name}.{key}: {known.as_toml()} ({known.origin})"
            yield Finding(wrong, f"{found}, but the profile has {_toml(has)}", known.place)


def _table_of(printer: Printer, name: str) -> Any:
    """Return what a table of a profile has become; None if the profile has none."""
    if name.startswith(FIRMWARE):
        return printer.firmware.table(_kind(name))
    return getattr(printer, name)


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=ROUNDING, abs_tol=1e-9)
    return bool(one == other)


def _inside(has: tuple[float, float], known: Any) -> bool:
    return bool(known[0] - ROUNDING <= has[0] and has[1] <= known[1] + ROUNDING)
