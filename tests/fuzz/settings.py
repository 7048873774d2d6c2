"""Seeded changes to profiles and to recordings."""

from __future__ import annotations

from random import Random

from tests.fuzz.grammar import NUMBERS
from tests.fuzz.mutations import FACTORS, renumbered, scaled

VALUES = (
    *NUMBERS,
    b"1e14",
    b"1e-9",
    b"20000",
    b"true",
    b"'a'",
    b"[]",
    b"[1]",
    b"{}",
    b"1979-05-27",
)


def profile(rng: Random, texts: list[str]) -> str:
    """Return a shipped profile's text with a few changes."""
    lines = rng.choice(texts).encode().splitlines()
    for _ in range(1 + min(int(rng.expovariate(0.5)), 12)):
        k = rng.randrange(len(lines))
        kind = rng.randrange(8)
        if kind <= 3:
            lines[k] = renumbered(rng, lines[k], rng.choice(VALUES))
        elif kind == 4:
            del lines[k]
        elif kind == 5:
            lines.insert(k, rng.choice(lines))
        elif kind == 6 and lines[k]:
            at = rng.randrange(len(lines[k]))
            lines[k] = lines[k][:at] + bytes([rng.randrange(32, 127)]) + lines[k][at + 1 :]
        else:
            lines[k] = scaled(rng.choice(FACTORS), lines[k], 1)
        if not lines:
            break
    return b"\n".join(lines).decode("latin-1")


def table(rng: Random, text: bytes) -> bytes:
    """Return a recording or a command with a few changes."""
    lines = text.splitlines()
    for _ in range(1 + min(int(rng.expovariate(0.5)), 8)):
        k = rng.choice((0, 1, rng.randrange(len(lines))))
        k = min(k, len(lines) - 1)
        kind = rng.randrange(8)
        if kind <= 2:
            lines[k] = renumbered(rng, lines[k], rng.choice(NUMBERS))
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
