"""The kernel of a profile, for compensation inside Klipper: its file, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from hframe_post.errors import ArgumentError
from hframe_post.firmware.base import Finding
from hframe_post.firmware.klipper.code import table_of
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.hosts.klipper.kernel_file import read
from hframe_post.model.kernel import Bounds, Kernel, kernel
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__

SECTION = "hframe_live"
SAME = 1e-6  # between weights of the same model, computed on other processors


def name_of(profile: Path) -> Path:
    """Return where the kernel of a profile is: next to it."""
    return profile.with_suffix(".kernel")


def live_kernel(printer: Printer) -> Kernel:
    """Return the kernel for Klipper's own limits. Raises ArgumentError if no motor suffices."""
    return kernel(printer.plant, printer.kinematics, _bounds(printer))


def by_itself(printer: Printer, name: str) -> dict[str, Kernel]:
    """Return the kernel under a name; nothing where there is none."""
    if printer.firmware.klipper is None:
        return {}
    try:
        return {name: live_kernel(printer)}
    except ArgumentError:  # the motors cannot follow
        return {}


def _bounds(printer: Printer) -> Bounds:
    table, motors, travel = table_of(printer), printer.motors, printer.travel
    return Bounds(
        table.velocity,
        table.acceleration,
        table.square_corner_velocity,
        motors.belt_velocity,
        motors.belt_acceleration,
        (sum(travel.x) / 2.0, sum(travel.y) / 2.0),
    )


def kernel_file(printer: Printer) -> bytes | None:
    """Return the kernel's file; None where there is none: no Klipper, or not measured.

    Without a kernel that the motors can follow it says why, and Klipper refuses it.
    """
    if printer.firmware.dialect != "klipper" or printer.invented:
        return None
    measured = printer.measured.isoformat() if printer.measured else "on an unknown day"
    kind = printer.kinematics.type
    names = {
        "profile": printer.name,
        "made_by": f"hframe-post {__version__}",
        "measured": measured,
        "kinematics": klipper_name(kind),
    }
    try:
        return live_kernel(printer).as_text(names, _bounds(printer))
    except ArgumentError as error:
        return f"no kernel: {error}\n".encode()


def klipper_name(kind: str) -> str:
    """Return what Klipper calls a type of kinematics."""
    return {"hbot": "corexy"}.get(kind, kind.replace("-", "_"))


def check_live(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    """Yield what is wrong with the kernel that Klipper reads, or its version and age."""
    if not config.sections(SECTION):
        return
    name = config.text(SECTION, "kernel") or "printer.kernel"
    path = config.path.absolute().parent / Path(name).expanduser()
    again = "write it again: hframe-post setup printer.cfg, then restart Klipper"
    try:
        data = path.read_bytes()
        found = read(data)
    except FileNotFoundError:
        yield Finding(False, f"{path} is missing: Klipper prints as without it until identify")
        return
    except (OSError, ValueError) as error:
        yield Finding(True, f"{path}: {error}")
        return
    wanted = live_kernel(printer)
    weights = [taps.h for taps in (*wanted.axes, *(taps for _, taps in wanted.couplings))]
    there = [found.x, found.y, *(each.taps for each in found.couplings)]
    same = len(weights) == len(there) and all(
        len(h) == len(taps.weights) and np.allclose(h, taps.weights, rtol=0.0, atol=SAME)
        for h, taps in zip(weights, there, strict=True)
    )
    if not same:
        yield Finding(True, f"{path} is not of this profile as it is now: {again}")
    days = ""
    if printer.measured is not None:
        days = f", {(datetime.now(UTC).date() - printer.measured).days} days ago"
    yield Finding(
        False,
        f"{path}: {found.names['made_by']}, measured {found.names['measured']}{days}; leaves "
        f"{1e3 * found.numbers['leaves']:.1f} µm",
    )
