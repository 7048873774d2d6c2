"""The file of a kernel, and hframe_live.c, which plays it.

The file is a line with the format, a digest of all after it, and JSON.

``limits`` are Klipper's, of the path for which the figures (mm) hold. ``x`` and ``y`` are weights
of the path, 1 ms apart; the first is ``AHEAD`` ms later. ``racking`` has those of x for the angle
that is taken off y, or none, and ``x_c`` is where its lever arm is 0. The C is
compiled against the headers of the Klipper that runs, and called by its cffi.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

FORMAT = b"hframe-post kernel 4\n"
AHEAD, TAPS = 100, 501  # as in hframe_live.h
LIMITS = ("max_velocity", "max_accel", "square_corner_velocity")
FIGURES = ("leaves", "without", "deviation", "reserve")
KEYS = {"profile", "made_by", "measured", "kinematics", "limits", *FIGURES, *"xy", "racking", "x_c"}
AGAIN = "write it again with 'hframe-post identify', then restart Klipper"


def signed(kernel: dict[str, Any]) -> bytes:
    """Return the file of a kernel with all keys."""
    body = json.dumps(kernel, indent=0).encode()
    return FORMAT + hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def read(data: bytes) -> dict[str, Any]:
    """Return the kernel of a file. Raises ValueError, with the cause and the next step."""
    if not data.startswith(FORMAT):
        raise ValueError(f"it is not a kernel of this version of hframe-post: {AGAIN}")
    digest, _, body = data[len(FORMAT) :].partition(b"\n")
    if digest != hashlib.sha256(body).hexdigest().encode():
        raise ValueError(f"it is damaged or was edited: {AGAIN}")
    try:
        kernel: dict[str, Any] = json.loads(body)
        racking = kernel["racking"]
        taps = [kernel["x"], kernel["y"], *([racking] if racking != [] else [])]
        numbers = all(len(h) == TAPS and math.isfinite(sum(map(abs, h))) for h in taps)
        numbers = numbers and math.isfinite(kernel["x_c"])
        known = {*kernel} == KEYS and {*kernel["limits"]} == {*LIMITS}
    except (ValueError, LookupError, TypeError):
        known = False
    if not (known and numbers):
        raise ValueError(f"it holds something else than a kernel: {AGAIN}")
    return kernel


# ---------------------------------------------------------------------- its C

SOURCE = Path(__file__).resolve().with_name("hframe_live.c")
DECLARED = SOURCE.with_suffix(".h")  # for cffi, too
# times the greatest deviation from the path: up to it, fading asks no more of the motors than the
# kernel does, on strokes into the edge with the kernels of an H-bot and three measured printers
EDGE = 10.0
HEADERS = ("itersolve.h", "trapq.h", "list.h")
GCC = ("gcc", "-O3", "-shared", "-fPIC", "-Wall", "-Werror")


def compiled(headers: Path, folder: Path = SOURCE.parent) -> Path:
    """Return the library for these headers, compiled unless it was before.

    Raises ValueError, with what the compiler said.
    """
    try:
        parts = [
            each.read_bytes() for each in (SOURCE, DECLARED, *(headers / name for name in HEADERS))
        ]
    except OSError as error:
        raise ValueError(f"{error.filename}: {error.strerror}: this Klipper is not known") from None
    digest = hashlib.sha256(repr((parts, GCC)).encode()).hexdigest()[:16]
    library = folder / f"_hframe_live-{digest}.so"
    if library.is_file():
        return library
    made = folder / f"{library.stem}.{os.getpid()}.tmp"
    command = [*GCC, "-I", str(headers), "-o", str(made), str(SOURCE), "-lm"]
    try:
        for faster in (["-march=native"], []):  # some processors have no "native"
            done = subprocess.run([*command, *faster], capture_output=True, timeout=120)
            if not done.returncode:
                made.replace(library)
                return library
        said = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        raise ValueError(f"{SOURCE.name} does not compile with this Klipper: {said[0][:200]}")
    except FileNotFoundError:
        raise ValueError("gcc is missing, with which Klipper compiles, too: install it") from None
    except (OSError, subprocess.SubprocessError) as error:
        raise ValueError(f"{SOURCE.name} cannot be compiled in {folder}: {error}") from None
    finally:
        made.unlink(missing_ok=True)


@cache
def library(chelper: ModuleType) -> tuple[Any, Any]:
    """Return cffi as Klipper has it, and the library. Raises ValueError."""
    ffi, _ = chelper.get_ffi()
    ours = compiled(Path(str(chelper.__file__)).resolve().parent)
    ffi.cdef(DECLARED.read_text())
    return ffi, ffi.dlopen(str(ours))


def taps(ffi: Any, kernel: dict[str, Any], travel: list[tuple[float, float]]) -> Any:
    """Return a kernel of ``read`` for the C; travel: of x and y, mm."""
    least, most = zip(*travel, strict=True)
    edge = max(EDGE * kernel["deviation"], 1e-3)
    x, y, racking = (kernel[name][::-1] for name in ("x", "y", "racking"))
    own = least, most, edge, [x, y], bool(racking), kernel["x_c"], racking
    return ffi.new("struct hframe_kernel *", own)
