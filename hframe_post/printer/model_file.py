"""The model of a machine in a file of its own: what identify, check and calibrate-print measured.

A profile, ``printer.toml``, belongs to its owner, and its keys count. It names its model, a file
next to it such as ``printer.model.toml``, which these commands overwrite each time.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from hframe_post.arrays import TS, Array
from hframe_post.errors import PrinterError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import MICRORAD, parse, shipped, text_of
from hframe_post.printer.settings import Printer

DIGITS = 4  # after the point of a response's µm or µrad
WINDOW = ("L", "n_C", "n_up", "effort")  # of [compensation]


def model_path(profile: str | Path) -> Path:
    """Return the file next to a profile in which its model is written."""
    return Path(profile).with_suffix(".model.toml")


@dataclass(frozen=True, slots=True)
class Texts:
    """A profile that names its model, that model, and the printer that both describe."""

    profile: str
    model: str
    printer: Printer


def measured(
    printer: Printer, plant: Plant, uncertainty: float | None, day: date | None
) -> Printer:
    """Return a printer with a plant that was measured on it; the mass of its bed stays.

    uncertainty: share by which the printer may differ from the plant. A printer that compensated
    nothing compensates racking, and one whose plant racks is an H-bot, which Klipper calls corexy,
    too.
    """
    kinematics, compensation = printer.kinematics, printer.compensation
    if plant.Gxtheta is not None and kinematics.type == "corexy":
        kinematics = replace(kinematics, type="hbot")
    if compensation.strategy == "none":
        compensation = replace(compensation, strategy="racking")
    return replace(
        printer, plant=replace(plant, bed=printer.plant.bed), kinematics=kinematics,
        compensation=compensation, invented=False, uncertainty=uncertainty, measured=day,
        verified=None,
    )  # fmt: skip


def texts(
    printer: Printer, source: str, target: str | Path, notes: Sequence[str] | None = None,
    text: str | None = None,
) -> Texts:  # fmt: skip
    """Return a profile's text that names its model, and the text of the model.

    printer: has the plant and the windows to write. source: name or file of the profile that it
    was loaded from; a shipped one is extended, not copied. target: file that the profile will be.
    notes: comments of the plant; None keeps those of the present model. text: of the source, if
    it is in no file. Raises PrinterError if the source cannot be changed safely.
    """
    before, newline = _text_and_newline(source) if text is None else (text, "\n")
    if notes is None:
        notes = list(_notes(source))
    profile = _naming(before, model_path(target).name, printer, source)
    model = "".join(_lines(printer, notes))
    loaded = parse(profile, Path(target).stem, str(target), model)
    if printer.verified is not None:
        mark = replace(printer.verified, model=loaded.model)
        model += "\n" + tomlkit.dumps({"verified": {
            "date": mark.date, "reduction": mark.reduction, "firmware": mark.firmware,
            "model": mark.model,
        }})  # fmt: skip
    return Texts(profile.replace("\n", newline), model, loaded)


def _text_and_newline(source: str) -> tuple[str, str]:
    """Return the text of a profile and its line end. A shipped profile is extended."""
    if source in shipped():
        return f'extends = "{source}"\n', "\n"
    text = text_of(source)
    if 0 < text.count("\n") == text.count("\r\n"):
        return text.replace("\r\n", "\n"), "\r\n"
    return text, "\n"


def named_model(profile: str) -> list[Path]:
    """Return the file of the model that a profile names, if it names one."""
    name = tomllib.loads(text_of(profile)).get("model")
    return [] if name is None else [Path(profile).parent / name]


def _notes(source: str) -> Iterator[str]:
    """Yield the comments of the plant in a model, or in a profile that contains its plant."""
    if source in shipped():
        return
    text = text_of(str([Path(source), *named_model(source)][-1]))
    _, _, plant = text.partition("\n[plant]")
    for line in plant.splitlines()[1:]:
        if not line.startswith("#"):
            return
        yield line[1:].removeprefix(" ")


def _naming(text: str, model: str, printer: Printer, source: str) -> str:
    """Return a profile's text that names a model, without what the model contains."""
    now, before = printer, parse(text, source, source)
    try:
        document: Any = tomlkit.parse(text)
        for name in ("model", "plant", "verified"):
            document.pop(name, None)
        if (found := document.get("compensation")) is not None:
            for key in WINDOW:
                found.pop(key, None)
            if not found and "#" not in found.as_string():
                document.pop("compensation")
        for table, key, value, old in (
            ("kinematics", "type", now.kinematics.type, before.kinematics.type),
            ("compensation", "strategy", now.compensation.strategy, before.compensation.strategy),
        ):
            if value != old:
                if table not in document:
                    document.append(table, tomlkit.table())
                document[table][key] = value
        named = f'model = "{model}"\n{document.as_string().rstrip()}\n'
        changed = tomllib.loads(named) != tomllib.loads(text)
    except (TOMLKitError, ValueError, RecursionError):
        advice = f'this file cannot be changed safely: write model = "{model}" in its first line'
        raise PrinterError(advice, "model", source) from None
    return named if changed else text


def _lines(printer: Printer, notes: Sequence[str]) -> Iterator[str]:
    """Yield the text of a model.

    Without racking it has a gain of zero, since the profile that is extended may rack.
    """
    plant, found = printer.plant, printer.compensation
    yield "# Written by hframe-post: what it measured. The profile's own keys count more.\n\n"
    yield f"[compensation]\nL = {found.L}\nn_C = {found.n_C}\nn_up = {found.n_up}\n"
    yield f"effort = {[*found.effort]}\n"
    yield "\n[plant]\n"
    for note in notes:
        yield f"# {note}".rstrip() + "\n"
    yield f"invented = {str(printer.invented).lower()}\n"
    if printer.uncertainty is not None:
        yield f"uncertainty = {printer.uncertainty!r}\n"
    if printer.measured is not None:
        yield f'measured = "{printer.measured}"\n'
    if plant.bed is not None:
        yield f"moving_mass = {plant.bed.mass!r}\n"
    yield f"Ts = {TS}\nx_c = {plant.x_c!r}\n"
    no_racking = ImpulseResponse(np.zeros(1), 0, rest=0.0)
    functions = {"Gxx": plant.Gxx, "Gyy": plant.Gyy, "Gxtheta": plant.Gxtheta or no_racking}
    for name, G in functions.items():
        yield f"\n[plant.{name}]\n{_linear(G, angle=name == 'Gxtheta')}"


def _linear(G: ImpulseResponse, angle: bool) -> str:
    """Return the lines of a response; angle: one in rad."""
    unit, name = (MICRORAD, "µrad") if angle else (1.0, "µm")
    lag, unknown = round(G.lag / unit, DIGITS), np.round(G.unknown / unit, DIGITS)
    lines = f"lead = {G.lead}\n"
    if lag:
        lines += f"lag = {lag!r}  # {name} behind at 1 mm/s\n"
    if G.drift:
        lines += f"drift = {G.drift!r}  # standard deviation of all frequencies\n"
    if len(unknown):
        lines += "unknown = [  # standard deviation of what is not known, likewise\n"
        lines += f"{_rows(unknown)}]\n"
    lines += f"deviation = [  # {name} at each ms, by a pulse of 1000 mm/s² for 1 ms\n"
    return f"{lines}{_rows(np.round(G.deviation / unit, DIGITS))}]\n"


def _rows(values: Array) -> str:
    shown = [f"{value:.{DIGITS}f}" for value in (values + 0.0).tolist()]  # no negative zero
    rows = (", ".join(shown[k : k + 10]) for k in range(0, len(shown), 10))
    return "".join(f"    {row},\n" for row in rows)
