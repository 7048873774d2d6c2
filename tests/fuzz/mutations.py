"""Seeded changes to G-code: bytes, numbers, words, lines, blocks of lines, modes, encodings."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache, reduce
from operator import xor
from pathlib import Path
from random import Random

from tests.fuzz import grammar
from tests.fuzz.grammar import NUMBERS

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z]\s*[-+]?(?:\d+\.?\d*|\.\d+)")
LINES = (
    # modes and places
    b"G91", b"G90", b"M82", b"M83", b"G92 E0", b"G92 X10 Y10", b"G92", b"G92 Z0.2", b"G92 E0 X5",
    b"G92.1", b"G92.2", b"G92.3", b"G20", b"G21", b"G28", b"G28 X", b"G28 W", b"G 91", b"M 82",
    b"(c) G91", b"N 5 G91", b"G90 G91", b"G17", b"G18", b"G53 G1 X1", b"G54", b"G1 X100;G91",
    b"SAVE_GCODE_STATE NAME=x", b"RESTORE_GCODE_STATE NAME=x MOVE=1", b"SET_GCODE_OFFSET Z=0.1",
    b"M206 X1", b"M428", b"G60 S0", b"G61 S0", b"M120", b"M121", b"SET_KINEMATIC_POSITION X=1",
    # moves
    b"G1 F0.01", b"G1 F0", b"G1 F-600", b"G1", b"G1 X", b"G1 X9999", b"G1 Z-20", b"G1 Z100 F1",
    b"G1 E219414", b"G1 E-5 F2400", b"G1 E5 F2400", b"G1 Z0.4 F600", b"G0 X100 Y100 F9000",
    b"G1 X100.0001 Y100 E0.0001", b"G1X101Y101F3000", b"g1x102y99e.1", b"n7 g1 x101 y101*99",
    b"G1 X100 Y100 ; (", b"G1 X100 (a ; b) Y100", b"G1 A5", b"G1 X100 X101", b"G1 X1e2 Y1e2",
    b"G01 X100 Y100", b"G1.0 X100", b"G1 X100 Y100 E.5 H1", b"G0 E1", b"G1 P1 X99", b"G1 S1 X99",
    # curves
    b"G2 X110 Y100 I5 J0 E1", b"G3 I10 J0 E2", b"G2 X90 Y100 R5", b"G3 X95 Y100 R-20 E1",
    b"G3 I50000", b"G2 I5 P3 E2", b"G3 X100 Y100 I0 J0", b"G2 X100 Y100 R0", b"G3 I5 J5 Z1 E1",
    b"G2 I1 K2", b"G5 I1 J1 P1 Q1 X120 Y120", b"G5.1 I1 J1 X120 Y120", b"G2 X100 Y100 I1e-9",
    b"G3 I3 P1.5", b"G2 I3 P1000000",
    # waiting, temperatures, tools, filament
    b"M104 S200", b"M109 S200", b"G4 P500", b"G4 S1", b"G4 P-5000", b"G4 P1e9", b"G4", b"G4 P",
    b"T1", b"T0", b"T", b"T?", b"Tx", b"T-1", b"T255", b"M600", b"M600 L50", b"G10", b"G11",
    b"G10 S1", b"G10 P0 X1", b"G11 S0", b"M701", b"M702", b"M84", b"M18 E", b"M400", b"M25",
    b"M0", b"M1", b"M2", b"M30", b"M112", b"M108", b"PAUSE", b"M221 S90", b"M221 S-1", b"M220 S50",
    b"M220 S0", b"M220 B", b"M220 R", b"M220 S1000", b"M200 D1.75", b"M302 P1", b"M900 K0.05",
    # limits
    b"M204 S500", b"M204 S0.0000001", b"M204 P800 T900", b"M201 X500 Y500", b"M203 Y0.001",
    b"M203 X200 Y200", b"M205 X8", b"M205 J0.01", b"M566 X300 Y300", b"M593 F40",
    b"SET_VELOCITY_LIMIT ACCEL=1e4", b"SET_VELOCITY_LIMIT VELOCITY='20'",
    b"SET_VELOCITY_LIMIT accel=900 # x", b"SET_VELOCITY_LIMIT ACCEL", b"SET_PRESSURE_ADVANCE X",
    # what is commanded, and to whom
    b"M73 P10 R5", b"M73 P10.5 R7.5 Q3 S1", b"M117 Layer 3 *5", b"M117 G91", b"M118 E1 G28",
    b"M106 S255", b"M106 P1 S0.5", b"M486 S1", b"M486 APart", b";TIME:100", b"; G91",
    b";TIME_ELAPSED:5.5", b"; estimated printing time (normal mode) = 1h 2m 3s", b";LAYER:7",
    b";TYPE:WALL-OUTER", b"; FEATURE: Outer wall", b"EXCLUDE_OBJECT_START NAME=a",
    b"EXCLUDE_OBJECT_END", b"EXCLUDE_OBJECT_DEFINE NAME=a CENTER=1,2", b"PRINT_START A=1 B='x y'",
    b"M1002 gcode_claim_action : 0", b"M624 AQAAAAAAAAA=", b"G29", b"G29.1 Z0.01", b"G380 S2 Z1",
    b"M991 S0 P1", b"{if layer_z > 1}G91{endif}", b"; thumbnail begin 2x2 8", b"_MACRO",
    # what is no line
    b"\xff\xfe\x00", b"(" * 50, b"\x1b[2J", b"%", b"\x00", b"M5", b"*", b"N10", b"N10 ", b"N10*20",
    b"O1000", b"/G1 X1", b"#1=5", b"?", b"!", b"~", b"$$", b"\xe2\x80\xa8G91", b"G1 X100\x0bY100",
    b"G\xa091", b"G1\tX100", b";" + b"x" * 100_000, b";\xe9\xfc", b"M118 \xf0\x9f\x98\x80",
)  # fmt: skip
LARGEST = 1 << 20  # bytes, from which nothing is changed: a check holds a file several times
FACTORS = (0.5, 1.1, -1.0, 10.0, 1000.0, 1e-4)

MARKS = (b";@%d", b"M117 @%d", b"UNHEARD_OF @%d")  # carried in motion, the last one at rest

Lines = list[bytes]
Mutation = Callable[[Random, Lines, int], None]


def gcode(rng: Random, seeds: list[bytes]) -> bytes:
    """Return the head and a part of a seed file, with a few changes and with marks."""
    seed = rng.choice(seeds)
    head = [line for line in _stretch(seed, 0, 40) if not line.startswith((b"G1", b"G0"))]
    head = head if rng.random() < 0.5 else []
    body = _stretch(seed, rng.randrange(len(seed)), rng.randrange(20, 120))
    modes = rng.choice((b"M82", b"M83", b"")), rng.choice((b"G90", b"G90", b"G90", b""))
    lines = [*head, *modes, *body]
    for _ in range(min(int(rng.expovariate(0.3)), 25)):
        if not lines or sum(map(len, lines)) > LARGEST:
            break
        rng.choices(MUTATIONS, WEIGHTS)[0](rng, lines, rng.randrange(len(lines)))
    for _ in range(rng.choice((0, 0, 0, 0, 1, 3))):
        _splice(rng, lines, rng.choice(seeds))
    if rng.random() < 0.05:
        lines = _numbered(rng, lines)
    return encoded(rng, _marked(rng, lines))


def _stretch(text: bytes, start: int, count: int) -> Lines:
    """Return some lines of a file from the start of one of them on."""
    start = text.rfind(b"\n", 0, start) + 1
    return text[start : start + 120 * count].splitlines()[:count]


# ---------------------------------------------------------------------- lines and blocks


def _lose(rng: Random, lines: Lines, k: int) -> None:
    if len(lines) > 5:
        del lines[k]


def _repeat(rng: Random, lines: Lines, k: int) -> None:
    lines.insert(k, rng.choice(lines))


def _swap(rng: Random, lines: Lines, k: int) -> None:
    j = rng.randrange(len(lines))
    lines[j], lines[k] = lines[k], lines[j]


def _insert(rng: Random, lines: Lines, k: int) -> None:
    lines.insert(k, rng.choice(LINES) if rng.random() < 0.5 else grammar.line(rng))


def _around(rng: Random, lines: Lines, k: int) -> None:
    """Change a mode, a unit or an object for some lines."""
    opened, closed = rng.choice(
        ((b"G91", b"G90"), (b"G20", b"G21"), (b"M83", b"M82"), (b"M82", b"M83"), (b"G10", b"G11"),
         (b"EXCLUDE_OBJECT_START NAME=a", b"EXCLUDE_OBJECT_END NAME=a"), (b"G92 E5", b"G92 E0"),
         (b"SAVE_GCODE_STATE NAME=s", b"RESTORE_GCODE_STATE NAME=s"), (b"(", b")"),
         (b"G91\nM83", b"M82\nG90"), (b"M220 S30", b"M220 S100"))
    )  # fmt: skip
    lines.insert(min(k + rng.randrange(1, 8), len(lines)), closed)
    lines.insert(k, opened)


def _flip_modes(rng: Random, lines: Lines, k: int) -> None:
    """Change modes and units inside an object, and do not restore all of them."""
    block = lines[k : k + rng.randrange(1, 15)]
    for _ in range(rng.randrange(1, 5)):
        block.insert(rng.randrange(len(block) + 1), rng.choice(grammar.FLIPS))
    opened, closed = rng.choice(grammar.OBJECTS)
    lines[k : k + len(block)] = [opened, *block, closed]


def _picture(rng: Random, lines: Lines, k: int) -> None:
    lines[k:k] = grammar.thumbnail(rng)


def _move_block(rng: Random, lines: Lines, k: int) -> None:
    block = lines[k : k + rng.randrange(2, 12)]
    if rng.random() < 0.5:
        del lines[k : k + len(block)]
    at = rng.randrange(len(lines) + 1)
    lines[at:at] = block[::-1] if rng.random() < 0.2 else block


def _splice(rng: Random, lines: Lines, other: bytes) -> None:
    """Insert some lines of another slicer."""
    at = rng.randrange(len(lines) + 1)
    lines[at:at] = _stretch(other, rng.randrange(len(other)), rng.randrange(1, 15))


# ---------------------------------------------------------------------- words and numbers


def _renumber(rng: Random, lines: Lines, k: int) -> None:
    lines[k] = renumbered(rng, lines[k], rng.choice(NUMBERS))


def _scale(rng: Random, lines: Lines, k: int) -> None:
    lines[k] = scaled(rng.choice(FACTORS), lines[k], 2)


def _scale_words(rng: Random, lines: Lines, k: int) -> None:
    """Scale the numbers of one letter on some lines, as for another printer or material."""
    letter, factor = rng.choice(b"XYZEF"), rng.choice((0.9, 0.99, 1.01, 1.5, -1.0, 0.1))
    pattern = re.compile(rb"(?<=%c)[-+]?\d*\.?\d+" % letter)
    for j in range(k, min(k + rng.randrange(1, 20), len(lines))):
        lines[j] = pattern.sub(lambda m: b"%.5f" % (factor * _value(m[0])), lines[j])


def _reword(rng: Random, lines: Lines, k: int) -> None:
    """Remove, double, move or rename a word."""
    words = list(WORD.finditer(lines[k]))
    if len(words) < 2:
        return
    word, other = rng.choice(words[1:]), rng.choice(words)
    before, after = lines[k][: word.start()], lines[k][word.end() :]
    letter = bytes([rng.choice(b"XYZEFIJKPRSABDGMTxyzef")])
    lines[k] = before + rng.choice((b"", word[0] * 2, other[0], letter + word[0][1:])) + after


def _jitter(rng: Random, lines: Lines, k: int) -> None:
    """Repeat a line many times a little further on: segments shorter than a step."""
    places = list(re.finditer(rb"(?<=[XY])-?\d+\.?\d*", lines[k]))
    if not places:
        return
    place, step = rng.choice(places), rng.choice((0.0, 1e-5, 4e-4, 0.01))
    start = _value(place[0])
    before, after = lines[k][: place.start()], lines[k][place.end() :]
    lines[k + 1 : k + 1] = [
        b"%b%.5f%b" % (before, start + step * j, after) for j in range(1, rng.randrange(3, 40))
    ]


# ---------------------------------------------------------------------- bytes


def _flip(rng: Random, lines: Lines, k: int) -> None:
    if lines[k]:
        at = rng.randrange(len(lines[k]))
        lines[k] = lines[k][:at] + bytes([rng.randrange(256)]) + lines[k][at + 1 :]


def _break(rng: Random, lines: Lines, k: int) -> None:
    """Cut a line short or in two, or join it with the next."""
    at, kind = rng.randrange(len(lines[k]) + 1), rng.randrange(3)
    if kind == 0:
        lines[k] = lines[k][:at]
    elif kind == 1:
        lines[k : k + 1] = [lines[k][:at], lines[k][at:]]
    else:
        lines[k : k + 2] = [b"".join(lines[k : k + 2])]


def _pierce(rng: Random, lines: Lines, k: int) -> None:
    """Insert a bracket, quote, control or foreign character in some lines."""
    for j in range(k, min(k + rng.randrange(1, 4), len(lines))):
        at = rng.randrange(len(lines[j]) + 1)
        lines[j] = lines[j][:at] + rng.choice(grammar.BREAKS) + lines[j][at:]


def _restyle(rng: Random, lines: Lines, k: int) -> None:
    lines[k] = lines[k].swapcase().replace(b" ", rng.choice((b"", b"  ", b"\t")))


def _append(rng: Random, lines: Lines, k: int) -> None:
    lines[k] += rng.choice((b"\r", b" ; x", b" (y", b"*1", b" E1", b" F1200", b" X Y", b" \t"))


def _number_lines(rng: Random, lines: Lines, k: int) -> None:
    """Add line numbers and checksums, as a host sends them; some are wrong."""
    end = min(k + rng.randrange(1, 10), len(lines))
    lines[k:end] = _numbered(rng, lines[k:end], 0.05)


def _numbered(rng: Random, lines: Lines, wrong: float = 0.0) -> Lines:
    numbered = []
    for j, text in enumerate(lines):
        line = b"N%d %b" % (j, text.partition(b";")[0])
        numbered.append(b"%b*%d" % (line, reduce(xor, line) ^ (rng.random() < wrong)))
    return numbered


MUTATIONS: tuple[Mutation, ...] = (
    _insert, _renumber, _scale, _scale_words, _reword, _flip, _lose, _repeat, _swap, _around,
    _move_block, _jitter, _break, _restyle, _append, _number_lines, _flip_modes, _pierce, _picture,
)  # fmt: skip
WEIGHTS = (5, 2, 1, 1, 2, 1, 1, 1, 1, 2, 1, 1, 1, 1, 1, 1, 2, 1, 0.3)


def encoded(rng: Random, lines: Lines) -> bytes:
    """Return the file's bytes with some line ends, sometimes changed as by an editor."""
    kind = rng.randrange(30)
    if kind == 0:
        return b"\xef\xbb\xbf" + b"\r\n".join(lines) + b"\r\n"
    if kind == 1:
        return b"\r".join(lines)
    if kind == 2:
        return b"\n".join(lines).decode("latin-1").encode("utf-16")
    if kind == 3:
        return b"".join(line + rng.choice((b"\n", b"\r\n", b"\n\n")) for line in lines)
    if kind == 4:
        text = b"\n".join(lines)
        return text[: rng.randrange(len(text) + 1)]
    return b"\n".join(lines) + rng.choice((b"\n", b"\n", b"", b"\r\n"))


def _value(number: bytes) -> float:
    value = float(number)
    return value if math.isfinite(value) else 0.0


def scaled(factor: float, line: bytes, count: int) -> bytes:
    """Return the line with its first numbers times a factor."""
    return NUMBER.sub(lambda m: b"%.9g" % (factor * _value(m[0])), line, count=count)


def renumbered(rng: Random, line: bytes, number: bytes) -> bytes:
    """Return the line with another number in place of one of its own."""
    places = list(NUMBER.finditer(line))
    if not places:
        return line + number
    place = rng.choice(places)
    return line[: place.start()] + number + line[place.end() :]


def _marked(rng: Random, lines: Lines) -> Lines:
    """Return the lines with numbered marks between them, the last one at the end."""
    marked = []
    for k, line in enumerate(lines):
        marked.append(line)
        if rng.random() < 0.15:
            kind = rng.choice(
                (b";@%d", b";@%d", b";@%d", b"M117 @%d", b"M117 @%d", b"UNHEARD_OF @%d")
            )
            marked.append(kind % k)
    return [*marked, b";@%d" % len(lines)]


@cache
def seeds(folders: tuple[Path, ...]) -> list[bytes]:
    """Return all G-code files of some folders."""
    return [path.read_bytes() for folder in folders for path in sorted(folder.glob("*.gcode"))]
