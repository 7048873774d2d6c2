"""Where the head goes by Klipper's own gcode_move, exclude_object and gcode_arcs, without a host.

These modules run as they are; only what they ask of the printer is a stand-in. A file of some
hundred thousand lines takes seconds, so that it can be interrupted at many places.
"""

from __future__ import annotations

import importlib
import re
from collections import namedtuple
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from hframe_post.arrays import Array

EXTRAS = "gcode_move", "exclude_object", "gcode_arcs"
WORD = re.compile(r"([A-Z])\s*([-+]?[\d.]+)")


class _Printer:
    """A printer without a configuration: stands in for it, for its parts, and for each command."""

    error = ValueError
    Coord = namedtuple("Coord", "x y z e")

    def __init__(self) -> None:
        self.commands: dict[str, Callable[[Any], object]] = {}
        self.at = [0.0, 0.0, 0.0, 0.0]
        self.moves: list[tuple[float, ...]] = []
        self.speed = 0.0  # of the last move, mm/s
        self.respond_info = lambda *_: None

    def register_command(
        self, name: str, handler: Callable[[Any], object], *_: object, **__: object
    ) -> None:
        self.commands[name] = handler

    def create_gcode_command(self, name: str, text: str, parameters: dict[str, str]) -> _Command:
        command = _Command(self, name, text)
        command.parameters = parameters
        return command

    def lookup_object(self, name: str, default: object = None) -> Any:
        return {"gcode_move": getattr(self, "gcode_move", None)}.get(name) or self

    def load_object(self, _: object, name: str) -> Any:
        return getattr(self, name)

    def get_printer(self) -> _Printer:
        return self

    def register_event_handler(self, *_: object) -> None: ...

    def is_active(self) -> bool:  # the tuning tower
        return False

    def getboolean(self, _: str, default: bool) -> bool:
        return default

    def getfloat(self, _: str, default: float, **__: object) -> float:
        return default

    # ------------------------------------------------------------------ the toolhead

    def get_extruder(self) -> _Printer:
        return self

    def get_name(self) -> str:
        return "extruder"

    def get_position(self) -> list[float]:
        return list(self.at)

    def move(self, place: list[float], speed: float) -> None:
        if place != self.at:
            self.speed = speed
            self.at = list(place)
            self.moves.append(tuple(place))


class _Command:
    """A line as Klipper's parser gives it to its commands."""

    def __init__(self, printer: _Printer, name: str, text: str) -> None:
        self._printer, self._text, self.respond_info = printer, text, printer.respond_info
        self.error = ValueError
        if re.fullmatch(r"[GM]\d+", name):
            self.parameters = dict(WORD.findall(text.upper()))
        else:
            self.parameters = dict(part.split("=", 1) for part in text.split() if "=" in part)

    def get_command_parameters(self) -> dict[str, str]:
        return self.parameters

    def get_commandline(self) -> str:
        return self._text

    def get(self, name: str, default: Any = None) -> Any:
        return self.parameters.get(name, default)

    def get_float(self, name: str, default: Any = None, **_: object) -> Any:
        return float(self.parameters[name]) if name in self.parameters else default

    get_int = get_float


def head(lines: Iterable[str]) -> tuple[Array, list[int]]:
    """Return where the head goes (n, 4), mm, and how many places it had seen before each line."""
    printer, before = _played(lines)
    return np.array(printer.moves), before


def speed(lines: Iterable[str]) -> float:
    """Return the feed rate, mm/s, of the last move."""
    return _played(lines)[0].speed


def parsed(line: str) -> Any:
    """Return a line as a command, for a handler of Klipper's."""
    name, _, rest = line.partition(";")[0].strip().partition(" ")
    return _Command(_Printer(), name.upper(), rest)


def _played(lines: Iterable[str]) -> tuple[_Printer, list[int]]:
    printer = _Printer()
    for name in EXTRAS:
        module = importlib.import_module(f"klippy.extras.{name}")
        setattr(printer, name, module.load_config(printer))
    move = printer.gcode_move  # type: ignore[attr-defined]
    move._handle_ready()  # its events
    printer.exclude_object._handle_connect()  # type: ignore[attr-defined]
    before = list[int]()
    for line in lines:
        before.append(len(printer.moves))
        name, _, rest = line.partition(";")[0].strip().partition(" ")
        if handler := printer.commands.get(name.upper()):
            handler(_Command(printer, name.upper(), rest))
    return printer, before
