"""Changes to a profile's TOML text that keep the rest of it, comments included."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from hframe_post.arrays import TS, Complex
from hframe_post.errors import PrinterError
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.profile import model_digest, parse, shipped, text_of

CANNOT_CHANGE = "this file cannot be changed safely: extend a shipped profile in a new one"
Windows = tuple[Window, Window]
Tables = Mapping[str, dict[str, Any]]  # settings, by the names of their tables


def with_windows(
    name_or_path: str, windows: Windows, limits: Mapping[str, float] | None = None
) -> str:
    """Return a profile's text with these windows. A shipped profile is extended, not copied.

    limits: changes to [limits]. Raises PrinterError if the text cannot be changed safely.
    """
    tables = {"compensation": _settings(windows), **({"limits": dict(limits)} if limits else {})}
    return _changed(name_or_path, tables, "")


def with_plant(
    name_or_path: str, plant: Plant, windows: Windows, notes: Sequence[str],
    uncertainty: float | None = None,
) -> str:  # fmt: skip
    """Return a profile's text with this plant, these windows, and notes as comments.

    A shipped profile is extended, not copied. The plant counts as measured: ``invented`` is
    removed, and a profile that compensated nothing compensates racking. uncertainty: share by
    which the printer may differ from the plant, if known. Raises PrinterError if the text cannot
    be changed safely.
    """
    before = parse(_text_and_newline(name_or_path)[0], name_or_path)
    strategy = {"strategy": "racking"} if before.compensation.strategy == "none" else {}
    tables = {"compensation": {**_settings(windows), **strategy}}
    table = _plant(plant, notes, before.invented, uncertainty)
    return _changed(name_or_path, tables, table)


def with_verification(name_or_path: str, date: str, reduction: float) -> str:
    """Return a profile's text with the mark of `verify`.

    Raises PrinterError if the text cannot be changed safely.
    """
    text, newline = _text_and_newline(name_or_path)
    firmware = parse(text, name_or_path).firmware.dialect
    mark = {"date": date, "reduction": round(reduction, 4), "firmware": firmware,
            "model": model_digest(text)}  # fmt: skip
    try:
        document = tomlkit.parse(text)
        document.pop("verified", None)
        table = tomlkit.dumps({"verified": mark})
        changed = f"{document.as_string().rstrip()}\n\n{table}"
        if tomllib.loads(changed) != {**tomllib.loads(text), "verified": mark}:
            raise ValueError("more was changed than intended")
    except (TOMLKitError, ValueError, RecursionError):
        advice = (
            "this file cannot be changed safely: start a new one that extends a shipped profile"
        )
        raise PrinterError(advice, "verified", name_or_path) from None
    if parse(changed, name_or_path).verified is None:
        raise PrinterError("the mark does not fit this model", "verified", name_or_path)
    return changed.replace("\n", newline)


def _changed(name_or_path: str, tables: Tables, plant: str) -> str:
    """Return the profile's text with these settings and, unless empty, this table ``plant``."""
    text, newline = _text_and_newline(name_or_path)
    try:
        changed = _edited(text, tables, plant)
        if tomllib.loads(changed) != _merged(text, tables, plant):
            raise ValueError("more was changed than intended")
    except (TOMLKitError, ValueError, RecursionError):
        lines = ", ".join(
            f"{key} = {value}" for settings in tables.values() for key, value in settings.items()
        )
        advice = f"write these lines yourself: {lines}"
        if plant:
            advice = (
                "this file cannot be changed safely: start a new one that extends a shipped profile"
            )
        raise PrinterError(advice, next(iter(tables)), name_or_path) from None
    parse(changed, name_or_path)  # raises if it cannot be loaded
    return changed.replace("\n", newline)


def _text_and_newline(name_or_path: str) -> tuple[str, str]:
    """Return the text to change and its line end. A shipped profile is extended."""
    if name_or_path in shipped():
        return f'extends = "{name_or_path}"\n', "\n"
    text = text_of(name_or_path)
    if 0 < text.count("\n") == text.count("\r\n"):
        return text.replace("\r\n", "\n"), "\r\n"
    return text, "\n"


def _settings(windows: Windows) -> dict[str, Any]:
    x, y = windows
    effort = [float(x.effort), float(y.effort)]
    return {"L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": effort}


def _edited(text: str, tables: Tables, plant: str) -> str:
    document = tomlkit.parse(text)
    for name, settings in tables.items():
        if name not in document:
            document.append(name, tomlkit.table())
        table: Any = document[name]
        for key, value in settings.items():
            if isinstance(value, list) and len(table.get(key, ())) == len(value):
                for k, number in enumerate(value):  # one by one, so that comments between them stay
                    table[key][k] = number
            else:
                table[key] = value
    if not plant:
        return document.as_string()
    document.pop("plant", None)
    document.pop("verified", None)  # for another plant
    return f"{document.as_string().rstrip()}\n\n{plant}"


def _merged(text: str, tables: Tables, plant: str) -> dict[str, Any]:
    """Return the contents that the changed text must have."""
    before = tomllib.loads(text)
    if plant:
        before.pop("verified", None)
    changed = {name: {**before.get(name, {}), **settings} for name, settings in tables.items()}
    return {**before, **changed, **tomllib.loads(plant)}


def _plant(
    plant: Plant, notes: Sequence[str], was_invented: bool, uncertainty: float | None
) -> str:
    """Return the table ``plant`` with notes, and its transfer functions.

    Without racking it has a gain of zero, since the profile that is extended may rack.
    """
    no_racking = TransferFunction(np.zeros(0, complex), np.zeros(0, complex), 0.0)
    functions = {"Gxx": plant.Gxx, "Gyy": plant.Gyy, "Gxtheta": plant.Gxtheta or no_racking}
    comments = "".join(f"# {note}".rstrip() + "\n" for note in notes)
    measured = "invented = false\n" if was_invented else ""
    known = "" if uncertainty is None else f"uncertainty = {uncertainty!r}\n"
    head = f"[plant]\n{comments}{measured}{known}Ts = {TS}\nx_c = {plant.x_c!r}\n"
    return head + "".join(_transfer_function(name, G) for name, G in functions.items())


def _transfer_function(name: str, G: TransferFunction) -> str:
    roots = {"zeros": G.zeros, "poles": G.poles}
    lists = "".join(f"{key} = [{_pairs(values)}]\n" for key, values in roots.items())
    return f"\n[plant.{name}]\ngain = {G.gain!r}\n{lists}"


def _pairs(roots: Complex) -> str:
    pairs = (f"    [{root.real!r}, {root.imag!r}],\n" for root in (roots + 0.0).tolist())
    return "\n" + "".join(pairs) if len(roots) else ""
