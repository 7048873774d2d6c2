"""hframe_live.c, compiled against the headers of the Klipper that runs, and called by cffi."""

from __future__ import annotations

import hashlib
import os
import subprocess
from collections.abc import Sequence
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
# sums of a window in vectors: in any order, without looking for NaN
SUMS = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math", "-fno-math-errno")


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
    digest = hashlib.sha256(repr((parts, GCC, SUMS)).encode()).hexdigest()[:16]
    library = folder / f"_hframe_live-{digest}.so"
    if library.is_file():
        return library
    made = folder / f"{library.stem}.{os.getpid()}.tmp"
    command = [*GCC, *SUMS, "-I", str(headers), "-o", str(made), str(SOURCE), "-lm"]
    try:
        for faster in (["-march=native"], []):  # some processors have no "native"
            done = subprocess.run([*command, *faster], capture_output=True, timeout=120)
            if not done.returncode:
                break
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
            raise ValueError(f"{SOURCE.name} does not compile with this Klipper: {said[0][:200]}")
        made.replace(library)
    except FileNotFoundError:
        raise ValueError("gcc is missing, with which Klipper compiles, too: install it") from None
    except (OSError, subprocess.SubprocessError) as error:
        raise ValueError(f"{SOURCE.name} cannot be compiled in {folder}: {error}") from None
    finally:
        made.unlink(missing_ok=True)
    return library


class Native:
    """The library, and Klipper's pointers to the same structures."""

    def __init__(self, chelper: ModuleType) -> None:
        import cffi  # Klipper has it; nothing else needs it

        self._main, _ = chelper.get_ffi()
        self.ffi = cffi.FFI()
        self.ffi.cdef(DECLARED.read_text())
        assert chelper.__file__ is not None
        self.lib = self.ffi.dlopen(str(compiled(Path(chelper.__file__).resolve().parent)))

    def kernel(self, kernel: dict[str, Any], travel: Sequence[tuple[float, float]]) -> Any:
        """Return a kernel of ``read`` for the C; travel: of x and y, mm."""
        least, most = zip(*travel, strict=True)
        rows = [(*row[:4], row[4][::-1]) for row in kernel["couplings"]]
        edge = max(EDGE * kernel["deviation"], 1e-3)
        axes = [kernel["x"][::-1], kernel["y"][::-1]]
        return self.ffi.new("struct hframe_kernel *", (least, most, edge, axes, len(rows), rows))

    def behind(self, klippers: Any, kernel: Any) -> Any:
        """Return our kinematics behind Klipper's, or None if it cannot have one."""
        ours = self.lib.hframe_live_alloc(self.ours(klippers), kernel)
        return None if ours == self.ffi.NULL else self.ffi.gc(ours, self.lib.free)

    def ours(self, pointer: Any) -> Any:
        kind = "struct stepper_kinematics *"
        return self.ffi.cast(kind, int(self._main.cast("uintptr_t", pointer)))

    def klippers(self, pointer: Any) -> Any:
        kind = "struct stepper_kinematics *"
        return self._main.cast(kind, int(self.ffi.cast("uintptr_t", pointer)))
