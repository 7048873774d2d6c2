"""The file of a kernel: lines of text that end with a digest of all before it.

::

    hframe-post kernel 1
    profile = voron.toml (9f8e7d6c)          who made it, of what, when
    kinematics = corexy                      Klipper's name
    acceleration = 10000                     the limits for which its figures hold
    x = 60 0.00012 …                         samples ahead; taps, the furthest ahead first
    coupling = y x x 140 60 …                answer, command, lever's axis or -, its centre, taps
    sha256 = …
"""

from __future__ import annotations

import hashlib
import math
from typing import NamedTuple

FORMAT = b"hframe-post kernel 1\n"
DIGEST = b"sha256 = "
NAMES = ("profile", "made_by", "measured", "kinematics")
NUMBERS = ("velocity", "acceleration", "leaves", "without", "deviation", "belt_velocity",
           "belt_acceleration")  # fmt: skip
AXES = {"x": 0, "y": 1, "-": -1}
MOST_TAPS = 1024  # as in hframe_live.c


class Taps(NamedTuple):
    """Weights of the path, a millisecond apart; the first is that of ``ahead`` ms later."""

    ahead: int
    weights: list[float]


class Coupling(NamedTuple):
    """Taps from one axis to another, times the distance from ``centre`` along an axis, or 1."""

    answer: int
    command: int
    along: int
    centre: float
    taps: Taps


class KernelFile(NamedTuple):
    names: dict[str, str]
    numbers: dict[str, float]
    x: Taps
    y: Taps
    couplings: list[Coupling]


def signed(text: str) -> bytes:
    """Return the file for these lines: with the format before and the digest after them."""
    body = FORMAT + text.encode()
    return body + DIGEST + hashlib.sha256(body).hexdigest().encode() + b"\n"


def read(data: bytes) -> KernelFile:
    """Return what a file holds. Raises ValueError, with the cause and the next step."""
    if not data.startswith(FORMAT):
        raise ValueError(
            "it is not a kernel of this version of hframe-post: write it again with 'hframe-post "
            "identify', then restart Klipper"
        )
    body, _, digest = data.rpartition(DIGEST)
    if digest != hashlib.sha256(body).hexdigest().encode() + b"\n":
        raise ValueError("it is damaged or was edited: write it again with 'hframe-post identify'")
    names, numbers = dict[str, str](), dict[str, float]()
    axes, couplings = dict[str, Taps](), list[Coupling]()
    for line in body[len(FORMAT) :].decode().splitlines():
        key, _, value = line.partition(" = ")
        if key in NAMES:
            names[key] = value
        elif key in NUMBERS:
            numbers[key] = float(value)
        elif key in ("x", "y"):
            axes[key] = _taps(value.split())
        elif key == "coupling":
            answer, command, along, centre, *taps = value.split()
            couplings.append(
                Coupling(AXES[answer], AXES[command], AXES[along], float(centre), _taps(taps))
            )
        else:
            raise ValueError(f"unknown key {key[:40]!r}: update hframe-post")
    if {*names} != {*NAMES} or {*numbers} != {*NUMBERS} or {*axes} != {"x", "y"}:
        raise ValueError("a key is missing: write it again with 'hframe-post identify'")
    return KernelFile(names, numbers, axes["x"], axes["y"], couplings)


def _taps(words: list[str]) -> Taps:
    ahead, weights = int(words[0]), [float(word) for word in words[1:]]
    if not 0 <= ahead < len(weights) <= MOST_TAPS or not all(map(math.isfinite, weights)):
        raise ValueError("its taps are out of range: write it again with 'hframe-post identify'")
    return Taps(ahead, weights)
