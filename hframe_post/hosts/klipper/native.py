"""hframe_live.c, compiled against the headers of the Klipper that runs, and called by cffi."""

from __future__ import annotations

import hashlib
import os
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

SOURCE = Path(__file__).resolve().with_name("hframe_live.c")
HEADERS = ("itersolve.h", "trapq.h", "list.h")
GCC = ("gcc", "-O3", "-shared", "-fPIC", "-Wall", "-Werror")
# sums of a window in vectors: in any order, without looking for NaN
SUMS = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math", "-fno-math-errno")
DECLARED = """
    void *hframe_kernel_alloc(void);
    int hframe_kernel_axis(void *k, int axis, double least, double most, int ahead, int count,
                           const double *h);
    int hframe_kernel_coupling(void *k, int answer, int command, int along, double centre,
                               int ahead, int count, const double *h);
    void *hframe_live_alloc(void *orig, void *k);
    void hframe_live_begin(void *sk);
    void hframe_live_end(void *sk);
    void hframe_live_reset(void *sk);
    double hframe_live_window(void *sk);
    int64_t hframe_live_clamped(void *sk);
    void free(void *p);
"""


def compiled(headers: Path, folder: Path = SOURCE.parent) -> Path:
    """Return the library for these headers, compiled unless it was before.

    Raises ValueError, with what the compiler said.
    """
    try:
        parts = [SOURCE.read_bytes(), *((headers / name).read_bytes() for name in HEADERS)]
    except OSError as error:
        raise ValueError(f"{error.filename}: {error.strerror}: this Klipper is not known") from None
    digest = hashlib.sha256(repr((parts, GCC, SUMS)).encode()).hexdigest()[:16]
    library = folder / f"_hframe_live-{digest}.so"
    if library.is_file():
        return library
    made = folder / f"{library.stem}.{os.getpid()}.tmp"
    command = [*GCC, *SUMS, "-I", str(headers), "-o", str(made), str(SOURCE), "-lm"]
    try:
        done = subprocess.run([*command, "-march=native"], capture_output=True, timeout=120)
        if done.returncode:  # some processors have no "native"
            done = subprocess.run(command, capture_output=True, timeout=120)
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
    """The library, whose pointers are those of Klipper's own C."""

    def __init__(self, chelper: ModuleType) -> None:
        import cffi  # Klipper has it; nothing else needs it

        self._main, _ = chelper.get_ffi()
        self.ffi = cffi.FFI()
        self.ffi.cdef(DECLARED)
        assert chelper.__file__ is not None
        self.lib = self.ffi.dlopen(str(compiled(Path(chelper.__file__).resolve().parent)))

    def freed(self, pointer: Any) -> Any:
        """Return a pointer of ours that is freed with its last use. Raises MemoryError."""
        if pointer == self.ffi.NULL:
            raise MemoryError
        return self.ffi.gc(pointer, self.lib.free)

    def ours(self, pointer: Any) -> Any:
        return self.ffi.cast("void *", int(self._main.cast("uintptr_t", pointer)))

    def klippers(self, pointer: Any) -> Any:
        kind = "struct stepper_kinematics *"
        return self._main.cast(kind, int(self.ffi.cast("uintptr_t", pointer)))
