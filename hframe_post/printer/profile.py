"""Profiles: read from TOML and checked completely."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from datetime import date
from importlib import resources
from pathlib import Path
from typing import Any

from hframe_post.arrays import TS
from hframe_post.errors import PrinterError, one_line
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.firmware_tables import check_needs, load_firmware
from hframe_post.printer.plant_tables import read_bed, read_plant
from hframe_post.printer.schema import (
    checked,
    checked_value,
    digest_of,
    file_text,
    known_keys,
)
from hframe_post.printer.settings import (
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

# tables of a profile and what they become; without one of the latter, its default is None
USUAL: dict[str, type[Any]] = {
    "travel": Travel, "limits": Limits, "kinematics": Kinematics, "compensation": Compensation,
    "sweep": Sweep, "speed": Speed,
}  # fmt: skip
IF_GIVEN: dict[str, type[Any]] = {"steps": Steps, "retraction": Retraction, "extruder": Extruder}
MEASURED = ("plant", "compensation", "speed", "verified")  # tables of a model
# a profile without a plant: the nozzle follows the motors exactly
NOT_MEASURED = {"Ts": TS} | {G: {"gain": 1.0, "zeros": [], "poles": []} for G in ("Gxx", "Gyy")}
MAX_PROFILE_BYTES = 1 << 20  # bytes of a profile
KLIPPER_SECTION = re.compile(r"^\[(printer|mcu|stepper_x|include .*)\]\s*$", re.MULTILINE)


def shipped() -> dict[str, str]:
    """Return the TOML texts of the profiles that come with hframe-post, by name."""
    folder = resources.files(__package__) / "profiles"
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
        return file_text(Path(path), MAX_PROFILE_BYTES, "no profile is")
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


def _check_tables(document: dict[str, Any]) -> None:
    """Raise PrinterError unless the tables are known ones and those that a profile needs."""
    needed = ("travel", "limits", "firmware", "plant")
    known = (*USUAL, *IF_GIVEN, "motors", "firmware", "plant", "verified")
    known_keys(document, ("description", *known), "")
    for section in known:
        wanted = section in needed or section in document
        if wanted and not isinstance(document.get(section), dict):
            raise PrinterError("the table is missing", section)
    if not isinstance(document.get("description", ""), str):
        raise PrinterError("must be text", "description")


def _printer(document: dict[str, Any], name: str, digest: str) -> Printer:
    document = {"plant": NOT_MEASURED, **document}
    _check_tables(document)
    usual = {key: checked(kind, document.get(key, {}), key) for key, kind in USUAL.items()}
    given = {k: checked(kind, document[k], k) for k, kind in IF_GIVEN.items() if k in document}
    limits, kinematics = usual["limits"], usual["kinematics"]
    motors = checked(Motors, document.get("motors", {}), "motors").completed(
        kinematics, limits.velocity, limits.acceleration, limits.square_corner_velocity
    )
    model = _model_digest(document)
    printer = Printer(
        **usual, **given, **_measured(document["plant"], limits, kinematics), name=name,
        description=document.get("description", ""), motors=motors, digest=digest, model=model,
        firmware=load_firmware(document["firmware"]), verified=_verified(document, model),
    )  # fmt: skip
    check_needs(printer.firmware, printer.steps is not None)
    return printer


def _measured(table: dict[str, Any], limits: Limits, kinematics: Kinematics) -> dict[str, Any]:
    """Return what [plant] says: the plant, and how it is known."""
    bed = read_bed(table.get("moving_mass"), limits, kinematics)
    plant = replace(read_plant(table), bed=bed)
    if plant.Gxtheta is not None and not kinematics.racks:
        cause = f"a {kinematics.type} printer does not rack: extend a profile without this table"
        raise PrinterError(cause, "plant.Gxtheta")
    uncertainty = table.get("uncertainty")
    if uncertainty is not None:
        uncertainty = checked_value(float, uncertainty, SHARE, "plant.uncertainty")
    return {
        "plant": plant,
        "invented": checked_value(bool, table.get("invented", True), {}, "plant.invented"),
        "uncertainty": uncertainty,
        "measured": _day(table.get("measured"), "plant.measured"),
    }


def _day(value: Any, key: str) -> date | None:
    try:
        return None if value is None else date.fromisoformat(value)
    except (TypeError, ValueError):
        raise PrinterError(f'must be a day such as "2026-01-31", it is {value!r}', key) from None


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
