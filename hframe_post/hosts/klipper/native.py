"""hframe_live.c, compiled against the headers of the Klipper that runs, and called by its cffi."""

from __future__ import annotations

import hashlib
import os
import subprocess
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

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
    rows = [(*row[:4], row[4][::-1]) for row in kernel["couplings"]]
    edge = max(EDGE * kernel["deviation"], 1e-3)
    axes = [kernel["x"][::-1], kernel["y"][::-1]]
    return ffi.new("struct hframe_kernel *", (least, most, edge, axes, len(rows), rows))
