"""New profiles, from what a firmware says of itself: each number, and where it came from.

A line of such a profile is ``acceleration = 8000    # max_accel of [printer]``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields

from hframe_post.printer.firmware_tables import TABLES
from hframe_post.printer.settings import Extruder, Limits, Retraction, Speed, Steps, Sweep

SWEEP_AMPLITUDE = 5000.0  # mm/s², unless max_accel is less

Value = float | tuple[float, ...] | tuple[tuple[float, float], ...] | tuple[str] | str | bool


@dataclass(frozen=True, slots=True)
class Known:
    """A value of a profile and its origin, in words."""

    value: Value
    origin: str

    def as_toml(self) -> str:
        return _toml(self.value)


def _toml(value: Value) -> str:
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
    if as_float(acceleration) < SWEEP_AMPLITUDE:
        return {"amplitude": acceleration}
    return {"amplitude": Known(SWEEP_AMPLITUDE, "usual; the acceleration above allows it")}


KINDS = {
    "limits": Limits, "steps": Steps, "retraction": Retraction, "extruder": Extruder,
    "sweep": Sweep, "speed": Speed,
    **{f"firmware.{name}": kind for name, kind in TABLES.items()},
}  # fmt: skip
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
# About what prints have without compensation; walls show it, infill does not.
MAX_ERROR = """\
# max_error = {outer-wall = 0.05, inner-wall = 0.1, infill = 0.2}
#   mm: print as fast as that allows; '--max-error 100um --dry-run' shows the time of an error.
#   The hot end counts as melting 15 mm³/s unless limits.flow says more or less. The limits of the
#   filament are read from files of OrcaSlicer, Bambu Studio, PrusaSlicer and Cura."""
FIRMWARE = "firmware."  # how the name of a firmware's table begins
COLUMN = 32


def profile_text(tables: Tables, description: str) -> str:
    """Return a new profile as TOML. It has no plant yet: 'identify' writes it."""
    (dialect,) = (name[len(FIRMWARE) :] for name in tables if name.startswith(FIRMWARE))
    others = dict(tables)
    firmware = "".join(f"{_line(*item)}\n" for item in others.pop("firmware", {}).items())
    settings = "\n".join(line for name, table in others.items() for line in _table(name, table))
    return f"""\
# A profile for hframe-post, in mm and s. A comment says where a value was found; what is not
# here has its default. No command changes this file; what is measured goes into another one.

description = {json.dumps(description, ensure_ascii=False)}

{settings}
[firmware]
dialect = "{dialect}"
{firmware}
"""


def unwritten(name: str) -> dict[str, object]:
    """Return the values of a table's keys where a profile does not have them."""
    return {each.name: each.default for each in fields(KINDS[name])} if name in KINDS else {}


def _table(name: str, table: dict[str, Known]) -> Iterator[str]:
    usual = unwritten(name)
    table = {key: known for key, known in table.items() if known.value != usual.get(key)}
    if not table:
        return
    own = name.startswith(FIRMWARE)
    title = TABLES[name[len(FIRMWARE) :]].title if own else TITLES[name]
    yield f"{f'[{name}]':24s}# {title}"
    for key, known in table.items():
        yield _line(key, known)
    if name == "speed":
        yield MAX_ERROR
    yield ""


def _line(key: str, known: Known) -> str:
    return f"{f'{key} = {known.as_toml()}':{COLUMN}s}# {known.origin}"
