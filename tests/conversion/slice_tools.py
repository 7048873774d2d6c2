"""Convert a slice and read from the result what a slicer's user would check."""

import re
from dataclasses import replace

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.conversion.report import Report
from hframe_post.printer.settings import Printer
from hframe_post.writers.print_time import Deferred
from tests.slices import Slice

MOTION = re.compile(rb"\s*(?:G[01235](?!\d)|M20[1345](?!\d)|M220(?!\d)|SET_VELOCITY_LIMIT|G92 E)")
MOVE = re.compile(rb"\s*G[01235](?!\d)")
OURS = re.compile(
    rb"; processed by|; hframe-post|SET_VELOCITY_LIMIT|SET_INPUT_SHAPER|M400$|G4 P|G9[01]|M8[23]"
    rb"|M593 [FXY]|M900 K|M493 S|M494 T"
)
WORD = re.compile(rb"\bE(-?(?:\d+\.?\d*|\.\d+))")
LAYER = re.compile(rb"\s*;.*layer|\(Slice", re.IGNORECASE)


def converted(each: Slice, printer: Printer) -> tuple[list[bytes], list[bytes], Report]:
    """Lines of the output, those of them that tell of time, and the report."""
    firmware = replace(printer.firmware, harmless=each.harmless, returns=each.returns)
    conversion = GcodeConversion(
        each.lines, replace(printer, firmware=firmware), Options("racking")
    )
    pieces = list(conversion)
    text = b"".join(p.text if isinstance(p, Deferred) else p for p in pieces)
    with_times = (p for p in pieces if isinstance(p, Deferred) and not p.summary)
    deferred = [p.text[a:b] for p in with_times for a, b in p.at.tolist()]
    return text.splitlines(), deferred, conversion.report()


def filament(lines: list[bytes], relative: bool) -> list[float]:
    """Total before every layer's mark, and at the end: Klipper's reading, in ten lines."""
    total, at, printed = 0.0, 0.0, []
    absolute = True
    for line in lines:
        body = line.partition(b";")[0].split(b"(")[0]
        word = WORD.search(body)
        if LAYER.match(line):
            printed.append(total)
        elif body.startswith(b"G92") and word:
            at = float(word[1])
        elif body.startswith((b"G90", b"G91")):
            absolute = body.startswith(b"G90")
        elif body.startswith((b"M82", b"M83")):
            relative = body.startswith(b"M83")
        elif MOVE.match(body) and word:
            value = float(word[1])
            step = value if relative or not absolute else value - at
            total, at = total + step, at + step
    return [*printed, total]


def carried(lines: list[bytes]) -> list[bytes]:
    """What is neither motion nor the stream's, without the time that it tells at once."""
    kept = (line for line in lines if not MOTION.match(line) and not OURS.match(line))
    return [re.sub(rb"^(;TIME_ELAPSED:).*", rb"\1", line) for line in kept]
