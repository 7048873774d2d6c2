"""Convert a slice and read from the result what a slicer's user would check."""

import re
from dataclasses import replace

from hframe_post.conversion.options import Options
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.printer.settings import Printer
from hframe_post.writers.print_time import Deferred
from tests.gcode_tools import follow
from tests.slices import Slice

MOTION = re.compile(rb"\s*(?:G[01235](?!\d)|M20[1345](?!\d)|M220(?!\d)|SET_VELOCITY_LIMIT|G92 E)")
OURS = re.compile(
    rb"; processed by|; hframe-post|SET_VELOCITY_LIMIT|SET_INPUT_SHAPER|M400$|G4 P|G9[01]|M8[23]"
    rb"|M593 [FXY]|M900 K|M493 S|M494 T"
)
LAYER = r"\s*;.*layer|\(Slice"


def converted(each: Slice, printer: Printer) -> tuple[list[bytes], list[bytes], Report]:
    """Lines of the output, those of them that tell of time, and the report."""
    firmware = replace(printer.firmware, harmless=each.harmless, returns=each.returns)
    conversion = WholeFile(each.lines, replace(printer, firmware=firmware), Options("racking"))
    pieces = list(conversion.gcode())
    text = b"".join(p.text if isinstance(p, Deferred) else p for p in pieces)
    with_times = (p for p in pieces if isinstance(p, Deferred) and not p.summary)
    deferred = [p.text[a:b] for p in with_times for a, b in p.at.tolist()]
    return text.splitlines(), deferred, conversion.report


def filament(lines: list[bytes], relative: bool) -> list[float]:
    """Return the total before every layer's mark, and at the end."""
    reading = follow((b"M83\n" if relative else b"") + b"\n".join(lines), LAYER)
    return [*reading.at_layer, reading.filament]


def carried(lines: list[bytes]) -> list[bytes]:
    """What is neither motion nor the stream's, without the time that it tells at once."""
    kept = (line for line in lines if not MOTION.match(line) and not OURS.match(line))
    return [re.sub(rb"^(;TIME_ELAPSED:).*", rb"\1", line) for line in kept]
