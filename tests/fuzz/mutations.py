"""Seeded changes to G-code, to profiles and to recordings, as accidents and malice make them."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path
from random import Random

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-0", b"1e9", b"-1", b"0.00001", b"999999", b"-3.5", b"nan", b"inf", b"1e400", b"1.",
    b".5", b"+2", b"--3", b"1.2.3", b"0x10", b"9" * 400, b"1" * 5000, b"", b"1e-300", b"0.0349",
)  # fmt: skip
LINES = (
    b"G91", b"G90", b"M82", b"M83", b"G92 E0", b"G92 X10 Y10", b"G92", b"G20", b"G21", b"G28",
    b"G28 X", b"T1", b"T0", b"M104 S200", b"M109 S200", b"G4 P500", b"G4 S1", b"G4 P-5000",
    b"G4 P1e9", b"M204 S500", b"M204 S0.0000001", b"M201 X500 Y500", b"M203 Y0.001", b"M205 X8",
    b"M220 S50", b"M220 S0", b"M221 S90", b"M600", b"M84", b"G10", b"G11", b"G1 F0.01", b"G1 F0",
    b"G1", b"G1 X", b"G1 X9999", b"G1 Z-20", b"G1 Z100 F1", b"G1 E219414", b"G1 E-5 F2400",
    b"G1 E5 F2400", b"G1 Z0.4 F600", b"G0 X100 Y100 F9000", b"G2 X110 Y100 I5 J0 E1",
    b"G3 I10 J0 E2", b"G2 X90 Y100 R5", b"G3 I50000", b"G5 I1 J1 P1 Q1 X120 Y120", b"M73 P10 R5",
    b"M117 Layer 3 *5", b"(c) G91", b"N 5 G91", b"n7 g1 x101 y101*99", b"G 91", b"M 82",
    b"g1x102y99e.1",
    b"SET_VELOCITY_LIMIT ACCEL=1e4", b"SET_VELOCITY_LIMIT VELOCITY='20'", b"EXCLUDE_OBJECT_END",
    b"SAVE_GCODE_STATE NAME=x", b"PRINT_START", b"G17", b"G18", b"G53 G1 X1", b"M5",
    b"\xff\xfe\x00",
    b"G1 X100 Y100 ; (", b"(" * 50, b"; G91", b"G1 X100;G91", b"\x1b[2J", b"%", b"M220 R", b"G54",
    b"M400", b"G92 E1000000", b"G1 X100.0001 Y100 E0.0001", b"M106 S255", b"M593 F40", b"G29",
)  # fmt: skip


def gcode(rng: Random, seeds: list[bytes]) -> bytes:
    """A stretch of a seed with its head, with a few changes and with marks."""
    lines = rng.choice(seeds).splitlines()
    head = (
        [line for line in lines[:40] if not line.startswith((b"G1", b"G0"))]
        if rng.random() < 0.5
        else []
    )
    start = rng.randrange(max(len(lines) - 20, 1))
    body = lines[start : start + rng.randrange(20, 120)]
    lines = [*head, rng.choice((b"M82", b"M83")), b"G90", *body]
    for _ in range(min(int(rng.expovariate(0.3)), 25)):
        _change(rng, lines)
    return b"\n".join(_marked(rng, lines)) + rng.choice((b"\n", b"\n", b"", b"\r\n"))


def _change(rng: Random, lines: list[bytes]) -> None:
    k = rng.randrange(len(lines))
    kind = rng.randrange(12)
    if kind == 0 and len(lines) > 5:
        del lines[k]
    elif kind == 1:
        lines.insert(k, rng.choice(lines))
    elif kind == 2:
        j = rng.randrange(len(lines))
        lines[j], lines[k] = lines[k], lines[j]
    elif kind <= 5:
        lines.insert(k, rng.choice(LINES))
    elif kind <= 7:
        lines[k] = _renumbered(rng, lines[k], rng.choice(NUMBERS))
    elif kind == 8:
        scaled = rng.choice((0.5, 1.1, -1.0, 10.0, 1000.0, 1e-4))
        lines[k] = _scaled(scaled, lines[k], 2)
    elif kind == 9 and lines[k]:
        at = rng.randrange(len(lines[k]))
        lines[k] = lines[k][:at] + bytes([rng.randrange(256)]) + lines[k][at + 1 :]
    elif kind == 10:
        lines[k] = lines[k].swapcase().replace(b" ", rng.choice((b"", b"  ", b"\t")))
    else:
        lines[k] += rng.choice((b"\r", b" ; x", b" (y", b"*1", b" E1", b" F1200", b" X Y"))


def _value(number: bytes) -> float:
    value = float(number)
    return value if math.isfinite(value) else 0.0


def _scaled(factor: float, line: bytes, count: int) -> bytes:
    return NUMBER.sub(lambda m: b"%.9g" % (factor * _value(m[0])), line, count=count)


def _renumbered(rng: Random, line: bytes, number: bytes) -> bytes:
    places = list(NUMBER.finditer(line))
    if not places:
        return line + number
    place = rng.choice(places)
    return line[: place.start()] + number + line[place.end() :]


def _marked(rng: Random, lines: list[bytes]) -> list[bytes]:
    """The lines with numbered marks among them, the last one at the end."""
    marked = []
    for k, line in enumerate(lines):
        marked.append(line)
        if rng.random() < 0.15:
            kind = rng.choice((b";@%d", b";@%d", b"M117 @%d", b"UNHEARD_OF @%d"))
            marked.append(kind % k)
    return [*marked, b";@%d" % len(lines)]


def arcs(rng: Random) -> tuple[bytes, dict[int, tuple[float, float, float]]]:
    """Ten arcs, one after another, of any sweep; line → centre and radius that the file gives."""
    x, y = 140.0, 140.0
    lines = [b"G90", b"M83", b"G1 Z0.2 F600", b"G1 X%.3f Y%.3f F6000" % (x, y)]
    known = {}
    for _ in range(10):
        radius = rng.choice((0.5, 2.0, 10.0, 25.0, 50.0)) * rng.uniform(0.5, 1.0)
        for _ in range(100):
            angle = rng.uniform(0.0, 2.0 * math.pi)
            I, J = round(radius * math.cos(angle), 3), round(radius * math.sin(angle), 3)
            if all(60.0 + 50.0 <= c <= 220.0 - 50.0 for c in (x + I, y + J)):
                break
        else:
            continue
        cx, cy, r = x + I, y + J, math.hypot(I, J)
        sweep = rng.choice((0.01, 0.5, 1.0, 1.0, 1.999, 2.0)) * math.pi * rng.uniform(0.99, 1.0)
        sweep = 2.0 * math.pi if rng.random() < 0.2 else sweep
        clockwise = rng.random() < 0.5
        turned = math.atan2(-J, -I) + (-sweep if clockwise else sweep)
        full = sweep == 2.0 * math.pi
        x, y = (
            (x, y)
            if full
            else (round(cx + r * math.cos(turned), 3), round(cy + r * math.sin(turned), 3))
        )
        end = b"" if full and rng.random() < 0.5 else b" X%.3f Y%.3f" % (x, y)
        lines.append(
            b"G%d%s I%.3f J%.3f E%.4f" % (2 if clockwise else 3, end, I, J, 0.05 * r * sweep)
        )
        known[len(lines)] = (cx, cy, r)
    return b"\n".join(lines) + b"\n;@1\n", known


def profile(rng: Random, texts: list[str]) -> str:
    """A shipped profile's text with a few changes."""
    lines = rng.choice(texts).encode().splitlines()
    for _ in range(1 + min(int(rng.expovariate(0.5)), 12)):
        k = rng.randrange(len(lines))
        kind = rng.randrange(8)
        if kind <= 3:
            number = rng.choice(
                (*NUMBERS, b"1e14", b"1e-9", b"20000", b"true", b"'a'", b"[]", b"[1]", b"{}")
            )
            lines[k] = _renumbered(rng, lines[k], number)
        elif kind == 4:
            del lines[k]
        elif kind == 5:
            lines.insert(k, rng.choice(lines))
        elif kind == 6 and lines[k]:
            at = rng.randrange(len(lines[k]))
            lines[k] = lines[k][:at] + bytes([rng.randrange(32, 127)]) + lines[k][at + 1 :]
        else:
            scaled = rng.choice((0.5, 1.1, -1.0, 10.0, 1000.0, 1e-4))
            lines[k] = _scaled(scaled, lines[k], 1)
        if not lines:
            break
    return b"\n".join(lines).decode("latin-1")


def table(rng: Random, text: bytes) -> bytes:
    """A recording or a command with a few changes."""
    lines = text.splitlines()
    for _ in range(1 + min(int(rng.expovariate(0.5)), 8)):
        k = rng.choice((0, 1, rng.randrange(len(lines))))
        kind = rng.randrange(8)
        if kind <= 2:
            lines[k] = _renumbered(rng, lines[k], rng.choice(NUMBERS))
        elif kind == 3:
            del lines[k : k + rng.choice((1, 10, 10_000))]
        elif kind == 4:
            lines.insert(k, rng.choice(lines))
        elif kind == 5:
            lines[k] = lines[k].replace(b",", rng.choice((b";", b"", b",,", b" ")), 1)
        elif kind == 6 and lines[k]:
            at = rng.randrange(len(lines[k]))
            lines[k] = lines[k][:at] + bytes([rng.randrange(256)]) + lines[k][at + 1 :]
        else:
            lines = lines[: rng.randrange(len(lines))]
        lines = lines or [b""]
    return b"\n".join(lines) + b"\n"


@cache
def seeds(folders: tuple[Path, ...]) -> list[bytes]:
    """All G-code files of some folders."""
    return [path.read_bytes() for folder in folders for path in sorted(folder.glob("*.gcode"))]
