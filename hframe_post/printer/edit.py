"""Profiles as TOML text: changes that keep the rest of it, comments included."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import PrinterError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Coupling, Plant
from hframe_post.printer.profile import (
    AXES,
    FUNCTION,
    MICRORAD,
    model_digest,
    parse,
    shipped,
    text_of,
)

Windows = tuple[Window, Window]
Settings = Mapping[str, dict[str, Any]]  # by the names of their tables
DIGITS, IN_A_LINE = 4, 10  # after the point of a response's µm or µrad; numbers


def with_windows(
    name_or_path: str, windows: Windows, limits: Mapping[str, float] | None = None
) -> str:
    """Return a profile's text with these windows. A shipped profile is extended, not copied.

    limits: changes to [limits]. Raises PrinterError if the text cannot be changed safely.
    """
    tables = {"compensation": _settings(windows), **({"limits": dict(limits)} if limits else {})}
    return _changed(name_or_path, tables)


def with_bands(name_or_path: str, avoid: Sequence[tuple[int, int]]) -> str:
    """Return a profile's text with bands of motor speed that outer walls avoid, mm/s.

    Raises PrinterError if the text cannot be changed safely.
    """
    return _changed(name_or_path, {"speed": {"avoid": [list(band) for band in avoid]}})


def with_plant(
    name_or_path: str, plant: Plant, windows: Windows, notes: Sequence[str],
    uncertainty: float | None = None, text: str | None = None, measured: date | None = None,
) -> str:  # fmt: skip
    """Return a profile's text with this plant, these windows, and notes as comments.

    A shipped profile is extended, not copied. The plant counts as measured, and a profile that
    compensated nothing compensates racking. uncertainty: share by which the printer may differ
    from the plant, if known. text: of the profile, if it is in no file. measured: day of the
    recordings. Raises PrinterError if the text cannot be changed safely.
    """
    source = _text_and_newline(name_or_path) if text is None else (text, "\n")
    before = parse(source[0], name_or_path)
    strategy = {"strategy": "racking"} if before.compensation.strategy == "none" else {}
    tables = {"compensation": {**_settings(windows), **strategy}}
    if plant.Gxtheta is not None and before.kinematics.type == "corexy":
        tables["kinematics"] = {"type": "hbot"}  # which Klipper calls corexy, too
    table = _plant(replace(plant, bed=before.plant.bed), notes, uncertainty, measured)
    return _changed(name_or_path, tables, table, ("plant", "verified"), source)


def with_check(
    name_or_path: str,
    moved: Mapping[str, ImpulseResponse],
    uncertainty: float,
    measured: date | None,
) -> str:
    """Return a profile's text with responses of axes that drifted; comments and the rest stay.

    moved: by Gxx and Gyy. measured: day of the recordings; None leaves that of the profile. The
    mark of `verify` stays: a check moves a model no farther than printers drift. Raises
    PrinterError if the text cannot be changed safely.
    """
    text, newline = _text_and_newline(name_or_path)
    table: dict[str, Any] = {"uncertainty": uncertainty}
    if measured is not None:
        table["measured"] = measured.isoformat()
    table |= _functions(moved)
    changed = _changed(name_or_path, {"plant": table}, source=(text, "\n"))
    if parse(text, name_or_path).verified is not None:
        mark = {"verified": {"model": model_digest(changed)}}
        changed = _changed(name_or_path, mark, source=(changed, "\n"))
    return changed.replace("\n", newline)


def _functions(moved: Mapping[str, ImpulseResponse]) -> dict[str, Any]:
    tables = dict[str, Any]()
    for name, G in moved.items():
        tables[name] = _response(G)
        if G.elsewhere:
            tables[name]["x"] = G.x
            tables[name]["places"] = [
                {"x": one.x, "frequency": one.frequency, **_response(one.G)} for one in G.elsewhere
            ]
    return tables


def _response(G: ImpulseResponse) -> dict[str, Any]:
    return {"lead": G.lead, "deviation": _rounded(G.deviation, 1.0), **_known(G, 1.0)}


def with_verification(name_or_path: str, date: str, reduction: float) -> str:
    """Return a profile's text with the mark of `verify`.

    Raises PrinterError if the text cannot be changed safely.
    """
    text, newline = _text_and_newline(name_or_path)
    firmware = parse(text, name_or_path).firmware.dialect
    mark = {"date": date, "reduction": round(reduction, 4), "firmware": firmware,
            "model": model_digest(text)}  # fmt: skip
    table = tomlkit.dumps({"verified": mark})
    changed = _changed(name_or_path, {}, table, ("verified",), (text, newline))
    if parse(changed, name_or_path).verified is None:
        raise PrinterError("the mark does not fit this model", "verified", name_or_path)
    return changed


def _changed(
    name_or_path: str, tables: Settings, appended: str = "", dropped: Sequence[str] = (),
    source: tuple[str, str] | None = None,
) -> str:  # fmt: skip
    """Return the profile's text with these settings, and with TOML that replaces some tables.

    source: its text and line end, by default those of its file.
    """
    text, newline = source or _text_and_newline(name_or_path)
    try:
        before = tomllib.loads(text)
        kept = {name: table for name, table in before.items() if name not in dropped}
        settings = {name: {**before.get(name, {}), **new} for name, new in tables.items()}
        changed = _edited(text, tables, appended, dropped)
        if tomllib.loads(changed) != {**kept, **settings, **tomllib.loads(appended)}:
            raise ValueError("more was changed than intended")
    except (TOMLKitError, ValueError, RecursionError):
        advice = (
            "this file cannot be changed safely: start a new one that extends a shipped profile"
        )
        if not appended:
            lines = (f"{key} = {value}" for new in tables.values() for key, value in new.items())
            advice = f"write these lines yourself: {', '.join(lines)}"
        raise PrinterError(advice, next(iter(tables), "verified"), name_or_path) from None
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


def _edited(text: str, tables: Settings, appended: str, dropped: Sequence[str]) -> str:
    document = tomlkit.parse(text)
    for name, settings in tables.items():
        if name not in document:
            document.append(name, tomlkit.table())
        _set(document[name], settings)
    if not appended:
        return document.as_string()
    for name in dropped:
        document.pop(name, None)
    return f"{document.as_string().rstrip()}\n\n{appended}"


def _set(table: Any, settings: Mapping[str, Any]) -> None:
    for key, value in settings.items():
        if isinstance(value, dict) and key in table:
            if "deviation" in value:  # takes the place of poles and zeros
                for old in set(FUNCTION).intersection(table[key]):
                    table[key].remove(old)
            _set(table[key], value)
        elif isinstance(value, list) and len(table.get(key, ())) == len(value):
            for k, one in enumerate(value):  # one by one, so that comments between them stay
                if isinstance(one, dict):
                    _set(table[key][k], one)
                else:
                    table[key][k] = one
        elif key == "deviation":
            table[key] = tomlkit.array(f"[\n{_rows(value)}]")
        else:
            table[key] = value


def _plant(
    plant: Plant, notes: Sequence[str], uncertainty: float | None, measured: date | None
) -> str:
    """Return the table ``plant`` with notes, and its transfer functions.

    Without racking it has a gain of zero, since the profile that is extended may rack.
    """
    no_racking = ImpulseResponse(np.zeros(1), 0, rest=0.0)
    functions = {"Gxx": plant.Gxx, "Gyy": plant.Gyy, "Gxtheta": plant.Gxtheta or no_racking}
    comments = "".join(f"# {note}".rstrip() + "\n" for note in notes)
    known = "" if uncertainty is None else f"uncertainty = {uncertainty!r}\n"
    known += "" if measured is None else f'measured = "{measured}"\n'
    known += "" if plant.bed is None else f"moving_mass = {plant.bed.mass!r}\n"
    head = f"[plant]\n{comments}invented = false\n{known}Ts = {TS}\nx_c = {plant.x_c!r}\n"
    tables = [
        f"\n[plant.{name}]\n{_linear(G, f'plant.{name}', angle=name == 'Gxtheta')}"
        for name, G in functions.items()
    ]
    return "".join([head, *tables, *map(_coupling, plant.cross)])


def _coupling(coupling: Coupling) -> str:
    names = {axis: name for name, axis in AXES.items()}
    axes = f'answer = "{names[coupling.answer]}"\ncommand = "{names[coupling.command]}"\n'
    if coupling.along is not None:
        axes += f'along = "{names[coupling.along]}"\ncentre = {coupling.centre!r}\n'
    return (
        f"\n[[plant.cross]]\n{axes}{_linear(coupling.G, 'plant.cross', coupling.along is not None)}"
    )


def _linear(G: ImpulseResponse, table: str, angle: bool) -> str:
    """Return the lines of a response; angle: one in rad.

    table: its name in the profile.
    """
    unit, name = (MICRORAD, "µrad") if angle else (1.0, "µm")
    comment = f"{name} at each ms, by a pulse of 1000 mm/s² for 1 ms"
    lines = f"lead = {G.lead}\n"
    for key, value in _known(G, unit).items():
        if isinstance(value, list):
            lines += _list(key, value, "standard deviation of what is not known, likewise")
        else:
            late = f"{name} behind at 1 mm/s"
            meaning = late if key == "lag" else "standard deviation of all frequencies"
            lines += f"{key} = {value!r}  # {meaning}\n"
    lines += f"x = {G.x!r}  # mm, where it holds\n" if G.elsewhere else ""
    lines += _list("deviation", _rounded(G.deviation, unit), comment)
    for one in G.elsewhere:
        lines += f"\n[[{table}.places]]\nx = {one.x!r}\nfrequency = {one.frequency!r}\n"
        lines += _linear(one.G, table, angle)
    return lines


def _known(G: ImpulseResponse, unit: float) -> dict[str, Any]:
    """Return a response's lag, drift and unknown in the profile's units, those that are not 0."""
    (lag,) = _rounded(np.array([G.lag]), unit)
    known = {"lag": lag, "drift": G.drift, "unknown": _rounded(G.unknown, unit)}
    return {key: value for key, value in known.items() if value}


def _rounded(values: Array, unit: float) -> list[float]:
    """Return values in the profile's units, to DIGITS."""
    return [float(value) for value in np.round(values / unit, DIGITS) + 0.0]


def _list(key: str, values: Sequence[float], comment: str) -> str:
    return f"{key} = [  # {comment}\n{_rows(values)}]\n"


def _rows(values: Sequence[float]) -> str:
    shown = [f"{value:.{DIGITS}f}" for value in values]
    rows = (", ".join(shown[k : k + IN_A_LINE]) for k in range(0, len(shown), IN_A_LINE))
    return "".join(f"    {row},\n" for row in rows)


def _pairs(roots: Complex) -> str:
    pairs = (f"    [{root.real!r}, {root.imag!r}],\n" for root in (roots + 0.0).tolist())
    return "\n" + "".join(pairs) if len(roots) else ""
