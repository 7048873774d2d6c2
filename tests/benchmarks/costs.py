"""Cost of a sample, a move, a stop and another line: differences between drawn prints.

How it grows: the cost in prints of twice as many moves, times that in these; 1 is linear.

CPU time depends on the machine and on what else it does; instructions, as valgrind counts them
where it is installed, hardly do.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.benchmarks.speed import PAIRS, processor_s

MOVES = 1500  # of 20 mm, at 100 mm/s: five minutes
HEAD = ("cost of", "CPU, µs", "growth", "instructions", "growth")


class Drawn(NamedTuple):
    """A print of moves, each in ``split`` pieces, with stops and other lines before each.

    line: those lines, with a number below 8.
    """

    feed: int = 6000
    split: int = 1
    stop: bool = False
    lines: int = 0
    line: str = "M106 S{}"
    moves: int = MOVES

    def text(self) -> str:
        """Return its G-code."""
        rows, x, y = ["G28", "M83", "G90", "G1 X100 Y100 Z0.2 F6000"], 100.0, 100.0
        for i in range(self.moves):
            rows += ["G1 E-0.8 F3000", "G1 E0.8 F3000"] * self.stop
            rows += [self.line.format(j % 8) for j in range(self.lines)]
            to_x, to_y = (150.0 + 60.0 * f(2.4 * i) for f in (math.cos, math.sin))
            d = math.hypot(to_x - x, to_y - y)
            dx, dy = 20.0 * (to_x - x) / d, 20.0 * (to_y - y) / d
            for k in range(1, self.split + 1):
                way, off = k / self.split, 0.015 * math.sin(math.pi * k / self.split)
                place = f"X{x + way * dx - off * dy:.3f} Y{y + way * dy + off * dx:.3f}"
                rows.append(f"G1 {place} E{0.7 / self.split:.5f} F{self.feed}")
            x, y = x + dx, y + dy
        return "\n".join([*rows, ""])


PLAIN = Drawn()
# what a print has more of than the plain one, and how many at each move
MORE = {
    "a sample (ms of print)": (PLAIN._replace(feed=3000), 200),
    "a move": (PLAIN._replace(split=40), 39),
    "a stop with a retraction": (PLAIN._replace(stop=True), 1),
    "another line": (PLAIN._replace(lines=100), 100),
    "a line that names a feature": (PLAIN._replace(lines=100, line=";TYPE:FILL{}"), 100),
    "a line that labels an object": (
        PLAIN._replace(lines=100, line="EXCLUDE_OBJECT_START NAME=cube_{}"),
        100,
    ),
    "a line that repeats a pressure advance": (
        PLAIN._replace(lines=100, line="SET_PRESSURE_ADVANCE ADVANCE=0.03"),
        100,
    ),
    "a line that changes it": (
        PLAIN._replace(lines=100, line="SET_PRESSURE_ADVANCE ADVANCE=0.0{}"),
        100,
    ),
}


def rows(printer: str) -> Iterator[list[str]]:
    """Yield a row for each of MORE, as HEAD names its cells; "–": not measured here."""
    plain, longer = costs(PLAIN, printer), costs(PLAIN._replace(moves=2 * MOVES), printer)
    for name, (drawn, count) in MORE.items():
        twice = costs(drawn._replace(moves=2 * MOVES), printer)
        more = [b - a for a, b in zip(plain, costs(drawn, printer), strict=True)]
        grown = [b - a for a, b in zip(longer, twice, strict=True)]
        growth = [f"{b / (2.0 * a):.2f}" if a else "–" for a, b in zip(more, grown, strict=True)]
        seconds, instructions = (each / (count * MOVES) for each in more)
        counted = f"{instructions:,.0f}".replace(",", " ") if instructions else "–"
        yield [name, f"{1e6 * seconds:.2f}", growth[0], counted, growth[1]]


def costs(drawn: Drawn, printer: str) -> tuple[float, float]:
    """Return CPU seconds and instructions of a conversion; 0 where these cannot be counted."""
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "drawn.gcode", Path(folder) / "out.gcode"
        source.write_text(drawn.text())
        options = [str(source), "-o", str(out), "-q", "--force", "--jobs", "1", "-p", printer]
        command = [sys.executable, "-m", "hframe_post", *options]
        return min(processor_s(command) for _ in range(PAIRS)), instructions_of(command)


def instructions_of(command: list[str]) -> float:
    if shutil.which("valgrind") is None:
        return 0.0
    counting = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={os.devnull}"]
    run = subprocess.run([*counting, *command], capture_output=True, text=True, check=True)
    found = re.search(r"Collected : (\d+)", run.stderr)
    return float(found[1]) if found else 0.0
