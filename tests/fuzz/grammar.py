"""Lines that are almost valid: any number in a word, words twice or missing."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

NUMBERS = (
    b"0", b"-0", b"1e9", b"-1", b"0.00001", b"999999", b"-3.5", b"nan", b"inf", b"1e400", b"1.",
    b".5", b"+2", b"--3", b"1.2.3", b"0x10", b"9" * 400, b"1" * 5000, b"", b"1e-300", b"0.0349",
    b"1,5", b"00010", b"+.5", b"-.0", b".", b"-", b"1_0", b"1e3", b" 7", b"279.999", b"280.001",
    b"0.0005", b"2147483648", b"4294967297", b"1.0000000000000000001", "\uff11".encode(),
)  # fmt: skip
BREAKS = (b";", b"(", b")", b"*", b"#", b"'", b'"', b"\\", b"=", b"{", b"}", b"%", b"\t", b"\r",
          b"\0", b"\x0b", b"\x1a", b"\xc2\x85", b"\xe2\x80\xa8", b"\xff")  # fmt: skip
QUOTED = (b"%b", b"'%b'", b'"%b"', b"'%b", b'%b"', b"\\%b", b" %b", b"%b # ", b"%b;")
FLIPS = (b"G90", b"G91", b"M82", b"M83", b"G20", b"G21", b"G17", b"G92 E0", b"G90 ; G91", b"G91.1")
OBJECTS = (
    (b"EXCLUDE_OBJECT_START NAME='part (1)'", b"EXCLUDE_OBJECT_END NAME='part (1)'"),
    (b"; printing object Cube id:0 copy 0", b"; stop printing object Cube id:0 copy 0"),
    (b"M486 S3", b"M486 S-1"), (b";MESH:a.stl", b";MESH:NONMESH"),
    (b"M624 AQAAAAAAAAA=", b"M625"),
)  # fmt: skip


def line(rng: Random) -> bytes:
    """Return a line of a random kind."""
    return rng.choice(KINDS)(rng)


def number(rng: Random) -> bytes:
    """Return a number that is probably on a bed, or an odd one."""
    if rng.random() < 0.2:
        return rng.choice(NUMBERS)
    size = rng.choice((0.001, 0.3, 5.0, 30.0, 200.0))
    return b"%.*f" % (rng.choice((0, 3, 5)), rng.uniform(-0.3, 1.0) * size)


def _words(rng: Random, letters: bytes, count: int) -> bytes:
    chosen = [bytes([rng.choice(letters)]) for _ in range(count)]
    space = rng.choice((b" ", b" ", b" ", b"", b"\t"))
    return b"".join(space + letter + number(rng) for letter in chosen)


def _place(rng: Random) -> bytes:
    """Return a G92 with any axes."""
    return b"G92" + _words(rng, b"XYZEE", rng.randrange(5))


def _curve(rng: Random) -> bytes:
    """Return an arc or a spline with any words, probably with an end and a centre."""
    plain = b" X%.3f Y%.3f" % (rng.uniform(60, 200), rng.uniform(60, 200))
    head = rng.choice((b"G2", b"G3", b"G5", b"G02", b"g3")) + (plain if rng.random() < 0.5 else b"")
    return head + _words(rng, b"IJIJRKPQEZFXY", rng.randrange(1, 5))


def _move(rng: Random) -> bytes:
    head = rng.choice((b"G1", b"G0", b"G01", b"g1", b"N3 G1"))
    return head + _words(rng, b"XYZEFXYE", rng.randrange(1, 5))


def _limit(rng: Random) -> bytes:
    """Return SET_VELOCITY_LIMIT or a similar command, quoted in any way."""
    names = (b"VELOCITY", b"ACCEL", b"accel", b"SQUARE_CORNER_VELOCITY", b"MINIMUM_CRUISE_RATIO",
             b"ACCEL_TO_DECEL", b"Accel ", b"X")  # fmt: skip
    if rng.random() < 0.3:
        return rng.choice((b"M201", b"M203", b"M204", b"M205", b"M220", b"M566")) + _words(
            rng, b"XYZESPTRJB", rng.randrange(4)
        )
    given = b" ".join(
        rng.choice(names) + b"=" + rng.choice(QUOTED) % number(rng) for _ in range(rng.randrange(4))
    )
    return (
        rng.choice((b"SET_VELOCITY_LIMIT ", b"set_velocity_limit ", b"SET_VELOCITY_LIMIT\t"))
        + given
    )


def _macro(rng: Random) -> bytes:
    """Return a user's macro with texts that look like motion."""
    names = (b"PRINT_START", b"_x", b"M117", b"RESPOND MSG=", b"SET_DISPLAY_TEXT MSG=", b"M118",
             b"SET_GCODE_VARIABLE MACRO=a VARIABLE=b VALUE=", b"T0_PARK", b"G1_0")  # fmt: skip
    texts = (b"G91", b"G1 X5", b"it's 5\" (wide", b"a;b", b"A=1 B='x y'", b"{a}", b"%s", b"*12")
    return rng.choice(names) + b" " + rng.choice(QUOTED) % rng.choice(texts)


def _dwell(rng: Random) -> bytes:
    return rng.choice((b"G4", b"M109", b"M400", b"G10", b"G11")) + _words(rng, b"PSRL", 1)


def _comment(rng: Random) -> bytes:
    """Return brackets, semicolons and quotes in any order, with a mode among them."""
    parts = [rng.choice((*BREAKS[:8], b"G91", b"X5", b" ")) for _ in range(rng.randrange(2, 9))]
    return rng.choice((b"; ", b"(", b"G1 X100 ", b"M117 ", b"")) + b"".join(parts)


def _long(rng: Random) -> bytes:
    size = rng.choice((300, 5_000, 70_000, 1 << 20))
    return rng.choice((b";", b"G1 X100", b"M117 ", b"G1 X100" + b" " * size, b"_M ")) + (
        rng.choice((b"a", b" ", b"(", b"5", b"\xff", b" Y1")) * size
    )


KINDS: tuple[Callable[[Random], bytes], ...] = (
    _place, _curve, _curve, _move, _move, _limit, _macro, _dwell, _comment, _long,
)  # fmt: skip


def thumbnail(rng: Random) -> list[bytes]:
    """Return a thumbnail in comments, as slicers write it; its end may be missing."""
    digits = b"ABCDEFGHabcdefgh0123456789+/"
    rows = [b"; " + bytes(rng.choices(digits, k=78)) for _ in range(rng.randrange(1, 30))]
    ends = [b"; thumbnail end", b";"] if rng.random() < 0.8 else []
    return [b"; thumbnail begin 16x16 %d" % rng.randrange(9999), *rows, *ends]
