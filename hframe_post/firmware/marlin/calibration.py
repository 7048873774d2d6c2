"""Motions whose duration shows which planner and which timer a Marlin board has.

``steady`` is strokes of a single block at full speed: all planners take the same time, a timer
that counts a tick more takes longer, one that smooths steps is faster. Then come ``LINES`` lines
that move nothing, whose duration shows how many arrive in a second. ``uneven`` is strokes of
short blocks that are slow and fast in turn, so that most steps belong to a ramp: it takes a time
of its own on each planner. Strokes begin and end at rest, x alone moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import PrinterError
from hframe_post.firmware.code import plain
from hframe_post.firmware.marlin.marlin_code import TRAPEZOIDS, MarlinCode, motion_limits
from hframe_post.firmware.marlin.planner import GENERATIONS, Planner, make_planner
from hframe_post.native.block_times import Timer
from hframe_post.native.whole_steps import Blocks, most_steps, motor_steps
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState

PART_S = 120.0  # of each part, about
LINES, LINE = 10_000, "G1 F3000"
# bits of such a line with number, checksum and line feed, and of its ok
LINE_BITS = 10 * (len(f"N{LINES} {LINE}*99\n") + len("ok\n"))
BAUDS = (115_200, 250_000)
EDGE_MM = 10.0  # mm of travel that stay unused on either side
BLOCK_STEPS = 24  # of x in a block of ``uneven``


@dataclass(frozen=True, slots=True)
class Part:
    """Strokes there and back over blocks: x at their ends (k + 1,), speeds asked for (k,)."""

    name: str
    x: Array
    v: Array
    strokes: int


@dataclass(frozen=True, slots=True)
class Calibration:
    """The lines of the file, and for each kind of board the seconds of each part.

    table: the profile's own, to which the durations are compared.
    """

    lines: list[bytes]
    parts: tuple[str, ...]
    durations: dict[str, tuple[float, ...]]
    table: MarlinTable

    def as_text(self) -> str:
        """Return how to print the file, and the table in which to look its durations up."""
        boards = [
            f"{board:44s}" + "".join(f"{seconds:9.2f}s" for seconds in durations)
            for board, durations in self.durations.items()
        ]
        sent = " or ".join(f"{LINES * LINE_BITS / baud:.1f} at {baud} baud" for baud in BAUDS)
        usual = LINES / self.table.lines_per_second
        classic = (
            "Built with CLASSIC_JERK, only the steady part is as in the table: it shows the timer."
        )
        return "\n".join(
            [
                "Home the printer, print the file from SD without filament, and note how long each "
                "part takes: M31",
                "reports it after the part, or take it from a stopwatch or the host's log. The row "
                "with both durations",
                "shows the keys for [firmware.marlin]:",
                " " * 44 + "".join(f"{part:>10s}" for part in self.parts),
                *boards,
                "If the steady part is shorter than in every row, the board smooths steps: set "
                "firmware.marlin.adaptive_step_smoothing.",
                *([classic] if self.table.classic_jerk else []),
                f"The part 'lines' is {LINES} lines. From SD: if it takes more than {usual:.0f} s, "
                f"set lines_per_second to {LINES} / its seconds. Over a serial line: set latency "
                f"to (its seconds - {sent}) / {LINES}.",
            ]
        )


def calibration(printer: Printer) -> Calibration:
    """Return the calibration for a printer. Raises PrinterError if its profile lacks Marlin."""
    if printer.firmware.marlin is None and printer.firmware.dialect != "marlin":
        raise PrinterError(
            f"this profile is for {printer.firmware.dialect}; only boards that run Marlin need "
            "this calibration",
            "firmware.dialect", printer.name,
        )  # fmt: skip
    marlin, matrix = MarlinCode.from_printer(printer), printer.kinematics.matrix
    left, right = (x + edge for x, edge in zip(printer.travel.x, (EDGE_MM, -EDGE_MM), strict=True))
    if right - left < 2.0 * EDGE_MM:
        cause = f"must be at least {4.0 * EDGE_MM:g} mm long for a calibration"
        raise PrinterError(cause, "travel.x", printer.name)
    belt = marlin.steps.belt
    room = math.ceil(left / belt) * belt, math.floor(right / belt) * belt
    parts = _steady(marlin, *room), _uneven(marlin, *room)
    durations = {
        name: tuple(_duration(part, marlin, matrix, planner) for part in parts)
        for name, planner in _boards(marlin)
    }
    lines = _lines(marlin, sum(printer.travel.y) / 2.0, parts)
    return Calibration(lines, tuple(part.name for part in parts), durations, marlin.table)


def _boards(marlin: MarlinCode) -> list[tuple[str, Planner]]:
    """Return the keys of the profile that stand for each kind of board, and its planner."""
    hz, found = marlin.table.timer_hz, []
    for name in GENERATIONS:
        planner = make_planner(name, Timer(hz))
        found.append((f'planner = "{name}"', planner))
        if not planner.fixed_time:
            slower = make_planner(name, Timer(hz, extra_tick=True))
            found.append((f'planner = "{name}", timer_extra_tick = true', slower))
    return found


def _steady(marlin: MarlinCode, left: float, right: float) -> Part:
    v = marlin.limits.velocity
    stroke = (right - left) / v + v / marlin.limits.acceleration
    return Part("steady", np.array([left, right]), np.array([v]), _even(PART_S / stroke))


def _uneven(marlin: MarlinCode, left: float, right: float) -> Part:
    """Return blocks on whole steps, so short that they do not reach their fast speed."""
    d, limits = BLOCK_STEPS * marlin.steps.belt, marlin.limits
    x = left + d * np.arange(int((right - left) / d) // 2 * 2 + 1)
    # at half the acceleration a fast block would just be reached
    fast = min(math.sqrt(0.5 * 2.0 * limits.acceleration * d), limits.velocity)
    v = np.where(np.arange(len(x) - 1) % 2, fast, 0.2 * fast)
    return Part("uneven", np.asarray(x), np.asarray(v), _even(PART_S / float((d / v).sum())))


def _even(strokes: float) -> int:
    return max(2, round(strokes / 2.0) * 2)


def _duration(part: Part, marlin: MarlinCode, matrix: Array, planner: Planner) -> float:
    belt = marlin.steps.belt
    cells = np.rint(np.column_stack([part.x, np.zeros_like(part.x)]) / belt).astype(np.int64)
    n = most_steps(motor_steps(cells, matrix)).astype(np.float64)
    d = np.diff(cells[:, 0]) * belt
    total = 0.0
    for order in (1, -1):  # there, and back
        n_, d_, v = (each[::order].copy() for each in (n, d, part.v))
        blocks = Blocks(n_, d_, np.floor(marlin.limits.acceleration * n_ / d_))
        v = np.ceil(60.0 * v) / 60.0  # F is whole
        joint = np.concatenate([[0.0], np.minimum(v[:-1], v[1:]), [0.0]])
        total += float(planner.stroke(blocks, joint, v)[2].sum())
    return total * part.strokes / 2.0


def _lines(marlin: MarlinCode, y: float, parts: tuple[Part, ...]) -> list[bytes]:
    """Return the file. y: where the strokes are, mm."""
    limits, table = marlin.limits, marlin.table
    a, v = plain(limits.acceleration, 0), plain(limits.velocity + 1.0, 0)
    corners = "X1 Y1 E1" if table.classic_jerk else "J0.3"  # a reversal is a stop with either
    motion = "M493 S1 X0 Y0 C0 P0" if table.planner == "ft-motion" else "M493 S0"
    text = [
        "; home first; the duration of each part shows the planner and the timer", "M400",
        "M593 F0", "M900 K0", motion, TRAPEZOIDS, *motion_limits(v, a, corners), "G90",
    ]  # fmt: skip
    for part in parts:
        x = [plain(place, 3) for place in part.x.tolist()]
        f = [plain(np.ceil(60.0 * speed), 0) for speed in part.v.tolist()]
        there = [f"G1 X{place} F{feed}" for place, feed in zip(x[1:], f, strict=True)]
        back = [f"G1 X{place} F{feed}" for place, feed in zip(x[-2::-1], f[::-1], strict=True)]
        text += [
            f"G1 X{x[0]} Y{plain(y, 3)} F3000",
            "M400",
            "G4 P2000",
            f"M118 {part.name} begins",
            "M75",
        ]
        text += (there + back) * (part.strokes // 2)
        text += ["M400", "M77", f"M118 {part.name} ends", "M31"]
    text += ["M400", "G4 P2000", "M118 lines begins", "M75"]
    text += [LINE] * LINES
    text += ["M77", "M118 lines ends", "M31"]
    state = ModalState(True, False, 0.0, 50.0, (0.0, 0.0, 0.0))  # places count as homed
    end = marlin.end(state, np.zeros(4))
    return [line.encode() + b"\n" for line in text] + [line + b"\n" for line in end]
