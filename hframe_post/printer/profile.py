"""Profiles: read from TOML and checked completely."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, field, fields, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import ArgumentError, PrinterError, one_line
from hframe_post.model.impulse_response import LONGEST, ImpulseResponse
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Bed, Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.firmware_tables import check_needs, load_firmware
from hframe_post.printer.schema import checked, digest_of, file_text, known_keys, within
from hframe_post.printer.settings import (
    PLACES,
    SHARE,
    Compensation,
    Extruder,
    Limits,
    Motors,
    Printer,
    Retraction,
    Speed,
    Steps,
    Sweep,
    Travel,
    Verified,
)

TABLES: dict[str, type[Any]] = {  # of a profile, and what they become
    "travel": Travel, "limits": Limits, "kinematics": Kinematics, "motors": Motors,
    "compensation": Compensation, "sweep": Sweep, "speed": Speed, "steps": Steps,
    "retraction": Retraction, "extruder": Extruder,
}  # fmt: skip
NEEDED, IF_GIVEN = ("travel", "limits"), ("steps", "retraction", "extruder")  # None without one
MEASURED = ("plant", "compensation", "speed", "verified")  # tables of a model
# a profile without a plant: the nozzle follows the motors exactly
NOT_MEASURED = {"Ts": TS} | {G: {"gain": 1.0, "zeros": [], "poles": []} for G in ("Gxx", "Gyy")}
MICRORAD = 1e-3  # rad per mm/sample² in which 1000 mm/s² during 1 ms cause 1 µrad
DEVIATIONS = {"least": -1e6, "most": 1e6, "count": LONGEST}  # µm or µrad of a response
ROOTS = {"least": -1e5, "most": 1e5, "count": 50}  # of a function: so their product is finite
KLIPPER_SECTION = re.compile(r"^\[(printer|mcu|stepper_x|include .*)\]\s*$", re.MULTILINE)


def shipped() -> dict[str, str]:
    """Return the TOML texts of the profiles that come with hframe-post, by name."""
    folder = Path(__file__).parent / "profiles"
    found = (f for f in folder.iterdir() if f.name.endswith(".toml"))
    return {f.name.removesuffix(".toml"): f.read_text("utf-8") for f in sorted(found, key=str)}


def load(name_or_path: str) -> Printer:
    """Return the shipped profile of that name, or the one in that file. Raises PrinterError."""
    profiles = shipped()
    if name_or_path in profiles:
        return parse(profiles[name_or_path], name_or_path)
    return parse(text_of(name_or_path), one_line(Path(name_or_path).stem), name_or_path)


def text_of(path: str) -> str:
    """Return the text of a profile's file, line ends unchanged. Raises PrinterError."""
    if not Path(path).is_file():
        known = ", ".join(shipped())
        raise PrinterError(f"no such profile or file; shipped are: {known}", source=path)
    try:
        return file_text(Path(path), "no profile is")
    except OSError as error:
        raise PrinterError(f"cannot be read: {error}", source=path) from None


def parse(text: str, name: str, source: str = "", model: str | None = None) -> Printer:
    """Return a profile from its TOML text. Raises PrinterError, which names the bad key.

    source: its file, next to its model. model: text of that, if it is in
    no file.
    """
    try:
        document = _document(_loaded(text), source, model)
        known = {key: value for key, value in document.items() if key != "verified"}
        return _printer(document, name, digest_of(known))
    except RecursionError:
        raise PrinterError("nested too deeply", source=source or name) from None
    except PrinterError as error:
        raise PrinterError(error.cause, error.key, source or name) from None


def _loaded(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also a number of thousands of digits
        if KLIPPER_SECTION.search(text):
            raise PrinterError(
                "this is Klipper's configuration, not a profile. Make a profile from it with "
                "'hframe-post setup printer.cfg'"
            ) from None
        raise PrinterError(f"not valid TOML: {error}") from None


def _document(own: dict[str, Any], source: str, model: str | None) -> dict[str, Any]:
    """Return a profile merged into its model, and both into the shipped profile that it extends.

    The model's plant replaces that of the shipped profile as a whole.
    """
    document = dict[str, Any]()
    if "extends" in own:
        base, profiles = own["extends"], shipped()
        if not isinstance(base, str) or base not in profiles:
            raise PrinterError(f"no such profile; shipped are: {', '.join(profiles)}", "extends")
        document = _document(tomllib.loads(profiles[base]), base, None)
    if "model" in own:
        measured = _model(own["model"], source, model)
        document = {**_merged(document, measured), "plant": measured.get("plant")}
    own = {key: value for key, value in own.items() if key not in ("extends", "model")}
    return _merged(document, own) if document else own


def _model(name: Any, source: str, text: str | None) -> dict[str, Any]:
    """Return the tables of the model that a profile names."""
    if not isinstance(name, str):
        raise PrinterError('must be the name of a file, such as "printer.model.toml"', "model")
    path = Path(source).parent / name
    if text is None and not path.is_file():
        raise PrinterError(
            f"there is no {path}, which 'hframe-post identify' writes: copy it here with the "
            "profile, or leave the line out", "model",
        )  # fmt: skip
    try:
        measured = _loaded(text_of(str(path)) if text is None else text)
    except PrinterError as error:
        raise PrinterError(f"{path}: {error.cause}", "model") from None
    known_keys(measured, MEASURED, "")
    if not all(isinstance(table, dict) for table in measured.values()):
        raise PrinterError(f"{path} holds other things than tables", "model")
    return measured


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return ``base`` with the keys of ``changes``; transfer functions are replaced as a whole."""
    merged = dict(base)
    for key, value in changes.items():
        tables = isinstance(value, dict) and isinstance(base.get(key), dict)
        whole = not tables or key in ("Gxx", "Gyy", "Gxtheta")
        merged[key] = value if whole else _merged(base[key], value)
    return merged


def _printer(document: dict[str, Any], name: str, digest: str) -> Printer:
    document = {"plant": NOT_MEASURED, **document}
    known_keys(document, ("description", *TABLES, "firmware", "plant", "verified"), "")
    description = document.get("description", "")
    if not isinstance(description, str):
        raise PrinterError("must be text", "description")
    tables = {
        key: checked(kind, document.get(key, None if key in NEEDED else {}), key)
        for key, kind in TABLES.items()
        if key in document or key not in IF_GIVEN
    }
    for key in ("firmware", "plant"):
        if not isinstance(document.get(key), dict):
            raise PrinterError("the table is missing", key)
    limits, kinematics, model = tables["limits"], tables["kinematics"], _model_digest(document)
    tables["motors"] = tables["motors"].completed(
        kinematics, limits.velocity, limits.acceleration, limits.square_corner_velocity
    )
    printer = Printer(
        **tables, **_measured(document["plant"], limits, kinematics), name=name,
        description=description, digest=digest, model=model,
        firmware=load_firmware(document["firmware"]), verified=_verified(document, model),
    )  # fmt: skip
    check_needs(printer.firmware, printer.steps is not None)
    return printer


def _verified(document: dict[str, Any], model: str) -> Verified | None:
    """Return the mark of `check`, if it was for this plant and window."""
    if "verified" not in document:
        return None
    mark = checked(Verified, document["verified"], "verified")
    return mark if mark.model == model else None


def _model_digest(document: dict[str, Any]) -> str:
    """Return a digest of plant and window."""
    others = ("measured", "moving_mass")
    plant = {key: value for key, value in document["plant"].items() if key not in others}
    return digest_of({"plant": plant, "compensation": document.get("compensation")})


def played_by(printer: Printer, dialect: str) -> Printer:
    """Return the printer with another firmware. Raises PrinterError if the profile lacks it."""
    if dialect == printer.firmware.dialect:
        return printer
    firmware = replace(printer.firmware, dialect=dialect)
    check_needs(firmware, printer.steps is not None, printer.name)
    return replace(printer, firmware=firmware, digest=f"{printer.digest} {dialect}")


def check_identified(printer: Printer) -> None:
    """Raise PrinterError if the plant was not measured on this printer."""
    if printer.invented:
        raise PrinterError(
            "this printer is not measured yet, so nothing is compensated. Next, with an "
            "accelerometer: 'hframe-post measure -o measure.gcode', which says how to go on; "
            "without one: 'hframe-post calibrate-print' (docs/start.md)",
            source=printer.name,
        )


# ----------------------------------------------------------------------
# The table [plant]: responses, or transfer functions in their place.


@dataclass(frozen=True, slots=True)
class _Plant:
    Ts: float
    Gxx: Any
    Gyy: Any
    Gxtheta: Any = None
    x_c: float | None = field(default=None, metadata=PLACES)
    invented: bool = True
    uncertainty: float | None = field(default=None, metadata=SHARE)
    measured: date | None = None
    moving_mass: float | None = within(0.05, 50.0, default=None)  # kg


@dataclass(frozen=True, slots=True)
class _Response:
    """deviation, unknown: µm or µrad; lag: ms, or µrad at 1 mm/s."""

    deviation: Array = field(metadata=DEVIATIONS)
    lead: int
    lag: float = within(-1e3, 1e3, default=0.0)
    drift: float = field(default=0.0, metadata=SHARE)
    unknown: Array = field(default_factory=lambda: np.zeros(0), metadata=DEVIATIONS)


@dataclass(frozen=True, slots=True)
class _Function:
    zeros: Complex = field(metadata=ROOTS)
    poles: Complex = field(metadata=ROOTS)
    gain: float


def _measured(table: dict[str, Any], limits: Limits, kinematics: Kinematics) -> dict[str, Any]:
    """Return what [plant] says: the plant, and how it is known."""
    own, bed = checked(_Plant, table, "plant"), None
    if own.moving_mass is not None:
        if not kinematics.bed_moves:
            cause = f"the bed of a {kinematics.type} printer does not move in y: leave it out"
            raise PrinterError(cause, "plant.moving_mass")
        bed = Bed(own.moving_mass, limits.filament_mass)
    if own.Gxtheta is not None and own.x_c is None:
        raise PrinterError("the key is missing", "plant.x_c")
    if own.Ts != TS:
        raise PrinterError(f"must be {TS}: the clock runs in milliseconds", "plant.Ts")
    Gxx, Gyy = (_linear(getattr(own, G), f"plant.{G}", 1.0) for G in ("Gxx", "Gyy"))
    racking = None
    if own.Gxtheta is not None:
        found = _linear(own.Gxtheta, "plant.Gxtheta", 0.0, MICRORAD)
        racking = found if np.append(found.deviation, found.lag).any() else None
    if racking is not None and not kinematics.racks:
        cause = f"a {kinematics.type} printer does not rack: extend a profile without this table"
        raise PrinterError(cause, "plant.Gxtheta")
    return {
        "plant": Plant(Gxx, Gyy, racking, own.x_c or 0.0, bed), "invented": own.invented,
        "uncertainty": own.uncertainty, "measured": own.measured,
    }  # fmt: skip


def _linear(table: Any, key: str, rest: float, unit: float = 1.0) -> ImpulseResponse:
    """Return a response with this gain at rest, written as such or as a transfer function."""
    if not isinstance(table, dict):
        raise PrinterError(
            "must be a table of deviation and lead, or of zeros, poles and gain", key
        )
    response, function = ([each.name for each in fields(k)] for k in (_Response, _Function))
    known_keys(table, (*function, *response), key)
    is_response = not {*response}.isdisjoint(table)
    for name in table:
        if is_response and name in function:
            cause = "is of a transfer function, and deviation of a response: leave one of them out"
            raise PrinterError(cause, f"{key}.{name}")
    try:
        if not is_response:
            G = checked(_Function, table, key)
            return ImpulseResponse.from_transfer_function(
                TransferFunction(G.zeros, G.poles, G.gain), rest
            )
        q = checked(_Response, table, key)
        return ImpulseResponse(
            q.deviation * unit, q.lead, rest, q.lag * unit, q.drift, q.unknown * unit
        )
    except ArgumentError as error:
        raise PrinterError(str(error), key) from None
