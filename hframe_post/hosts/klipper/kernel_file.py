"""The file of a kernel: a line with the format, a digest of all after it, and JSON.

``limits`` are Klipper's, of the path for which the figures (mm) hold. ``x`` and ``y`` are weights
of the path, 1 ms apart; the first is ``AHEAD`` ms later. A row of ``couplings`` has the answering
and the commanding axis, the axis of the lever or −1, its centre, and weights.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

FORMAT = b"hframe-post kernel 3\n"
AHEAD, TAPS, COUPLINGS = 100, 501, 8  # as in hframe_live.h
LIMITS = ("max_velocity", "max_accel", "square_corner_velocity")
FIGURES = ("leaves", "without", "deviation", "reserve")
KEYS = {"profile", "made_by", "measured", "kinematics", "limits", *FIGURES, "x", "y", "couplings"}
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
        rows = kernel["couplings"]
        taps = [kernel["x"], kernel["y"], *(h for _, _, _, _, h in rows)]
        axes = all({*row[:2]} <= {0, 1} and row[2] in (-1, 0, 1) for row in rows)
        numbers = all(len(h) == TAPS and math.isfinite(sum(map(abs, h))) for h in taps)
        known = {*kernel} == KEYS and {*kernel["limits"]} == {*LIMITS} and len(rows) <= COUPLINGS
    except (ValueError, LookupError, TypeError):
        known = False
    if not (known and axes and numbers):
        raise ValueError(f"it holds something else than a kernel: {AGAIN}")
    return kernel
