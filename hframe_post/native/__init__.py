"""Access to the compiled loops of modules that also have them in numpy.

``kernel("name")`` is None if the loops were not built. Then the module's numpy version is used,
which gives the same bits and takes longer. Arrays are passed without conversion; an array of the
wrong type or layout raises ctypes.ArgumentError.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np

BUILT_FOR = 4  # as in kernels.h: raised whenever a signature changes

_D, _I = ctypes.c_double, ctypes.c_int64
_FLOATS, _INTEGERS, _BYTES = "float64", "int64", "uint8"
_TEXT = ctypes.c_char_p
_ADDRESS = ctypes.c_void_p  # of an array that is passed many times
_SIGNATURES: dict[str, tuple[Any, ...]] = {  # as in the C files
    "breakpoints": (
        _FLOATS, _BYTES, _I, _D, _D, _D, _D, _INTEGERS, _FLOATS, _BYTES,
    ),
    "deviation": (
        _FLOATS, _FLOATS, _I, _FLOATS, _FLOATS, _INTEGERS, _I, _I, _I, _D, _FLOATS, _INTEGERS,
    ),
    "plain_moves": (_TEXT, _I, _I, _I, _I, _ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS),
    "command_lines": (
        _TEXT, _TEXT, _I, _I, _INTEGERS, _INTEGERS, _BYTES, _BYTES, _INTEGERS,
    ),
    "path_lengths": (_FLOATS, _I, _I, _I, _D, _D, _FLOATS),
    "follow": (_FLOATS, _FLOATS, _I, _FLOATS, _I, _FLOATS, _INTEGERS),
    "fitted": (_FLOATS, _I, _INTEGERS, _I, _I, _FLOATS, _FLOATS),
}  # fmt: skip

Kernel = Callable[..., int]


def kernel(name: str) -> Kernel | None:
    """Return the compiled loop of that name, or None if there is none on this machine."""
    kernels = built()
    return None if kernels is None else kernels[name]


@cache
def built() -> dict[str, Kernel] | None:
    folder = Path(__file__).parent
    paths = [folder / f"_kernels{suffix}" for suffix in EXTENSION_SUFFIXES]
    return next((found for path in paths if path.exists() and (found := loaded(path))), None)


def loaded(path: Path) -> dict[str, Kernel] | None:
    """Return the loops of a library, or None if it is for another machine or version."""
    try:
        library = ctypes.CDLL(str(path))
        if int(library.built_for()) != BUILT_FOR:
            return None
        return {name: _bound(library, name) for name in _SIGNATURES}
    except (OSError, AttributeError):
        return None


def _bound(library: ctypes.CDLL, name: str) -> Kernel:
    function = library[name]
    function.restype = _I
    function.argtypes = [
        np.ctypeslib.ndpointer(kind, flags="C_CONTIGUOUS") if isinstance(kind, str) else kind
        for kind in _SIGNATURES[name]
    ]
    return function
