"""The kernel of a profile, for compensation inside Klipper: its file, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hframe_post.arrays import X, Y
from hframe_post.errors import ArgumentError
from hframe_post.firmware.klipper.printer_cfg import KINEMATICS, KlipperConfig
from hframe_post.hosts.klipper.kernel_file import FIGURES, LIMITS, read, signed
from hframe_post.model.kernel import Bounds, Figures, Kernel, kernel
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.new_profile import Finding
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__

SECTION = "hframe_live"
SAME = 1e-6  # between weights of the same model, computed on other processors


def live_kernel(printer: Printer) -> tuple[Kernel, Figures]:
    """Return the kernel for Klipper's own limits. Raises ArgumentError if no motor suffices."""
    return kernel(printer.plant, printer.kinematics, bounds_of(printer))


def by_itself(printer: Printer, name: str) -> dict[str, Kernel]:
    """Return the kernel under a name; nothing where there is none."""
    if printer.firmware.dialect != "klipper":
        return {}
    try:
        return {name: live_kernel(printer)[0]}
    except ArgumentError:  # the motors cannot follow
        return {}


def bounds_of(printer: Printer) -> Bounds:
    table, motors, travel = printer.firmware.own(KlipperTable), printer.motors, printer.travel
    return Bounds(
        table.velocity, table.acceleration, table.square_corner_velocity, motors.belt_velocity,
        motors.belt_acceleration, (sum(travel.x) / 2.0, sum(travel.y) / 2.0),
    )  # fmt: skip


def kernel_file(printer: Printer) -> bytes | None:
    """Return the kernel's file; None where there is none: no Klipper, or not measured.

    Without a kernel that the motors can follow it says why, and Klipper refuses it.
    """
    if printer.firmware.dialect != "klipper" or printer.invented:
        return None
    bounds = bounds_of(printer)
    try:
        made, figures = live_kernel(printer)
    except ArgumentError as error:
        return f"no kernel: {error}\n".encode()
    limits = bounds.velocity, bounds.acceleration, bounds.corner
    x_c, angle = (made.racking[0].x_c, made.racking[1].tolist()) if made.racking else (0.0, [])
    return signed({
        "profile": printer.name,
        "made_by": f"hframe-post {__version__}",
        "measured": str(printer.measured or "on an unknown day"),
        "kinematics": klipper_name(printer.kinematics.type),
        "limits": dict(zip(LIMITS, limits, strict=True)),
        **{name: float(f"{getattr(figures, name):.6g}") for name in FIGURES},
        "x": made.axes[X].tolist(), "y": made.axes[Y].tolist(),
        "racking": angle, "x_c": x_c,
    })  # fmt: skip


def klipper_name(kind: str) -> str:
    """Return what Klipper calls a type of kinematics."""
    return next((name for name, kinds in KINEMATICS.items() if kind in kinds), kind)


def check_live(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    """Yield what is wrong with the kernel that Klipper reads, or its version and age."""
    if not config.sections(SECTION):
        return
    name = config.text(SECTION, "kernel") or "printer.kernel"
    path = config.path.absolute().parent / Path(name).expanduser()
    try:
        found = read(path.read_bytes())
    except FileNotFoundError:
        yield Finding(False, f"{path} is missing: Klipper prints as without it until identify")
        return
    except (OSError, ValueError) as error:
        yield Finding(True, f"{path}: {error}")
        return
    wanted, _ = live_kernel(printer)
    weights = [*wanted.axes, *(wanted.racking[1:] if wanted.racking else ())]
    there = [found["x"], found["y"], *filter(None, [found["racking"]])]
    if np.shape(there) != np.shape(weights) or np.abs(np.subtract(there, weights)).max() > SAME:
        again = "write it again: hframe-post setup printer.cfg, then restart Klipper"
        yield Finding(True, f"{path} is not of this profile as it is now: {again}")
    of, leaves = f"{found['made_by']}, measured {found['measured']}", 1e3 * found["leaves"]
    yield Finding(False, f"{path}: {of}; leaves {leaves:.1f} µm")
