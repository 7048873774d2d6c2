"""Where the head goes by Klipper's own modules, without a host.

gcode_move, exclude_object and gcode_arcs run as they are; only what they ask of the printer is a
stand-in. A file of some hundred thousand lines takes seconds, so that an object can be excluded at
many places.
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
        self.handlers = dict[str, list[Callable[[], object]]]()
        self.commands: dict[str, Callable[[Any], object]] = {}
        self.at = [0.0, 0.0, 0.0, 0.0]
        self.moves: list[tuple[float, ...]] = []
        self.speed = 0.0  # of the last move, mm/s
        self.respond_info = self.respond_raw = self.register_endpoint = lambda *_: None

    def register_command(
        self, name: str, handler: Callable[[Any], object], *_: object, **__: object
    ) -> None:
        self.commands[name] = handler

    def create_gcode_command(self, name: str, text: str, parameters: dict[str, str]) -> _Command:
        command = _Command(self, name, text)
        command.parameters = parameters
        return command

    def lookup_object(self, name: str, default: object = None) -> Any:
        return getattr(self, name) if name in EXTRAS else self

    def load_object(self, _: object, name: str) -> Any:
        return getattr(self, name)

    def get_printer(self) -> _Printer:
        return self

    def register_event_handler(self, event: str, handler: Callable[[], object]) -> None:
        self.handlers.setdefault(event, []).append(handler)

    def send_event(self, event: str) -> None:
        for handler in self.handlers.get(event, ()):
            handler()

    # ------------------------------------------------------------------ G-code

    def load(self) -> None:
        for name in EXTRAS:
            module = importlib.import_module(f"klippy.extras.{name}")
            setattr(self, name, module.load_config(self))
        self.send_event("klippy:ready")
        self.send_event("klippy:connect")

    def run_script(self, script: str) -> None:
        for line in script.splitlines():
            command = parsed(line, self)
            if handler := self.commands.get(command.name):
                handler(command)

    run_script_from_command = run_script

    # ------------------------------------------------------------------ the rest

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
        self.name, self.respond_raw = name, printer.respond_raw
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


def parsed(line: str, printer: _Printer | None = None) -> Any:
    """Return a line as a command, for a handler of Klipper's."""
    name, _, rest = line.partition(";")[0].strip().partition(" ")
    return _Command(printer or _Printer(), name.upper(), rest)


def _played(lines: Iterable[str]) -> tuple[_Printer, list[int]]:
    printer = _Printer()
    printer.load()
    before = list[int]()
    for line in lines:
        before.append(len(printer.moves))
        printer.run_script(line)
    return printer, before
