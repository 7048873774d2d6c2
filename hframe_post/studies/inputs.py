"""The paper's rectangle, which studies print."""

from __future__ import annotations

from hframe_post.printer.settings import Printer


def rectangle(printer: Printer) -> list[bytes]:
    """Return the paper's Fig. 7: 120 × 20 mm at 150 mm/s and 1e4 mm/s², at rest at the corners.

    It begins where racking does not move the nozzle, as in the paper, unless the bed is too
    narrow for that, and is centred on the bed in y.
    """
    low, high = printer.travel.x
    width, clear = 120, 5  # mm; the command needs some travel beyond its path
    x = max(min(printer.plant.x_c, high - width - clear), low + clear)
    y = round(sum(printer.travel.y) / 2.0) - 10
    corners = ((x + width, y), (x + width, y + 20), (x, y + 20), (x, y))
    lines = ["G28", "M83", "M204 S10000", "M205 X0 Y0 J0"]  # Marlin with either kind of corners
    lines += ["SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY=0"]  # Klipper
    lines += ["G1 Z0.2 F600", f"G0 X{x:g} Y{y:g} F9000", ";LAYER:0", ";TYPE:WALL-OUTER"]
    lines += [
        f"G1 X{x:g} Y{y:g} E{length:g}"
        for (x, y), length in zip(corners, (4, 0.7, 4, 0.7), strict=True)
    ]
    return [line.encode() + b"\n" for line in lines]
