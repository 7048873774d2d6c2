"""Test paths as G-code, for studies that need no sliced part."""

from __future__ import annotations

from hframe_post.printer import Printer

PATHS = ("rectangle",)


def rectangle(printer: Printer) -> list[bytes]:
    """The paper's Fig. 7: 120 × 20 mm at 150 mm/s and 1e4 mm/s², at rest at the corners.

    It begins where racking does not move the nozzle, as in the paper, and lies in the middle
    of the bed in y.
    """
    x, y = printer.plant.x_c, round(sum(printer.travel.y) / 2.0) - 10
    corners = ((x + 120, y), (x + 120, y + 20), (x, y + 20), (x, y))
    lines = ["G28", "M83", "M204 S10000", "M205 X0 Y0", "G1 Z0.2 F600", f"G0 X{x:g} Y{y:g} F9000"]
    lines += [";LAYER:0", ";TYPE:WALL-OUTER"]
    lines += [
        f"G1 X{x:g} Y{y:g} E{length:g}"
        for (x, y), length in zip(corners, (4, 0.7, 4, 0.7), strict=True)
    ]
    return [line.encode() + b"\n" for line in lines]
